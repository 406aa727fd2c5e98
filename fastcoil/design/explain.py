"""explain: whether one loop will hunt, why, what would cure it, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_integer
from fastcoil.base.figures import BLUE, LINE_GREY, RED, SHADE_GREY, YELLOW, apply_style, wrap_text
from fastcoil.base.text import align_columns, format_kelvin, format_percent, format_period, format_two_digits
from fastcoil.design.advice import (
    AS_IS,
    GAIN_CURES,
    LONGER_TI,
    LOST_SHARE,
    REPAIRED_VALVE,
    UNSURE_MARGINS,
    Advice,
    Trial,
    find_cures,
)
from fastcoil.design.limit_cycle import HUNTING_MARGIN
from fastcoil.design.operating_points import operating_points
from fastcoil.design.prediction import (
    PHASE_PARTS,
    Prediction,
    margin_omissions,
    phase_shares,
    predict_cycles_at,
    predict_or_nearest,
    shortest_ti,
)
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import STATUS_OK, WARM_UP_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LONGEST_BOUNDARY = 7 * 86400
"""Seconds of a boundary that is explained: the operating points are reported one by one."""


def explain(
    loop: Loop, boundary: Boundary, *, at: int | None = None, warm_up: int = WARM_UP_S, seed: int = 0
) -> Explanation:
    """Explain one loop on one day: whether it will hunt, why, what would cure it, and what that costs.

    The loop is linearised at each hour and set-point of the day; the describing function of the backlash gives the
    hunting index there, and the worst one is quoted.  Then the loop as it is and every cure are simulated on the day.

    Parameters
    ----------
    loop
        A single loop, no sweep.
    boundary
        A single day of at most a week.
    at
        A second of it: the hunting index is that of the conditions there alone.  By default the whole day counts.
    warm_up
        Seconds at the start that do not count.
    seed
        Seed of the measurement noise, 0 … 2**64 - 1.

    Returns
    -------
    Explanation
        The answer; print it to read it, ``.plot()`` draws it.

    Raises
    ------
    InputError
        With one sentence for each mistake in the arguments.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.explain(fc.Loop.preset("lbnl").assign(ti=5), fc.paper_day()).why  # doctest: +SKIP
    """
    plan_simulation(loop, boundary, traces=["T_sup"], warm_up=warm_up, seed=seed)
    with argument_checks() as check:
        if loop.sizes:
            dims = ", ".join(f"{dim} ({size})" for dim, size in loop.sizes.items())
            check.problems.append(f"loop is a sweep over {dims}: give one loop, with a number for each parameter")
        if boundary.n_days > 1:
            check.problems.append(f"boundary has {boundary.n_days} days: give one, such as boundary.isel(0)")
        if boundary.n_steps > LONGEST_BOUNDARY:
            check.problems.append(
                f"boundary lasts {boundary.hours:g} h: give at most {LONGEST_BOUNDARY // 3600} h of it"
            )
        last = boundary.n_steps - 1
        cure = f"give a second of the boundary, a whole number from 0 to {last}"
        second = check.unless_none(require_integer, "at", at, 0, last, cure)
    if loop["estimate_ratio"] is not None:  # a cure may change the backlash, or the estimate
        loop = loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]
    points = operating_points(boundary, warm_up, second)
    prediction, doubts = predict_or_nearest(loop, points)
    trial = Trial(loop, boundary, points, None if doubts else prediction, warm_up, seed)
    cures, advice = find_cures(trial, prediction)
    return Explanation(doubts or margin_omissions(prediction), cures, advice, loop, boundary, trial.prediction)


def _points_dataset(prediction: Prediction, simulated: xr.Dataset) -> xr.Dataset:
    """The operating points with their margins, and the swing simulated at each, K."""
    points, plants, cycles = prediction.points, prediction.plants, prediction.cycles
    kelvin, second = {"units": "K"}, {"units": "s"}
    return xr.Dataset(
        {
            "start": ("point", points.start, second | {"long_name": "first second"}),
            "seconds": ("point", points.seconds, second | {"long_name": "seconds spent there"}),
            **{name: ("point", values) for name, values in points.conditions.items()},
            "opening": ("point", plants.opening),
            "gain": ("point", plants.gain, kelvin | {"long_name": "change per unit of opening"}),
            "reachable": ("point", plants.reachable),
            "hunting_index": ("point", cycles.hunting_index),
            "hunts": ("point", cycles.hunts),
            "period": ("point", cycles.period, second),
            "amplitude": ("point", cycles.amplitude, kelvin | {"long_name": "half of peak to peak"}),
            "swing": ("point", simulated["swings"].values[0], kelvin | {"long_name": "simulated, peak to peak"}),
        }
    )


@dataclass(frozen=True, repr=False)
class Explanation:
    """Why one loop hunts on one day, or does not.

    Attributes
    ----------
    hunts
        Whether the simulated day hunts: all of it, see the metric of that name, or a part.
    predicted
        Whether the linear model predicts hunting at some operating point; None where it cannot tell.
    hunting index
        Largest describing-function hunting index of the day; above 0.85 a loop hunts.  NaN where theory cannot tell.
    period, amplitude
        Of the predicted cycle at the worst operating point, s and K (half of peak to peak); NaN without.
    why
        The reason in a sentence.
    doubts
        Why theory cannot tell, or what it leaves out; empty where there is nothing.
    phase
        DataArray over ``part``: degrees that each part of the loop takes at the critical frequency; None without.
    points
        Dataset over ``point``: each hour at each set-point with its hunting index; None where theory cannot tell.
    cures
        Dataset over ``cure``, ``as_it_is`` first: the parameters that change, the predicted ``hunting_index``, the simulated
        metrics, ``hunting`` (1 where the day hunts, at least for a part), ``chatters``, ``words`` and ``verdict``.
    recommended, advice
        The cure to take, ``as_it_is`` where the loop is good, or nothing helps; and the sentences that say so.
    loop, boundary
        What was explained.
    """

    doubts: tuple[str, ...]
    simulated: xr.Dataset  # the cures with their traces
    best_advice: Advice
    loop: Loop
    boundary: Boundary
    prediction: Prediction | None

    @property
    def phase(self) -> xr.DataArray | None:
        """Degrees that each part of the loop takes."""
        return None if self.prediction is None else phase_shares(self.prediction)

    @property
    def points(self) -> xr.Dataset | None:
        """The operating points of the day."""
        return None if self.prediction is None else _points_dataset(self.prediction, self.simulated)

    @property
    def cures(self) -> xr.Dataset:
        """What was tried, as it is first, and what it does."""
        return self.simulated.drop_vars(["T_sup", "elapsed_time", "swings"])

    @property
    def recommended(self) -> str:
        """Name of the cure to take."""
        return str(self.simulated["cure"].values[self.best_advice.best])

    @property
    def advice(self) -> str:
        """What to do, in a sentence or two; empty where the loop cannot be simulated."""
        return "" if self._has_failed else self.best_advice.text

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts, for a part of it at least."""
        return bool(self.simulated["hunting"][0])

    @property
    def predicted(self) -> bool | None:
        """Whether theory predicts hunting; None where it cannot tell."""
        return None if self.prediction is None else self.prediction.hunting.size > 0

    @property
    def hunting_index(self) -> float:
        """Largest hunting index of the day."""
        return self._at_worst_point("hunting_index")

    @property
    def period(self) -> float:
        """Period of the cycle predicted at the worst operating point, s."""
        return self._at_worst_point("period")

    @property
    def amplitude(self) -> float:
        """Half of peak to peak of the cycle predicted at the worst operating point, K."""
        return self._at_worst_point("amplitude")

    def _at_worst_point(self, name: str) -> float:
        p = self.prediction
        return math.nan if p is None else float(getattr(p.cycles, name)[p.worst_point])

    @property
    def why(self) -> str:
        """The reason in a sentence."""
        if self.prediction is None:
            return f"Why: theory cannot tell, since {'; '.join(self.doubts)}.  The answer is that of the simulation."
        kp, ti, stroke, backlash = (float(self.loop[n]) for n in ("kp", "ti", "stroke_time", "backlash"))  # type: ignore[arg-type]
        hunting_index, tried_cures = self.hunting_index, self.cures["cure"].values
        margin_text = f"hunting index {hunting_index:.2g}; a loop hunts above {HUNTING_MARGIN:g}"
        # the hunting index goes with kp
        factor = HUNTING_MARGIN / hunting_index if hunting_index else math.inf
        if not self.predicted:
            return _why_not_predicted(self, self.prediction, margin_text, factor, ti)
        ends = "" if self.hunts else "  On this day no such swing persists."
        if hunting_index <= HUNTING_MARGIN:
            # calm by its hunting index, but not once it swings: the hunting index is that of swings up to 2 K
            motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
            explanation = "a large swing sustains itself once started, although a small one dies out"
            return f"Why: {motor}{explanation} ({margin_text}).{ends}"
        if LONGER_TI in tried_cures:
            needed = f"with this kp the loop needs about {float(self.cures['ti'].sel(cure=LONGER_TI)):g} s"
            fault = f"the integral is too fast for the coil: ti = {ti:.4g} s, while {needed}"
        else:
            highest = f"{format_two_digits(kp * factor)} 1/K with this ti"
            fault = f"the gain is too high: kp = {kp:.4g} 1/K, but it must be below {highest}"
        if self.hunts and REPAIRED_VALVE in tried_cures and not self.cures["hunting"].sel(cure=REPAIRED_VALVE):
            determine = f"and the {stroke:g}-s stroke determine" if stroke else "determines"
            ends = f"  Any backlash triggers it; the {format_percent(backlash)} gap {determine} the size of the swing."
        elif self.hunts:
            ends = "  It would swing even with a perfect valve."
        return f"Why: {fault} ({margin_text}).{ends}"

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        lines = [self.answer, self.why]
        if self.prediction is not None:
            points = _points_dataset(self.prediction, self.simulated)
            lines += [_agreement_line(self, points), _worst_point_line(self.prediction, points)]
            lines += [f"Not in the hunting index: {clause}." for clause in self.doubts]
            lines += ["", *_phase_lines(phase_shares(self.prediction))]
        return "\n".join([*lines, "", *_cure_table(self), self.advice]).rstrip()

    def __repr__(self) -> str:
        return f"<fastcoil explanation: {self.answer}>"

    def __str__(self) -> str:
        return self.text

    @apply_style()
    def plot(self) -> Figure:
        """The explanation on one page, as a matplotlib ``Figure``; where theory cannot tell, the day alone."""
        from matplotlib.figure import Figure

        prediction, middle = self.prediction, self.boundary.n_steps // 2
        heights = [_HEIGHT_OF_MAP, _HEIGHT_OF_DAY] if prediction is not None else [_HEIGHT_OF_DAY]
        fig = Figure(figsize=(_WIDTH, sum(heights)), layout="constrained")
        *above, below = fig.subplots(len(heights), squeeze=False, height_ratios=heights)[:, 0]
        if prediction is not None:
            _draw_gains(above[0], self.simulated, prediction)
            middle = int(prediction.points.start[prediction.worst_point])
        _draw_day(below, self.simulated, self.best_advice.best, self.boundary, middle)
        heading = wrap_text(f"{self.answer}\n{self.why}", _WIDTH - 0.3, 9.0)
        fig.suptitle(heading, x=0.01, ha="left", fontsize=9)
        return fig

    @property
    def answer(self) -> str:
        """Whether the loop will hunt, in one sentence."""
        if self._has_failed:
            return "This loop cannot be simulated: temperatures leave the range of the model."
        if self.hunts:
            chatter = f"; {self._chatter_clause}" if self._chatter_clause else ""
            return f"This loop will hunt{' for a part of the day' * self._is_hunting_in_part}: {self.describe_day()}{chatter}."
        if self.simulated["share_off"][0] > LOST_SHARE:
            error = format_kelvin(float(self.cures["rmse"][0]))
            return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
        if self._chatter_clause:
            return f"This loop will not hunt, but {self._chatter_clause}."
        if self.predicted:
            return "This loop will not hunt on this day, but theory predicts that it may: it is on the edge."
        return f"This loop will not hunt{', but it is on the edge' * (UNSURE_MARGINS[0] <= self.hunting_index <= UNSURE_MARGINS[1])}."

    def describe_day(self, cure: str = AS_IS) -> str:
        """What the simulated day shows with a cure, or as it is."""
        results = self.simulated.sel(cure=cure)
        if not results["hunting"]:
            return f"no hunting, RMS error {format_kelvin(float(results['rmse']))}"
        swing, period = float(results["hunting_swing"]), float(results["hunting_period"])
        if results["hunts"] or self.prediction is None:
            return f"about {format_kelvin(swing)} peak to peak every {format_period(period)}"
        hunting_points = self.prediction.hunting
        swing, n_points = float(np.nanmedian(results["swings"].values[hunting_points])), self.prediction.reached.size
        return f"about {format_kelvin(swing)} peak to peak at {hunting_points.size} of {n_points} operating points"

    @property
    def _chatter_clause(self) -> str:
        """How the motor chatters; empty where it does not."""
        now = self.simulated.isel(cure=0)
        estimate, gap = (format_percent(float(now[name])) for name in ("estimate_settled", "backlash_final"))
        chatters = f"its motor chatters, {6.0 * float(now['switch_frequency']):.0f} reversals an hour"
        return f"{chatters}: the estimate, {estimate}, is larger than the backlash, {gap}" if now["chatters"] else ""

    @property
    def _is_hunting_in_part(self) -> bool:
        """Whether it hunts for a part of the day only, or not regularly."""
        return self.hunts and not self.simulated["hunts"][0] > 0.0

    @property
    def _has_failed(self) -> bool:
        return int(self.simulated["status"][0]) != STATUS_OK


def _why_not_predicted(
    explanation: Explanation, prediction: Prediction, margin_text: str, factor: float, ti: float
) -> str:
    """The reason where theory predicts no hunting.  factor: that kp may grow by."""
    if explanation.hunts:
        return f"Why: theory does not predict it ({margin_text}): noise, steps or changing conditions keep the swing going."
    if explanation.hunting_index > HUNTING_MARGIN:
        return f"Why: {margin_text}, but theory predicts no swing large enough to count as hunting."
    shortest = shortest_ti(prediction, HUNTING_MARGIN)
    ways = [f"with {factor:.3g} times this kp"] if math.isfinite(factor) else []
    ways += [f"with a ti below {format_two_digits(shortest)} s"] if shortest < ti else []
    return f"Why: {margin_text}{', and this one would ' * bool(ways)}{', or '.join(ways)}."


def _cure_table(explanation: Explanation) -> list[str]:
    """A heading and a row for each cure: what is now in numbers, the others relative to it."""
    ds = explanation.cures
    hunting_index, error, swing, travel = (
        ds[name].values for name in ("hunting_index", "rmse", "hunting_swing", "motor_travel")
    )
    rows: list[tuple[str, ...]] = [("", "hunting_index", "RMSE", "swing", "motor travel", "")]
    for k, words in enumerate(ds["words"].values.tolist()):
        if k:
            change, verdict_text = f"{100 * (error[k] / error[0] - 1):+.0f} %", str(ds["verdict"].values[k])
            travel_text = f"× {format_two_digits(travel[k] / travel[0])}" if travel[0] > 0 else "–"
        else:
            change, travel_text = f"{error[0]:.3g} K", f"{travel[0]:.3g} strokes"
            verdict_text = (
                "hunts for a part of the day"
                if explanation._is_hunting_in_part
                else "hunts"
                if explanation.hunts
                else "does not hunt"
            )
        cells = (f"{hunting_index[k]:.2f}", change, format_kelvin(swing[k]), travel_text)
        are_finite = np.isfinite([hunting_index[k], error[k], swing[k], travel[k]])
        rows.append(
            (
                words,
                *(cell if is_known else "–" for cell, is_known in zip(cells, are_finite, strict=True)),
                verdict_text,
            )
        )
    return ["Possible changes and their cost, each simulated on this day", *align_columns(rows, right=range(1, 5))]


_LEAST_PHASE = 0.5  # degrees; less is not shown


def _phase_lines(phase: xr.DataArray) -> list[str]:
    """What each part of the loop takes, the largest first."""
    ordered = phase.sortby(-phase)
    shares = zip(ordered["part"].values.tolist(), ordered.values.tolist(), strict=True)
    lines = [f"  {PHASE_PARTS[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= _LEAST_PHASE]
    period = format_period(float(phase.attrs["period"]))
    return [f"Phase lag of each part of the loop (180° in all), at a period of {period}:", *lines]


def _agreement_line(explanation: Explanation, points: xr.Dataset) -> str:
    """What theory predicts beside what the simulation shows."""
    hunting_points = points.isel(point=points["hunts"].values > 0.0)
    swings, cycle = 2.0 * hunting_points["amplitude"].values, "no cycle"
    if np.isfinite(swings).any():
        k = int(np.nanargmax(swings))
        cycle = (
            f"up to {format_kelvin(swings[k])} peak to peak every {format_period(float(hunting_points['period'][k]))}"
        )
    elif swings.size:
        cycle = "a cycle whose size theory does not give"
    line = f"Predicted: {cycle}; simulated over the day: {'failed' if explanation._has_failed else explanation.describe_day()}."
    return line + "  Where the two disagree, go by the simulation." * (explanation.predicted != explanation.hunts)


def _worst_point_line(prediction: Prediction, points: xr.Dataset) -> str:
    """Which operating point is quoted, what happens there, and how the hunting index differs over the day."""
    worst, hunting_index = points.isel(point=prediction.worst_point), points["hunting_index"].values[prediction.reached]
    place = f"{float(worst['T_set']):.3g} °C, {float(worst['start']) / 3600.0:.3g} h after the start"
    place += f" (opening {100 * float(worst['opening']):.0f} %)"
    swing, simulated_swing = 2.0 * float(worst["amplitude"]), float(worst["swing"])
    if math.isfinite(swing) and math.isfinite(simulated_swing):
        place += f": {format_kelvin(swing)} predicted, {format_kelvin(simulated_swing)} simulated"
    if points.sizes["point"] == 1:
        return f"Where: at {place}."
    return (
        f"Where: worst at {place}.  Over the day the hunting index goes from {hunting_index.min():.2g} to {hunting_index.max():.2g}, and "
        f"{prediction.hunting.size} of {hunting_index.size} operating points are predicted to hunt."
    )


_WIDTH, _HEIGHT_OF_MAP, _HEIGHT_OF_DAY = 7.5, 3.7, 3.8  # inches
_DRAWN_SECONDS, _SECONDS_BEFORE_WORST = (
    5400,
    600,
)  # seconds that are drawn, and how many of them before the worst operating point
_GAIN_SPAN, _TI_STEPS = (
    8.0,
    60,
)  # the map goes from the gains of now and the cures, divided by this, to as many times them
_LABEL_PLACE = 0.85  # where on a contour its label is, as a share of its length
_CONTOURS = (0.4, HUNTING_MARGIN, 1.7)
_ON_WHITE = {"fc": "white", "ec": "none", "pad": 0.6}
_MARKS = {"lower_kp": ("v", "lower kp"), "longer_ti": (">", "longer ti"), "simc": ("s", "SIMC"),
    "simulated_gains": ("D", "found by simulation"),
}  # fmt: skip


def _draw_gains(axes: Axes, cures: xr.Dataset, prediction: Prediction) -> None:
    """Which kp and ti hunt at the worst operating point; the hunting index goes with kp."""
    marked = np.flatnonzero(np.isin(cures["cure"], ("as_it_is", *GAIN_CURES)))
    kp_of_cures, ti_of_cures = (
        np.broadcast_to(cures.get(n, prediction.columns[n]), cures.sizes["cure"]) for n in ("kp", "ti")
    )
    ti_grid = np.geomspace(ti_of_cures[marked].min() / _GAIN_SPAN, ti_of_cures[marked].max() * _GAIN_SPAN, _TI_STEPS)
    swept = prediction.loop.assign(ti=("tuning", ti_grid))
    at_kp = predict_cycles_at(swept, prediction.plants, np.array([prediction.worst_point])).hunting_index[:, 0]
    low, high = kp_of_cures[marked].min() / _GAIN_SPAN, kp_of_cures[marked].max() * _GAIN_SPAN
    with np.errstate(divide="ignore"):
        limits = {level: kp_of_cures[0] * level / at_kp for level in _CONTOURS}
    hunts = np.clip(limits[HUNTING_MARGIN], low, high)
    axes.fill_between(ti_grid, hunts, high, color=SHADE_GREY, lw=0, label=f"hunts (hunting index > {HUNTING_MARGIN:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(ti_grid, limits[level], color="black" if level == HUNTING_MARGIN else LINE_GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[int(_LABEL_PLACE * inside.size)]
            axes.text(ti_grid[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center", bbox=_ON_WHITE)
    axes.plot(ti_of_cures[0], kp_of_cures[0], "o", color=RED, ms=7, label="as it is")
    for k in marked[1:]:
        mark, words = _MARKS[str(cures["cure"].values[k])]
        colour = BLUE if cures["hunting"][k] == 0 else YELLOW
        axes.plot(
            ti_of_cures[k], kp_of_cures[k], mark, ms=7, color=colour, mec="black", mew=0.6, ls="none", label=words
        )
    axes.set(xscale="log", yscale="log", xlim=(ti_grid[0], ti_grid[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Gains that make the loop hunt, judged by the hunting index", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _draw_day(axes: Axes, cures: xr.Dataset, best: int, boundary: Boundary, middle: int) -> None:
    """Part of the day as it is, and with the recommended cure."""
    elapsed = cures["elapsed_time"].values
    start = max(0, min(middle - _SECONDS_BEFORE_WORST, boundary.n_steps - _DRAWN_SECONDS))
    is_drawn = (elapsed >= start) & (elapsed < start + _DRAWN_SECONDS)
    hours = elapsed[is_drawn] / 3600.0
    axes.plot(hours, cures["T_sup"][0][is_drawn], color=RED, lw=1.0, label="as it is")
    if best:
        axes.plot(hours, cures["T_sup"][best][is_drawn], color=BLUE, lw=1.2, label=str(cures["words"].values[best]))
    T_set = boundary.series["T_set"][0][elapsed[is_drawn].astype(int)]
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
