"""Operating points: the conditions of a sweep, and the hours and set-points of one day."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, is_number, require_array, require_instance, to_builtin
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, short_repr
from fastcoil.design.plants import Columns, Plants, linearise_plants
from fastcoil.logs.series import TIME
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import check_clashes, check_stability
from fastcoil.loops.labelled import to_bare_numbers
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import Layout, coordinate_attrs, parameter_columns
from fastcoil.model.metric_table import WARM_UP_S

CONDITION_SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "T_out", "Q_room", "dp_ratio")
"""Series of the boundary that are the conditions of a point."""
Evaluation = Callable[[Columns, Plants], Iterable[tuple[str, Array]]]
"""Variables by name, (n, …) each, of n points with these parameters and plants."""


def index_chunks(n: int, size: int = 2048) -> list[Index]:
    """Split the numbers 0 to n - 1 into chunks: the responses of 2,048 points take up to 60 MB."""
    return [np.arange(first, min(first + size, n)) for first in range(0, n, size)]


class OperatingPoints:
    """Every loop of a sweep at every operating point, in one flat order; warm_up: seconds that a day's mean leaves out.

    Dims are those of the loop, then ``day`` if the boundary has it, then ``elapsed_time`` if ``at`` is a list.
    """

    def __init__(self, loop: Loop, boundary: Boundary, at: Any = None, warm_up: int = WARM_UP_S) -> None:
        with argument_checks() as check:
            check(require_instance, "loop", loop, Loop, "give a fastcoil.Loop")
            cure = "give a fastcoil.Boundary, such as fastcoil.paper_day()"
            check(require_instance, "boundary", boundary, Boundary, cure)
        seconds = _parse_seconds(at, boundary.n_steps)
        self.seconds, self.has_times = seconds, seconds is not None and np.ndim(to_builtin(at)) > 0
        if seconds is None:
            self._entering = _require_mean_conditions(boundary, warm_up)
        else:
            days = [boundary.of_day(k) for k in range(boundary.n_days)]
            self._entering = {name: np.stack([day[name][seconds] for day in days]) for name in CONDITION_SERIES}
        layout = Layout(loop, boundary)
        check_clashes(layout.loop, np.array(boundary.extremes["T_set"]), boundary.extremes["backlash_scale"][0])
        require_one_gap(boundary)
        check_stability(layout)
        self.loop, self._layout = layout.loop, layout
        self.sizes = dict(loop.sizes)
        if boundary.has_day_dim:
            self.sizes["day"] = boundary.n_days
        if seconds is not None and self.has_times:
            self.sizes["elapsed_time"] = seconds.size
        self.size = math.prod(self.sizes.values())

    def evaluate(self, variables: Evaluation) -> dict[str, Array]:
        """Return variables of all points, (size, …) each, computed in chunks that fit into memory."""
        parts = []
        for index in index_chunks(self.size):
            columns = self.columns(index)
            parts.append(dict(variables(columns, linearise_plants(columns, self.conditions(index), self.loop.rules))))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def columns(self, index: Index) -> dict[str, np.ndarray]:
        """Every parameter at the points ``index``, see ``parameter_columns``."""
        return parameter_columns(self.loop, self.sizes, index)

    def conditions(self, index: Index) -> dict[str, Array]:
        """``CONDITION_SERIES`` at the points ``index``, (n,) each."""
        places = np.unravel_index(index, tuple(self.sizes.values())) if self.sizes else ()
        along, zeros = dict(zip(self.sizes, places, strict=True)), np.zeros(index.size, np.int64)
        place = along.get("day", zeros), along.get("elapsed_time", zeros)
        return {name: values[place] for name, values in self._entering.items()}

    def dataset(self, variables: Mapping[str, tuple[Array, Mapping[str, Any]]]) -> xr.Dataset:
        """Label results, (size, …) each, with their attributes; ``attrs["dims"]`` has the dims after the first."""
        labels = self._layout.coordinates()
        if self.seconds is not None:
            dims = ("elapsed_time",) if self.has_times else ()
            labels["elapsed_time"] = xr.DataArray(self.seconds.astype(float).reshape(-1 if dims else ()), dims=dims)
        clash = sorted({*labels, *self.sizes} & variables.keys())
        if clash:
            sentence = f"{clash[0]} is swept, and a result has that name: give the dimension another name"
            raise InputError(sentence, clash[0], "conflict")
        shape, data_vars = tuple(self.sizes.values()), {}
        for name, (values, attrs) in variables.items():
            dims = (*self.sizes, *attrs.get("dims", ()))
            about = {key: text for key, text in attrs.items() if key != "dims"}
            data_vars[name] = (dims, values.reshape((*shape, *values.shape[1:])), about)
        table = self.loop.parameters
        return xr.Dataset(data_vars, {n: c.assign_attrs(coordinate_attrs(n, table)) for n, c in labels.items()})


def require_pi(loop: Loop) -> None:
    """Refuse control laws other than the PI, whose open loop is unknown."""
    laws = sorted(set(np.unique(np.asarray(loop["law"])).tolist()) - {"pi"})
    if laws:
        sentences = [f"law = {law!r}: the open loop is known for the PI only" for law in laws]
        raise InputError(sentences, "law", "unsupported")


def _parse_seconds(at: Any, n_steps: int) -> Index | None:
    cure = f"give a second of the boundary, a whole number from 0 to {n_steps - 1}, or a list of them"
    if at is None:
        return None
    at = to_bare_numbers("at", at, TIME)
    values = np.array([float(to_builtin(at))]) if is_number(at) else require_array("at", at, cure)
    if values.ndim != 1 or not values.size:
        raise InputError(f"at = {short_repr(at)}: {cure}", "at", "type")
    wrong = values[~((values >= 0) & (values < n_steps) & (values == np.floor(values)))]
    if wrong.size:
        raise InputError(f"at has {wrong[0]:g}: {cure}", "at", "value")
    return values.astype(np.int64)


def require_one_gap(boundary: Boundary) -> None:
    """Refuse a boundary that changes the backlash: theory knows a gap of one size."""
    low, high = boundary.extremes["backlash_scale"]
    if not low == high == 1.0:
        scale_text = f"= {low:g}" if low == high else f"goes from {low:g} to {high:g}"
        cure = "theory knows a gap of one size; give boundary.assign(backlash_scale=1), and the backlash that you mean"
        raise InputError(f"backlash_scale {scale_text}: {cure}", "backlash_scale", "unsupported")


def _require_mean_conditions(boundary: Boundary, warm_up: int) -> dict[str, Array]:
    """Means of ``CONDITION_SERIES`` over enabled seconds, (n_days, 1) each; refused where a day has none."""
    conditions = {name: np.empty(boundary.n_days) for name in CONDITION_SERIES}
    for k in range(boundary.n_days):
        rows = boundary.of_day(k)
        is_counted = rows["enabled"] != 0.0
        is_counted[:warm_up] = False
        n = np.count_nonzero(is_counted)
        for name, means in conditions.items():
            means[k] = np.where(is_counted, rows[name], 0.0).sum() / (n or np.nan)
    days_without = np.flatnonzero(np.isnan(conditions["T_set"]))
    if days_without.size:
        day_text = f"on day {boundary.day[days_without[0]]} " if boundary.has_day_dim else ""
        cure = "take another day, or a longer one, or give the second as at="
        raise InputError(f"no second {day_text}is enabled after the warm-up of {warm_up} s: {cure}", "boundary", "data")
    return {name: means[:, None] for name, means in conditions.items()}


class PointsOfDay(NamedTuple):
    """Operating points of a day, in the order of time."""

    start: Index  # first second, (n,)
    seconds: Index  # number of seconds at the point, (n,)
    conditions: dict[str, Array]  # means, (n,) each

    @property
    def size(self) -> int:
        return self.start.size


def operating_points(boundary: Boundary, warm_up: int, at: int | None = None) -> PointsOfDay:
    """Return the points of a day, each hour at each set-point, or the second ``at``; plant on, after the warm-up."""
    series = {name: boundary.series[name][0] for name in CONDITION_SERIES}
    is_on = boundary.series["enabled"][0] > 0.0
    if at is not None:
        if not is_on[at]:
            raise InputError(f"at = {at}: the plant is off at that second, give one at which it runs", "at", "value")
        conditions = {name: values[at : at + 1].copy() for name, values in series.items()}
        return PointsOfDay(np.array([at]), np.array([1]), conditions)
    counted = np.flatnonzero(is_on & (np.arange(is_on.size) >= warm_up))
    if not counted.size:
        raise InputError("the loop is off all day: take a day on which it is enabled", "boundary", "data")
    level = np.round(series["T_set"][counted] / 0.5)
    level -= level.min()
    _, member = np.unique(counted // 3600 * (level.max() + 1.0) + level, return_inverse=True)
    seconds = np.bincount(member)
    start = np.full(seconds.size, is_on.size)
    np.minimum.at(start, member, counted)
    means = {name: np.bincount(member, values[counted]) / seconds for name, values in series.items()}
    is_long = seconds >= min(300, int(seconds.max()))
    order = np.flatnonzero(is_long)[np.argsort(start[is_long])]
    return PointsOfDay(start[order], seconds[order], {name: values[order] for name, values in means.items()})
