"""Digests and ranges of the samples of a boundary, from one pass over its days."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array
from fastcoil.loops.boundary.series import ADDED_SERIES, BOUNDARY_SERIES

LARGE = 2**22
"""Samples of a series.  A boundary of more is hashed day by day, so that a stream of them needs no memory; one of fewer
series by series, as every boundary once was."""


class Survey(NamedTuple):
    """What one pass over the days finds.

    extremes: least and largest value by series.  sha256: of all; day_sha256: of each day.  stopped: seconds that are
    not enabled because no air flows.
    """

    extremes: dict[str, tuple[float, float]]
    sha256: str
    day_sha256: list[str]
    stopped: int = 0


def day_digest(label: int, rows: Mapping[str, Array]) -> str:
    """Hash of a day: of its label, and of its samples, second by second."""
    digest = hashlib.sha256(f"{label} ".encode())
    digest.update(np.stack([rows[name] for name in _hashed(rows)], axis=1).data)
    return digest.hexdigest()


def survey(
    days: Iterable[tuple[dict[str, Array], int]], labels: NDArray[np.int64], n_steps: int, has_day_dim: bool
) -> Survey:
    """One pass over the days: the series of each, and how many of its seconds are stopped."""
    small = labels.size * n_steps <= LARGE
    kept: dict[str, list[Array]] = {name: [] for name in BOUNDARY_SERIES}
    extremes: dict[str, tuple[float, float]] = {}
    found, stopped = [], 0
    for label, (rows, seconds) in zip(labels.tolist(), days, strict=True):
        stopped += seconds
        found.append(day_digest(label, rows))
        for name, (low, high) in ranges(rows).items():
            before = extremes.get(name, (low, high))
            extremes[name] = min(low, before[0]), max(high, before[1])
            if small:
                kept[name].append(rows[name])
    if small:
        held = {name: np.stack(one) for name, one in kept.items()}
        return Survey(extremes, series_digest(held, labels, has_day_dim), found, stopped)
    return Survey(extremes, days_digest(found, labels, n_steps, has_day_dim), found, stopped)


def ranges(series: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Least and largest value by series."""
    return {name: (float(values.min()), float(values.max())) for name, values in series.items()}


def series_digest(series: Mapping[str, Array], labels: NDArray[np.int64], has_day_dim: bool) -> str:
    """Hash of the day labels and of every name and sample, series by series, each (n_days, n_steps)."""
    n_steps = next(iter(series.values())).shape[1]
    digest = _begun(1, labels, n_steps, has_day_dim)
    for name in _hashed(series):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(series[name], dtype="<f8").data)
    return digest.hexdigest()


def days_digest(days: Iterable[str], labels: NDArray[np.int64], n_steps: int, has_day_dim: bool) -> str:
    """Hash of the day labels and of the hashes of all ``days``."""
    digest = _begun(2, labels, n_steps, has_day_dim)
    for one in days:
        digest.update(one.encode())
    return digest.hexdigest()


def _begun(version: int, labels: NDArray[np.int64], n_steps: int, has_day_dim: bool) -> hashlib._Hash:
    digest = hashlib.sha256(f"boundary {version} {has_day_dim} {labels.size} {n_steps}".encode())
    digest.update(labels.astype("<i8").tobytes())
    return digest


def _hashed(series: Mapping[str, Array]) -> list[str]:
    """The series that count; one that came later only where it does something, so that older digests hold."""
    return [
        name
        for name, values in series.items()
        if name not in ADDED_SERIES or not (values == BOUNDARY_SERIES[name].default).all()
    ]
