"""Bode and Nyquist plots of a loop: how near it is to swinging, without its gap and because of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.figures import COLOURS, DOTTED, FAINT, LINE_STYLES, apply_style, mark_logarithms, wrapped
from fastcoil.design.describing_function import Elements, limited, swings_of
from fastcoil.design.limit_cycle import MOST, Cycles, cycles_of
from fastcoil.design.linearise import Margins, margins_of
from fastcoil.design.operating_points import OperatingPoints, require_pi
from fastcoil.design.plants import Columns, Complex, Plants, loop_response, plants_of
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LOWEST, _FREQUENCIES = 1e-6, 4000  # of the curves, rad/s and number
_HIGH, _LOW = 30.0, 0.01  # sizes of L between which a Bode plot shows it
_REACH = 3.0  # A Nyquist plot shows this much of the plane to the left and below
_READING = (
    "Thick: L. Thin: -1/N. A loop hunts where L reaches -1/N, or nearly. One dot: the cycle. Two dots: the frequency "
    "at which a loop that does not hunt comes nearest to one."
)
_AMPLITUDES, _SMALLEST = 400, 1e-3  # number of amplitudes, and least |N| that is drawn
_WIDTH = 6.5  # inches
_OPEN: Any = {"frameon": False, "handlelength": 2.5}


class _Curve(NamedTuple):
    """One loop: what the legend calls it, its frequencies [rad/s] and L there, and what theory predicts.

    minus_1_over_N: over the amplitude, at the frequency of the cycle or, without one, of the margin; empty where theory
    says nothing.  at: that frequency.
    """

    words: str
    w: Array
    L: Complex
    minus_1_over_N: Complex
    at: float
    margins: Margins
    cycles: Cycles

    @property
    def hunts(self) -> bool:
        """Whether it is predicted to hunt."""
        return bool(self.cycles.hunts[0] > 0.0)

    def label(self, words: str) -> str:
        """What the legend says of it."""
        return f"{self.words}: {words}" if self.words else words


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
        size.loglog(curve.w, np.abs(curve.L), color=colour, ls=line, label=curve.label(words))
        phase.semilogx(curve.w, degrees, color=colour, ls=line)
        _mark(size, curve.w, degrees + 180.0, np.abs(curve.L), 1.0, colour)
        _mark(phase, curve.w, 1.0 - np.abs(curve.L), degrees, -180.0, colour)
        deepest = min(deepest, float(degrees[np.abs(curve.L) > _LOW].min(initial=-180.0)))
    shown = np.concatenate([curve.w[(np.abs(curve.L) < _HIGH) & (np.abs(curve.L) > _LOW)] for curve in curves])
    if shown.size:
        size.set_xlim(shown.min(), shown.max())
    mark_logarithms(size.xaxis)
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
    """Draw the open loop L in the complex plane, with -1/N(A) and the margin between the two.

    N(A) is the describing function, for an input that swings by A, of all that lies between the controller and the
    supply temperature and is not linear: see ``limit_cycle``.  Up to three loops.

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
    axes.axhline(0.0, color="black", lw=0.6)
    axes.axvline(0.0, color="black", lw=0.6)
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), color="black", lw=0.8, ls=DOTTED)
    axes.plot(-1.0, 0.0, "+", color="black", ms=9)
    for curve, colour, line in zip(curves, COLOURS, LINE_STYLES, strict=False):
        near = np.abs(curve.L) < 3.0 * _REACH
        answer = "hunts" if curve.hunts else "does not hunt"
        words = f"margin {curve.cycles.margin[0]:.2g}, {answer}" if curve.minus_1_over_N.size else "not predicted"
        axes.plot(curve.L.real[near], curve.L.imag[near], color=colour, ls=line, label=curve.label(words))
        axes.plot(curve.minus_1_over_N.real, curve.minus_1_over_N.imag, color=colour, lw=0.7, label="_-1/N")
        if curve.cycles.margin[0] > 0.0:
            on_L = complex(np.interp(curve.at, curve.w, curve.L))  # where the loop hunts, or comes nearest to it
            pair = np.array([on_L] if curve.hunts else [on_L, on_L / curve.cycles.margin[0]])
            axes.plot(pair.real, pair.imag, color=colour, lw=0.8, ls=DOTTED, marker="o", ms=3.5)
    axes.set(xlim=(-_REACH, 1.2), ylim=(-_REACH, 1.2), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.legend(loc="upper left", framealpha=0.8, edgecolor="none")
    axes.set_title(wrapped(_READING, 0.75 * _WIDTH, 9), loc="left")
    return figure


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
        cycles = cycles_of(one, plant)
        at = float(2.0 * math.pi / cycles.period[0] if cycles.hunts[0] > 0.0 else cycles.frequency[0])
        curve = _minus_1_over_N(one, plant, at)
        words = names[k] if plant.reachable[0] else ", ".join(filter(None, [names[k], "set-point out of reach"]))
        found.append(_Curve(words, w, L, curve, at, margins_of(one, plant), cycles))
    return found


def _minus_1_over_N(columns: Columns, plant: Plants, at: float) -> Complex:
    """Over the amplitude of u, at a frequency [rad/s]; empty where theory says nothing."""
    if not math.isfinite(at):
        return np.empty(0, complex)
    elements, swings = Elements.of(columns), swings_of(plant.curve, plant.T_sup, plant.gain)
    amplitudes = elements.amplitudes(MOST, _AMPLITUDES)
    mean = elements.mean(amplitudes, swings)
    N = elements.describe(amplitudes, np.array(at), swings, limited(amplitudes, -mean, 1.0 - mean))[0]
    return np.asarray(-1.0 / N[np.abs(N) > _SMALLEST])


def _mark(axes: Axes, w: Array, crossing: Array, values: Array, level: float, colour: str) -> None:
    """A line from a curve to a level where ``crossing`` first changes its sign: a margin."""
    change = np.flatnonzero(crossing[:-1] * crossing[1:] < 0.0)
    if change.size:
        k = change[0]
        axes.plot([w[k], w[k]], [values[k], level], color=colour, lw=0.8, marker="o", ms=3.5)
