"""Operating points: the conditions of a sweep, and the hours and set-points of one day."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import array_of, checking, instance_of, is_number, plain, refuse
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.design.plants import Columns, Plants, plants_of
from fastcoil.logs.series import TIME
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import check_clashes, check_stability
from fastcoil.loops.labelled import as_labelled, in_our_unit
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import Layout, columns_of, coordinate_attrs
from fastcoil.model.metric_table import WARM_UP

ENTERING = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")  # series of the boundary that make an operating point
Evaluation = Callable[[Columns, Mapping[str, Array], Plants], Iterable[tuple[str, Array]]]
"""Variables by name, (n, …) each, of n points with these parameters, conditions and plants."""
_CHUNK = 2048  # points at a time: their responses take up to 60 MB


def chunks(n: int) -> list[Index]:
    """The numbers 0 to n - 1 in parts that fit into memory."""
    return [np.arange(first, min(first + _CHUNK, n)) for first in range(0, n, _CHUNK)]


class OperatingPoints:
    """Every loop of a sweep at every operating point, in one flat order.

    Dims are those of the loop, then ``day`` if the boundary has it, then ``elapsed_time`` if several seconds are asked
    for.  loop, boundary, at: see ``linearise``.  warm_up: seconds that the mean of a day leaves out.
    """

    def __init__(self, loop: Loop, boundary: Boundary, at: Any = None, warm_up: int = WARM_UP) -> None:
        with checking() as check:
            check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
            check(instance_of, "boundary", boundary, Boundary, "give a fastcoil.Boundary, such as fastcoil.paper_day()")
        self.seconds = _seconds_of(at, boundary.n_steps)
        self.has_times = self.seconds is not None and np.ndim(plain(at)) > 0
        self._entering = _means(boundary, warm_up) if self.seconds is None else _samples(boundary, self.seconds)
        layout = Layout(loop, boundary)
        check_clashes(layout.loop, np.array(boundary.extremes["T_set"]), boundary.extremes["backlash_scale"][0])
        require_one_gap(boundary)
        check_stability(layout)
        self.loop, self._layout = layout.loop, layout
        self.sizes = dict(loop.sizes)
        if boundary.has_day_dim:
            self.sizes["day"] = boundary.n_days
        if self.seconds is not None and self.has_times:
            self.sizes["elapsed_time"] = self.seconds.size
        self.size = math.prod(self.sizes.values())

    def evaluated(self, variables: Evaluation) -> dict[str, Array]:
        """Variables of all points, (size, …) each, computed in parts that fit into memory."""
        parts = []
        for index in chunks(self.size):
            columns, conditions = self.columns(index), self.conditions(index)
            parts.append(dict(variables(columns, conditions, plants_of(columns, conditions))))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def columns(self, index: Index) -> dict[str, np.ndarray]:
        """Every parameter at the points ``index``, see ``columns_of``."""
        return columns_of(self.loop, self.sizes, index)

    def conditions(self, index: Index) -> dict[str, Array]:
        """What enters at the points ``index``, and T_set: (n,) each."""
        places = np.unravel_index(index, tuple(self.sizes.values())) if self.sizes else ()
        place = dict(zip(self.sizes, places, strict=True))
        nothing = np.zeros(index.size, np.int64)
        at = place.get("day", nothing), place.get("elapsed_time", nothing)
        return {name: values[at] for name, values in self._entering.items()}

    def plants(self, index: Index) -> Plants:
        """The plants at the points ``index``, at rest."""
        return plants_of(self.columns(index), self.conditions(index))

    def dataset(self, variables: Mapping[str, tuple[Array, Mapping[str, Any]]]) -> xr.Dataset:
        """Name results, each (size, …) with its attributes; dims behind the first are in ``attrs["dims"]``."""
        labels = self._layout.coordinates()
        if self.seconds is not None:
            dims = ("elapsed_time",) if self.has_times else ()
            labels["elapsed_time"] = xr.DataArray(self.seconds.astype(float).reshape(-1 if dims else ()), dims=dims)
        clash = sorted({*labels, *self.sizes} & variables.keys())
        if clash:
            raise InputError(f"{clash[0]} is swept, and a result has that name: give the dimension another name")
        shape, found = tuple(self.sizes.values()), {}
        for name, (values, attrs) in variables.items():
            more = tuple(attrs.get("dims", ()))
            kept = {k: v for k, v in attrs.items() if k != "dims"}
            found[name] = ((*self.sizes, *more), values.reshape((*shape, *values.shape[1:])), kept)
        table = self.loop.parameters
        return xr.Dataset(found, {n: c.assign_attrs(coordinate_attrs(n, table)) for n, c in labels.items()})


def require_pi(loop: Loop) -> None:
    """Refuse control laws other than the PI, whose open loop nobody knows."""
    words = sorted(set(np.unique(np.asarray(loop["law"])).tolist()) - {"pi"})
    refuse([f"law = {word!r}: the open loop is known for the PI only" for word in words])


def _seconds_of(at: Any, n_steps: int) -> Index | None:
    cure = f"give a second of the boundary, a whole number from 0 to {n_steps - 1}, or a list of them"
    if at is None:
        return None
    labelled = as_labelled("at", at, "at")
    at = at if labelled is None else in_our_unit("at", labelled, TIME)
    values = np.array([float(plain(at))]) if is_number(at) else array_of("at", at, cure)
    if values.ndim != 1 or not values.size:
        raise InputError(WrongType(f"at = {shown(at)}: {cure}"))
    wrong = values[~((values >= 0) & (values < n_steps) & (values == np.floor(values)))]
    if wrong.size:
        raise InputError(f"at has {wrong[0]:g}: {cure}")
    return values.astype(np.int64)


def require_one_gap(boundary: Boundary) -> None:
    """Refuse a boundary that changes the backlash: theory knows a gap of one size."""
    low, high = boundary.extremes["backlash_scale"]
    if not low == high == 1.0:
        found = f"= {low:g}" if low == high else f"goes from {low:g} to {high:g}"
        cure = "give boundary.assign(backlash_scale=1), and the backlash that you mean"
        raise InputError(f"backlash_scale {found}: theory knows a gap of one size; {cure}")


def mean_conditions(boundary: Boundary, warm_up: int, *, carry_over: bool = False) -> dict[str, Array]:
    """Means of ENTERING over enabled seconds, (n_days,); NaN without any.  carry_over: only day 1 has a warm-up."""
    found = {name: np.empty(boundary.n_days) for name in ENTERING}
    for k in range(boundary.n_days):
        rows = boundary.of_day(k)
        counted = rows["enabled"] != 0.0
        counted[: 0 if carry_over and k else warm_up] = False
        n = np.count_nonzero(counted)
        for name, means in found.items():
            means[k] = np.where(counted, rows[name], 0.0).sum() / (n or np.nan)
    return found


def _means(boundary: Boundary, warm_up: int) -> dict[str, Array]:
    """``mean_conditions``, (n_days, 1); refused where a day has none."""
    found = mean_conditions(boundary, warm_up)
    without = np.flatnonzero(np.isnan(found["T_set"]))
    if without.size:
        on = f"on day {boundary.day[without[0]]} " if boundary.has_day_dim else ""
        raise InputError(
            f"no second {on}is enabled after the warm-up of {warm_up} s: take another day, or a longer one, "
            "or give the second as at="
        )
    return {name: means[:, None] for name, means in found.items()}


def _samples(boundary: Boundary, seconds: Index) -> dict[str, Array]:
    """What enters at some seconds, (n_days, n)."""
    days = [{n: rows[n][seconds] for n in ENTERING} for rows in map(boundary.of_day, range(boundary.n_days))]
    return {name: np.stack([day[name] for day in days]) for name in ENTERING}


SAME_SET_POINT = 0.5  # set-points of an hour that differ by less may count as one, K
SHORTEST = 300  # seconds that an hour must spend at a set-point before it counts as an operating point of its own


class PointsOfDay(NamedTuple):
    """Operating points of a day, in the order of time."""

    start: Index  # first second, (n,)
    seconds: Index  # how many the point stands for, (n,)
    conditions: dict[str, Array]  # means, (n,) each
    of_second: Index  # number of the point that a second belongs to, -1 for none, (n_steps,)

    @property
    def size(self) -> int:
        return self.start.size


def operating_points(boundary: Boundary, warm_up: int, at: int | None = None) -> PointsOfDay:
    """Points of a day: of each hour at each set-point, or of the second ``at``; plant on, after the warm-up."""
    series = {name: boundary.series[name][0] for name in ENTERING}
    on = boundary.series["enabled"][0] > 0.0
    if at is not None:
        if not on[at]:
            raise InputError(f"at = {at}: the plant is off at that second, give one at which it runs")
        only = np.where(np.arange(on.size) == at, 0, -1)
        return PointsOfDay(np.array([at]), np.array([1]), {n: v[at : at + 1].copy() for n, v in series.items()}, only)
    counted = np.flatnonzero(on & (np.arange(on.size) >= warm_up))
    if not counted.size:
        raise InputError("the loop is off all day: take a day on which it is enabled")
    level = np.round(series["T_set"][counted] / SAME_SET_POINT)
    level -= level.min()
    _, member = np.unique(counted // 3600 * (level.max() + 1.0) + level, return_inverse=True)
    seconds = np.bincount(member)
    start = np.full(seconds.size, on.size)
    np.minimum.at(start, member, counted)
    means = {n: np.bincount(member, v[counted]) / seconds for n, v in series.items()}
    long = seconds >= min(SHORTEST, int(seconds.max()))
    order = np.flatnonzero(long)[np.argsort(start[long])]
    number = np.full(seconds.size, -1)
    number[order] = np.arange(order.size)
    of_second = np.full(on.size, -1)
    of_second[counted] = number[member]
    return PointsOfDay(start[order], seconds[order], {n: v[order] for n, v in means.items()}, of_second)
