"""Drawn parameters as axes: their values in groups, so that what is drawn along an axis can be drawn along them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, nearest
from fastcoil.plots.labels import is_parameter

BINS = 8
_MOST_VALUES = 12
"""A parameter with no more values than this has a group for each."""
_FEWEST = 5
"""Members of a group, as a rule: their scatter would say nothing."""


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

    Raises
    ------
    InputError
        For a parameter that is not drawn, or for too few scenarios to group.
    """
    known = drawn_parameters(ds)
    wrong = [f"{n} is not drawn in this study{nearest(n, known)}; drawn are: {', '.join(known) or 'none'}"
             for n in names if n not in known]  # fmt: skip
    if wrong:
        raise InputError(wrong)
    drawn = [d for d in ds["status"].dims if any(d in ds[n].dims for n in names)]
    shape = tuple(ds.sizes[d] for d in drawn)
    template = xr.DataArray(np.zeros(shape), dims=drawn)
    values = [_along(ds[n], template) for n in names]
    groups = [_groups(v, BINS if len(names) == 1 else _side(v.size)) for v in values]
    counts = tuple(int(g.max()) + 1 for g in groups)
    if min(counts) < 2 or values[0].size < 2 * np.prod(counts):
        raise InputError(
            f"{' and '.join(names)}: {values[0].size} drawn scenarios are too few to group, about {_FEWEST} in each: "
            "draw more of them"
        )
    cell = np.ravel_multi_index(tuple(groups), counts)
    members = np.bincount(cell, minlength=int(np.prod(counts)))
    order = np.argsort(cell, kind="stable")
    place = np.empty(cell.size, dtype=int)
    place[order] = np.arange(cell.size) - np.repeat(np.cumsum(members) - members, members)
    labels = {
        n: (n, np.array([np.median(v[g == k]) for k in range(c)]), ds[n].attrs)
        for n, v, g, c in zip(names, values, groups, counts, strict=True)
    }
    found = {}
    for name, variable in ds.data_vars.items():
        if set(variable.dims) != set(ds["status"].dims):
            continue  # traces, and answers of other forms
        others = [d for d in ds["status"].dims if d not in drawn]
        flat = variable.transpose(*others, *drawn).values
        flat = flat.reshape(*flat.shape[: len(others)], -1)
        whole = np.full((*flat.shape[:-1], int(np.prod(counts)), int(members.max())), np.nan)
        whole[..., cell, place] = flat
        dims = (*others, *names, "sample")
        found[name] = (dims, whole.reshape(*flat.shape[:-1], *counts, -1), variable.attrs)
    kept = {
        n: c for n, c in ds.coords.items() if not set(c.dims) & set(drawn) and set(c.dims) <= set(ds["status"].dims)
    }
    words = _in_words(members, len(names))
    coordinates = {
        **kept,
        **labels,
        "members": (tuple(names), members.reshape(counts)),
        "sample": ("sample", np.arange(members.max()), {"pooled_as": words}),
    }
    return xr.Dataset(found, coords=coordinates, attrs=ds.attrs)


def _along(values: xr.DataArray, template: xr.DataArray) -> np.ndarray:
    """The values of a parameter at every drawn scenario, flat."""
    return (values.reset_coords(drop=True).variable + template.variable).transpose(*template.dims).values.ravel()


def _side(n: int) -> int:
    """Groups along each side of a map, so that a cell has about ``_FEWEST`` members or more."""
    return int(np.clip(np.sqrt(n / _FEWEST), 2, BINS))


def _groups(values: np.ndarray, n: int) -> np.ndarray:
    """The group of each value: one for each of few values, else ``n`` of equal counts; equal values stay together."""
    distinct = np.unique(values)
    if distinct.size <= _MOST_VALUES:
        return np.searchsorted(distinct, values)
    n = max(1, min(n, values.size // _FEWEST))
    cuts = np.sort(values)[(np.arange(1, n) * values.size) // n]
    groups = np.searchsorted(np.unique(cuts), values, side="right")
    return np.unique(groups, return_inverse=True)[1].reshape(-1)


def _in_words(members: np.ndarray, n: int) -> str:
    filled = members[members > 0]
    least, most = int(filled.min()), int(filled.max())
    count = f"{least}" if least == most else f"{least} to {most}"
    return f"{count} samples in each {'group of values' if n == 1 else 'cell'}"
