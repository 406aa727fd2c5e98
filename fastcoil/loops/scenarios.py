"""Scenarios of a study in one flat order, its days in the form of the kernel, its results as a Dataset."""

import hashlib
import math
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import carried_unit, raise_problems, require_instance
from fastcoil.base.errors import InputError, IntegrityError, Problem, short_repr
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.series import ADDED_SERIES, BOUNDARY_SERIES, is_clock_changed, read_series
from fastcoil.loops.labelled import SeriesLabels
from fastcoil.loops.loop import Loop, remove_rules, used_choices
from fastcoil.loops.netcdf import CLOCK_COORDINATES, without_fill_values
from fastcoil.model.engine.emulator import DAY_COLUMN, DAY_COLUMNS, Day
from fastcoil.model.engine.metrics import NO_HISTORY, DayHistory, history_after, make_schedule
from fastcoil.model.parameter_table import PARAMETERS, Parameter

from fastcoil.model.metric_table import (  # isort: skip
    METRICS, SETTLING_TIME_S, STATUS_CRASHED, STATUS_MEANINGS, STATUS_NOT_RUN, TRACES, Output,
)  # fmt: skip


def clock_coordinates(boundary: Boundary, elapsed_time: xr.Variable | None = None) -> dict[str, xr.DataArray]:
    """Return ``start``, and for a single day the ``time`` of its traces unless clocks are changed during it."""
    start = boundary.start_coordinate
    if start is None or boundary.start is None:
        return {}
    coordinates = {"start": start}
    if elapsed_time is None or boundary.has_day_dim:
        return coordinates
    if not is_clock_changed(boundary.time_zone, boundary.start[0], boundary.n_steps):
        time = start.values + np.rint(elapsed_time.values).astype(np.int64).astype("timedelta64[s]")
        attrs = {"long_name": "date and time", "standard_name": "time"}
        attrs |= {"time_zone": boundary.time_zone} if boundary.time_zone else {}
        coordinates["time"] = xr.DataArray(time.astype("datetime64[ns]"), dims="elapsed_time", attrs=attrs)
    return coordinates


class Layout:
    """Dimensions of a study and its parameters by flat index (C order): ``day``, the loop's own, ``replicate``."""

    def __init__(self, loop: Loop, boundary: Boundary, replicates: int = 1) -> None:
        if boundary.start is not None and (names := {*loop.sizes, *loop.swept} & set(CLOCK_COORDINATES)):
            sentence = "{} is swept, and the boundary has a start: give the dim another name"
            raise InputError([Problem(sentence.format(name), name, "name") for name in sorted(names)])
        self.loop = _with_used_rules(loop)
        self.boundary = boundary
        self.sizes = ({"day": boundary.n_days} if boundary.has_day_dim else {}) | self.loop.sizes
        if replicates > 1:
            self.sizes["replicate"] = replicates
        self.size = math.prod(self.sizes.values())
        self._labels = self.loop.coordinates()

    def columns(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Return every parameter of the scenarios ``index``, see ``parameter_columns``."""
        return parameter_columns(self.loop, self.sizes, index)

    def describe(self, flat: int) -> str:
        """Return the labels of one scenario in the sweep as text; empty if there is only one scenario."""
        labels = self.coordinates()
        place = np.unravel_index(flat, tuple(self.sizes.values())) if self.sizes else ()
        labels_here = {d: labels[d].values[i] for d, i in zip(self.sizes, place, strict=True)}
        return ", ".join(f"{d}={v}" if isinstance(v, str) else f"{d}={v:g}" for d, v in labels_here.items())

    def coordinates(self) -> dict[str, xr.DataArray]:
        """Return the labels of every dimension and the swept parameters along them."""
        coordinates = dict(self._labels)
        if "day" in self.sizes:
            coordinates["day"] = xr.DataArray(self.boundary.day, dims="day")
        if "replicate" in self.sizes:
            coordinates["replicate"] = xr.DataArray(np.arange(self.sizes["replicate"]), dims="replicate")
        return coordinates


def _with_used_rules(loop: Loop) -> Loop:
    """Return the loop without rules that no scenario has, unless their parameters were changed."""
    used_rules = [rule for rule in loop.rules.values() if rule.name in used_choices(loop, rule.kind)]
    parameters_read = {n for rule in used_rules for n in rule.own}
    unused_names = [
        rule.name
        for rule in loop.rules.values()
        if rule not in used_rules and all(n in parameters_read or loop[n] is p.default for n, p in rule.own.items())
    ]
    return remove_rules(loop, unused_names) if unused_names else loop


def parameter_columns(loop: Loop, sizes: Mapping[str, int], index: np.ndarray) -> dict[str, np.ndarray]:
    """Return every parameter of the scenarios ``index``, (n,) each, NaN if not given; days and replicates by number."""
    place = dict(zip(sizes, np.unravel_index(index, tuple(sizes.values())), strict=True)) if sizes else {}
    columns: dict[str, np.ndarray] = {}
    for name in loop.parameters:
        value = loop[name]
        if isinstance(value, xr.DataArray):
            columns[name] = value.values[tuple(place[str(d)] for d in value.dims)]
        else:
            columns[name] = np.full(index.size, math.nan if value is None else value)
    if loop["estimator"] is None:
        columns["estimator"] = np.where(columns["learning_step"] > 0.0, "learner", "none")
    for dim in ("day", "replicate"):
        columns[dim] = place.get(dim, np.zeros(index.size, dtype=np.int64))
    return columns


class Days:
    """Days of a boundary with their commands, (n_days, n_steps) or ``None``, warm-up and seed.

    Each is made on demand; the last two are kept.  carry_over: whether they are a sequence, in which the warm-up counts
    on the first day only, and the label of the first keys the noise of all.
    """

    def __init__(
        self, boundary: Boundary, command: np.ndarray | None, warm_up: int, seed: int, *, carry_over: bool = False
    ) -> None:
        self._boundary, self._command, self.carry_over = boundary, command, carry_over
        self._warm_up, self._seed = warm_up, (seed & 0xFFFFFFFF, seed >> 32)
        self._cached_days: dict[int, Day] = {}
        self._histories: dict[int, DayHistory] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._boundary.n_days

    def __getitem__(self, k: int) -> Day:
        with self._lock:
            if k not in self._cached_days:
                while len(self._cached_days) >= 2:
                    del self._cached_days[next(iter(self._cached_days))]
                self._cached_days[k] = self._make_day(k)
            return self._cached_days[k]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_cached_days": {}, "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_lock": threading.Lock()})

    @cached_property
    def sha256(self) -> list[str]:
        """Hash of the inputs of each day: series, command, label (keys the noise); of a sequence also earlier ones."""
        hashes = self._boundary.day_sha256 if self._command is None else [self._hash(k) for k in range(len(self))]
        if not self.carry_over:
            return hashes
        return list(accumulate(hashes, lambda before, one: hashlib.sha256(f"{before} {one}".encode()).hexdigest()))

    def _make_day(self, k: int) -> Day:
        is_continued = self.carry_over and k > 0
        before = self._history_before(k) if is_continued else NO_HISTORY
        series = self._boundary.of_day(k)
        if self.carry_over:
            self._histories[k] = history_after(series["T_set"], series["enabled"], before)
        return Day(
            series=np.stack([series[name] for name in DAY_COLUMNS], axis=1), command=self._commands(k),
            schedule=make_schedule(series["T_set"], series["enabled"], 0 if is_continued else self._warm_up, before),
            label=int(self._boundary.day[0 if self.carry_over else k]), seed=self._seed,
            start=k * self._boundary.n_steps if is_continued else 0, was_enabled=before.enabled,
        )  # fmt: skip

    def _history_before(self, k: int) -> DayHistory:
        """Return the time since the last disturbance before day ``k`` of a sequence, up to the settling time."""
        if k - 1 in self._histories:
            return self._histories[k - 1]
        first_day = max(0, k - -(-SETTLING_TIME_S // self._boundary.n_steps))
        before = NO_HISTORY if first_day == 0 else DayHistory(disturbed_at=-SETTLING_TIME_S)
        for day in range(first_day, k):
            series = self._boundary.of_day(day)
            before = history_after(series["T_set"], series["enabled"], before)
        return before

    def _commands(self, k: int) -> np.ndarray:
        return np.empty(0) if self._command is None else self._command[k]

    def _hash(self, k: int) -> str:
        digest = hashlib.sha256(f"{int(self._boundary.day[k])} ".encode())
        table = self[k].series
        digest.update(table[:, : DAY_COLUMN.backlash_scale].tobytes())
        for name in ADDED_SERIES:
            column = table[:, DAY_COLUMNS.index(name)]
            if np.any(column != BOUNDARY_SERIES[name].default):
                digest.update(f"{name} ".encode() + column.tobytes())
        digest.update(self._commands(k).tobytes())
        return digest.hexdigest()


def read_commands(command: Any, boundary: Boundary) -> np.ndarray | None:
    """Return the open-loop command as (n_days, n_steps), or None in closed loop."""
    if command is None:
        return None
    problems: list[str] = []
    boundary_labels = SeriesLabels(boundary.n_steps, None, boundary.day, 0.0, boundary.start, boundary.clock_zone)
    series, _ = read_series({"command": command}, problems, known_labels=boundary_labels)
    raise_problems(problems)
    return series["command"].broadcast(boundary.n_days, boundary.n_steps)


_DIM_ATTRS = {
    "day": {"long_name": "label of the day", "units": "1"},
    "replicate": {"long_name": "replicate: number of the noise realisation", "units": "1"},
    "sample": {"long_name": "sample of the parameter space", "units": "1"},
    "volume": {"long_name": "control volume, numbered along the water", "units": "1"},
    "elapsed_time": {"long_name": "elapsed time", "units": "s"},
}


def flat_dataset(
    index: np.ndarray, metrics: np.ndarray, status: np.ndarray, traces: Mapping[str, np.ndarray], trace_interval: int
) -> xr.Dataset:
    """Put metrics, (len(METRICS), n), and traces, (n, [N,] n_points), into a Dataset along ``scenario``."""
    flags = {"flag_values": np.arange(len(STATUS_MEANINGS), dtype=np.int8), "flag_meanings": " ".join(STATUS_MEANINGS)}
    variables: dict[str, Any] = {}
    for output, values in zip(METRICS.values(), metrics, strict=True):
        variables[output.name] = ("scenario", values, cf_attributes(output))
    variables["status"] = ("scenario", status.astype(np.int8), {"long_name": "status of the scenario", **flags})
    labels = {"scenario": index}
    for name, values in traces.items():
        output = TRACES[name]
        data = np.nan_to_num(values, nan=0.0).astype(np.int8) if name == "mode" else values
        dims = ("scenario", "volume", "elapsed_time") if output.per_volume else ("scenario", "elapsed_time")
        variables[name] = (dims, data, cf_attributes(output))
        labels["elapsed_time"] = trace_interval * np.arange(values.shape[-1], dtype=float)
        if output.per_volume:
            labels["volume"] = np.arange(1, values.shape[1] + 1)
    coords = {d: (d, values, coordinate_attrs(d) if d != "scenario" else {}) for d, values in labels.items()}
    return xr.Dataset(variables, coords)


def join_flat(
    n_scenarios: int,
    parts: Iterable[xr.Dataset],
    allocate: Callable[[tuple[int, ...], Any, np.dtype[Any]], np.ndarray] = np.full,
) -> xr.Dataset:
    """Join flat parts (see ``flat_dataset``) into one Dataset of all scenarios, ``not_run`` where there is no part.

    allocate: makes an array of a shape, value and type.  ``IntegrityError`` if two parts hold the same scenario.
    """
    variables: dict[Hashable, tuple[Any, np.ndarray, dict[Any, Any]]] = {}
    coordinates: dict[Hashable, Any] = {}
    is_joined = np.zeros(n_scenarios, dtype=bool)
    reference_part: xr.Dataset | None = None
    for part in parts:
        index = part["scenario"].values
        if index.size and index.max() >= n_scenarios:
            raise IntegrityError(f"scenario {index.max()} was found, of {n_scenarios}: run in another folder, with -o")
        if is_joined[index].any():
            twice = index[is_joined[index]][0]
            raise IntegrityError(f"scenario {twice} was found twice: run in another folder, with -o")
        is_joined[index] = True
        reference_part = check_same_form(reference_part, part)
        for name in part.data_vars:
            variable = part.variables[name]
            values = variable.values
            if name not in variables:
                missing_value = STATUS_NOT_RUN if name == "status" else np.nan if values.dtype.kind == "f" else 0
                data = allocate((n_scenarios, *values.shape[1:]), missing_value, values.dtype)
                variables[name] = (variable.dims, data, variable.attrs)
                coordinates |= {d: part.variables[d] for d in variable.dims[1:] if d in part.coords}
            variables[name][1][index] = values
    return xr.Dataset(variables, coords=coordinates)


def check_same_form(reference_part: xr.Dataset | None, part: xr.Dataset) -> xr.Dataset:
    """Refuse to join flat parts whose variables differ in form; return the part to compare the next one with.

    Crashed scenarios have no variables of a reduction.  ``InputError`` if those differ, ``IntegrityError`` for others.
    """
    if reference_part is None or _is_crashed(reference_part):
        return part
    if _is_crashed(part):
        return reference_part
    first, second = _variable_forms(reference_part), _variable_forms(part)
    for name in sorted({*first, *second}, key=str) if first != second else ():
        if first.get(name) != second.get(name):
            problem = f"{name} has another form in some scenarios than in others"
            if name in METRICS or name in TRACES or name == "status":
                raise IntegrityError(f"{problem}: run in another folder, with -o")
            forms = f"{short_repr(second.get(name, ()))} and {short_repr(first.get(name, ()))}"
            cure = "let the reduction give the same variables, types, dims and labels for all"
            raise InputError(f"{problem}, {forms}: {cure}", str(name), "shape")
    return reference_part


def _variable_forms(part: xr.Dataset) -> dict[Hashable, tuple[Any, ...]]:
    """Return type, sizes and labels of every variable, without those of scenarios, the first dim."""
    labels = {d: part.variables[d].values.tolist() for d in part.dims if d in part.coords and d != "scenario"}
    forms = {}
    for name in part.data_vars:
        variable = part.variables[name]
        sizes = dict(zip(variable.dims[1:], variable.shape[1:], strict=True))
        forms[name] = str(variable.dtype), sizes, {d: labels[d] for d in sizes if d in labels}
    return forms


def _is_crashed(part: xr.Dataset) -> bool:
    return bool((part["status"].values == STATUS_CRASHED).all())


def unflatten(flat: xr.Dataset, layout: Layout) -> xr.Dataset:
    """Give the flat results of all scenarios the dims and coordinates of the study."""
    dims, shape = tuple(layout.sizes), tuple(layout.sizes.values())
    variables = {n: ((*dims, *v.dims[1:]), v.values.reshape((*shape, *v.shape[1:])), v.attrs) for n, v in flat.items()}
    labels = {n: c.assign_attrs(coordinate_attrs(n, layout.loop.parameters)) for n, c in layout.coordinates().items()}
    labels |= clock_coordinates(layout.boundary, flat.variables.get("elapsed_time"))
    trace_coordinates = {n: c for n, c in flat.coords.items() if n != "scenario"}
    return without_fill_values(xr.Dataset(variables, coords={**labels, **trace_coordinates}))


def cf_attributes(output: Output) -> dict[str, Any]:
    """Return the CF attributes of a result variable."""
    attrs: dict[str, Any] = {"long_name": output.long_name, "units": output.unit}
    if output.flags:
        attrs |= {"flag_values": np.arange(len(output.flags), dtype=float), "flag_meanings": " ".join(output.flags)}
    if output.difference:
        attrs["units_metadata"] = "temperature: difference"
    if output.comment:
        attrs["comment"] = output.comment
    return attrs


def coordinate_attrs(name: str, table: Mapping[str, Parameter] = PARAMETERS) -> dict[str, str]:
    """Return the CF attributes of a coordinate: a parameter, a reserved or a user-defined dimension."""
    if name in table:
        parameter = table[name]
        units = {"units": parameter.unit} if parameter.unit else {}
        return {"long_name": parameter.label, **units, "comment": parameter.text}
    return dict(_DIM_ATTRS.get(name, {"long_name": name}))


def check_result(ds: xr.Dataset) -> None:
    """Refuse anything but the result of a simulation or a study."""
    cure = "give a Dataset of fastcoil.simulate or open_study"
    require_instance("ds", ds, xr.Dataset, cure)
    if "status" not in ds:
        raise InputError(f"ds has no status: {cure}", "ds", "data")
    not_numeric = [n for n in ("status", *METRICS) if n in ds and ds[n].dtype.kind not in "iuf"]
    if not_numeric:
        raise InputError(f"ds has no numbers as {', '.join(not_numeric)}: {cure}", "ds", "type")
    require_scenarios(ds, ds["status"].dims)
    require_table_units(ds, PARAMETERS, METRICS)


def require_scenarios(ds: xr.Dataset, dims: Iterable[Hashable]) -> None:
    """Refuse dims without a label, of which nothing can be said."""
    sentence = "ds has nothing along {}: choose a label at least"
    raise_problems([Problem(sentence.format(dim), str(dim), "shape") for dim in dims if not ds.sizes[dim]])


def require_table_units(ds: xr.Dataset, *tables: Mapping[str, Any]) -> None:
    """Refuse variables of these tables that are in other units than theirs."""
    units = {name: entry.unit for table in tables for name, entry in table.items() if name in ds}
    raise_problems([
        Problem(f"ds.{name} is in {short_repr(given_unit)}: give it in {unit}", f"ds.{name}", "unit")
        for name, unit in units.items()
        if (given_unit := carried_unit(f"ds.{name}", ds[name])) not in (None, unit)
    ])  # fmt: skip


def check_counted_result(ds: xr.Dataset, argument: str = "ds") -> None:
    """Refuse what ``check_result`` refuses, an empty dim, and a label that stands twice, which would count twice."""
    require_instance(argument, ds, xr.Dataset, "give a Dataset of fastcoil.simulate or open_study")
    check_result(ds)
    require_distinct_labels(ds, ds["status"].dims)


def require_distinct_labels(ds: xr.Dataset, dims: Iterable[Hashable]) -> None:
    """Refuse an empty dim, and a label that stands twice."""
    problems = []
    for dim in dims:
        labels, counts = np.unique(ds[dim].values, return_counts=True)
        if not labels.size:
            problems.append(Problem(f"ds has nothing along {dim}: choose a label at least", str(dim), "shape"))
        elif counts.max() > 1:
            sentence = f"ds has {counts.max()} entries for {dim} {labels[counts.argmax()]}, counted as if independent"
            cure = f"choose one, or label them with assign_coords({dim}=...)"
            problems.append(Problem(f"{sentence}: {cure}", str(dim), "duplicate"))
    raise_problems(problems)
