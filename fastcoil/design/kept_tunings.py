"""Every tuning that was tried with its measures: each is simulated once, and a file keeps them for later.

Measures do not depend on how far a search has come, so that one that was killed is repeated from the file at no cost up
to where it was, and goes on to the same answer.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, IntegrityError, StorageError
from fastcoil.base.files import commit, read_bytes, storage_errors

KEPT = "tune.json"
"""Name of the file in the folder of a tuning."""
_KIND, _FORMAT = "fastcoil tuning", 1
_LARGEST = 2**28
"""Bytes."""


class Archive:
    """Tunings by their values, in the order in which they were tried.

    parameters, measures: names of the columns.  key: see ``evaluate.key_of``.  path: file that keeps them, if any.
    """

    def __init__(self, parameters: Sequence[str], measures: Sequence[str], key: str, path: Path | None) -> None:
        self.parameters, self.measures, self._key, self._path = list(parameters), list(measures), key, path
        self._found: dict[tuple[float, ...], tuple[float, ...]] = {}
        if path is not None:
            self._read(path)

    def evaluated(self, values: Array, measure: Callable[[Array], dict[str, Array]]) -> dict[str, Array]:
        """The measures (n,) of tunings (n, d); ``measure`` is asked for those that nobody tried before."""
        rows = [tuple(row) for row in values.tolist()]
        new = list(dict.fromkeys(row for row in rows if row not in self._found))
        if new:
            found = measure(np.array(new))
            self._found |= zip(new, zip(*(found[name].tolist() for name in self.measures), strict=True), strict=True)
            if self._path is not None:
                commit(self._path, self._text().encode())
        return self.table(rows)[1]

    def table(self, rows: Iterable[tuple[float, ...]]) -> tuple[Array, dict[str, Array]]:
        """Values (n, d) and measures (n,) of tunings that were tried."""
        rows = list(rows)
        table = np.array([self._found[row] for row in rows])
        return np.array(rows), {name: table[:, k] for k, name in enumerate(self.measures)}

    def _text(self) -> str:
        rows = [[*row, *(value if math.isfinite(value) else None for value in of)] for row, of in self._found.items()]
        head = {"kind": _KIND, "format": _FORMAT, "key": self._key}
        head |= {"parameters": self.parameters, "measures": self.measures}
        lines = ",\n".join(json.dumps(row) for row in rows)
        return json.dumps(head)[:-1] + f', "tried": [\n{lines}\n]}}\n'

    def _read(self, path: Path) -> None:
        try:
            with storage_errors(path, "read"):
                data = read_bytes(path, _LARGEST)
        except StorageError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return
            raise
        except ValueError as error:  # too large, or no file
            raise InputError(f"{path} {error}: give another file, or delete it") from None
        found = _parsed(data)
        if found is None:
            raise IntegrityError(f"{path} is no file of tunings, or damaged: delete it, or give another one")
        if found["key"] != self._key:
            raise InputError(
                f"{path} keeps tunings of other valves, days, measures or another model: choose another file or "
                "folder, or delete it"
            )
        d = len(self.parameters)
        for row in found["tried"]:
            values = [math.inf if value is None else float(value) for value in row]
            self._found[tuple(values[:d])] = tuple(values[d:])


def _parsed(data: bytes) -> dict[str, Any] | None:
    """The content of a file, if it is one of ours and whole."""
    try:
        found = json.loads(data)
        width = len(found["parameters"]) + len(found["measures"])
        sound = found["kind"] == _KIND and found["format"] == _FORMAT and isinstance(found["key"], str)
        rows = all(
            len(row) == width and all(value is None or type(value) in (int, float) for value in row)
            for row in found["tried"]
        )
        return dict(found) if sound and rows else None
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
