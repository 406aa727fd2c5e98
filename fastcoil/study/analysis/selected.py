"""Part of a result by labels that a user typed."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, nearest
from fastcoil.loops.labels import is_parameter, quantity_of

_MOST_LABELS = 12
"""That a message lists; a parameter with more values than that along another dimension has none to choose from."""


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

    Raises
    ------
    InputError
        For a name or a label that ``ds`` does not have; it lists those that there are.
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
    """Position of one label along each of some dimensions, and the case in words.

    Raises
    ------
    InputError
        For a dimension or a label that ``ds`` does not have, or several labels of one.
    """
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
