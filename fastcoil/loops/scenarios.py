"""The scenarios of a study in one flat order, and its days as the kernel takes them, each made when it is needed."""

from __future__ import annotations

import hashlib
import math
import threading
from collections.abc import Mapping
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import array_of
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.clock import is_changed
from fastcoil.loops.loop import Loop, forgetting, words_used
from fastcoil.loops.netcdf import CLOCK
from fastcoil.model.engine.emulator import DAY_COLUMNS, C, Day
from fastcoil.model.engine.metrics import NOTHING_BEFORE, Before, after, schedule
from fastcoil.model.metric_table import SETTLING_TIME

_SECOND = np.timedelta64(1, "s")


def clock_coordinates(boundary: Boundary, elapsed_time: xr.Variable | None = None) -> dict[str, xr.DataArray]:
    """``start``; of a single day also the ``time`` of its traces, unless its clock is changed on the way."""
    start = boundary.start_coordinate
    if start is None or boundary.start is None:
        return {}
    found = {"start": start}
    if elapsed_time is None or boundary.has_day_dim:
        return found
    if not is_changed(boundary.time_zone, boundary.start[0], boundary.n_steps):
        time = start.values + np.rint(elapsed_time.values).astype(np.int64) * _SECOND
        attrs = {"long_name": "date and time", "standard_name": "time"}
        zone = {"time_zone": boundary.time_zone} if boundary.time_zone else {}
        found["time"] = xr.DataArray(time.astype("datetime64[ns]"), dims="elapsed_time", attrs=attrs | zone)
    return found


class Layout:
    """Dimensions of a study and the parameters of its scenarios by flat index (C order; the last dim is fastest).

    ``day`` comes first if the boundary has that dimension, so that neighbours share a day, then the loop's own
    dimensions, then ``replicate`` if there are several.
    """

    def __init__(self, loop: Loop, boundary: Boundary, replicates: int = 1) -> None:
        if boundary.start is not None and (names := {*loop.sizes, *loop.swept} & set(CLOCK)):
            raise InputError(
                [f"{name} is swept, and the boundary has a start: give the dim another name" for name in sorted(names)]
            )
        self.loop = _with_used_rules(loop)
        self.boundary = boundary
        self.sizes = ({"day": boundary.n_days} if boundary.has_day_dim else {}) | self.loop.sizes
        if replicates > 1:
            self.sizes["replicate"] = replicates
        self.size = math.prod(self.sizes.values())
        self._labels = self.loop.coordinates()

    def columns(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Every parameter of the scenarios ``index``, see ``columns_of``."""
        return columns_of(self.loop, self.sizes, index)

    def describe(self, flat: int) -> str:
        """One scenario in words: its labels in the sweep; empty if there is only one scenario."""
        labels, swept = self.coordinates(), self.loop.swept
        place = np.unravel_index(flat, tuple(self.sizes.values())) if self.sizes else ()
        at = {d: labels[d].values[i] for d, i in zip(self.sizes, place, strict=True)}
        named = [f"{d}={v}" if isinstance(v, str) else f"{d}={v:g}" for d, v in at.items() if d in swept or d in labels]
        return ", ".join(named)

    def coordinates(self) -> dict[str, xr.DataArray]:
        """Labels of every dimension and the swept parameters along them."""
        coordinates = dict(self._labels)
        if "day" in self.sizes:
            coordinates["day"] = xr.DataArray(self.boundary.day, dims="day")
        if "replicate" in self.sizes:
            coordinates["replicate"] = xr.DataArray(np.arange(self.sizes["replicate"]), dims="replicate")
        return coordinates


def _with_used_rules(loop: Loop) -> Loop:
    """The loop without rules that no scenario has, unless their parameters were changed."""
    used = [rule for rule in loop.rules.values() if rule.name in words_used(loop, rule.kind)]
    read = {n for rule in used for n in rule.own}
    unused = [
        rule.name
        for rule in loop.rules.values()
        if rule not in used and all(n in read or loop[n] is p.default for n, p in rule.own.items())
    ]
    return forgetting(loop, unused) if unused else loop


def columns_of(loop: Loop, sizes: Mapping[str, int], index: np.ndarray) -> dict[str, np.ndarray]:
    """Every parameter of the scenarios ``index`` of a study with these sizes, (n,) each; NaN where one is not given.

    ``day`` is the position along that dimension, ``replicate`` the replicate's number.
    """
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


_KEPT = 2
"""Days; the threads of a run work on neighbours."""


class Days:
    """The days of a boundary with their commands, (n_days, n_steps) or ``None``, warm-up and seed.

    Each is made from the boundary when it is asked for, and the last few are kept, so that they do not take the memory
    of the boundary once more.

    carry_over: whether they are a sequence.  Then the warm-up counts on the first day only, the clock continues, and
    the label of the first day keys the noise of all.
    """

    def __init__(
        self, boundary: Boundary, command: np.ndarray | None, warm_up: int, seed: int, *, carry_over: bool = False
    ) -> None:
        self._boundary, self._command, self.carry_over = boundary, command, carry_over
        self._warm_up, self._seed = warm_up, (seed & 0xFFFFFFFF, seed >> 32)
        self._kept: dict[int, Day] = {}
        self._after: dict[int, Before] = {}
        self._making = threading.Lock()

    def __len__(self) -> int:
        return self._boundary.n_days

    def __getitem__(self, k: int) -> Day:
        with self._making:
            if k not in self._kept:
                while len(self._kept) >= _KEPT:
                    del self._kept[next(iter(self._kept))]
                self._kept[k] = self._make(k)
            return self._kept[k]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": {}, "_making": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_making": threading.Lock()})

    @cached_property
    def sha256(self) -> list[str]:
        """Hash of all that acts on each day: its series, its command and its label, which keys the noise.

        In a sequence this includes the days before.
        """
        hashes = self._boundary.day_sha256 if self._command is None else [self._hash(k) for k in range(len(self))]
        if not self.carry_over:
            return hashes
        return list(accumulate(hashes, lambda before, one: hashlib.sha256(f"{before} {one}".encode()).hexdigest()))

    def _make(self, k: int) -> Day:
        follows = self.carry_over and k > 0
        before = self._before(k) if follows else NOTHING_BEFORE
        series = self._boundary.of_day(k)
        if self.carry_over:
            self._after[k] = after(series["T_set"], series["enabled"], before)
        return Day(
            series=np.stack([series[name] for name in DAY_COLUMNS], axis=1),
            command=self._commands(k),
            schedule=schedule(series["T_set"], series["enabled"], 0 if follows else self._warm_up, before),
            label=int(self._boundary.day[0 if self.carry_over else k]),
            seed=self._seed,
            start=k * self._boundary.n_steps if follows else 0,
            was_enabled=before.enabled,
        )

    def _before(self, k: int) -> Before:
        """Time since the last disturbance before day ``k`` of a sequence, up to the settling time."""
        if k - 1 in self._after:
            return self._after[k - 1]
        first = max(0, k - -(-SETTLING_TIME // self._boundary.n_steps))
        before = NOTHING_BEFORE if first == 0 else Before(disturbed_at=-SETTLING_TIME)
        for day in range(first, k):
            series = self._boundary.of_day(day)
            before = after(series["T_set"], series["enabled"], before)
        return before

    def _commands(self, k: int) -> np.ndarray:
        return np.empty(0) if self._command is None else self._command[k]

    def _hash(self, k: int) -> str:
        digest = hashlib.sha256(f"{int(self._boundary.day[k])} ".encode())
        table = self[k].series
        scaled = np.any(table[:, C.backlash_scale] != 1.0)
        digest.update(table[:, : None if scaled else C.backlash_scale].tobytes())
        digest.update(self._commands(k).tobytes())
        return digest.hexdigest()


def commands_of(command: Any, boundary: Boundary) -> np.ndarray | None:
    """The open-loop command as (n_days, n_steps), or None in closed loop."""
    if command is None:
        return None
    with np.errstate(over="ignore"):  # a number that overflows is refused as infinite
        values = array_of("command", command, "give 1-s samples, an array of numbers").astype(float)
    shape = (boundary.n_days, boundary.n_steps)
    if values.shape not in (shape, shape[1:]):
        raise InputError(f"command has shape {values.shape}: give 1-s samples, {shape[1:]} or (day, second) = {shape}")
    bad = np.argwhere(~((values >= 0.0) & (values <= 1.0)))
    if bad.size:
        raise InputError(
            f"command = {values[tuple(bad[0])]} at second {bad[0][-1]}: must be a fraction of stroke, 0 to 1"
        )
    return np.array(np.broadcast_to(values, shape), order="C")
