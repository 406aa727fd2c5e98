"""explain: whether one loop will hunt, why, what would cure it, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_integer
from fastcoil.base.errors import Problem
from fastcoil.base.figures import BLUE, LINE_GREY, RED, SHADE_GREY, YELLOW, apply_style, wrap_text
from fastcoil.design.limit_cycle import HUNTING_INDEX_LIMIT
from fastcoil.design.operating_points import operating_points
from fastcoil.design.swing_verdict import LEAST_REGULARITY, SwingVerdict, moving_inputs
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import STATUS_OK, WARM_UP_S

from fastcoil.base.text import (  # isort: skip
    align_columns, format_kelvin, format_percent, format_period, format_swing, format_two_digits,
)  # fmt: skip
from fastcoil.design.advice import (  # isort: skip
    AS_IS, GAIN_CURES, LONGER_TI, LOST_SHARE, NO_INVERSE, NOISE_SWINGS_IT, REPAIRED_VALVE, UNSURE_HUNTING_INDEX,
    Advice, Trial, find_cures,
)  # fmt: skip
from fastcoil.design.prediction import (  # isort: skip
    PHASE_PARTS, Prediction, hunting_index_omissions, phase_shares, plant_in_words, predict_cycles_at,
    predict_or_nearest, shortest_ti,
)  # fmt: skip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_DAYS = 7  # of a boundary: the operating points are reported one by one


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
    warm_up, seed
        As in ``simulate``.

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
    >>> explanation = fc.explain(fc.Loop.preset("lbnl").assign(ti=8), fc.paper_day(hours=1))
    >>> explanation.hunts, explanation.recommended
    (True, 'simc')
    >>> print(explanation.advice)
    Do this: SIMC: kp 0.034 1/K, ti 38 s: RMSE ...
    """
    plan_simulation(loop, boundary, warm_up=warm_up, seed=seed)
    with argument_checks() as check:
        if loop.sizes:
            dims = ", ".join(f"{dim} ({size})" for dim, size in loop.sizes.items())
            sentence = f"loop is a sweep over {dims}: give one loop, with a number for each parameter"
            check.problems.append(Problem(sentence, "loop", "shape"))
        if boundary.n_days > 1:
            sentence = f"boundary has {boundary.n_days} days: give one, such as boundary.isel(0)"
            check.problems.append(Problem(sentence, "boundary", "shape"))
        if boundary.n_steps > MAX_DAYS * 86400:
            sentence = f"boundary lasts {boundary.hours:g} h: give at most {MAX_DAYS * 24} h of it"
            check.problems.append(Problem(sentence, "boundary", "size"))
        last = boundary.n_steps - 1
        cure = f"give a second of the boundary, a whole number from 0 to {last}"
        second = check.unless_none(require_integer, "at", at, 0, last, cure)
    if loop["estimate_ratio"] is not None:  # a cure may change the backlash, or the estimate
        loop = loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]
    points = operating_points(boundary, warm_up, second)
    prediction, doubts = predict_or_nearest(loop, points)
    trial = Trial(loop, boundary, None if doubts else prediction, warm_up, seed)
    cures, advice, contradiction = find_cures(trial, prediction)
    doubts = doubts or hunting_index_omissions(prediction)
    return Explanation(doubts, cures, advice, contradiction, loop, boundary, trial.prediction)


def _points_dataset(prediction: Prediction) -> xr.Dataset:
    """Return the operating points with their hunting indices."""
    points, plants, cycles = prediction.points, prediction.plants, prediction.cycles
    kelvin, second = {"units": "K"}, {"units": "s"}
    variables: dict[str, tuple[Any, ...]] = {
        "start": (points.start, second | {"long_name": "first second"}),
        "seconds": (points.seconds, second | {"long_name": "seconds spent there"}),
        **{name: (values,) for name, values in points.conditions.items()},
        "opening": (plants.opening,),
        "gain": (plants.gain, kelvin | {"long_name": "change per unit of opening"}),
        "reachable": (plants.reachable,),
        **{name: (getattr(cycles, name),) for name in ("hunting_index", "hunts")},
        "period": (cycles.period, second),
        "amplitude": (cycles.amplitude, kelvin | {"long_name": "half of peak to peak"}),
    }
    return xr.Dataset({name: ("point", *variable) for name, variable in variables.items()})


@dataclass(frozen=True, repr=False)
class Explanation:
    """Explanation of one loop on one day: whether it hunts, why, and what helps.

    Attributes
    ----------
    hunts
        Whether the loop makes the swing of the day itself: it would also swing with air, water and set-point constant.
    predicted
        Whether the linear model predicts hunting at some operating point; None where it cannot tell.
    hunting_index
        Largest ``|L| |N|`` of the describing function on the day; above 0.85 a loop hunts.  NaN where theory has none.
    period, amplitude
        Of the predicted cycle at the worst operating point, s and K (half of peak to peak); NaN without.
    why
        The reason in a sentence.
    doubts
        Why theory cannot tell, or what it leaves out; empty where there is nothing.
    phase
        DataArray over ``part``: phase lag of each part of the loop at the critical frequency, degrees; None without.
    points
        Dataset over ``point``: each hour at each set-point with its hunting index; None where theory cannot tell.
    cures
        Dataset over ``cure``, ``as_it_is`` first: the parameters that change, the predicted ``hunting_index``, the
        simulated metrics, ``hunts`` judged as above, ``swing_alone`` (K, with air, water and set-point constant),
        ``rings`` (1 where changes start a swing that dies out), ``chatters``, ``words`` and ``verdict``.
    recommended, advice
        The cure to take, ``as_it_is`` where the loop is good, or nothing helps; and the sentences that say so.
    contradiction
        The sentence that says where the converged march turns the answer or the advice round; empty where it does not.
    loop, boundary
        The arguments of ``explain``.
    """

    doubts: tuple[str, ...]
    simulated: xr.Dataset  # the cures with their traces
    best_advice: Advice
    contradiction: str
    loop: Loop
    boundary: Boundary
    prediction: Prediction | None

    @property
    def phase(self) -> xr.DataArray | None:
        return None if self.prediction is None else phase_shares(self.prediction)

    @property
    def points(self) -> xr.Dataset | None:
        return None if self.prediction is None else _points_dataset(self.prediction)

    @property
    def cures(self) -> xr.Dataset:
        return self.simulated.drop_vars([self.loop["controlled"], "elapsed_time"])

    @property
    def recommended(self) -> str:
        return str(self.simulated["cure"].values[self.best_advice.best])

    @property
    def advice(self) -> str:
        return "" if self._has_failed else self.best_advice.text

    @property
    def hunts(self) -> bool:
        return bool(self.simulated["hunts"][0] > 0.0)

    @property
    def predicted(self) -> bool | None:
        return None if self.prediction is None else self.prediction.hunting_points.size > 0

    @property
    def hunting_index(self) -> float:
        return self._at_worst_point("hunting_index")

    @property
    def period(self) -> float:
        return self._at_worst_point("period")

    @property
    def amplitude(self) -> float:
        return self._at_worst_point("amplitude")

    def _at_worst_point(self, name: str) -> float:
        p = self.prediction
        return math.nan if p is None else float(getattr(p.cycles, name)[p.worst_point])

    @property
    def why(self) -> str:
        now = self.simulated.isel(cure=0)
        if not now["chatters"]:
            return self._why_it_swings
        estimate, gap = (format_percent(float(now[name])) for name in ("estimate_settled", "backlash_final"))
        return (
            f"Why: the estimate, {estimate}, is larger than the backlash, {gap}; without the inverse the loop "
            f"{self.judge(NO_INVERSE).clause}."
        )

    @property
    def _why_it_swings(self) -> str:
        if self.prediction is None:
            return f"Why: theory cannot tell, since {'; '.join(self.doubts)}.  The answer is that of the simulation."
        kp, ti, stroke, backlash = (float(self.loop[n]) for n in ("kp", "ti", "stroke_time", "backlash"))  # type: ignore[arg-type]
        cures, index = self.cures["cure"].values, self.hunting_index
        index_text = f"hunting index {index:.2g}; a loop hunts above {HUNTING_INDEX_LIMIT:g}"
        factor = HUNTING_INDEX_LIMIT / index if index else math.inf  # the hunting index is proportional to kp
        if not self.predicted:
            return _why_not_predicted(self, self.prediction, index_text, factor, ti)
        ends = "" if self.hunts else "  On this day no such swing persists."
        if index <= HUNTING_INDEX_LIMIT:
            # calm by its hunting index, but not once it swings: the index is that of swings up to 2 K
            motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
            swing = "a large swing sustains itself once started, although a small one dies out"
            return f"Why: {motor}{swing} ({index_text}).{ends}"
        if LONGER_TI in cures:
            needed = f"with this kp the loop needs about {float(self.cures['ti'].sel(cure=LONGER_TI)):g} s"
            fault = f"the integral is too fast for the {plant_in_words(self.loop)}: ti = {ti:.4g} s, while {needed}"
        else:
            highest = f"{format_two_digits(kp * factor)} 1/K with this ti"
            fault = f"the gain is too high: kp = {kp:.4g} 1/K, but it must be below {highest}"
        if self.hunts and REPAIRED_VALVE in cures and not self.cures["hunts"].sel(cure=REPAIRED_VALVE) > 0.0:
            determine = f"and the {stroke:g}-s stroke determine" if stroke else "determines"
            ends = f"  Any backlash triggers it; the {format_percent(backlash)} gap {determine} the size of the swing."
        elif self.hunts:
            repaired = str(self.cures["verdict"].sel(cure=REPAIRED_VALVE).values) if REPAIRED_VALVE in cures else ""
            start = "Noise would swing it" if NOISE_SWINGS_IT in repaired else "It would swing"
            ends = f"  {start} even with a perfect valve."
        return f"Why: {fault} ({index_text}).{ends}"

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        lines = [self.answer, self.why]
        if self.prediction is not None:
            points = _points_dataset(self.prediction)
            lines += [_agreement_line(self, points), _worst_point_line(self.prediction, points)]
            lines += [f"Not in the hunting index: {clause}." for clause in self.doubts]
            lines += ["", *_phase_lines(phase_shares(self.prediction), plant_in_words(self.loop))]
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
        heights = [3.7, 3.8] if prediction is not None else [3.8]  # of map and day, inches
        fig = Figure(figsize=(_WIDTH, sum(heights)), layout="constrained")
        *above, below = fig.subplots(len(heights), squeeze=False, height_ratios=heights)[:, 0]
        if prediction is not None:
            _draw_gains(above[0], self.simulated, prediction)
            middle = int(prediction.points.start[prediction.worst_point])
        _draw_day(below, self, middle)
        fig.suptitle(wrap_text(f"{self.answer}\n{self.why}", _WIDTH - 0.3, 9.0), x=0.01, ha="left", fontsize=9)
        return fig

    @property
    def answer(self) -> str:
        """Whether the loop will hunt, in a sentence, and in another one where the converged march says otherwise."""
        return f"{self._answer_as_given}  {self.contradiction}".rstrip()

    @property
    def _answer_as_given(self) -> str:
        if self._has_failed:
            return "This loop cannot be simulated: temperatures leave the range of the model."
        verdict = self.judge()
        return f"This loop {verdict.clause}{self._reservation}.  {verdict.reason}".rstrip()

    @property
    def _reservation(self) -> str:
        """What the answer adds: chatter, a set-point that is not held, or doubts of a theory that predicts hunting."""
        now = self.simulated.isel(cure=0)
        if now["chatters"]:
            joint = ", and" if self.hunts else ", but"
            return f"{joint} its motor chatters, {6.0 * float(now['switch_frequency']):.0f} reversals an hour"
        if self.hunts:
            return ""
        if now["share_off"] > LOST_SHARE:
            return f", but it does not hold its set-point either: its RMS error is {format_kelvin(float(now['rmse']))}"
        low, high = UNSURE_HUNTING_INDEX
        if self.predicted:
            return ", although theory predicts that it may"
        if self.hunting_index > high:
            return f", although its hunting index is {self.hunting_index:.2g}"
        return ", but it is on the edge" * (self.hunting_index >= low)

    def judge(self, cure: str = AS_IS) -> SwingVerdict:
        """Judge whose swing the day with a cure shows, or as it is."""
        results = self.simulated.sel(cure=cure)
        is_own, is_regular = bool(results["hunts"] > 0.0), bool(results["swing_regularity"] >= LEAST_REGULARITY)
        swing, period, alone = (float(results[n]) for n in ("hunting_swing", "hunting_period", "swing_alone"))
        rings, prefix = bool(results["rings"] > 0.0), "supply air " * self._has_controlled_room
        return SwingVerdict(is_own, is_regular, swing, period, alone, moving_inputs(self.boundary), rings, prefix)

    @property
    def _has_controlled_room(self) -> bool:
        """Whether errors and predictions are those of a room, and swings of the day those of the supply air."""
        return bool(self.loop["controlled"] == "T_room")

    @property
    def _has_failed(self) -> bool:
        return int(self.simulated["status"][0]) != STATUS_OK


def _why_not_predicted(e: Explanation, prediction: Prediction, index_text: str, factor: float, ti: float) -> str:
    """Reason where theory predicts no hunting.  factor: by which kp may grow."""
    if e.hunting_index > HUNTING_INDEX_LIMIT:
        joint = "although" if e.hunts else "but"
        return f"Why: {index_text}, {joint} theory predicts no swing large enough to count as hunting."
    if e.hunts:
        noise = float(e.loop["noise_std"])  # type: ignore[arg-type]
        ends = f": the noise of {format_kelvin(noise)} keeps the swing going" * bool(noise)
        return f"Why: theory does not predict it ({index_text}){ends}."
    shortest = shortest_ti(prediction, HUNTING_INDEX_LIMIT)
    ways = [f"with {factor:.3g} times this kp"] if math.isfinite(factor) else []
    ways += [f"with a ti below {format_two_digits(shortest)} s"] if shortest < ti else []
    return f"Why: {index_text}{', and this one would ' * bool(ways)}{', or '.join(ways)}."


def _cure_table(e: Explanation) -> list[str]:
    """A heading and a row for each cure, relative to the loop as it is."""
    ds = e.cures
    heads = {"hunting_index": "hunting index", "rmse": "RMSE", "hunting_swing": "swing", "motor_travel": "motor travel"}
    if e._has_controlled_room:  # each number says of which temperature it is
        heads |= {"rmse": "RMSE of room", "hunting_swing": "supply air", "settled_range": "room"}
    columns = [ds[name].values for name in heads]
    index, error, swing, travel, *room = columns
    rows: list[tuple[str, ...]] = [("", *heads.values(), "")]
    for k, words in enumerate(ds["words"].values.tolist()):
        if k:
            change, verdict = f"{100 * (error[k] / error[0] - 1):+.0f} %", str(ds["verdict"].values[k])
            travel_text = f"× {format_two_digits(round(travel[k] / travel[0], 3))}" if travel[0] > 0 else "–"
        else:
            change, travel_text = f"{error[0]:.3g} K", f"{travel[0]:.3g} strokes"
            verdict = e.judge().clause.partition(":")[0]
        cells = (f"{index[k]:.2f}", change, format_swing(swing[k]), travel_text, *(format_swing(T[k]) for T in room))
        shown = (cell if np.isfinite(column[k]) else "–" for cell, column in zip(cells, columns, strict=True))
        rows.append((words, *shown, verdict))
    title = "Possible changes and their cost, each simulated on this day"
    return [title, *align_columns(rows, right=range(1, len(heads) + 1))]


def _phase_lines(phase: xr.DataArray, plant_words: str) -> list[str]:
    """Phase lag of each part of the loop, the largest first, without those below 0.5°."""
    words = PHASE_PARTS | {"plant": plant_words}
    ordered = phase.sortby(-phase)
    shares = zip(ordered["part"].values.tolist(), ordered.values.tolist(), strict=True)
    lines = [f"  {words[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= 0.5]
    period = format_period(float(phase.attrs["period"]))
    return [f"Phase lag of each part of the loop (180° in all), at a period of {period}:", *lines]


def _agreement_line(e: Explanation, points: xr.Dataset) -> str:
    """Prediction and simulation compared."""
    hunting = points.isel(point=points["hunts"].values > 0.0)
    swings, cycle, room = 2.0 * hunting["amplitude"].values, "no cycle", "the room " * e._has_controlled_room
    if np.isfinite(swings).any():
        k = int(np.nanargmax(swings))
        cycle = f"{room}up to {format_swing(swings[k])} every {format_period(float(hunting['period'][k]))}"
    elif swings.size:
        cycle = "a cycle whose size theory does not give"
    extremes = format_swing(float(e.simulated["settled_range"][0]))
    simulated = "failed" if e._has_failed else f"it {e.judge().clause}, {room}at most {extremes}"
    line = f"Predicted: {cycle}; simulated: {simulated}."
    return line + "  Where the two disagree, go by the simulation." * (e.predicted != e.hunts)


def _worst_point_line(prediction: Prediction, points: xr.Dataset) -> str:
    """The worst operating point, what is predicted there, and the range of the hunting index over the day."""
    worst, reachable = points.isel(point=prediction.worst_point), points.isel(point=prediction.reachable_points)
    index = reachable["hunting_index"].values
    place = f"{float(worst['T_set']):.3g} °C, {float(worst['start']) / 3600.0:.3g} h after the start"
    place += f" (opening {100 * float(worst['opening']):.0f} %)"
    if points.sizes["point"] == 1:
        return f"Where: at {place}."
    return (
        f"Where: worst at {place}.  Over the day the hunting index goes from {index.min():.2g} to {index.max():.2g}, "
        f"and {prediction.hunting_points.size} of {index.size} operating points are predicted to hunt."
    )


_WIDTH = 7.5  # inches
_MARKS = {"lower_kp": ("v", "lower kp"), "longer_ti": (">", "longer ti"), "simc": ("s", "SIMC"),
    "simulated_gains": ("D", "found by simulation"),
}  # fmt: skip


def _draw_gains(axes: Axes, cures: xr.Dataset, prediction: Prediction) -> None:
    """Draw which kp and ti hunt at the worst operating point; the hunting index is proportional to kp."""
    marked = np.flatnonzero(np.isin(cures["cure"], (AS_IS, *GAIN_CURES)))
    kp, ti = (np.broadcast_to(cures.get(n, prediction.columns[n]), cures.sizes["cure"]) for n in ("kp", "ti"))
    span = 8.0  # from the smallest gains divided by this to so many times the largest
    ti_grid = np.geomspace(ti[marked].min() / span, ti[marked].max() * span, 60)
    swept = prediction.loop.assign(ti=("tuning", ti_grid))
    index = predict_cycles_at(swept, prediction.plants, np.array([prediction.worst_point])).hunting_index[:, 0]
    low, high = kp[marked].min() / span, kp[marked].max() * span
    styles = {0.4: (LINE_GREY, ":"), HUNTING_INDEX_LIMIT: ("black", "-"), 1.7: (LINE_GREY, ":")}
    with np.errstate(divide="ignore"):
        limits = {level: kp[0] * level / index for level in styles}
    label, hunts = f"hunts (hunting index > {HUNTING_INDEX_LIMIT:g})", np.clip(limits[HUNTING_INDEX_LIMIT], low, high)
    axes.fill_between(ti_grid, hunts, high, color=SHADE_GREY, lw=0, label=label)
    for level, (colour, style) in styles.items():
        axes.plot(ti_grid, limits[level], color=colour, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i, box = inside[int(0.85 * inside.size)], {"fc": "white", "ec": "none", "pad": 0.6}
            axes.text(ti_grid[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center", bbox=box)
    axes.plot(ti[0], kp[0], "o", color=RED, ms=7, label="as it is")
    for k in marked[1:]:
        mark, words = _MARKS[str(cures["cure"].values[k])]
        colour = BLUE if cures["hunts"][k] == 0 else YELLOW
        axes.plot(ti[k], kp[k], mark, ms=7, color=colour, mec="black", mew=0.6, ls="none", label=words)
    axes.set(xscale="log", yscale="log", xlim=(ti_grid[0], ti_grid[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Gains that make the loop hunt, judged by the hunting index", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _draw_day(axes: Axes, e: Explanation, middle: int) -> None:
    """Draw the controlled temperature around the second ``middle``, as it is and with the recommended cure."""
    cures, best, boundary, is_room = e.simulated, e.best_advice.best, e.boundary, e._has_controlled_room
    start = max(0, min(middle - 600, boundary.n_steps - (seconds := 6 * 3600 if is_room else 5400)))
    drawn = cures["T_room" if is_room else "T_sup"].sel(elapsed_time=slice(start, start + seconds - 1))
    hours, T = drawn["elapsed_time"].values / 3600.0, drawn.values
    axes.plot(hours, T[0], color=RED, lw=1.0, label="as it is")
    if best:
        axes.plot(hours, T[best], color=BLUE, lw=1.2, label=str(cures["words"].values[best]))
    T_set = boundary.series["T_set"][0][drawn["elapsed_time"].values.astype(int)]
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="room [°C]" if is_room else "supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
