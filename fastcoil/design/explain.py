"""explain: whether one loop will hunt, why, what would cure it, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import xarray as xr

from fastcoil.base.arguments import checking, instance_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.design.answer import Found, Theory, answer_of, page, sentences, why_of
from fastcoil.design.cures import (
    PARTS,
    Prediction,
    cures_of,
    gain_margin_without_backlash,
    hunts_uncounted,
    left_out,
    phase_shares,
    predict,
    recommended,
    response_of,
    shortest_ti,
    swings_at,
    try_cures,
    verdict,
    why_no_margin,
    why_not_linear,
)
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.operating_points import operating_points
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import WARM_UP

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Explanation:
    """Why one loop hunts on one day, or does not.

    Attributes
    ----------
    hunts
        Whether the simulated day hunts, see the metric of that name.
    foretold
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
    """

    hunts: bool
    foretold: bool | None
    margin: float
    period: float
    amplitude: float
    why: str
    doubts: tuple[str, ...]
    phase: xr.DataArray | None
    points: xr.Dataset | None
    cures: xr.Dataset
    recommended: str
    _found: Found

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        return "\n".join(sentences(self._found))

    def __repr__(self) -> str:
        return f"<fastcoil explanation: {answer_of(self._found)}>"

    def __str__(self) -> str:
        return self.text

    def plot(self) -> Figure:
        """The explanation on one page, as a matplotlib ``Figure``."""
        return page(self._found)


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
    with checking() as check:
        check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        check(instance_of, "boundary", boundary, Boundary, "give a fastcoil.Boundary, such as fastcoil.paper_day()")
    with checking() as check:
        check.problems += _too_many(loop, boundary)
        last = boundary.n_steps - 1
        cure = f"give a second of the boundary, a whole number from 0 to {last}"
        second = check.unless_none(whole_of, "at", at, 0, last, cure)
    plan_simulation(loop, boundary, traces=["T_sup"], warm_up=warm_up, seed=seed)
    loop = _with_estimate(loop)
    points = operating_points(boundary, warm_up, second)
    doubts = why_not_linear(loop)
    prediction = predict(loop, points) if not doubts else None
    if prediction is not None:
        doubts = why_no_margin(loop, prediction)
        prediction = None if doubts else prediction
    tried = cures_of(loop, prediction)
    cures = try_cures(loop, boundary, tried, prediction, warm_up, seed)
    swings = swings_at(points, boundary, cures.isel(cure=0))
    theory = theory_of(loop, prediction, swings) if prediction is not None else None
    uncounted = prediction is not None and hunts_uncounted(prediction, swings, cures.isel(cure=0))
    cures = cures.assign(uncounted=uncounted)
    cures = cures.assign(verdict=("cure", [verdict(cures, k) for k in range(len(tried))]))
    found = Found(
        loop=loop,
        boundary=boundary,
        theory=theory,
        doubts=doubts,
        left_out=left_out(loop, prediction) if prediction is not None else (),
        cures=cures,
        best=recommended(cures, [cure.name for cure in tried]),
    )
    worst: dict[str, Any] = {"foretold": None, "margin": math.nan, "period": math.nan, "amplitude": math.nan}
    if prediction is not None:
        cycles = prediction.cycles
        worst = {"foretold": prediction.hunts, "margin": prediction.margin}
        worst |= {name: float(getattr(cycles, name)[prediction.worst]) for name in ("period", "amplitude")}
    return Explanation(
        hunts=found.hunts,
        **worst,
        why=why_of(found),
        doubts=found.doubts + found.left_out,
        phase=theory.phase if theory is not None else None,
        points=theory.points if theory is not None else None,
        cures=cures.drop_vars(["T_sup", "elapsed_time", "uncounted"]),
        recommended=tried[found.best].name,
        _found=found,
    )


def _too_many(loop: Loop, boundary: Boundary) -> list[str]:
    found = []
    if loop.sizes:
        dims = ", ".join(f"{dim} ({size})" for dim, size in loop.sizes.items())
        found.append(f"loop is a sweep over {dims}: give one loop, with a number for each parameter")
    if boundary.n_days > 1:
        found.append(f"boundary has {boundary.n_days} days: give one, such as boundary.isel(0)")
    if boundary.n_steps > LONGEST:
        found.append(
            f"boundary lasts {boundary.hours:g} h: give at most {LONGEST // 3600} h, they are reported one by one"
        )
    return found


def _with_estimate(loop: Loop) -> Loop:
    """The loop with its estimate as such: a cure may change the backlash, or the estimate."""
    if loop["estimate_ratio"] is None:
        return loop
    return loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]


def theory_of(loop: Loop, prediction: Prediction, swings: Array) -> Theory:
    """What theory tells at the worst operating point."""
    response = response_of(loop, prediction)
    shares = phase_shares(loop, response)
    attrs = {"units": "degree", "long_name": "phase that each part of the loop takes", "period": response.period}
    phase = xr.DataArray([shares[part] for part in PARTS], dims="part", coords={"part": list(PARTS)}, attrs=attrs)
    # the margin goes with kp
    factor = HUNTS_ABOVE / prediction.margin if prediction.margin else math.inf
    ti = shortest_ti(loop, prediction, HUNTS_ABOVE)
    return Theory(
        prediction, response, factor, ti, phase, gain_margin_without_backlash(loop, prediction), swings
    )  # fmt: skip
