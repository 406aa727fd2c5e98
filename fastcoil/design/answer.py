"""What was found about one loop on one day: the sentences, the table and the page that report it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, DOTTED, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.design.cures import (
    DEAD_BAND,
    LONGER_TI,
    REPAIRED,
    SIMC,
    TUNINGS,
    UNSURE,
    Prediction,
    Response,
    cycles_at,
    hunting,
    of_a_gap,
)
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.model.metric_table import STATUS_OK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LOST = 0.5  # share of the time off the set-point from which a loop does not control


class Theory(NamedTuple):
    """What theory tells of a loop.

    response, phase, gain_margin: at the worst operating point; phase has the degrees that each part of the loop takes
    over ``part``; the gain margin is that behind a perfect valve.  swings: simulated at each operating point, K.
    kp_factor: kp could be that many times as large, below 1: it has to shrink to that, before the margin is that from
    which a loop hunts; infinite where it has none.  ti: shortest integral time with a margin of 0.85 at this kp, s; NaN
    if none has it.
    """

    prediction: Prediction
    response: Response
    kp_factor: float
    ti: float
    phase: xr.DataArray
    gain_margin: float
    swings: Array

    @property
    def too_large(self) -> bool:
        """Whether the margin alone makes it hunt: a slow motor may keep a large swing up where it does not."""
        return self.prediction.margin > HUNTS_ABOVE

    @property
    def unsure(self) -> bool:
        """Whether the margin is so near its limit that it does not decide."""
        return UNSURE[0] <= self.prediction.margin <= UNSURE[1]

    @property
    def points(self) -> xr.Dataset:
        """The operating points with their margins."""
        points, plants, cycles, _ = self.prediction
        kelvin, second = {"units": "K"}, {"units": "s"}
        return xr.Dataset(
            {
                "start": ("point", points.start, second | {"long_name": "first second"}),
                "seconds": ("point", points.seconds, second | {"long_name": "seconds spent there"}),
                **{name: ("point", values) for name, values in points.conditions.items()},
                "opening": ("point", plants.opening),
                "gain": ("point", plants.gain, kelvin | {"long_name": "change per unit of opening"}),
                "reachable": ("point", plants.reachable),
                "margin": ("point", cycles.margin),
                "hunts": ("point", cycles.hunts),
                "period": ("point", cycles.period, second),
                "amplitude": ("point", cycles.amplitude, kelvin | {"long_name": "half of peak to peak"}),
                "swing": ("point", self.swings, kelvin | {"long_name": "simulated, peak to peak"}),
            }
        )


class Found(NamedTuple):
    """Everything behind an explanation.

    loop, boundary: a single scenario.  theory: None where theory cannot tell, for the reasons in ``doubts``.
    left_out: what the margin does not see.
    cures: over ``cure``, as it is first, with the trace T_sup.  best: index of the recommended one.
    """

    loop: Loop
    boundary: Boundary
    theory: Theory | None
    doubts: tuple[str, ...]
    left_out: tuple[str, ...]
    cures: xr.Dataset
    best: int

    @property
    def now(self) -> xr.Dataset:
        """The loop as it is, simulated."""
        return self.cures.isel(cure=0)

    @property
    def failed(self) -> bool:
        """Whether the simulation of the loop as it is failed."""
        return int(self.now["status"]) != STATUS_OK

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts."""
        return bool(self.now["hunts"] > 0)

    @property
    def lost(self) -> bool:
        """Whether it is off its set-point for most of the time."""
        return bool(self.now["share_off"] > _LOST)

    @property
    def needs_cure(self) -> bool:
        """Whether it hunts, for a part of the day at least."""
        return bool(hunting(self.cures)[0])

    def value(self, name: str) -> float:
        """A parameter of the loop."""
        return float(self.loop[name])  # type: ignore[arg-type]

    def cured(self, name: str) -> int | None:
        """Index of a cure; None if it was not tried."""
        names = self.cures["cure"].values.tolist()
        return int(names.index(name)) if name in names else None

    def with_cure(self, parameter: str, k: int) -> float:
        """A parameter of the loop with a cure."""
        values = self.cures[parameter] if parameter in self.cures.coords else None
        return float(values[k]) if values is not None and values.ndim else self.value(parameter)


MINUTES = 120.0
"""Seconds from which a period is given in minutes."""
_NOTHING = 5e-4  # temperature difference that nobody sees, K


def answer_of(found: Found) -> str:
    """Whether the loop will hunt, in one sentence."""
    if found.failed:
        return "This loop cannot be simulated: temperatures leave the range of the model."
    if found.hunts:
        return f"This loop will hunt: about {simulated(found)}."
    if found.lost and not found.needs_cure:
        error = kelvin(float(found.now["rmse"]))
        return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
    theory = found.theory
    if theory is None or not theory.prediction.hunts:
        return f"This loop will not hunt{', but it is on the edge' * (theory is not None and theory.unsure)}."
    prediction = theory.prediction
    places = f"{prediction.hunting.size} of {prediction.reached.size} operating points"
    if found.needs_cure:
        swing = kelvin(float(np.nanmedian(theory.swings[prediction.hunting])))
        return f"This loop will hunt, but not all day or not regularly: by about {swing} peak to peak at {places}."
    return f"This loop will hardly hunt: theory predicts it at {places}, which the simulated day does not show."


def why_of(found: Found) -> str:
    """The reason, in a sentence or two."""
    theory = found.theory
    if theory is None:
        return f"Why: theory cannot tell, since {'; '.join(found.doubts)}.  The answer is that of the simulation."
    margin, kp, ti, stroke = theory.prediction.margin, *(found.value(name) for name in ("kp", "ti", "stroke_time"))
    known = f"margin {margin:.2g}; a loop hunts above {HUNTS_ABOVE:g}"
    largest = number(kp * theory.kp_factor)
    if not theory.prediction.hunts:
        if theory.too_large:
            return f"Why: {known}, so kp has to be below {largest} 1/K, but theory finds no swing that counts."
        ways = [f"with {theory.kp_factor:.3g} times this kp"] if math.isfinite(theory.kp_factor) else []
        ways += [f"with a ti below {number(theory.ti)} s"] if theory.ti < ti else []
        return f"Why: {known}{', and it would ' * bool(ways)}{', or '.join(ways)}."
    if not theory.too_large:
        # calm by its margin, but not once it swings: the margin is that of swings up to 2 K
        motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
        return f"Why: {motor}a large swing keeps itself up once it has begun, though a small one dies away ({known})."
    longer = found.cured(LONGER_TI)
    if longer is not None:
        needed = f"with this kp the loop needs about {found.with_cure('ti', longer):g} s"
        fault = f"the integral is too fast for the coil: ti = {ti:g} s, while {needed}"
    else:
        fault = f"the gain is too high: kp = {kp:g} 1/K, while it has to be below {largest} 1/K with this ti"
    if theory.gain_margin <= 1.0 or not found.value("backlash"):
        return f"Why: {fault} ({known}).  It would swing behind a perfect valve, too."
    motor = f" and the motor's {stroke:g} s" if stroke else ""
    size = per_cent(found.value("backlash"))
    return f"Why: {fault} ({known}).  Any backlash starts it; its {size}{motor} set the size of the swing."


def simulated(found: Found) -> str:
    """The swing of the simulated day."""
    swing, period = float(found.now["hunting_swing"]), float(found.now["hunting_period"])
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


def table_of(found: Found) -> list[str]:
    """A heading and a row for each cure: what is now in numbers, the others relative to it."""
    ds = found.cures
    margin, error, swing, travel = (ds[name].values for name in ("margin", "rmse", "hunting_swing", "motor_travel"))
    rows: list[tuple[str, ...]] = [_HEAD]
    for k, words in enumerate(ds["words"].values.tolist()):
        if k:
            change = f"{100 * (error[k] / error[0] - 1):+.0f} %"
            moved, says = f"× {number(travel[k] / travel[0])}" if travel[0] > 0 else "–", str(ds["verdict"].values[k])
        else:
            change, moved = f"{error[0]:.3g} K", f"{travel[0]:.3g} strokes"
            says = "hunts" if found.hunts else "hunts in part" if found.needs_cure else "does not hunt"
        cells = (f"{margin[k]:.2f}", change, kelvin(swing[k]), moved)
        known = np.isfinite([margin[k], error[k], swing[k], travel[k]])
        rows.append((words, *(cell if is_known else "–" for cell, is_known in zip(cells, known, strict=True)), says))
    widths = [max(len(row[c]) for row in rows) for c in range(len(_HEAD))]
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


def sentences(found: Found) -> list[str]:
    """The explanation, line by line."""
    lines = [answer_of(found), why_of(found)]
    if found.theory is not None:
        lines += [*_agreement(found, found.theory), *_where(found.theory)]
        lines += [f"Not in the margin: {clause}." for clause in found.left_out]
        lines += ["", *_phase(found.theory)]
    return [*lines, "", *table_of(found), *_honest(found), *_advice(found)]


def _agreement(found: Found, theory: Theory) -> list[str]:
    """What theory predicts beside what the simulation shows."""
    if found.failed:
        return []
    shown = simulated(found) if found.hunts else f"no hunting, RMS error {kelvin(float(found.now['rmse']))}"
    lines = [f"Predicted: {_predicted(theory.prediction)}; simulated over the day: {shown}."]
    if theory.unsure or theory.prediction.hunts != found.hunts:
        lines.append(f"Near a margin of {HUNTS_ABOVE:g}, or where the two disagree, go by the simulation.")
    return lines


def _predicted(prediction: Prediction) -> str:
    if not prediction.hunts:
        return "no cycle"
    swings, periods = (of[prediction.hunting] for of in (2.0 * prediction.cycles.amplitude, prediction.cycles.period))
    if not np.isfinite(swings).any():
        return "a cycle, of a size that theory does not give"
    every = _span(periods, "s") if float(np.nanmax(periods)) < MINUTES else _span(periods / 60.0, "min")
    return f"{_span(swings, 'K')} peak to peak every {every}"


def _span(values: Array, unit: str) -> str:
    low, high = (number(float(end)) for end in (np.nanmin(values), np.nanmax(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _where(theory: Theory) -> list[str]:
    """Which operating point is quoted, what happens there, and how the margin differs over the day."""
    prediction = theory.prediction
    k, margin = prediction.worst, prediction.cycles.margin[prediction.reached]
    T_set, hours = float(prediction.points.conditions["T_set"][k]), float(prediction.points.start[k]) / 3600.0
    opening = 100 * float(prediction.plants.opening[k])
    place = f"{T_set:.3g} °C, {hours:.3g} h after the start (opening {opening:.0f} %)"
    swing, shown = 2.0 * float(prediction.cycles.amplitude[k]), float(theory.swings[k])
    if math.isfinite(swing) and math.isfinite(shown):
        place += f": {kelvin(swing)} predicted, {kelvin(shown)} simulated"
    if prediction.points.size == 1:
        return [f"Where: at {place}."]
    return [
        f"Where: worst at {place}.  Over the day the margin goes from {margin.min():.2g} to {margin.max():.2g}, and "
        f"{prediction.hunting.size} of {margin.size} operating points are predicted to hunt."
    ]


def _phase(theory: Theory) -> list[str]:
    """What each part of the loop takes, the largest first."""
    order = np.argsort(-theory.phase.values)
    shares = [(str(theory.phase["part"].values[k]), float(theory.phase[k])) for k in order]
    taken = [f"  {_PARTS[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= _LEAST_SHARE]
    return [f"Where the 180° of phase go, at one swing in {seconds(float(theory.phase.attrs['period']))}:", *taken]


def _honest(found: Found) -> list[str]:
    """What a dead band does not do; what backlash costs a loop that does not hunt."""
    repaired, band = found.cured(REPAIRED), found.cured(DEAD_BAND)
    if found.needs_cure:
        width = found.with_cure("error_dead_band", band) if band is not None else 0.0
        return [f"The dead band leaves the margin as it is, and holds any error up to {width:g} K."] * bool(width)
    if repaired is None or found.failed:
        return []
    error, without = (kelvin(float(found.cures["rmse"][k])) for k in (0, repaired))
    size = per_cent(found.value("backlash"))
    return [f"What the backlash of {size} costs anyway: RMSE {error} instead of {without}."] * (error != without)


def _advice(found: Found) -> list[str]:
    if found.failed:
        return []
    if not found.best:
        if found.needs_cure:
            return ["None of these cures it."]
        if found.lost:
            return ["None of these makes it hold its set-point."]
        return ["Leave it: none of these takes 5 % off the error."]
    now, then = found.now, found.cures.isel(cure=found.best)
    error = float(then["rmse"] / now["rmse"]) - 1.0
    travel, before = float(then["motor_travel"]), float(now["motor_travel"])
    moved = f", motor travel × {number(travel / before)}" if before else ""
    then_do = "Do this" if found.needs_cure else "If the error matters"
    return [f"{then_do}: {then['words'].item()}: RMSE {100 * error:+.0f} %{moved}."]


_SIZE, _WITHOUT_THEORY = (7.5, 7.5), (7.5, 3.8)
_TELLING, _BEFORE = 5400, 600  # seconds that are drawn, and how many of them before the worst operating point
_PHASES = (-200.0, -85.0)  # degrees: where a backlash may bring the phase to -180°, and some more
_SPAN, _TI_STEPS = 8.0, 60  # the map goes from the gains of now and the cures, divided by this, to as many times them
_LABEL = 0.85  # where on a contour its label is, as a share of its length
_CONTOURS = (0.4, HUNTS_ABOVE, 1.7)
_MARKS = {"lower_kp": "v", "longer_ti": ">", "simc": "s"}


@apply_style()
def page(found: Found) -> Figure:
    """The explanation as a page; where theory cannot tell, the day alone."""
    from matplotlib.figure import Figure

    if found.theory is None:
        fig = Figure(figsize=_WITHOUT_THEORY, layout="constrained")
        _day(fig.add_subplot(), found)
    else:
        fig = Figure(figsize=_SIZE, layout="constrained")
        grid = fig.add_gridspec(2, 2, height_ratios=(1.5, 1.0))
        _nichols(fig.add_subplot(grid[0, 0]), found.theory)
        _gains(fig.add_subplot(grid[0, 1]), found, found.theory)
        _day(fig.add_subplot(grid[1, :]), found)
    heading = wrapped(f"{answer_of(found)}\n{why_of(found)}", _SIZE[0] - 0.3, 9.0)
    fig.suptitle(heading, x=0.01, ha="left", fontsize=9)
    return fig


def _nichols(axes: Axes, theory: Theory) -> None:
    """Gain of L and of -1/N over their phase: the margin is how far L is above -1/N at the same phase."""
    from matplotlib.ticker import LogLocator

    response, k = theory.response, theory.response.nearest
    L, phase = np.abs(response.L), response.left - 180.0
    margin, at = theory.prediction.margin, float(phase[k])
    edge = float(L[k]) / margin if margin else float(L[k])
    seen = (phase > _PHASES[0] - 5.0) & (phase < _PHASES[1] + 5.0)
    axes.plot(phase[seen], L[seen], color=BLUE, label="loop L(jω)")
    N = of_a_gap()
    axes.plot(-180.0 - np.degrees(np.angle(N)), 1.0 / np.abs(N), color=RED, ls="--", label="backlash −1/N")
    axes.plot(-180.0, 1.0, "+", color="black", ms=8)
    axes.plot([at, at], [edge, L[k]], color="black", lw=0.9, ls=DOTTED)
    axes.plot(at, L[k], "o", color=BLUE, ms=6)
    axes.plot(at, edge, "o", mfc="white", color=RED, ms=6)
    axes.annotate(
        f"margin {margin:.2g}", (at, edge), xytext=(7, 0), textcoords="offset points", va="center", fontsize=8,
        bbox={"fc": "white", "ec": "none", "pad": 0.6},
    )  # fmt: skip
    if theory.prediction.hunts:
        there = response.cycle
        axes.plot(phase[there], L[there], "D", color=YELLOW, mec="black", mew=0.6, ms=6, ls="none",
                  label=f"cycle, every {seconds(response.period)}")  # fmt: skip
    ends = [edge, float(L[k]), float(L[response.cycle]), 1.0]
    axes.set(yscale="log", xlim=_PHASES, ylim=(0.4 * min(ends), 4.0 * max(ends)), xlabel="phase [°]", ylabel="gain")
    axes.set_xticks(range(-180, -80, 30))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.set_title("Hunts where L is above −1/N", loc="left")
    axes.legend(loc="lower right", frameon=False)


def _gains(axes: Axes, found: Found, theory: Theory) -> None:
    """Which kp and ti hunt at the worst operating point; the margin goes with kp."""
    prediction, ds = theory.prediction, found.cures
    kp, ti = found.value("kp"), found.value("ti")
    tunings = [k for k, name in enumerate(ds["cure"].values) if name in TUNINGS]

    marked = {name: [found.value(name), *(found.with_cure(name, k) for k in tunings)] for name in ("kp", "ti")}
    times = np.geomspace(min(marked["ti"]) / _SPAN, max(marked["ti"]) * _SPAN, _TI_STEPS)
    swept = found.loop.assign(ti=("tuning", times))
    at_kp = cycles_at(swept, prediction.plants, np.array([prediction.worst])).margin[:, 0]
    low, high = min(marked["kp"]) / _SPAN, max(marked["kp"]) * _SPAN
    with np.errstate(divide="ignore"):
        limits = {level: kp * level / at_kp for level in _CONTOURS}
    edge = np.clip(limits[HUNTS_ABOVE], low, high)
    axes.fill_between(times, edge, high, color=FAINT, lw=0, label=f"hunts (margin > {HUNTS_ABOVE:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(times, limits[level], color="black" if level == HUNTS_ABOVE else GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[int(_LABEL * inside.size)]
            axes.text(times[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center",
                      bbox={"fc": "white", "ec": "none", "pad": 0.6})  # fmt: skip
    axes.plot(ti, kp, "o", color=RED, ms=7, label="as it is")
    for k in tunings:
        name = str(ds["cure"].values[k])
        look: Any = {"color": BLUE if ds["hunts"][k] == 0 else YELLOW, "mec": "black", "mew": 0.6, "ls": "none"}
        axes.plot(found.with_cure("ti", k), found.with_cure("kp", k), _MARKS[name], ms=7, **look,
                  label="SIMC" if name == SIMC else name.replace("_", " "))  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=(times[0], times[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Which gains hunt, by their margin", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _day(axes: Axes, found: Found) -> None:
    """Part of the day as it is, and with the recommended cure."""
    ds, prediction = found.cures, found.theory.prediction if found.theory is not None else None
    t = ds["elapsed_time"].values
    middle = int(prediction.points.start[prediction.worst]) if prediction is not None else found.boundary.n_steps // 2
    start = max(0, min(middle - _BEFORE, found.boundary.n_steps - _TELLING))
    seen = (t >= start) & (t < start + _TELLING)
    hours = t[seen] / 3600.0
    T_set = found.boundary.series["T_set"][0][t[seen].astype(int)]
    axes.plot(hours, ds["T_sup"][0][seen], color=RED, lw=1.0, label="as it is")
    if found.best:
        cured = ds.isel(cure=found.best)
        axes.plot(hours, cured["T_sup"][seen], color=BLUE, lw=1.2, label=str(cured["words"].item()))
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
