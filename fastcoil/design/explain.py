"""explain: whether one loop will hunt, why, what would cure it, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, instance_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.text import aligned
from fastcoil.design.advice import (
    DEAD_BAND,
    LONGER_TI,
    REPAIRED,
    UNSURE,
    cures_of,
    hunting,
    hunts_uncounted,
    recommended,
    swings_at,
    try_cures,
    verdict,
)
from fastcoil.design.explain_page import draw
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.linearise import margins_of
from fastcoil.design.operating_points import operating_points
from fastcoil.design.prediction import (
    Prediction,
    left_out,
    phase_shares,
    predict,
    shortest_ti,
    why_no_margin,
    why_not_linear,
)
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import STATUS_OK, WARM_UP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST = 7 * 86400
"""Seconds of a boundary that is explained: the operating points are reported one by one."""
_LOST = 0.5  # share of the time off the set-point from which a loop does not control


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
    with checking() as check:
        check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        check(instance_of, "boundary", boundary, Boundary, "give a fastcoil.Boundary, such as fastcoil.paper_day()")
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
    plan_simulation(loop, boundary, traces=["T_sup"], warm_up=warm_up, seed=seed)
    if loop["estimate_ratio"] is not None:  # a cure may change the backlash, or the estimate
        loop = loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]
    points = operating_points(boundary, warm_up, second)
    doubts = why_not_linear(loop)
    prediction = None if doubts else predict(loop, points)
    if prediction is not None:
        doubts = why_no_margin(prediction)
        prediction = None if doubts else prediction
    tried = cures_of(loop, prediction)
    cures = try_cures(loop, boundary, tried, prediction, warm_up, seed)
    swings = swings_at(points, boundary, cures.isel(cure=0))
    cures = cures.assign(uncounted=prediction is not None and hunts_uncounted(prediction, swings, cures.isel(cure=0)))
    cures = cures.assign(verdict=("cure", [verdict(cures, k) for k in range(len(tried))]))
    best = tried[recommended(cures, [cure.name for cure in tried])].name
    if prediction is None:
        return Explanation(doubts, None, None, cures, best, loop, boundary, None)
    found = _points_of(prediction, swings)
    return Explanation(left_out(prediction), phase_shares(prediction), found, cures, best, loop, boundary, prediction)


def _points_of(prediction: Prediction, swings: Array) -> xr.Dataset:
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
            "swing": ("point", swings, kelvin | {"long_name": "simulated, peak to peak"}),
        }
    )


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

    doubts: tuple[str, ...]
    phase: xr.DataArray | None
    points: xr.Dataset | None
    simulated: xr.Dataset  # the cures with their traces
    recommended: str
    loop: Loop
    boundary: Boundary
    prediction: Prediction | None

    @property
    def cures(self) -> xr.Dataset:
        """What was tried, as it is first, and what it does."""
        return self.simulated.drop_vars(["T_sup", "elapsed_time", "uncounted"])

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts."""
        return bool(self.simulated["hunts"][0] > 0)

    @property
    def predicted(self) -> bool | None:
        """Whether theory predicts hunting; None where it cannot tell."""
        return None if self.prediction is None else self.prediction.hunting.size > 0

    @property
    def margin(self) -> float:
        """Largest margin of the day."""
        return math.nan if self.prediction is None else self.prediction.margin

    @property
    def period(self) -> float:
        """Period of the cycle predicted at the worst operating point, s."""
        return math.nan if self.prediction is None else float(self.prediction.cycles.period[self.prediction.worst])

    @property
    def amplitude(self) -> float:
        """Half of peak to peak of the cycle predicted at the worst operating point, K."""
        return math.nan if self.prediction is None else float(self.prediction.cycles.amplitude[self.prediction.worst])

    @property
    def why(self) -> str:
        """The reason in a sentence."""
        return _why(self)

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        lines = [self.answer, self.why]
        if self.points is not None and self.phase is not None:
            lines += [*_agreement(self, self.points), _where(self, self.points)]
            lines += [f"Not in the margin: {clause}." for clause in self.doubts]
            lines += ["", *_phase(self.phase)]
        return "\n".join([*lines, "", *_table(self), *self.advice])

    def __repr__(self) -> str:
        return f"<fastcoil explanation: {self.answer}>"

    def __str__(self) -> str:
        return self.text

    def plot(self) -> Figure:
        """The explanation on one page, as a matplotlib ``Figure``."""
        best = self._number_of(self.recommended) or 0
        return draw(f"{self.answer}\n{self.why}", self.boundary, self.simulated, best, self.prediction)

    @property
    def answer(self) -> str:
        """Whether the loop will hunt, in one sentence."""
        if self._failed:
            return "This loop cannot be simulated: temperatures leave the range of the model."
        if self.hunts:
            return f"This loop will hunt: about {_simulated_swing(self)}."
        if self._lost and not self._needs_cure:
            error = kelvin(float(self.cures["rmse"][0]))
            return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
        if self.prediction is None or not self.predicted:
            return f"This loop will not hunt{', but it is on the edge' * _is_unsure(self)}."
        there = self.prediction.hunting
        places = f"{there.size} of {self.prediction.reached.size} operating points"
        if self._needs_cure and self.points is not None:
            swing = kelvin(float(self.points["swing"][there].median()))
            return f"This loop will hunt, but not all day or not regularly: by about {swing} peak to peak at {places}."
        return f"This loop will hardly hunt: theory predicts it at {places}, which the simulated day does not show."

    @property
    def advice(self) -> list[str]:
        """What to do, in a sentence, and what a dead band leaves or the backlash costs."""
        if self._failed:
            return []
        best, error, travel = self._number_of(self.recommended), self.cures["rmse"].values, self.cures["motor_travel"]
        band, repaired = self._number_of(DEAD_BAND), self._number_of(REPAIRED)
        lines = []
        if self._needs_cure and band is not None:
            width = self._value("error_dead_band", band)
            lines = [f"The dead band leaves the margin as it is, and holds any error up to {width:g} K."]
        elif not self._needs_cure and repaired is not None and kelvin(error[0]) != kelvin(error[repaired]):
            now, without = kelvin(error[0]), kelvin(error[repaired])
            gap = per_cent(self._value("backlash"))
            lines = [f"What the backlash of {gap} costs anyway: RMSE {now} instead of {without}."]
        if best:
            moved = f", motor travel × {number(float(travel[best] / travel[0]))}" if travel[0] else ""
            then_do = "Do this" if self._needs_cure else "If the error matters"
            change = f"RMSE {100 * (error[best] / error[0] - 1.0):+.0f} %{moved}"
            return [*lines, f"{then_do}: {self.cures['words'].values[best]}: {change}."]
        if self._needs_cure:
            return [*lines, "None of these cures it."]
        if self._lost:
            return [*lines, "None of these makes it hold its set-point."]
        return [*lines, "Leave it: none of these takes 5 % off the error."]

    @property
    def _failed(self) -> bool:
        return int(self.simulated["status"][0]) != STATUS_OK

    @property
    def _needs_cure(self) -> bool:
        """Whether it hunts, for a part of the day at least."""
        return bool(hunting(self.simulated)[0])

    @property
    def _lost(self) -> bool:
        """Whether it is off its set-point for most of the time."""
        return bool(self.simulated["share_off"][0] > _LOST)

    def _value(self, name: str, k: int = 0) -> float:
        """A parameter of the loop with a cure."""
        of_cures = self.simulated.get(name)
        return float(self.loop[name] if of_cures is None or not of_cures.ndim else of_cures[k])  # type: ignore[arg-type]

    def _number_of(self, cure: str) -> int | None:
        """Index of a cure; None if it was not tried."""
        names = self.simulated["cure"].values.tolist()
        return names.index(cure) if cure in names else None


def _why(e: Explanation) -> str:
    """The reason, in a sentence or two."""
    if e.prediction is None:
        return f"Why: theory cannot tell, since {'; '.join(e.doubts)}.  The answer is that of the simulation."
    margin, kp, ti, stroke = e.margin, *(e._value(name) for name in ("kp", "ti", "stroke_time"))
    known = f"margin {margin:.2g}; a loop hunts above {HUNTS_ABOVE:g}"
    # the margin goes with kp
    factor = HUNTS_ABOVE / margin if margin else math.inf
    largest = number(kp * factor)
    if not e.predicted:
        if margin > HUNTS_ABOVE:
            return f"Why: {known}, so kp has to be below {largest} 1/K, but theory finds no swing that counts."
        shortest = shortest_ti(e.prediction, HUNTS_ABOVE)
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
    columns = {**e.prediction.columns, "backlash": np.zeros(1)}
    if not gap or margins_of(columns, e.prediction.plant).gain_margin[0] <= 1.0:
        return f"Why: {fault} ({known}).  It would swing behind a perfect valve, too."
    motor = f" and the motor's {stroke:g} s" if stroke else ""
    return f"Why: {fault} ({known}).  Any backlash starts it; its {per_cent(gap)}{motor} set the size of the swing."


def _is_unsure(e: Explanation) -> bool:
    """Whether the margin is so near its limit that it does not decide."""
    return UNSURE[0] <= e.margin <= UNSURE[1]


def _simulated_swing(e: Explanation) -> str:
    """The swing of the simulated day."""
    swing, period = (float(e.cures[name][0]) for name in ("hunting_swing", "hunting_period"))
    return f"{kelvin(swing)} peak to peak every {seconds(period)}"


MINUTES = 120.0
"""Seconds from which a period is given in minutes."""
_NOTHING = 5e-4  # temperature difference that nobody sees, K


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
            says = "hunts" if e.hunts else "hunts in part" if e._needs_cure else "does not hunt"
        cells = (f"{margin[k]:.2f}", change, kelvin(swing[k]), moved)
        known = np.isfinite([margin[k], error[k], swing[k], travel[k]])
        rows.append((words, *(cell if is_known else "–" for cell, is_known in zip(cells, known, strict=True)), says))
    return ["What could be done, and what it costs: the day simulated with each", *aligned(rows, right=range(1, 5))]


_LEAST_SHARE = 0.5  # degrees; less is not shown
_PARTS = {
    "integral": "integral of the PI",
    "coil": "coil",
    "sensor": "sensor",
    "sampling": "sampling and hold",
    "backlash": "backlash (and motor)",
}


def _phase(phase: xr.DataArray) -> list[str]:
    """What each part of the loop takes, the largest first."""
    ordered = phase.sortby(-phase)
    shares = zip(ordered["part"].values.tolist(), ordered.values.tolist(), strict=True)
    taken = [f"  {_PARTS[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= _LEAST_SHARE]
    return [f"Where the 180° of phase go, at one swing in {seconds(float(phase.attrs['period']))}:", *taken]


def _agreement(e: Explanation, points: xr.Dataset) -> list[str]:
    """What theory predicts beside what the simulation shows."""
    if e._failed or e.prediction is None:
        return []
    shown = _simulated_swing(e) if e.hunts else f"no hunting, RMS error {kelvin(float(e.cures['rmse'][0]))}"
    there = points.isel(point=e.prediction.hunting)
    swings, periods = 2.0 * there["amplitude"].values, there["period"].values
    if not swings.size:
        cycle = "no cycle"
    elif np.isfinite(swings).any():
        every = _span(periods, "s") if float(np.nanmax(periods)) < MINUTES else _span(periods / 60.0, "min")
        cycle = f"{_span(swings, 'K')} peak to peak every {every}"
    else:
        cycle = "a cycle, of a size that theory does not give"
    lines = [f"Predicted: {cycle}; simulated over the day: {shown}."]
    if _is_unsure(e) or e.predicted != e.hunts:
        lines.append(f"Near a margin of {HUNTS_ABOVE:g}, or where the two disagree, go by the simulation.")
    return lines


def _span(values: Array, unit: str) -> str:
    low, high = (number(float(end)) for end in (np.nanmin(values), np.nanmax(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _where(e: Explanation, points: xr.Dataset) -> str:
    """Which operating point is quoted, what happens there, and how the margin differs over the day."""
    assert e.prediction is not None
    at, margin = points.isel(point=e.prediction.worst), points["margin"].values[e.prediction.reached]
    place = f"{float(at['T_set']):.3g} °C, {float(at['start']) / 3600.0:.3g} h after the start"
    place += f" (opening {100 * float(at['opening']):.0f} %)"
    swing, shown = 2.0 * float(at["amplitude"]), float(at["swing"])
    if math.isfinite(swing) and math.isfinite(shown):
        place += f": {kelvin(swing)} predicted, {kelvin(shown)} simulated"
    if points.sizes["point"] == 1:
        return f"Where: at {place}."
    return (
        f"Where: worst at {place}.  Over the day the margin goes from {margin.min():.2g} to {margin.max():.2g}, and "
        f"{e.prediction.hunting.size} of {margin.size} operating points are predicted to hunt."
    )
