"""The days of a boundary: the Dataset of all samples, or makers of days; digests and ranges of either."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.logs.series import DIFFERENCE
from fastcoil.loops.boundary.clock import Clock
from fastcoil.loops.boundary.humidity import Dampest, dampest
from fastcoil.loops.boundary.series import ADDED_SERIES, BOUNDARY_SERIES, Frame, Given, read_series, series_of
from fastcoil.loops.labelled import Course

if TYPE_CHECKING:
    from fastcoil.loops.boundary.record import Boundary

Made = Mapping[str, Any]
"""Series of a day by name, as a user gives them."""
Maker = Callable[[int], Made]
"""Makes a day from its position."""
LARGE = 2**22
"""Samples of a series.  A larger boundary is hashed day by day, so that a stream needs no memory; a smaller one series
by series."""


class Survey(NamedTuple):
    """Least and largest value by series, digests of all and of each day, and the dampest air, from one pass."""

    extremes: dict[str, tuple[float, float]]
    sha256: str
    day_sha256: list[str]
    dampest: Dampest


def surveyed(days: Boundary) -> tuple[Survey, int]:
    """Look at all days once; also how many seconds a stream finds to be off for want of air flow."""
    small = days.n_days * days.n_steps <= LARGE
    extremes: dict[str, tuple[float, float]] = {}
    hashes, kept, stopped, damp = [], [], 0, Dampest()
    for k, label in enumerate(days.day.tolist()):
        rows, seconds = days.made(k)
        stopped += seconds
        hashes.append(day_digest(label, rows))
        damp = dampest(rows["T_a_in"], rows["W_a_in"], label if days.has_day_dim else None, damp)
        for name, values in rows.items():
            low, high = extremes.get(name, (np.inf, -np.inf))
            extremes[name] = min(low, float(values.min())), max(high, float(values.max()))
        if small:
            kept.append(rows)
    if not small:
        return Survey(extremes, digest_of(days, 2, (one.encode() for one in hashes)), hashes, damp), stopped
    whole = {name: np.stack([rows[name] for rows in kept]) for name in extremes}
    named = ((name.encode(), np.ascontiguousarray(whole[name], dtype="<f8").data) for name in hashed(whole))
    return Survey(extremes, digest_of(days, 1, chain.from_iterable(named)), hashes, damp), stopped


def dataset_of(series: Mapping[str, Array], day: NDArray[Any], n_steps: int, clock: Clock) -> xr.Dataset:
    """The Dataset of a boundary: series, (n_days, n_steps) each; none of a stream."""
    dims, row = (("day",), slice(None)) if day.ndim else ((), 0)
    seconds = np.arange(float(n_steps))
    ds = xr.Dataset(
        variables_of({name: values[row] for name, values in series.items()}),
        {
            "elapsed_time": ("elapsed_time", seconds, {"units": "s", "long_name": "time since the start"}),
            "day": (dims, day.astype(np.int64), {"long_name": "label of the day"}),
        },
    )
    if clock.start is None:
        return ds
    attrs = {"long_name": "date and time at elapsed_time 0", "standard_name": "time"}
    attrs |= {"time_zone": clock.time_zone} if clock.time_zone else {}
    return ds.assign_coords(start=(dims, clock.start.astype("datetime64[ns]")[row], attrs))


def with_day_dim(ds: xr.Dataset) -> xr.Dataset:
    """The Dataset of a boundary with the dim ``day``."""
    clock = [name for name in ("start",) if name in ds.coords]
    return ds if "day" in ds.dims else ds.reset_coords(clock).expand_dims("day").set_coords(clock)


def variables_of(series: Mapping[str, Array]) -> dict[str, xr.Variable]:
    """Series, (n_days, n_steps) or (n_steps,), with dims, units and long names."""
    found = {}
    for name, values in series.items():
        of = BOUNDARY_SERIES[name]
        attrs = {"units": of.unit, "long_name": of.long_name}
        if of.units is DIFFERENCE:  # CF-1.11: a difference in K is not a temperature in K
            attrs["units_metadata"] = "temperature: difference"
        found[name] = xr.Variable(("day", "elapsed_time")[-values.ndim :], values, attrs)
    return found


# ---------------------------------------------------------------------------------- makers of days, and digests
# Makers are partial functions, not closures: they are sent to other processes.


def labelled_day(make: Callable[[int], Made], labels: NDArray[np.int64], k: int) -> Made:
    """A day that a user's function makes from its label."""
    label = int(labels[k])
    try:
        return make(label)
    except InputError as error:
        raise InputError([f"day {label}: {problem}" for problem in error.problems]) from None
    except Exception as error:  # a user's function may raise anything
        cure = "it must give the series of every day"
        raise InputError(f"make fails for day {label}, {shown(error)}: {cure}") from error


def replaced_day(make: Maker, given: Mapping[str, Given | None], k: int) -> Made:
    """A day of which some series are given; None goes back to the default."""
    return {**make(k), **{name: None if one is None else one.of_day(k) for name, one in given.items()}}


def picked_day(makers: Sequence[Maker], part: Index, at: Index, k: int) -> Made:
    """A day of others: of the ``part`` of each, the one ``at`` a position, both (n_days,)."""
    make: Maker = makers[part[k]]
    return make(int(at[k]))


def checked_day(made: Made, n_steps: int, known: Course) -> tuple[dict[str, Array], int]:
    """A day that was made as series of (n_steps,), and how many seconds have no air flow; mistakes name the day."""
    label = int(np.asarray(known.day))
    if not isinstance(made, Mapping):
        cure = "give a mapping of series, such as a dict"
        raise InputError(WrongType(f"make gives a {type(made).__name__} for day {label}: {cure}"))
    if unknown := [name for name in made if name not in BOUNDARY_SERIES]:
        names = ", ".join(BOUNDARY_SERIES)
        raise InputError(
            [f"make gives {shown(n)} for day {label}{nearest(str(n), BOUNDARY_SERIES)}: use {names}" for n in unknown]
        )
    problems: list[str] = []
    series = {name: made.get(name) for name in BOUNDARY_SERIES}
    given, _ = read_series(series, problems, known=Frame(n_steps, known))
    if problems:
        raise InputError([f"day {label}: {problem}" for problem in problems])
    rows, stopped = series_of(given, 1, n_steps, by_air=made.get("enabled") is None)
    return {name: frozen(values[0]) for name, values in rows.items()}, stopped


def frozen(values: NDArray[Any]) -> NDArray[Any]:
    """The array, read-only from now on."""
    values.flags.writeable = False
    return values


def day_digest(label: int, rows: Mapping[str, Array]) -> str:
    """Hash of a day: of its label, and of its samples, second by second."""
    digest = hashlib.sha256(f"{label} ".encode())
    digest.update(np.stack([rows[name] for name in hashed(rows)], axis=1).data)
    return digest.hexdigest()


def digest_of(days: Boundary, version: int, parts: Iterable[Any]) -> str:
    """Hash of the day labels and of the bytes of all parts."""
    digest = hashlib.sha256(f"boundary {version} {days.has_day_dim} {days.n_days} {days.n_steps}".encode())
    digest.update(days.day.astype("<i8").tobytes())
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def hashed(series: Mapping[str, Array]) -> list[str]:
    """The series that count; one of ``ADDED_SERIES`` only where it does something."""
    return [
        name
        for name, values in series.items()
        if name not in ADDED_SERIES or not (values == BOUNDARY_SERIES[name].default).all()
    ]
