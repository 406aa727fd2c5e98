"""An explanation of one loop on one day: the sentences, the table and the page that report it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, DOTTED, FAINT, GREY, RED, YELLOW, apply_style, mark_logarithms, wrapped
from fastcoil.design.cures import (
    DEAD_BAND,
    LONGER_TI,
    REPAIRED,
    SIMC,
    TUNINGS,
    UNSURE,
    Prediction,
    cycles_at,
    gain_margin_without_backlash,
    hunting,
    response_of,
    shortest_ti,
)
from fastcoil.design.describing_function import describing_function
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.model.metric_table import STATUS_OK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LOST = 0.5  # share of the time off the set-point from which a loop does not control
MINUTES = 120.0
"""Seconds from which a period is given in minutes."""
_NOTHING = 5e-4  # temperature difference that nobody sees, K


@dataclass(frozen=True, repr=False)
class Explanation:
    """Why one loop hunts on one day, or does not.

    Attributes
    ----------
    hunts
        Whether the simulated day hunts, see the metric of that name.
    predicted
        Whether the linear model predicts hunting at some operating point; None where it cannot tell.
    margin
        Largest describing-function margin of the day; above 0.85 a loop hunts.  NaN where theory cannot tell.
    period, amplitude
        Of the predicted cycle at the worst operating point, s and K (half of peak to peak); NaN without.
    why
        The reason in a sentence.
    doubts
        Why theory cannot tell, or what it leaves out; empty where there is nothing.
    phase
        DataArray over ``part``: degrees that each part of the loop takes at the critical frequency; None without.
    points
        Dataset over ``point``: each hour at each set-point with its margin; None where theory cannot tell.
    cures
        Dataset over ``cure``, ``as_it_is`` first: the parameters that change, the predicted ``margin``, the simulated
        metrics, ``words`` and ``verdict``.
    recommended
        The cure to take; ``as_it_is`` where the loop is good, or nothing helps.
    loop, boundary
        What was explained.
    """

    predicted: bool | None
    margin: float
    period: float
    amplitude: float
    doubts: tuple[str, ...]
    phase: xr.DataArray | None
    points: xr.Dataset | None
    cures: xr.Dataset
    recommended: str
    loop: Loop
    boundary: Boundary
    _prediction: Prediction | None
    _simulated: xr.Dataset  # the cures with their traces

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts."""
        return bool(self.cures["hunts"][0] > 0)

    @property
    def why(self) -> str:
        """The reason in a sentence."""
        return _why(self)

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        lines = [_answer(self), self.why]
        if self._prediction is not None and self.points is not None and self.phase is not None:
            lines += [*_agreement(self, self.points), _where(self.points, self._prediction.worst)]
            lines += [f"Not in the margin: {clause}." for clause in self.doubts]
            lines += ["", *_phase(self.phase)]
        return "\n".join([*lines, "", *_table(self), *_honest(self), *_advice(self)])

    def __repr__(self) -> str:
        return f"<fastcoil explanation: {_answer(self)}>"

    def __str__(self) -> str:
        return self.text

    def plot(self) -> Figure:
        """The explanation on one page, as a matplotlib ``Figure``."""
        return _page(self)

    @property
    def _failed(self) -> bool:
        return int(self.cures["status"][0]) != STATUS_OK

    @property
    def _needs_cure(self) -> bool:
        """Whether it hunts, for a part of the day at least."""
        return bool(hunting(self._simulated)[0])

    @property
    def _lost(self) -> bool:
        """Whether it is off its set-point for most of the time."""
        return bool(self.cures["share_off"][0] > _LOST)

    def _value(self, name: str, k: int = 0) -> float:
        """A parameter of the loop with a cure."""
        if name in self.cures.coords and self.cures[name].ndim:
            return float(self.cures[name][k])
        return float(self.loop[name])  # type: ignore[arg-type]

    def _number_of(self, cure: str) -> int | None:
        """Index of a cure; None if it was not tried."""
        names = self.cures["cure"].values.tolist()
        return int(names.index(cure)) if cure in names else None


def _answer(e: Explanation) -> str:
    """Whether the loop will hunt, in one sentence."""
    if e._failed:
        return "This loop cannot be simulated: temperatures leave the range of the model."
    if e.hunts:
        return f"This loop will hunt: about {_shown_swing(e)}."
    if e._lost and not e._needs_cure:
        error = kelvin(float(e.cures["rmse"][0]))
        return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
    if e.points is None or not e.predicted:
        return f"This loop will not hunt{', but it is on the edge' * _is_unsure(e)}."
    there = _hunting(e.points)
    places = f"{there.sizes['point']} of {_reached(e.points).sizes['point']} operating points"
    if e._needs_cure:
        swing = kelvin(float(there["swing"].median()))
        return f"This loop will hunt, but not all day or not regularly: by about {swing} peak to peak at {places}."
    return f"This loop will hardly hunt: theory predicts it at {places}, which the simulated day does not show."


def _why(e: Explanation) -> str:
    """The reason, in a sentence or two."""
    if e._prediction is None:
        return f"Why: theory cannot tell, since {'; '.join(e.doubts)}.  The answer is that of the simulation."
    margin, kp, ti, stroke = e.margin, *(float(e.loop[name]) for name in ("kp", "ti", "stroke_time"))  # type: ignore[arg-type]
    known = f"margin {margin:.2g}; a loop hunts above {HUNTS_ABOVE:g}"
    # the margin goes with kp
    factor = HUNTS_ABOVE / margin if margin else math.inf
    largest = number(kp * factor)
    if not e.predicted:
        if margin > HUNTS_ABOVE:
            return f"Why: {known}, so kp has to be below {largest} 1/K, but theory finds no swing that counts."
        shortest = shortest_ti(e._prediction, HUNTS_ABOVE)
        ways = [f"with {factor:.3g} times this kp"] if math.isfinite(factor) else []
        ways += [f"with a ti below {number(shortest)} s"] if shortest < ti else []
        return f"Why: {known}{', and it would ' * bool(ways)}{', or '.join(ways)}."
    if margin <= HUNTS_ABOVE:
        # calm by its margin, but not once it swings: the margin is that of swings up to 2 K
        motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
        return f"Why: {motor}a large swing keeps itself up once it has begun, though a small one dies away ({known})."
    longer = e._number_of(LONGER_TI)
    if longer is not None:
        needed = f"with this kp the loop needs about {e._value('ti', longer):g} s"
        fault = f"the integral is too fast for the coil: ti = {ti:g} s, while {needed}"
    else:
        fault = f"the gain is too high: kp = {kp:g} 1/K, while it has to be below {largest} 1/K with this ti"
    gap = e._value("backlash")
    if not gap or gain_margin_without_backlash(e._prediction) <= 1.0:
        return f"Why: {fault} ({known}).  It would swing behind a perfect valve, too."
    motor = f" and the motor's {stroke:g} s" if stroke else ""
    return f"Why: {fault} ({known}).  Any backlash starts it; its {per_cent(gap)}{motor} set the size of the swing."


def _is_unsure(e: Explanation) -> bool:
    """Whether the margin is so near its limit that it does not decide."""
    return UNSURE[0] <= e.margin <= UNSURE[1]


def _reached(points: xr.Dataset) -> xr.Dataset:
    """The operating points at which the valve can hold the set-point, and theory has a margin."""
    return points.isel(point=np.flatnonzero(points["reachable"] & np.isfinite(points["margin"])))


def _hunting(points: xr.Dataset) -> xr.Dataset:
    """Those of them at which the loop is predicted to hunt."""
    there = _reached(points)
    return there.isel(point=np.flatnonzero(there["hunts"] > 0.0))


def _shown_swing(e: Explanation) -> str:
    """The swing of the simulated day."""
    swing, period = (float(e.cures[name][0]) for name in ("hunting_swing", "hunting_period"))
    return f"{kelvin(swing)} peak to peak every {seconds(period)}"


def seconds(value: float) -> str:
    """A period in words."""
    if not math.isfinite(value):
        return "now and then"
    return f"{number(value)} s" if value < MINUTES else f"{number(value / 60.0)} min"


def kelvin(value: float) -> str:
    """A temperature difference in words."""
    return f"{number(value)} K" if abs(value) >= _NOTHING else "0 K"


def number(value: float) -> str:
    """Two digits, without an exponent where it is large."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def per_cent(value: float) -> str:
    """A fraction in words."""
    return f"{100.0 * value:.3g} %"


_HEAD = ("", "margin", "RMSE", "swing", "motor travel", "")


def _table(e: Explanation) -> list[str]:
    """A heading and a row for each cure: what is now in numbers, the others relative to it."""
    ds = e.cures
    margin, error, swing, travel = (ds[name].values for name in ("margin", "rmse", "hunting_swing", "motor_travel"))
    rows: list[tuple[str, ...]] = [_HEAD]
    for k, words in enumerate(ds["words"].values.tolist()):
        if k:
            change = f"{100 * (error[k] / error[0] - 1):+.0f} %"
            moved, says = f"× {number(travel[k] / travel[0])}" if travel[0] > 0 else "–", str(ds["verdict"].values[k])
        else:
            change, moved = f"{error[0]:.3g} K", f"{travel[0]:.3g} strokes"
            says = "hunts" if e.hunts else "hunts in part" if e._needs_cure else "does not hunt"
        cells = (f"{margin[k]:.2f}", change, kelvin(swing[k]), moved)
        known = np.isfinite([margin[k], error[k], swing[k], travel[k]])
        rows.append((words, *(cell if is_known else "–" for cell, is_known in zip(cells, known, strict=True)), says))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for words, *numbers, says in rows:
        padded = [cell.rjust(width) for cell, width in zip(numbers, widths[1:-1], strict=True)]
        lines.append("  ".join([words.ljust(widths[0]), *padded, says]).rstrip())
    return ["What could be done, and what it costs: the day simulated with each", *lines]


_LEAST_SHARE = 0.5  # degrees; less is not shown
_PARTS = {
    "integral": "integral of the PI",
    "coil": "coil",
    "sensor": "sensor",
    "sampling": "sampling and hold",
    "backlash": "backlash (and motor)",
}


def _agreement(e: Explanation, points: xr.Dataset) -> list[str]:
    """What theory predicts beside what the simulation shows."""
    if e._failed:
        return []
    shown = _shown_swing(e) if e.hunts else f"no hunting, RMS error {kelvin(float(e.cures['rmse'][0]))}"
    lines = [f"Predicted: {_cycle(_hunting(points))}; simulated over the day: {shown}."]
    if _is_unsure(e) or e.predicted != e.hunts:
        lines.append(f"Near a margin of {HUNTS_ABOVE:g}, or where the two disagree, go by the simulation.")
    return lines


def _cycle(points: xr.Dataset) -> str:
    """The cycles that are predicted at these operating points."""
    if not points.sizes["point"]:
        return "no cycle"
    swings, periods = 2.0 * points["amplitude"].values, points["period"].values
    if not np.isfinite(swings).any():
        return "a cycle, of a size that theory does not give"
    every = _span(periods, "s") if float(np.nanmax(periods)) < MINUTES else _span(periods / 60.0, "min")
    return f"{_span(swings, 'K')} peak to peak every {every}"


def _span(values: Array, unit: str) -> str:
    low, high = (number(float(end)) for end in (np.nanmin(values), np.nanmax(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _where(points: xr.Dataset, worst: int) -> str:
    """Which operating point is quoted, what happens there, and how the margin differs over the day."""
    at, margin = points.isel(point=worst), _reached(points)["margin"].values
    place = f"{float(at['T_set']):.3g} °C, {float(at['start']) / 3600.0:.3g} h after the start"
    place += f" (opening {100 * float(at['opening']):.0f} %)"
    swing, shown = 2.0 * float(at["amplitude"]), float(at["swing"])
    if math.isfinite(swing) and math.isfinite(shown):
        place += f": {kelvin(swing)} predicted, {kelvin(shown)} simulated"
    if points.sizes["point"] == 1:
        return f"Where: at {place}."
    return (
        f"Where: worst at {place}.  Over the day the margin goes from {margin.min():.2g} to {margin.max():.2g}, and "
        f"{_hunting(points).sizes['point']} of {margin.size} operating points are predicted to hunt."
    )


def _phase(phase: xr.DataArray) -> list[str]:
    """What each part of the loop takes, the largest first."""
    shares = zip(phase["part"].values.tolist(), phase.values.tolist(), strict=True)
    ordered = sorted(shares, key=lambda of: -of[1])
    taken = [f"  {_PARTS[part]:<22}{share:>4.0f}°" for part, share in ordered if abs(share) >= _LEAST_SHARE]
    return [f"Where the 180° of phase go, at one swing in {seconds(float(phase.attrs['period']))}:", *taken]


def _honest(e: Explanation) -> list[str]:
    """What a dead band does not do; what backlash costs a loop that does not hunt."""
    repaired, band = e._number_of(REPAIRED), e._number_of(DEAD_BAND)
    if e._needs_cure:
        width = e._value("error_dead_band", band) if band is not None else 0.0
        return [f"The dead band leaves the margin as it is, and holds any error up to {width:g} K."] * bool(width)
    if repaired is None or e._failed:
        return []
    error, without = (kelvin(float(e.cures["rmse"][k])) for k in (0, repaired))
    size = per_cent(e._value("backlash"))
    return [f"What the backlash of {size} costs anyway: RMSE {error} instead of {without}."] * (error != without)


def _advice(e: Explanation) -> list[str]:
    best = e._number_of(e.recommended)
    if e._failed:
        return []
    if not best:
        if e._needs_cure:
            return ["None of these cures it."]
        if e._lost:
            return ["None of these makes it hold its set-point."]
        return ["Leave it: none of these takes 5 % off the error."]
    error, travel = e.cures["rmse"].values, e.cures["motor_travel"].values
    moved = f", motor travel × {number(travel[best] / travel[0])}" if travel[0] else ""
    then_do = "Do this" if e._needs_cure else "If the error matters"
    return [f"{then_do}: {e.cures['words'].values[best]}: RMSE {100 * (error[best] / error[0] - 1.0):+.0f} %{moved}."]


_SIZE, _WITHOUT_THEORY = (7.5, 7.5), (7.5, 3.8)
_TELLING, _BEFORE = 5400, 600  # seconds that are drawn, and how many of them before the worst operating point
_PHASES = (-200.0, -85.0)  # degrees: where a backlash may bring the phase to -180°, and some more
_SPAN, _TI_STEPS = 8.0, 60  # the map goes from the gains of now and the cures, divided by this, to as many times them
_LABEL = 0.85  # where on a contour its label is, as a share of its length
_CONTOURS = (0.4, HUNTS_ABOVE, 1.7)
_ON_WHITE = {"fc": "white", "ec": "none", "pad": 0.6}
_MARKS = {"lower_kp": "v", "longer_ti": ">", "simc": "s"}


@apply_style()
def _page(e: Explanation) -> Figure:
    """The explanation as a page; where theory cannot tell, the day alone."""
    from matplotlib.figure import Figure

    if e._prediction is None:
        fig = Figure(figsize=_WITHOUT_THEORY, layout="constrained")
        _day(fig.add_subplot(), e)
    else:
        fig = Figure(figsize=_SIZE, layout="constrained")
        grid = fig.add_gridspec(2, 2, height_ratios=(1.5, 1.0))
        _nichols(fig.add_subplot(grid[0, 0]), e._prediction)
        _gains(fig.add_subplot(grid[0, 1]), e, e._prediction)
        _day(fig.add_subplot(grid[1, :]), e)
    heading = wrapped(f"{_answer(e)}\n{e.why}", _SIZE[0] - 0.3, 9.0)
    fig.suptitle(heading, x=0.01, ha="left", fontsize=9)
    return fig


def _nichols(axes: Axes, prediction: Prediction) -> None:
    """Gain of L and of -1/N over their phase: the margin is how far L is above -1/N at the same phase."""
    response = response_of(prediction)
    k, L, phase = response.nearest, np.abs(response.L), response.left - 180.0
    margin, at = prediction.margin, float(phase[k])
    edge = float(L[k]) / margin if margin else float(L[k])
    seen = (phase > _PHASES[0] - 5.0) & (phase < _PHASES[1] + 5.0)
    axes.plot(phase[seen], L[seen], color=BLUE, label="loop L(jω)")
    N = describing_function(np.geomspace(0.5 + 1e-6, 500.0, 300), np.ones(1), np.ones(1))  # of any gap
    axes.plot(-180.0 - np.degrees(np.angle(N)), 1.0 / np.abs(N), color=RED, ls="--", label="backlash −1/N")
    axes.plot(-180.0, 1.0, "+", color="black", ms=8)
    axes.plot([at, at], [edge, L[k]], color="black", lw=0.9, ls=DOTTED)
    axes.plot(at, L[k], "o", color=BLUE, ms=6)
    axes.plot(at, edge, "o", mfc="white", color=RED, ms=6)
    words, beside = f"margin {margin:.2g}", (7, 0)
    axes.annotate(words, (at, edge), beside, textcoords="offset points", va="center", fontsize=8, bbox=_ON_WHITE)
    if prediction.hunts:
        there = response.cycle
        axes.plot(phase[there], L[there], "D", color=YELLOW, mec="black", mew=0.6, ms=6, ls="none",
                  label=f"cycle, every {seconds(response.period)}")  # fmt: skip
    ends = [edge, float(L[k]), float(L[response.cycle]), 1.0]
    axes.set(yscale="log", xlim=_PHASES, ylim=(0.4 * min(ends), 4.0 * max(ends)), xlabel="phase [°]", ylabel="gain")
    axes.set_xticks(range(-180, -80, 30))
    mark_logarithms(axes.yaxis)
    axes.set_title("Hunts where L is above −1/N", loc="left")
    axes.legend(loc="lower right", frameon=False)


def _gains(axes: Axes, e: Explanation, prediction: Prediction) -> None:
    """Which kp and ti hunt at the worst operating point; the margin goes with kp."""
    kp, ti = e._value("kp"), e._value("ti")
    tunings = [k for k, name in enumerate(e.cures["cure"].values) if name in TUNINGS]
    marked_kp, marked_ti = ([e._value(name, k) for k in (0, *tunings)] for name in ("kp", "ti"))
    times = np.geomspace(min(marked_ti) / _SPAN, max(marked_ti) * _SPAN, _TI_STEPS)
    swept = e.loop.assign(ti=("tuning", times))
    at_kp = cycles_at(swept, prediction.plants, np.array([prediction.worst])).margin[:, 0]
    low, high = min(marked_kp) / _SPAN, max(marked_kp) * _SPAN
    with np.errstate(divide="ignore"):
        limits = {level: kp * level / at_kp for level in _CONTOURS}
    edge = np.clip(limits[HUNTS_ABOVE], low, high)
    axes.fill_between(times, edge, high, color=FAINT, lw=0, label=f"hunts (margin > {HUNTS_ABOVE:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(times, limits[level], color="black" if level == HUNTS_ABOVE else GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[int(_LABEL * inside.size)]
            axes.text(times[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center", bbox=_ON_WHITE)
    axes.plot(ti, kp, "o", color=RED, ms=7, label="as it is")
    for k, own_kp, own_ti in zip(tunings, marked_kp[1:], marked_ti[1:], strict=True):
        name = str(e.cures["cure"].values[k])
        colour, words = BLUE if e.cures["hunts"][k] == 0 else YELLOW, "SIMC" if name == SIMC else name.replace("_", " ")
        axes.plot(own_ti, own_kp, _MARKS[name], ms=7, color=colour, mec="black", mew=0.6, ls="none", label=words)
    axes.set(xscale="log", yscale="log", xlim=(times[0], times[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Which gains hunt, by their margin", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _day(axes: Axes, e: Explanation) -> None:
    """Part of the day as it is, and with the recommended cure."""
    ds, prediction, n_steps = e._simulated, e._prediction, e.boundary.n_steps
    t, best = ds["elapsed_time"].values, e._number_of(e.recommended)
    middle = int(prediction.points.start[prediction.worst]) if prediction is not None else n_steps // 2
    start = max(0, min(middle - _BEFORE, n_steps - _TELLING))
    seen = (t >= start) & (t < start + _TELLING)
    hours = t[seen] / 3600.0
    axes.plot(hours, ds["T_sup"][0][seen], color=RED, lw=1.0, label="as it is")
    if best:
        axes.plot(hours, ds["T_sup"][best][seen], color=BLUE, lw=1.2, label=str(ds["words"].values[best]))
    T_set = e.boundary.series["T_set"][0][t[seen].astype(int)]
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
