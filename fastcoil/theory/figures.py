"""Bode and Nyquist plots of a loop: how near it is to swinging, without its gap and because of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fastcoil.arrays import Array
from fastcoil.boundary import Boundary
from fastcoil.errors import InputError
from fastcoil.plots.style import COLOURS, DOTTED, FAINT, LINE_STYLES, apply_style, wrapped
from fastcoil.simulation.loop import Loop
from fastcoil.theory.describing_function import describing_function
from fastcoil.theory.margins import Margins, margins_of
from fastcoil.theory.operating_points import OperatingPoints, require_pi
from fastcoil.theory.plants import loop_response, plants_of
from fastcoil.theory.response import Complex

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOWEST, _FREQUENCIES = 1e-6, 4000
"""Of the curves, rad/s and number."""
_HIGH, _LOW = 30.0, 0.01
"""Sizes of L between which a Bode plot shows it."""
_REACH = 3.0
"""A Nyquist plot shows this much of the plane to the left and below."""
_READING = (
    "A loop hunts where L reaches beyond -1/N, at a margin |L| |N| above 1.  Dots: the cycle, or for a loop that does "
    "not hunt the frequency at which it is nearest to one."
)
_WIDTH = 6.5
"""Inches."""
_OPEN: Any = {"frameon": False, "handlelength": 2.5}


class _Curve(NamedTuple):
    """One loop: what the legend calls it, its frequencies [rad/s], L there, its gap, and its margins."""

    words: str
    w: Array
    L: Complex
    gap: float
    margins: Margins


@apply_style()
def bode(loop: Loop, boundary: Boundary, *, at: Any = None) -> Figure:
    """Draw magnitude and phase of the open loop L, with gain margin and phase margin.

    Shaded is the phase at which a gap, which lags by up to 90°, can close the loop.  Up to three loops.

    Parameters
    ----------
    loop, boundary, at
        As for ``linearise``.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more loops than a figure shows.
    """
    from matplotlib.figure import Figure

    curves = _curves(loop, boundary, at)
    figure = Figure(figsize=(_WIDTH, 5.0), layout="constrained")
    size, phase = figure.subplots(2, 1, sharex=True)
    size.axhline(1.0, color="black", lw=0.8, ls=DOTTED)
    phase.axhline(-180.0, color="black", lw=0.8, ls=DOTTED)
    phase.axhspan(-180.0, -90.0, color=FAINT, lw=0)
    deepest = -200.0
    for curve, colour, line in zip(curves, COLOURS, LINE_STYLES, strict=False):
        degrees = np.degrees(np.unwrap(np.angle(curve.L)))
        gain_margin, phase_margin = curve.margins.gain_margin[0], curve.margins.phase_margin[0]
        words = f"gain margin {gain_margin:.2g}, phase margin {phase_margin:.0f}°"
        words = f"{curve.words}: {words}" if curve.words else words
        size.loglog(curve.w, np.abs(curve.L), color=colour, ls=line, label=words)
        phase.semilogx(curve.w, degrees, color=colour, ls=line)
        _mark(size, curve.w, degrees + 180.0, np.abs(curve.L), 1.0, colour)
        _mark(phase, curve.w, -np.log(np.abs(curve.L)), degrees, -180.0, colour)
        deepest = min(deepest, float(degrees[np.abs(curve.L) > _LOW].min(initial=-180.0)))
    shown = [curve.w[(np.abs(curve.L) < _HIGH) & (np.abs(curve.L) > _LOW)] for curve in curves]
    ends = [w for w in shown if w.size]
    if ends:
        first, last = min(w[0] for w in ends), max(w[-1] for w in ends)
        ticks = np.outer(10.0 ** np.arange(-7, 2), [1.0, 2.0, 5.0]).ravel()
        size.set_xlim(first, last)
        size.set_xticks(ticks[(ticks > first) & (ticks < last)])
        size.xaxis.set_major_formatter("{x:g}")
        size.minorticks_off()
    size.set_ylim(_LOW, _HIGH)
    phase.set_ylim(deepest - 10.0, -45.0)
    phase.set_yticks(np.arange(-90.0, deepest - 10.0, -45.0))
    size.set_yticks([0.01, 0.1, 1.0, 10.0])
    size.set_ylabel("|L|")
    phase.set(xlabel="angular frequency [rad/s]", ylabel="phase of L [°]")
    size.legend(loc="lower left", **_OPEN)
    phase.set_title("Shaded: where the lag of a gap, up to 90°, can close the loop", loc="left")
    return figure


@apply_style()
def nyquist(loop: Loop, boundary: Boundary, *, at: Any = None) -> Figure:
    """Draw the open loop L in the complex plane, with -1/N(A) of the gap and the margin between the two.

    N(A) is the describing function of the gap for an input that swings by A.  Where L reaches -1/N the loop hunts; the
    margin |L| |N| is marked where it is largest.  Up to three loops.

    Parameters
    ----------
    loop, boundary, at
        As for ``linearise``.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more loops than a figure shows.
    """
    from matplotlib.figure import Figure

    curves = _curves(loop, boundary, at)
    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    axes = figure.subplots()
    for place in (axes.axhline, axes.axvline):
        place(0.0, color="black", lw=0.6)
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), color="black", lw=0.8, ls=DOTTED)
    axes.plot(-1.0, 0.0, "+", color="black", ms=9)
    if any(curve.gap > 0.0 for curve in curves):
        N = describing_function(0.5 / _DEPTHS, np.array(1.0), np.array(1.0))
        axes.plot(-(1.0 / N).real, -(1.0 / N).imag, color="black", lw=1.2, ls="-.", label="-1/N of the gap")
    for curve, colour, line in zip(curves, COLOURS, LINE_STYLES, strict=False):
        near = np.abs(curve.L) < 3.0 * _REACH
        margin, on_L, on_N = _nearest(curve)
        label = ", ".join(filter(None, [curve.words, f"margin {margin:.2g}" if curve.gap > 0.0 else ""])) or "L"
        axes.plot(curve.L.real[near], curve.L.imag[near], color=colour, ls=line, label=label)
        if margin > 0.0 and curve.gap > 0.0:
            axes.plot([on_L.real, on_N.real], [on_L.imag, on_N.imag], color=colour, lw=0.8, marker="o", ms=3.5)
    axes.set(xlim=(-_REACH, 1.2), ylim=(-_REACH, 1.2), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.legend(loc="lower right", framealpha=0.8, edgecolor="none")
    if any(curve.gap > 0.0 for curve in curves):
        axes.set_title(wrapped(_READING, 0.75 * _WIDTH, 9), loc="left")
    return figure


_DEPTHS = np.linspace(0.002, 0.995, 500)
"""Half the gap over the amplitude at its input."""


def _curves(loop: Loop, boundary: Boundary, at: Any) -> list[_Curve]:
    points = OperatingPoints(loop, boundary, at)
    require_pi(points.loop)
    if points.size > len(COLOURS):
        raise InputError(f"{points.size} loops: a figure shows up to {len(COLOURS)}, select some")
    index = np.arange(points.size)
    columns = points.columns(index)
    plants = plants_of(columns, points.conditions(index))
    names, found = points.labels(), []
    for k in index:
        one = {name: values[k : k + 1] for name, values in columns.items()}
        plant = plants.some(index[k : k + 1])
        w = np.geomspace(_LOWEST, math.pi / float(one["sample_time"][0]), _FREQUENCIES)
        L = loop_response(one, plant, w)[0]
        found.append(_Curve(names[k], w, L, float(one["backlash"][0]), margins_of(one, plant)))
    return found


def _nearest(curve: _Curve) -> tuple[float, complex, complex]:
    """Largest |L| |N| where both lag 180° together; L and -1/N of the cycle, or where they are nearest to one."""
    N = describing_function(0.5 / _DEPTHS, np.array(1.0), np.array(1.0))
    left = np.pi + np.unwrap(np.angle(curve.L))
    size = np.nan_to_num(np.interp(left, -np.angle(N), np.abs(N), left=math.nan, right=math.nan))
    product = np.abs(curve.L) * size
    margin = float(product.max())
    # of the two cycles at a margin above 1 the faster is the stable one: it is where the product falls through 1
    k = int(np.flatnonzero(product >= 1.0)[-1] if margin >= 1.0 else np.argmax(product))
    return margin, complex(curve.L[k]), complex(curve.L[k]) / max(product[k], 1e-9)


def _mark(axes: Axes, w: Array, crossing: Array, values: Array, level: float, colour: str) -> None:
    """A line from a curve to a level where ``crossing`` first changes its sign: a margin."""
    change = np.flatnonzero(crossing[:-1] * crossing[1:] < 0.0)
    if change.size:
        k = change[0]
        axes.plot([w[k], w[k]], [values[k], level], color=colour, lw=0.8, marker="o", ms=3.5)
