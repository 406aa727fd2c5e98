"""Select part of a result by labels that a user typed, and group drawn parameters as axes."""

from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import raise_problems
from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import InputError, Problem, did_you_mean
from fastcoil.loops.labels import coordinate_quantity, is_parameter, quantity
from fastcoil.model.metric_table import METRICS
from fastcoil.model.parameter_table import CHANCE_DIMS, PARAMETERS

_MAX_LISTED = 12  # labels in a message


def numeric_dims(values: xr.DataArray) -> list[str]:
    """Return the dimensions that are axes of a swept number, with at least two values."""
    return [
        str(d) for d in values.dims
        if is_parameter(values, d) and d in values.coords and values[d].dtype.kind in "if" and values.sizes[d] > 1
    ]  # fmt: skip


PLANT_GROUPS = ("plant", "room", "coil", "valve", "actuator", "sensor")  # of parameters that a controller cannot choose


def swept_dims(ds: xr.Dataset, of: str = "status") -> list[str]:
    """Return the dims of a variable that were swept, with at least two labels; not those of chance."""
    return [str(d) for d in ds[of].dims if ds.sizes[d] > 1 and d not in CHANCE_DIMS and d in ds.coords]


def condition_dims(ds: xr.Dataset) -> set[Hashable]:
    """Return the dims along which the plant differs."""
    return {d for n in ds.coords if n in PARAMETERS and PARAMETERS[str(n)].group in PLANT_GROUPS for d in ds[n].dims}


def reduction_metrics(ds: xr.Dataset) -> list[str]:
    """Return the names of the numbers that ``[run] reduce`` gave for every scenario."""
    known, dims = {"status", *METRICS}, set(ds["status"].dims)
    candidates = {str(n): v for n, v in ds.data_vars.items() if n not in known}
    return [name for name, values in candidates.items() if set(values.dims) == dims and values.dtype.kind in "iuf"]


def mask_dataset(ds: xr.Dataset, mask: xr.DataArray) -> xr.Dataset:
    """Return ``ds.where(mask)``, a mask of the dims of all variables or fewer; large arrays are in nameless files."""
    masked = {}
    for name, values in ds.data_vars.items():
        room = allocate_on_disk(values.shape, np.nan, np.result_type(values.dtype, np.float32))
        np.copyto(room, values.values, where=mask.broadcast_like(values).transpose(*values.dims).values)
        masked[name] = values.copy(deep=False, data=room)
    return ds.assign(masked)


def matches_label(label: object, text: str) -> bool:
    """Whether a typed text means this label: a word itself, a number to 9 digits, a date in any form of ISO 8601."""
    if isinstance(label, str):
        return label == text
    try:
        if isinstance(label, np.datetime64):
            return bool(label == np.datetime64(text))
        return bool(np.isclose(float(label), float(text), rtol=1e-9, atol=0.0))  # type: ignore[arg-type]
    except ValueError:
        return False


def select_labels(ds: xr.Dataset, at: Mapping[str, Sequence[str]]) -> xr.Dataset:
    """Select the scenarios with these labels; a dimension with a single one is fixed there.

    at: dimension, or a parameter with few values along another one, → its labels.
    """
    dims = ds["status"].dims
    problems: list[Problem] = []
    known = [str(n) for n in ds.coords if len(ds[n].dims) == 1 and ds[n].dims[0] in dims]
    kept: dict[Hashable, np.ndarray] = {}
    for name, texts in at.items():
        if name not in known:
            has = list_first(known) or "none"
            sentence = f"--at {name}: no label of this study{did_you_mean(name, known)}; it has {has}"
            problems.append(Problem(sentence, "--at", "name"))
            continue
        labels, (dim,) = ds[name].values, ds[name].dims
        matches = [np.array([matches_label(label, text) for label in labels], dtype=bool) for text in texts]
        unknown = [text for text, matching in zip(texts, matches, strict=True) if not matching.any()]
        for text in unknown:
            problems.append(Problem(f"--at {name}={text}: {_list_choices(ds, name, text)}", "--at", "choice"))
        kept[dim] = np.logical_and(kept.get(dim, True), np.logical_or.reduce(matches))
    if not problems and any(not mask.any() for mask in kept.values()):
        problems.append(Problem("--at: no scenario has all of these labels together", "--at", "conflict"))
    raise_problems(problems)
    single = [dim for dim in kept if len(at.get(str(dim), ())) == 1]
    return ds.isel({d: int(np.argmax(mask)) if d in single else np.flatnonzero(mask) for d, mask in kept.items()})


def describe_labels(ds: xr.Dataset, at: Mapping[str, Sequence[str]]) -> str:
    """Describe a selection in words, such as ``backlash = 7 %, tuning = faster``."""
    words = []
    for name in at:
        axis_quantity, values = coordinate_quantity(ds, name), np.unique(ds[name].values)
        text = axis_quantity.number if values.dtype.kind == "f" and is_parameter(ds, name) else str
        words.append(f"{axis_quantity.text} = {' and '.join(map(text, values))}")
    return ", ".join(words)


def _list_choices(ds: xr.Dataset, name: str, text: str) -> str:
    """List what a user may give instead of an unknown label: of many numbers the nearest."""
    labels = np.unique(ds[name].values)
    if labels.size > _MAX_LISTED and labels.dtype.kind in "if":
        with suppress(ValueError):  # a word
            labels = np.sort(labels[np.argsort(abs(labels - float(text)))[:_MAX_LISTED]])
    return f"choose one of {list_first(labels)}"


def list_first(words: Sequence[Any] | np.ndarray) -> str:
    """Join the first of many words."""
    return ", ".join(map(str, words[:_MAX_LISTED])) + (", …" if len(words) > _MAX_LISTED else "")


N_GROUPS = 8
_MAX_DISTINCT_VALUES = 12  # a parameter with no more values than this has a group for each
_MIN_GROUP_SIZE = 5  # the scatter of fewer would mean nothing


def drawn_parameters(ds: xr.Dataset) -> list[str]:
    """Return the parameters whose numbers differ along dimensions that have other names, such as ``sample``."""
    dims = ds["status"].dims
    return [
        str(n) for n, c in ds.coords.items()
        if n not in dims and c.dims and set(c.dims) <= set(dims) and is_parameter(ds, n)
        and c.dtype.kind in "if" and np.unique(c.values).size > 1
    ]  # fmt: skip


def group_by_parameters(ds: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """Group the scenarios by the values of one or two parameters that differ along other dims, such as ``sample``.

    Returns the metrics and the status with these parameters as dimensions, instead of those along which they were
    drawn; their labels are the medians of the groups.  A group has the same number of members as another one, as near
    as can be, or, where the parameter has few values, all that have one of them.  The members of a group lie along
    ``sample``; groups have as many places as the largest one has members, and NaN, as status too, where there is none.
    The coordinate ``members`` says how many a group has; the attribute ``pooled_as`` of ``sample`` says it in words.
    """
    dims = ds["status"].dims
    drawn = [d for d in dims if any(d in ds[n].dims for n in names)]
    others = [d for d in dims if d not in drawn]
    one_slice = ds["status"].isel(dict.fromkeys(others, 0), drop=True)
    values = [ds[n].broadcast_like(one_slice).transpose(*drawn).values.ravel() for n in names]
    most = N_GROUPS if len(names) == 1 else int(np.clip(np.sqrt(values[0].size / _MIN_GROUP_SIZE), 2, N_GROUPS))
    groups = [_assign_groups(v, most) for v in values]
    counts = [int(g.max()) + 1 for g in groups]
    if min(counts) < 2 or values[0].size < 2 * np.prod(counts):
        sentence = f"{' and '.join(names)}: {values[0].size} drawn scenarios are too few to group"
        cure = f"about {_MIN_GROUP_SIZE} in each: draw more of them"
        raise InputError(f"{sentence}, {cure}", names[0], "data")
    # the cell of every scenario, how many each cell has, and its place in the cell
    cell = np.ravel_multi_index(tuple(groups), tuple(counts))
    members = np.bincount(cell, minlength=int(np.prod(counts)))
    place = np.empty(cell.size, dtype=int)
    place[np.argsort(cell, kind="stable")] = np.arange(cell.size) - np.repeat(np.cumsum(members) - members, members)
    grouped = {}
    for name, variable in ds.data_vars.items():
        if set(variable.dims) == set(dims):  # not traces, and answers of other forms
            flat = variable.transpose(*others, *drawn).values
            sizes = flat.shape[: len(others)]
            table = np.full((*sizes, members.size, members.max()), np.nan)
            table[..., cell, place] = flat.reshape(*sizes, -1)
            grouped[name] = ((*others, *names, "sample"), table.reshape(*sizes, *counts, -1), variable.attrs)
    coordinates: dict[Any, Any] = {n: c for n, c in ds.coords.items() if set(c.dims) <= set(others)}
    for name, v, g, count in zip(names, values, groups, counts, strict=True):
        coordinates[name] = (name, np.array([np.median(v[g == k]) for k in range(count)]), ds[name].attrs)
    coordinates["members"] = (tuple(names), members.reshape(counts))
    least, largest = members[members > 0].min(), members.max()
    each = f"{least}" if least == largest else f"{least} to {largest}"
    cells = f"{' × '.join(map(str, counts))} cells" if len(counts) > 1 else f"{counts[0]} groups"
    words = f"{each} samples in each of {cells}" + (f" of {quantity(names[0]).text}" if len(counts) == 1 else "")
    coordinates["sample"] = ("sample", np.arange(members.max()), {"pooled_as": words})
    return xr.Dataset(grouped, coords=coordinates, attrs=ds.attrs)


def _assign_groups(values: np.ndarray, n: int) -> np.ndarray:
    """Return the group of each value: one for each of few values, else ``n`` of equal counts; ties stay together."""
    distinct = np.unique(values)
    if distinct.size <= _MAX_DISTINCT_VALUES:
        return np.searchsorted(distinct, values)
    n = max(1, min(n, values.size // _MIN_GROUP_SIZE))
    cuts = np.sort(values)[(np.arange(1, n) * values.size) // n]
    groups = np.searchsorted(np.unique(cuts), values, side="right")
    return np.unique(groups, return_inverse=True)[1].reshape(-1)
