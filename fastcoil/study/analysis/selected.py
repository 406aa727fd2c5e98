"""Part of a result by labels that a user typed, and drawn parameters in groups, as axes."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, nearest
from fastcoil.loops.labels import is_parameter, quantity, quantity_of

_MOST_LABELS = 12
"""That a message lists; a parameter with more values than that along another dimension has none to choose from."""


def numeric_dims(values: xr.DataArray) -> list[str]:
    """Dimensions that are axes of a swept number, with at least two values."""
    return [
        str(d) for d in values.dims
        if is_parameter(values, d) and d in values.coords and values[d].dtype.kind in "if" and values.sizes[d] > 1
    ]  # fmt: skip


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


def selected(ds: xr.Dataset, at: Mapping[str, Sequence[str]]) -> xr.Dataset:
    """The scenarios with these labels; a dimension with one of them is fixed there.

    Parameters
    ----------
    ds
        A result.
    at
        Dimension, or a parameter with few values along another one, → its labels.
    """
    dims, problems = ds["status"].dims, []
    known = [str(n) for n in ds.coords if len(ds[n].dims) == 1 and ds[n].dims[0] in dims]
    kept: dict[Hashable, np.ndarray] = {}
    for name, texts in at.items():
        if name not in known:
            problems.append(
                f"--at {name}: no label of this study{nearest(name, known)}; it has {_listed(known) or 'none'}"
            )
            continue
        labels = ds[name].values
        found = [np.array([is_label(label, text) for label in labels], dtype=bool) for text in texts]
        problems += [_unknown(name, text, ds) for text, hit in zip(texts, found, strict=True) if not hit.any()]
        dim = ds[name].dims[0]
        kept[dim] = kept.get(dim, np.ones(labels.size, dtype=bool)) & np.logical_or.reduce(found)
    if not problems and any(not mask.any() for mask in kept.values()):
        problems.append("--at: no scenario has all of these labels together")
    if problems:
        raise InputError(problems)
    for dim, mask in kept.items():
        single = len(at.get(str(dim), ())) == 1
        ds = ds.isel({dim: int(np.argmax(mask)) if single else np.flatnonzero(mask)})
    return ds


def case_of(ds: xr.Dataset, labels: Mapping[str, Sequence[str]]) -> tuple[dict[str, int], str]:
    """Position of one label along each of some dimensions, and the case in words."""
    dims = [str(d) for d in ds["status"].dims if d in ds.coords]
    problems = [
        f"--relative-to {name}: no dimension of what is drawn{nearest(name, dims)}; it has {_listed(dims) or 'none'}"
        for name in labels
        if name not in dims
    ]
    problems += [f"--relative-to {name}: give one label" for name, texts in labels.items() if len(texts) > 1]
    if problems:
        raise InputError(problems)
    try:
        case = selected(ds, labels)
    except InputError as error:
        raise InputError([problem.replace("--at", "--relative-to", 1) for problem in error.problems]) from None
    return {d: int(np.argmax(ds[d].values == case[d].values)) for d in labels}, in_words(case, labels)


def in_words(ds: xr.Dataset, at: Mapping[str, Sequence[str]]) -> str:
    """``backlash = 7 %, tuning = faster``; ds: what was selected."""
    return ", ".join(f"{quantity_of(ds, name).text} = {_values(ds, name)}" for name in at)


def _values(ds: xr.Dataset, name: str) -> str:
    values = np.unique(ds[name].values)
    if values.dtype.kind == "f" and is_parameter(ds, name):
        return " and ".join(quantity_of(ds, name).number(value) for value in values)
    return " and ".join(map(str, values))


def _unknown(name: str, text: str, ds: xr.Dataset) -> str:
    """Why a label is refused, with those that there are."""
    labels = np.unique(ds[name].values)
    if name not in ds["status"].dims and labels.size > _MOST_LABELS:
        return (
            f"--at {name}={text}: {name} has a value of its own at each {ds[name].dims[0]}, none to choose from: take "
            f"--at {ds[name].dims[0]}=…, or group its values with -x {name} of plot, or --by {name} of export --latex"
        )
    return f"--at {name}={text}: choose one of {_listed([str(v) for v in _nearest_first(labels, text)])}"


def _nearest_first(labels: np.ndarray, text: str) -> np.ndarray:
    """The labels that a message lists: all in order, or those nearest to a number."""
    try:
        distance = abs(labels - float(text))
    except (ValueError, TypeError):
        return labels
    if labels.size <= _MOST_LABELS or np.isnan(distance).any():
        return labels
    close: np.ndarray = np.sort(labels[np.argsort(distance)[:_MOST_LABELS]])
    return close


def _listed(words: Sequence[Any]) -> str:
    return ", ".join(words[:_MOST_LABELS]) + (", …" if len(words) > _MOST_LABELS else "")


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
    """Group the scenarios by the values of drawn parameters.

    Parameters
    ----------
    ds
        A result.
    names
        One or two parameters that differ along other dimensions, such as ``sample``.

    Returns
    -------
    xarray.Dataset
        The metrics and the status with these parameters as dimensions, instead of those along which they were drawn;
        their labels are the medians of the groups.  A group has the same number of members as another one, as near as
        can be, or, where the parameter has few values, all that have one of them.  The members of a group lie along
        ``sample``; groups have as many places as the largest one has members, and NaN, as status too, where there is
        none.  The coordinate ``members`` says how many a group has; the attribute ``pooled_as`` of ``sample`` says it
        in words.
    """
    known = drawn_parameters(ds)
    wrong = [n for n in names if n not in known]
    if wrong:
        has = f"drawn are {', '.join(known)}" if known else "nothing is drawn in this study"
        raise InputError([f"{n} is no drawn parameter{nearest(n, known)}: {has}" for n in wrong])
    dims = ds["status"].dims
    drawn = [d for d in dims if any(d in ds[n].dims for n in names)]
    others = [d for d in dims if d not in drawn]
    values = [_along(ds, n, drawn) for n in names]
    most = BINS if len(names) == 1 else int(np.clip(np.sqrt(values[0].size / _FEWEST), 2, BINS))
    groups = [_groups(v, most) for v in values]
    counts = [int(g.max()) + 1 for g in groups]
    if min(counts) < 2 or values[0].size < 2 * np.prod(counts):
        raise InputError(
            f"{' and '.join(names)}: {values[0].size} drawn scenarios are too few to group, about {_FEWEST} in each: "
            "draw more of them"
        )
    cell, place, members = _places(groups, counts)
    found = {}
    for name, variable in ds.data_vars.items():
        if set(variable.dims) == set(dims):  # not traces, and answers of other forms
            flat = variable.transpose(*others, *drawn).values
            flat = flat.reshape(*flat.shape[: len(others)], -1)
            whole = np.full((*flat.shape[:-1], members.size, members.max()), np.nan)
            whole[..., cell, place] = flat
            found[name] = ((*others, *names, "sample"), whole.reshape(*flat.shape[:-1], *counts, -1), variable.attrs)
    coordinates: dict[Any, Any] = {n: c for n, c in ds.coords.items() if set(c.dims) <= set(others)}
    for name, v, g, count in zip(names, values, groups, counts, strict=True):
        coordinates[name] = (name, np.array([np.median(v[g == k]) for k in range(count)]), ds[name].attrs)
    coordinates["members"] = (tuple(names), members.reshape(counts))
    words = _in_words(members, counts, names)
    coordinates["sample"] = ("sample", np.arange(members.max()), {"pooled_as": words})
    return xr.Dataset(found, coords=coordinates, attrs=ds.attrs)


def _along(ds: xr.Dataset, name: str, drawn: Sequence[Hashable]) -> np.ndarray:
    """The values of a parameter at every drawn scenario, flat."""
    missing = {d: ds.sizes[d] for d in drawn if d not in ds[name].dims}
    whole = ds[name].reset_coords(drop=True).expand_dims(missing).transpose(*drawn)
    values: np.ndarray = whole.values.ravel()
    return values


def _places(groups: Sequence[np.ndarray], counts: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cell of every scenario, its place in it, and how many each cell has."""
    cell = np.ravel_multi_index(tuple(groups), tuple(counts))
    members = np.bincount(cell, minlength=int(np.prod(counts)))
    place = np.empty(cell.size, dtype=int)
    place[np.argsort(cell, kind="stable")] = np.arange(cell.size) - np.repeat(np.cumsum(members) - members, members)
    return cell, place, members


def _groups(values: np.ndarray, n: int) -> np.ndarray:
    """The group of each value: one for each of few values, else ``n`` of equal counts; equal values stay together."""
    distinct = np.unique(values)
    if distinct.size <= _MOST_VALUES:
        return np.searchsorted(distinct, values)
    n = max(1, min(n, values.size // _FEWEST))
    cuts = np.sort(values)[(np.arange(1, n) * values.size) // n]
    groups = np.searchsorted(np.unique(cuts), values, side="right")
    return np.unique(groups, return_inverse=True)[1].reshape(-1)


def _in_words(members: np.ndarray, counts: Sequence[int], names: Sequence[str]) -> str:
    filled = members[members > 0]
    least, most = int(filled.min()), int(filled.max())
    each = f"{least}" if least == most else f"{least} to {most}"
    if len(counts) > 1:
        return f"{each} samples in each of {' × '.join(map(str, counts))} cells"
    return f"{each} samples in each of {counts[0]} groups of {quantity(names[0]).text}"
