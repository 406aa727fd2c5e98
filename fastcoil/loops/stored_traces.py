"""Traces in a file of their own: described in the results, and read only when somebody asks for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np
import xarray as xr
from xarray.backends import AbstractDataStore, BackendArray
from xarray.core import indexing

from fastcoil.loops.netcdf import AS_STORED, COMPRESSION, LARGE
from fastcoil.loops.stored_file import StoredFile

Layout = Mapping[str, Mapping[str, Any]]
"""Of each variable in a file: its ``dims``, ``shape``, ``dtype`` and ``attrs``."""


def layout_of(variables: Iterable[tuple[str, xr.Variable]]) -> dict[str, Any]:
    """Describe variables, so that they can be offered before their file is opened; all of it is valid JSON."""
    return {
        name: {
            "dims": list(variable.dims),
            "shape": list(variable.shape),
            "dtype": variable.dtype.name,
            "attrs": {k: v if isinstance(v, str) else np.asarray(v).tolist() for k, v in variable.attrs.items()},
        }
        for name, variable in variables
    }


def open_lazily(file: StoredFile, layout: Layout) -> xr.Dataset:
    """The variables of a file, which stay on the disk until they are asked for; the file is not looked at."""
    return xr.open_dataset(cast("Any", _Store(file, layout)), **AS_STORED)


class _Store(AbstractDataStore):
    """What xarray needs to open a file."""

    def __init__(self, file: StoredFile, layout: Layout) -> None:
        self._file, self._layout = file, layout

    def get_variables(self) -> dict[str, xr.Variable]:
        return {name: self._variable(name, described) for name, described in self._layout.items()}

    def get_attrs(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        self._file.close()

    def _variable(self, name: str, described: Mapping[str, Any]) -> xr.Variable:
        array = _Array(self._file, name, tuple(described["shape"]), np.dtype(described["dtype"]))
        attrs = {k: v if isinstance(v, str) else np.asarray(v) for k, v in described["attrs"].items()}
        encoding = COMPRESSION if np.prod(array.shape) > LARGE else {}
        return xr.Variable(described["dims"], indexing.LazilyIndexedArray(array), attrs, dict(encoding))


class _Array(BackendArray):
    """A variable in a file, as xarray reads it; it can be pickled."""

    def __init__(self, file: StoredFile, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.file, self.name, self.shape, self.dtype = file, name, shape, dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: Any) -> np.ndarray:
        found = self.file.read(self.name, self.shape, key)
        return found.astype(self.dtype, copy=False)
