"""Part of a result by labels that a user typed, and drawn parameters in groups, as axes."""

from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import refuse
from fastcoil.base.arrays import on_disk
from fastcoil.base.errors import InputError, nearest
from fastcoil.loops.labels import is_parameter, quantity, quantity_of
from fastcoil.model.metric_table import METRICS, PREDICTIONS

_MOST_LABELS = 12
"""That a message lists; a parameter with more values than that along another dimension has none to choose from."""


def numeric_dims(values: xr.DataArray) -> list[str]:
    """Dimensions that are axes of a swept number, with at least two values."""
    return [
        str(d) for d in values.dims
        if is_parameter(values, d) and d in values.coords and values[d].dtype.kind in "if" and values.sizes[d] > 1
    ]  # fmt: skip


def own_metrics(ds: xr.Dataset) -> list[str]:
    """The numbers that a study's own ``reduce`` gave for every scenario."""
    known, dims = {"status", *METRICS, *PREDICTIONS}, set(ds["status"].dims)
    own = {str(n): v for n, v in ds.data_vars.items() if n not in known}
    return [name for name, values in own.items() if set(values.dims) == dims and values.dtype.kind in "iuf"]


def all_where(ds: xr.Dataset, mask: xr.DataArray) -> xr.Dataset:
    """``ds.where(mask)``, a mask of the dims of all variables or fewer; many numbers are put into nameless files."""
    found = {}
    for name, values in ds.data_vars.items():
        room = on_disk(values.shape, np.nan, np.result_type(values.dtype, np.float32))
        np.copyto(room, values.values, where=mask.broadcast_like(values).transpose(*values.dims).values)
        found[name] = values.copy(deep=False, data=room)
    return ds.assign(found)


def is_label(label: object, text: str) -> bool:
    """Whether a typed text means this label: a word itself, a number to 9 digits, a date in any form of ISO 8601."""
    if isinstance(label, str):
        return label == text
    try:
        if isinstance(label, np.datetime64):
            return bool(label == np.datetime64(text))
        return bool(np.isclose(float(label), float(text), rtol=1e-9, atol=0.0))  # type: ignore[arg-type]
    except ValueError:
        return False


def selected(ds: xr.Dataset, at: Mapping[str, Sequence[str]], option: str = "--at") -> xr.Dataset:
    """The scenarios with these labels; a dimension with one of them is fixed there.

    at: dimension, or a parameter with few values along another one, → its labels.  option: what the user typed.
    """
    dims, problems = ds["status"].dims, []
    known = [str(n) for n in ds.coords if len(ds[n].dims) == 1 and ds[n].dims[0] in dims]
    kept: dict[Hashable, np.ndarray] = {}
    for name, texts in at.items():
        if name not in known:
            has = listed(known) or "none"
            problems.append(f"{option} {name}: no label of this study{nearest(name, known)}; it has {has}")
            continue
        labels, (dim,) = ds[name].values, ds[name].dims
        found = [np.array([is_label(label, text) for label in labels], dtype=bool) for text in texts]
        unknown = [text for text, hit in zip(texts, found, strict=True) if not hit.any()]
        problems += [f"{option} {name}={text}: {_choices(ds, name, text)}" for text in unknown]
        kept[dim] = np.logical_and(kept.get(dim, True), np.logical_or.reduce(found))
    if not problems and any(not mask.any() for mask in kept.values()):
        problems.append(f"{option}: no scenario has all of these labels together")
    refuse(problems)
    single = [dim for dim in kept if len(at.get(str(dim), ())) == 1]
    return ds.isel({d: int(np.argmax(mask)) if d in single else np.flatnonzero(mask) for d, mask in kept.items()})


def case_of(ds: xr.Dataset, labels: Mapping[str, Sequence[str]]) -> tuple[dict[str, int], str]:
    """Position of one label along each of some dimensions, and the case in words."""
    option, dims = "--relative-to", [str(d) for d in ds["status"].dims if d in ds.coords]
    has = f"it has {listed(dims) or 'none'}"
    unknown = [name for name in labels if name not in dims]
    problems = [f"{option} {name}: no dimension of what is drawn{nearest(name, dims)}; {has}" for name in unknown]
    problems += [f"{option} {name}: give one label" for name, texts in labels.items() if len(texts) > 1]
    refuse(problems)
    case = selected(ds, labels, option)
    return {d: int(np.argmax(ds[d].values == case[d].values)) for d in labels}, in_words(case, labels)


def in_words(ds: xr.Dataset, at: Mapping[str, Sequence[str]]) -> str:
    """``backlash = 7 %, tuning = faster``; ds: what was selected."""
    words = []
    for name in at:
        of, values = quantity_of(ds, name), np.unique(ds[name].values)
        text = of.number if values.dtype.kind == "f" and is_parameter(ds, name) else str
        words.append(f"{of.text} = {' and '.join(map(text, values))}")
    return ", ".join(words)


def _choices(ds: xr.Dataset, name: str, text: str) -> str:
    """What a user may give instead of an unknown label: of many numbers those nearest to it."""
    labels = np.unique(ds[name].values)
    if labels.size > _MOST_LABELS and labels.dtype.kind in "if":
        with suppress(ValueError):  # a word
            labels = np.sort(labels[np.argsort(abs(labels - float(text)))[:_MOST_LABELS]])
    return f"choose one of {listed(labels)}"


def listed(words: Sequence[Any] | np.ndarray) -> str:
    """The first of many words."""
    return ", ".join(map(str, words[:_MOST_LABELS])) + (", …" if len(words) > _MOST_LABELS else "")


BINS = 8
_MOST_VALUES = 12  # A parameter with no more values than this has a group for each
_FEWEST = 5  # members of a group, as a rule: their scatter would say nothing


def drawn_parameters(ds: xr.Dataset) -> list[str]:
    """Parameters whose numbers differ along dimensions that have other names, such as ``sample``."""
    dims = ds["status"].dims
    return [
        str(n) for n, c in ds.coords.items()
        if n not in dims and c.dims and set(c.dims) <= set(dims) and is_parameter(ds, n)
        and c.dtype.kind in "if" and np.unique(c.values).size > 1
    ]  # fmt: skip


def binned(ds: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
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
    every = ds["status"].isel(dict.fromkeys(others, 0), drop=True)
    values = [ds[n].broadcast_like(every).transpose(*drawn).values.ravel() for n in names]
    most = BINS if len(names) == 1 else int(np.clip(np.sqrt(values[0].size / _FEWEST), 2, BINS))
    groups = [_groups(v, most) for v in values]
    counts = [int(g.max()) + 1 for g in groups]
    if min(counts) < 2 or values[0].size < 2 * np.prod(counts):
        raise InputError(
            f"{' and '.join(names)}: {values[0].size} drawn scenarios are too few to group, about {_FEWEST} in each: "
            "draw more of them"
        )
    # the cell of every scenario, how many each cell has, and its place in the cell
    cell = np.ravel_multi_index(tuple(groups), tuple(counts))
    members = np.bincount(cell, minlength=int(np.prod(counts)))
    place = np.empty(cell.size, dtype=int)
    place[np.argsort(cell, kind="stable")] = np.arange(cell.size) - np.repeat(np.cumsum(members) - members, members)
    found = {}
    for name, variable in ds.data_vars.items():
        if set(variable.dims) == set(dims):  # not traces, and answers of other forms
            flat = variable.transpose(*others, *drawn).values
            sizes = flat.shape[: len(others)]
            whole = np.full((*sizes, members.size, members.max()), np.nan)
            whole[..., cell, place] = flat.reshape(*sizes, -1)
            found[name] = ((*others, *names, "sample"), whole.reshape(*sizes, *counts, -1), variable.attrs)
    coordinates: dict[Any, Any] = {n: c for n, c in ds.coords.items() if set(c.dims) <= set(others)}
    for name, v, g, count in zip(names, values, groups, counts, strict=True):
        coordinates[name] = (name, np.array([np.median(v[g == k]) for k in range(count)]), ds[name].attrs)
    coordinates["members"] = (tuple(names), members.reshape(counts))
    least, largest = members[members > 0].min(), members.max()
    each = f"{least}" if least == largest else f"{least} to {largest}"
    cells = f"{' × '.join(map(str, counts))} cells" if len(counts) > 1 else f"{counts[0]} groups"
    words = f"{each} samples in each of {cells}" + (f" of {quantity(names[0]).text}" if len(counts) == 1 else "")
    coordinates["sample"] = ("sample", np.arange(members.max()), {"pooled_as": words})
    return xr.Dataset(found, coords=coordinates, attrs=ds.attrs)


def _groups(values: np.ndarray, n: int) -> np.ndarray:
    """The group of each value: one for each of few values, else ``n`` of equal counts; equal values stay together."""
    distinct = np.unique(values)
    if distinct.size <= _MOST_VALUES:
        return np.searchsorted(distinct, values)
    n = max(1, min(n, values.size // _FEWEST))
    cuts = np.sort(values)[(np.arange(1, n) * values.size) // n]
    groups = np.searchsorted(np.unique(cuts), values, side="right")
    return np.unique(groups, return_inverse=True)[1].reshape(-1)
