"""The days of a simulation as the kernel takes them, each made when a shard needs it."""

from __future__ import annotations

import hashlib
import threading
from functools import cached_property
from typing import Any

import numpy as np

from fastcoil.boundary import Boundary
from fastcoil.engine.emulator import DAY_COLUMNS, C, Day
from fastcoil.engine.schedule import schedule

_KEPT = 2
"""Days; the threads of a run work on neighbours."""


class Days:
    """The days of a boundary with their commands, (n_days, n_steps) or ``None``, warm-up and seed.

    Each is made from the boundary when it is asked for, and the last few are kept, so that they do not take the memory
    of the boundary once more.
    """

    def __init__(self, boundary: Boundary, command: np.ndarray | None, warm_up: int, seed: int) -> None:
        self._boundary, self._command = boundary, command
        self._warm_up, self._seed = warm_up, (seed & 0xFFFFFFFF, seed >> 32)
        self._kept: dict[int, Day] = {}
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
        """Hash of each day's series and command, and of its label, which keys the noise."""
        return [self._hash(k) for k in range(len(self))]

    def _make(self, k: int) -> Day:
        series = self._boundary.series
        return Day(
            series=self._table(k),
            command=self._commands(k),
            schedule=schedule(series["T_set"][k], series["enabled"][k], self._warm_up),
            label=int(self._boundary.day[k]),
            seed=self._seed,
        )

    def _table(self, k: int) -> np.ndarray:
        return np.stack([self._boundary.series[name][k] for name in DAY_COLUMNS], axis=1)

    def _commands(self, k: int) -> np.ndarray:
        return np.empty(0) if self._command is None else self._command[k]

    def _hash(self, k: int) -> str:
        digest = hashlib.sha256(f"{int(self._boundary.day[k])} ".encode())
        table = self._table(k)
        scaled = np.any(table[:, C.backlash_scale] != 1.0)
        digest.update(table[:, : None if scaled else C.backlash_scale].tobytes())
        digest.update(self._commands(k).tobytes())
        return digest.hexdigest()
