"""The Nyquist plot of a loop: how near it is to swinging, without its gap and because of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.figures import COLOURS, DOTTED, LINE_STYLES, apply_style, wrapped
from fastcoil.design.describing_function import Elements, limited, swings_of
from fastcoil.design.limit_cycle import MOST, cycles_of
from fastcoil.design.operating_points import OperatingPoints, require_pi
from fastcoil.design.plants import Columns, Complex, Plants, loop_response, plants_of
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labels import label_in_words
from fastcoil.loops.loop import Loop

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_LOWEST, _FREQUENCIES = 1e-6, 4000  # of the curves, rad/s and number
_REACH = 3.0  # A Nyquist plot shows this much of the plane to the left and below
_READING = (
    "Thick: L. Thin: -1/N. A loop hunts where L reaches -1/N, or nearly. One dot: the cycle. Two dots: the frequency "
    "at which a loop that does not hunt comes nearest to one."
)
_AMPLITUDES, _SMALLEST = 400, 1e-3  # number of amplitudes, and least |N| that is drawn
_WIDTH = 6.5  # inches


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

    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    axes = figure.subplots()
    axes.axhline(0.0, color="black", lw=0.6)
    axes.axvline(0.0, color="black", lw=0.6)
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), color="black", lw=0.8, ls=DOTTED)
    axes.plot(-1.0, 0.0, "+", color="black", ms=9)
    for (words, columns, plant), colour, line in zip(_loops(loop, boundary, at), COLOURS, LINE_STYLES, strict=False):
        w, L = _open_loop(columns, plant)
        cycles = cycles_of(columns, plant)
        margin, hunts = float(cycles.margin[0]), bool(cycles.hunts[0] > 0.0)
        critical = float(2.0 * math.pi / cycles.period[0] if hunts else cycles.frequency[0])
        minus_1_over_N = _minus_1_over_N(columns, plant, critical)
        answer = f"margin {margin:.2g}, {'hunts' if hunts else 'does not hunt'}"
        near = np.abs(L) < 3.0 * _REACH
        label = f"{words}{answer if minus_1_over_N.size else 'not predicted'}"
        axes.plot(L.real[near], L.imag[near], color=colour, ls=line, label=label)
        axes.plot(minus_1_over_N.real, minus_1_over_N.imag, color=colour, lw=0.7, label="_-1/N")
        if margin > 0.0:
            on_L = complex(np.interp(critical, w, L))  # where the loop hunts, or comes nearest to it
            pair = np.array([on_L] if hunts else [on_L, on_L / margin])
            axes.plot(pair.real, pair.imag, color=colour, lw=0.8, ls=DOTTED, marker="o", ms=3.5)
    axes.set(xlim=(-_REACH, 1.2), ylim=(-_REACH, 1.2), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.legend(loc="upper left", framealpha=0.8, edgecolor="none")
    axes.set_title(wrapped(_READING, 0.75 * _WIDTH, 9), loc="left")
    return figure


def _loops(loop: Loop, boundary: Boundary, at: Any) -> Iterator[tuple[str, Columns, Plants]]:
    """What the legend calls each loop, with a colon behind, its parameters and its plant."""
    points = OperatingPoints(loop, boundary, at)
    require_pi(points.loop)
    if points.size > len(COLOURS):
        raise InputError(f"{points.size} loops: a figure shows up to {len(COLOURS)}, select some")
    index = np.arange(points.size)
    columns = points.columns(index)
    plants = plants_of(columns, points.conditions(index))
    labelled = points.dataset({})
    for k, place in enumerate(np.ndindex(*points.sizes.values())):
        labels = [label_in_words(labelled, dim, i) for dim, i in zip(points.sizes, place, strict=True)]
        words = ", ".join([*labels, *([] if plants.reachable[k] else ["set-point out of reach"])])
        one = {name: values[k : k + 1] for name, values in columns.items()}
        yield f"{words}: " if words else "", one, plants.some(index[k : k + 1])


def _open_loop(columns: Columns, plant: Plants) -> tuple[Array, Complex]:
    """Frequencies, rad/s, up to the highest that the controller can make, and L there."""
    w = np.geomspace(_LOWEST, math.pi / float(columns["sample_time"][0]), _FREQUENCIES)
    return w, loop_response(columns, plant, w)[0]


def _minus_1_over_N(columns: Columns, plant: Plants, at: float) -> Complex:
    """-1/N over the amplitude of u, at a frequency [rad/s]; empty where theory says nothing."""
    if not math.isfinite(at):
        return np.empty(0, complex)
    elements, swings = Elements.of(columns), swings_of(plant.curve, plant.T_sup, plant.gain)
    amplitudes = elements.amplitudes(MOST, _AMPLITUDES)
    mean = elements.mean(amplitudes, swings)
    N = elements.describe(amplitudes, np.array(at), swings, limited(amplitudes, -mean, 1.0 - mean))[0]
    return np.asarray(-1.0 / N[np.abs(N) > _SMALLEST])
