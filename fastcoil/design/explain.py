"""explain: whether one loop will hunt, why, what would cure it, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, whole_of
from fastcoil.base.figures import BLUE, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.base.text import aligned, kelvin, number, per_cent, seconds
from fastcoil.design.advice import AS_IS, GAINS, LONGER_TI, LOST, REPAIRED, UNSURE, Advice, Trial, find_cures
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.operating_points import operating_points
from fastcoil.design.prediction import PARTS, Prediction, cycles_at, left_out, phase_shares, predict_any, shortest_ti
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import STATUS_OK, WARM_UP

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LONGEST = 7 * 86400
"""Seconds of a boundary that is explained: the operating points are reported one by one."""


def explain(
    loop: Loop, boundary: Boundary, *, at: int | None = None, warm_up: int = WARM_UP, seed: int = 0
) -> Explanation:
    """Explain one loop on one day: whether it will hunt, why, what would cure it, and what that costs.

    The loop is linearised at each hour and set-point of the day; the describing function of the backlash gives the
    margin there, and the worst one is quoted.  Then the loop as it is and every cure are simulated on the day.

    Parameters
    ----------
    loop
        A single loop, no sweep.
    boundary
        A single day of at most a week.
    at
        A second of it: the margin is that of the conditions there alone.  By default the whole day counts.
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
    with checking() as check:
        if loop.sizes:
            dims = ", ".join(f"{dim} ({size})" for dim, size in loop.sizes.items())
            check.problems.append(f"loop is a sweep over {dims}: give one loop, with a number for each parameter")
        if boundary.n_days > 1:
            check.problems.append(f"boundary has {boundary.n_days} days: give one, such as boundary.isel(0)")
        if boundary.n_steps > LONGEST:
            check.problems.append(f"boundary lasts {boundary.hours:g} h: give at most {LONGEST // 3600} h of it")
        last = boundary.n_steps - 1
        cure = f"give a second of the boundary, a whole number from 0 to {last}"
        second = check.unless_none(whole_of, "at", at, 0, last, cure)
    if loop["estimate_ratio"] is not None:  # a cure may change the backlash, or the estimate
        loop = loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]
    points = operating_points(boundary, warm_up, second)
    prediction, doubts = predict_any(loop, points)
    trial = Trial(loop, boundary, points, None if doubts else prediction, warm_up, seed)
    cures, advice = find_cures(trial, prediction)
    return Explanation(doubts or left_out(prediction), cures, advice, loop, boundary, trial.prediction)


def _points_of(prediction: Prediction, simulated: xr.Dataset) -> xr.Dataset:
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
            "margin": ("point", cycles.margin),
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
        metrics, ``hunting`` (1 where the day hunts, at least for a part), ``chatters``, ``words`` and ``verdict``.
    recommended, advice
        The cure to take, ``as_it_is`` where the loop is good, or nothing helps; and the sentences that say so.
    loop, boundary
        What was explained.
    """

    doubts: tuple[str, ...]
    simulated: xr.Dataset  # the cures with their traces
    advised: Advice
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
        return None if self.prediction is None else _points_of(self.prediction, self.simulated)

    @property
    def cures(self) -> xr.Dataset:
        """What was tried, as it is first, and what it does."""
        return self.simulated.drop_vars(["T_sup", "elapsed_time", "swings"])

    @property
    def recommended(self) -> str:
        """Name of the cure to take."""
        return str(self.simulated["cure"].values[self.advised.best])

    @property
    def advice(self) -> str:
        """What to do, in a sentence or two; empty where the loop cannot be simulated."""
        return "" if self._failed else self.advised.text

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts, for a part of it at least."""
        return bool(self.simulated["hunting"][0])

    @property
    def predicted(self) -> bool | None:
        """Whether theory predicts hunting; None where it cannot tell."""
        return None if self.prediction is None else self.prediction.hunting.size > 0

    @property
    def margin(self) -> float:
        """Largest margin of the day."""
        return self._worst("margin")

    @property
    def period(self) -> float:
        """Period of the cycle predicted at the worst operating point, s."""
        return self._worst("period")

    @property
    def amplitude(self) -> float:
        """Half of peak to peak of the cycle predicted at the worst operating point, K."""
        return self._worst("amplitude")

    def _worst(self, name: str) -> float:
        p = self.prediction
        return math.nan if p is None else float(getattr(p.cycles, name)[p.worst])

    @property
    def why(self) -> str:
        """The reason in a sentence."""
        if self.prediction is None:
            return f"Why: theory cannot tell, since {'; '.join(self.doubts)}.  The answer is that of the simulation."
        kp, ti, stroke, backlash = (float(self.loop[n]) for n in ("kp", "ti", "stroke_time", "backlash"))  # type: ignore[arg-type]
        margin, tried = self.margin, self.cures["cure"].values
        known = f"margin {margin:.2g}; a loop hunts above {HUNTS_ABOVE:g}"
        # the margin goes with kp
        factor = HUNTS_ABOVE / margin if margin else math.inf
        if not self.predicted:
            return _why_not_predicted(self, self.prediction, known, factor, ti)
        ends = "" if self.hunts else "  On this day no such swing persists."
        if margin <= HUNTS_ABOVE:
            # calm by its margin, but not once it swings: the margin is that of swings up to 2 K
            motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
            begun = "a large swing sustains itself once started, although a small one dies out"
            return f"Why: {motor}{begun} ({known}).{ends}"
        if LONGER_TI in tried:
            needed = f"with this kp the loop needs about {float(self.cures['ti'].sel(cure=LONGER_TI)):g} s"
            fault = f"the integral is too fast for the coil: ti = {ti:.4g} s, while {needed}"
        else:
            highest = f"{number(kp * factor)} 1/K with this ti"
            fault = f"the gain is too high: kp = {kp:.4g} 1/K, but it must be below {highest}"
        if self.hunts and REPAIRED in tried and not self.cures["hunting"].sel(cure=REPAIRED):
            determine = f"and the {stroke:g}-s stroke determine" if stroke else "determines"
            ends = f"  Any backlash triggers it; the {per_cent(backlash)} gap {determine} the size of the swing."
        elif self.hunts:
            ends = "  It would swing even with a perfect valve."
        return f"Why: {fault} ({known}).{ends}"

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        lines = [self.answer, self.why]
        if self.prediction is not None:
            points = _points_of(self.prediction, self.simulated)
            lines += [_agreement(self, points), _where(self.prediction, points)]
            lines += [f"Not in the margin: {clause}." for clause in self.doubts]
            lines += ["", *_phase(phase_shares(self.prediction))]
        return "\n".join([*lines, "", *_table(self), self.advice]).rstrip()

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
            middle = int(prediction.points.start[prediction.worst])
        _draw_day(below, self.simulated, self.advised.best, self.boundary, middle)
        heading = wrapped(f"{self.answer}\n{self.why}", _WIDTH - 0.3, 9.0)
        fig.suptitle(heading, x=0.01, ha="left", fontsize=9)
        return fig

    @property
    def answer(self) -> str:
        """Whether the loop will hunt, in one sentence."""
        if self._failed:
            return "This loop cannot be simulated: temperatures leave the range of the model."
        if self.hunts:
            more = f"; {self._chatter}" if self._chatter else ""
            return f"This loop will hunt{' for a part of the day' * self._in_part}: {self.shows()}{more}."
        if self.simulated["share_off"][0] > LOST:
            error = kelvin(float(self.cures["rmse"][0]))
            return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
        if self._chatter:
            return f"This loop will not hunt, but {self._chatter}."
        if self.predicted:
            return "This loop will not hunt on this day, but theory predicts that it may: it is on the edge."
        return f"This loop will not hunt{', but it is on the edge' * (UNSURE[0] <= self.margin <= UNSURE[1])}."

    def shows(self, cure: str = AS_IS) -> str:
        """What the simulated day shows with a cure, or as it is."""
        one = self.simulated.sel(cure=cure)
        if not one["hunting"]:
            return f"no hunting, RMS error {kelvin(float(one['rmse']))}"
        swing, period = float(one["hunting_swing"]), float(one["hunting_period"])
        if one["hunts"] or self.prediction is None:
            return f"about {kelvin(swing)} peak to peak every {seconds(period)}"
        there = self.prediction.hunting
        swing, of = float(np.nanmedian(one["swings"].values[there])), self.prediction.reached.size
        return f"about {kelvin(swing)} peak to peak at {there.size} of {of} operating points"

    @property
    def _chatter(self) -> str:
        """How the motor chatters; empty where it does not."""
        now = self.simulated.isel(cure=0)
        estimate, gap = (per_cent(float(now[name])) for name in ("estimate_settled", "backlash_final"))
        chatters = f"its motor chatters, {6.0 * float(now['switch_frequency']):.0f} reversals an hour"
        return f"{chatters}: the estimate, {estimate}, is larger than the backlash, {gap}" if now["chatters"] else ""

    @property
    def _in_part(self) -> bool:
        """Whether it hunts for a part of the day only, or not regularly."""
        return self.hunts and not self.simulated["hunts"][0] > 0.0

    @property
    def _failed(self) -> bool:
        return int(self.simulated["status"][0]) != STATUS_OK


def _why_not_predicted(e: Explanation, prediction: Prediction, known: str, factor: float, ti: float) -> str:
    """The reason where theory predicts no hunting.  factor: that kp may grow by."""
    if e.hunts:
        return f"Why: theory does not predict it ({known}): noise, steps or changing conditions keep the swing going."
    if e.margin > HUNTS_ABOVE:
        return f"Why: {known}, but theory predicts no swing large enough to count as hunting."
    shortest = shortest_ti(prediction, HUNTS_ABOVE)
    ways = [f"with {factor:.3g} times this kp"] if math.isfinite(factor) else []
    ways += [f"with a ti below {number(shortest)} s"] if shortest < ti else []
    return f"Why: {known}{', and this one would ' * bool(ways)}{', or '.join(ways)}."


def _table(e: Explanation) -> list[str]:
    """A heading and a row for each cure: what is now in numbers, the others relative to it."""
    ds = e.cures
    margin, error, swing, travel = (ds[name].values for name in ("margin", "rmse", "hunting_swing", "motor_travel"))
    rows: list[tuple[str, ...]] = [("", "margin", "RMSE", "swing", "motor travel", "")]
    for k, words in enumerate(ds["words"].values.tolist()):
        if k:
            change, says = f"{100 * (error[k] / error[0] - 1):+.0f} %", str(ds["verdict"].values[k])
            moved = f"× {number(travel[k] / travel[0])}" if travel[0] > 0 else "–"
        else:
            change, moved = f"{error[0]:.3g} K", f"{travel[0]:.3g} strokes"
            says = "hunts for a part of the day" if e._in_part else "hunts" if e.hunts else "does not hunt"
        cells = (f"{margin[k]:.2f}", change, kelvin(swing[k]), moved)
        known = np.isfinite([margin[k], error[k], swing[k], travel[k]])
        rows.append((words, *(cell if is_known else "–" for cell, is_known in zip(cells, known, strict=True)), says))
    return ["Possible changes and their cost, each simulated on this day", *aligned(rows, right=range(1, 5))]


_LEAST_SHARE = 0.5  # degrees; less is not shown


def _phase(phase: xr.DataArray) -> list[str]:
    """What each part of the loop takes, the largest first."""
    ordered = phase.sortby(-phase)
    shares = zip(ordered["part"].values.tolist(), ordered.values.tolist(), strict=True)
    taken = [f"  {PARTS[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= _LEAST_SHARE]
    period = seconds(float(phase.attrs["period"]))
    return [f"Phase lag of each part of the loop (180° in all), at a period of {period}:", *taken]


def _agreement(e: Explanation, points: xr.Dataset) -> str:
    """What theory predicts beside what the simulation shows."""
    there = points.isel(point=points["hunts"].values > 0.0)
    swings, cycle = 2.0 * there["amplitude"].values, "no cycle"
    if np.isfinite(swings).any():
        k = int(np.nanargmax(swings))
        cycle = f"up to {kelvin(swings[k])} peak to peak every {seconds(float(there['period'][k]))}"
    elif swings.size:
        cycle = "a cycle whose size theory does not give"
    line = f"Predicted: {cycle}; simulated over the day: {'failed' if e._failed else e.shows()}."
    return line + "  Where the two disagree, go by the simulation." * (e.predicted != e.hunts)


def _where(prediction: Prediction, points: xr.Dataset) -> str:
    """Which operating point is quoted, what happens there, and how the margin differs over the day."""
    at, margin = points.isel(point=prediction.worst), points["margin"].values[prediction.reached]
    place = f"{float(at['T_set']):.3g} °C, {float(at['start']) / 3600.0:.3g} h after the start"
    place += f" (opening {100 * float(at['opening']):.0f} %)"
    swing, shown = 2.0 * float(at["amplitude"]), float(at["swing"])
    if math.isfinite(swing) and math.isfinite(shown):
        place += f": {kelvin(swing)} predicted, {kelvin(shown)} simulated"
    if points.sizes["point"] == 1:
        return f"Where: at {place}."
    return (
        f"Where: worst at {place}.  Over the day the margin goes from {margin.min():.2g} to {margin.max():.2g}, and "
        f"{prediction.hunting.size} of {margin.size} operating points are predicted to hunt."
    )


_WIDTH, _HEIGHT_OF_MAP, _HEIGHT_OF_DAY = 7.5, 3.7, 3.8  # inches
_DRAWN, _BEFORE = 5400, 600  # seconds that are drawn, and how many of them before the worst operating point
_SPAN, _TI_STEPS = 8.0, 60  # the map goes from the gains of now and the cures, divided by this, to as many times them
_LABEL = 0.85  # where on a contour its label is, as a share of its length
_CONTOURS = (0.4, HUNTS_ABOVE, 1.7)
_ON_WHITE = {"fc": "white", "ec": "none", "pad": 0.6}
_MARKS = {"lower_kp": ("v", "lower kp"), "longer_ti": (">", "longer ti"), "simc": ("s", "SIMC"),
    "simulated_gains": ("D", "found by simulation"),
}  # fmt: skip


def _draw_gains(axes: Axes, cures: xr.Dataset, prediction: Prediction) -> None:
    """Which kp and ti hunt at the worst operating point; the margin goes with kp."""
    marked = np.flatnonzero(np.isin(cures["cure"], ("as_it_is", *GAINS)))
    own_kp, own_ti = (np.broadcast_to(cures.get(n, prediction.columns[n]), cures.sizes["cure"]) for n in ("kp", "ti"))
    times = np.geomspace(own_ti[marked].min() / _SPAN, own_ti[marked].max() * _SPAN, _TI_STEPS)
    swept = prediction.loop.assign(ti=("tuning", times))
    at_kp = cycles_at(swept, prediction.plants, np.array([prediction.worst])).margin[:, 0]
    low, high = own_kp[marked].min() / _SPAN, own_kp[marked].max() * _SPAN
    with np.errstate(divide="ignore"):
        limits = {level: own_kp[0] * level / at_kp for level in _CONTOURS}
    hunts = np.clip(limits[HUNTS_ABOVE], low, high)
    axes.fill_between(times, hunts, high, color=FAINT, lw=0, label=f"hunts (margin > {HUNTS_ABOVE:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(times, limits[level], color="black" if level == HUNTS_ABOVE else GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[int(_LABEL * inside.size)]
            axes.text(times[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center", bbox=_ON_WHITE)
    axes.plot(own_ti[0], own_kp[0], "o", color=RED, ms=7, label="as it is")
    for k in marked[1:]:
        mark, words = _MARKS[str(cures["cure"].values[k])]
        colour = BLUE if cures["hunting"][k] == 0 else YELLOW
        axes.plot(own_ti[k], own_kp[k], mark, ms=7, color=colour, mec="black", mew=0.6, ls="none", label=words)
    axes.set(xscale="log", yscale="log", xlim=(times[0], times[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Gains that make the loop hunt, judged by the margin", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _draw_day(axes: Axes, cures: xr.Dataset, best: int, boundary: Boundary, middle: int) -> None:
    """Part of the day as it is, and with the recommended cure."""
    t = cures["elapsed_time"].values
    start = max(0, min(middle - _BEFORE, boundary.n_steps - _DRAWN))
    seen = (t >= start) & (t < start + _DRAWN)
    hours = t[seen] / 3600.0
    axes.plot(hours, cures["T_sup"][0][seen], color=RED, lw=1.0, label="as it is")
    if best:
        axes.plot(hours, cures["T_sup"][best][seen], color=BLUE, lw=1.2, label=str(cures["words"].values[best]))
    T_set = boundary.series["T_set"][0][t[seen].astype(int)]
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
