"""Results as an xarray Dataset: names, units, dims."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import instance_of
from fastcoil.base.errors import InputError, IntegrityError, shown
from fastcoil.loops.scenarios import Layout, clock_coordinates
from fastcoil.model.metric_table import METRICS, STATUS_CRASHED, STATUS_MEANINGS, STATUS_NOT_RUN, TRACES, Output
from fastcoil.model.parameter_table import PARAMETERS, Parameter

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
    """Name the results of some scenarios, along the dim ``scenario``.

    index: (n,) flat indices; the others: see ``variables_of``.
    """
    return xr.Dataset(
        variables_of(metrics, status, traces), coords={"scenario": index, **trace_coordinates(traces, trace_interval)}
    )


def variables_of(metrics: np.ndarray, status: np.ndarray, traces: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The results of some scenarios by name: (dims, values, attributes), the first dim is ``scenario``.

    metrics: (len(METRICS), n); status: (n,); traces: name → (n, n_points) or (n, N, n_points).
    """
    variables: dict[str, Any] = {
        output.name: (("scenario",), metrics[k], attributes(output)) for k, output in enumerate(METRICS.values())
    }
    flags = {"flag_values": np.arange(len(STATUS_MEANINGS), dtype=np.int8), "flag_meanings": " ".join(STATUS_MEANINGS)}
    variables["status"] = (("scenario",), status.astype(np.int8), {"long_name": "status of the scenario", **flags})
    for name, values in traces.items():
        output = TRACES[name]
        data = np.nan_to_num(values, nan=0.0).astype(np.int8) if name == "mode" else values
        dims = ("scenario", "volume", "elapsed_time") if output.per_volume else ("scenario", "elapsed_time")
        variables[name] = (dims, data, attributes(output))
    return variables


def trace_coordinates(traces: Mapping[str, np.ndarray], trace_interval: int) -> dict[Hashable, xr.Variable]:
    """Labels of the dims of traces besides ``scenario``; see ``variables_of``."""
    labels: dict[str, np.ndarray] = {}
    for name, values in traces.items():
        labels["elapsed_time"] = trace_interval * np.arange(values.shape[-1], dtype=float)
        if TRACES[name].per_volume:
            labels["volume"] = np.arange(1, values.shape[1] + 1)
    return {dim: xr.Variable(dim, along, coordinate_attrs(dim)) for dim, along in labels.items()}


def join_flat(
    n_scenarios: int,
    parts: Iterable[xr.Dataset],
    names: Collection[str] | None = None,
    allocate: Callable[[tuple[int, ...], Any, np.dtype[Any]], np.ndarray] = np.full,
) -> xr.Dataset:
    """Join flat parts (see ``flat_dataset``) into one Dataset of all scenarios.

    names: the variables to join, all by default.  allocate: makes an array of a shape, value and type.
    A scenario that no part holds gets the status ``not_run`` and NaN as results.

    Raises
    ------
    IntegrityError
        If two parts hold the same scenario.
    """
    whole: dict[Hashable, tuple[Any, np.ndarray, dict[Any, Any]]] = {}
    coordinates: dict[Hashable, Any] = {}
    seen = np.zeros(n_scenarios, dtype=bool)
    first: xr.Dataset | None = None
    for part in parts:
        index = part["scenario"].values
        if index.size and index.max() >= n_scenarios:
            raise IntegrityError(f"scenario {index.max()} was found, of {n_scenarios}: delete the folder and run again")
        if seen[index].any():
            raise IntegrityError(f"scenario {index[seen[index]][0]} was found twice: delete the folder and run again")
        seen[index] = True
        first = check_same_form(first, part)
        for name in part.data_vars if names is None else names:
            if name not in part.variables:
                continue  # of crashed scenarios
            variable = part.variables[name]
            values = variable.values
            if name not in whole:
                nothing = STATUS_NOT_RUN if name == "status" else np.nan if values.dtype.kind == "f" else 0
                data = allocate((n_scenarios, *values.shape[1:]), nothing, values.dtype)
                whole[name] = (variable.dims, data, variable.attrs)
                coordinates |= {d: part.variables[d] for d in variable.dims[1:] if d in part.coords}
            whole[name][1][index] = values
    return xr.Dataset(whole, coords=coordinates)


def check_same_form(first: xr.Dataset | None, part: xr.Dataset) -> xr.Dataset:
    """Refuse to join flat parts whose variables differ in name, type, dims, shape or labels.

    first: an earlier part, if there is one.  Crashed scenarios have no answers of a reduction, and are not compared.
    Returns the part to compare the next one with.

    Raises
    ------
    InputError
        If a reduction answers in another form for some scenarios than for others.
    IntegrityError
        If anything else differs, which no run leaves behind.
    """
    if first is None or _is_crashed(first):
        return part
    if _is_crashed(part):
        return first
    for name in sorted({*first.data_vars, *part.data_vars}, key=str):
        one, other = _form(first, name), _form(part, name)
        if one == other:
            continue
        if name in METRICS or name in TRACES or name == "status":
            raise IntegrityError(
                f"{name} has another form in some scenarios than in others: delete the folder, run again"
            )
        raise InputError(
            f"the reduction gives {name} as {other or 'nothing'} for some scenarios, as {one or 'nothing'} for others: "
            "give the same variables, types, dims and labels for all"
        )
    return first


def _form(part: xr.Dataset, name: Hashable) -> str:
    """Type, dims, sizes and labels of a variable as text; empty if there is none."""
    if name not in part.data_vars:
        return ""
    variable = part.variables[name]
    sizes = ", ".join(f"{dim}: {size}" for dim, size in zip(variable.dims[1:], variable.shape[1:], strict=True))
    labels = [f" {d} = {shown(part[d].values.tolist())}" for d in variable.dims[1:] if d in part.coords]
    return f"{variable.dtype}({', '.join([str(variable.dims[0]), *filter(None, [sizes])])}){''.join(labels)}"


def _is_crashed(part: xr.Dataset) -> bool:
    return bool((part["status"].values == STATUS_CRASHED).all())


def unflatten(whole: xr.Dataset, layout: Layout) -> xr.Dataset:
    """Give the flat results of all scenarios the dims and coordinates of the study."""
    variables = {name: (v.dims, v.values, v.attrs) for name, v in whole.data_vars.items()}
    return shaped(variables, dict(whole.coords), layout)


def shaped(variables: Mapping[Any, Any], coords: Mapping[Hashable, Any], layout: Layout) -> xr.Dataset:
    """Give the results of all scenarios, see ``variables_of``, the dims and coordinates of the study.

    coords: those along other dims than ``scenario``.
    """
    dims, shape = tuple(layout.sizes), tuple(layout.sizes.values())
    named = {
        name: ((*dims, *along[1:]), values.reshape((*shape, *values.shape[1:])), attrs)
        for name, (along, values, attrs) in variables.items()
    }
    labels = {n: c.assign_attrs(coordinate_attrs(n, layout.loop.parameters)) for n, c in layout.coordinates().items()}
    labels |= clock_coordinates(layout.boundary, coords.get("elapsed_time"))
    return xr.Dataset(named, coords={**labels, **coords})


def attributes(output: Output) -> dict[str, Any]:
    """CF attributes of a result variable."""
    attrs: dict[str, Any] = {"long_name": output.long_name, "units": output.unit}
    if output.flags:
        attrs |= {"flag_values": np.arange(len(output.flags), dtype=float), "flag_meanings": " ".join(output.flags)}
    if output.difference:
        attrs["units_metadata"] = "temperature: difference"
    if output.comment:
        attrs["comment"] = output.comment
    return attrs


def coordinate_attrs(name: str, table: Mapping[str, Parameter] = PARAMETERS) -> dict[str, str]:
    """CF attributes of a coordinate: a parameter, a reserved or a user-defined dimension."""
    if name in table:
        parameter = table[name]
        units = {"units": parameter.unit} if parameter.unit else {}
        return {"long_name": parameter.label, **units, "comment": parameter.text}
    return dict(_DIM_ATTRS.get(name, {"long_name": name}))


_CURE = "give a Dataset of fastcoil.simulate or open_study"


def check_result(ds: xr.Dataset) -> None:
    """Refuse anything but the result of a simulation or a study."""
    instance_of("ds", ds, xr.Dataset, _CURE)
    if "status" not in ds:
        raise InputError(f"ds has no status: {_CURE}")
    odd = [n for n in ("status", *METRICS) if n in ds and ds[n].dtype.kind not in "iuf"]
    if odd:
        raise InputError(f"ds has no numbers as {', '.join(odd)}: {_CURE}")
