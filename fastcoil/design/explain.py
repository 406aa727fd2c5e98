"""explain: whether one loop will hunt, why, what would cure it, and what that costs."""

from __future__ import annotations

import math

import xarray as xr

from fastcoil.base.arguments import checking, instance_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.design.answer import Explanation
from fastcoil.design.cures import (
    Prediction,
    cures_of,
    hunts_uncounted,
    left_out,
    phase_shares,
    predict,
    recommended,
    response_of,
    swings_at,
    try_cures,
    verdict,
    why_no_margin,
    why_not_linear,
)
from fastcoil.design.operating_points import operating_points
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import WARM_UP

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
    worst = {"margin": math.nan, "period": math.nan, "amplitude": math.nan}
    if prediction is not None:
        worst = {name: float(getattr(prediction.cycles, name)[prediction.worst]) for name in worst}
    return Explanation(
        predicted=prediction.hunts if prediction is not None else None,
        **worst,
        doubts=left_out(prediction) if prediction is not None else doubts,
        phase=phase_shares(loop, response_of(prediction)) if prediction is not None else None,
        points=_points_of(prediction, swings) if prediction is not None else None,
        cures=cures.drop_vars(["T_sup", "elapsed_time", "uncounted"]),
        recommended=tried[recommended(cures, [cure.name for cure in tried])].name,
        loop=loop,
        boundary=boundary,
        _prediction=prediction,
        _simulated=cures,
    )


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
