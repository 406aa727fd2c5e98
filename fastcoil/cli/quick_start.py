"""Quick start of commands: garbage collection off during imports, and no import of dask unless it is used.

Both affect the whole process, so they are applied only where the process runs nothing but this command.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

OWN_PROCESS = "a process of its own"
"""Context object of a command started by ``fastcoil.__main__``."""


@contextmanager
def quick_start() -> Iterator[None]:
    """Import heavy modules, including xarray, inside this context.

    The imported objects are frozen: the garbage collector does not scan them, which would take 0.1 s.
    """
    if click.get_current_context().obj != OWN_PROCESS:
        yield
        return
    gc.disable()
    try:
        _import_xarray_without_dask()
        yield
    finally:
        gc.freeze()
        gc.enable()


def _import_xarray_without_dask() -> None:
    """Import xarray, which then leaves dask alone until something else has imported that.

    Of every array that it is given, xarray asks whether it is one of dask's, and imports dask to know: 0.4 s, where
    dask is installed.  Before somebody else has imported it, none can be.  This touches names that xarray does not
    promise to keep; a version without them is left as it is.
    """
    from xarray.namedarray import pycompat, utils

    modules = getattr(pycompat, "_cached_duck_array_modules", {})
    is_of_dask = getattr(utils, "is_dask_collection", None)
    if hasattr(pycompat, "DuckArrayModule") and "dask" not in modules:
        modules["dask"] = _NotImportedYet(modules, pycompat.DuckArrayModule)
    if is_of_dask is not None:
        known: Any = utils
        known.is_dask_collection = lambda array: sys.modules.get("dask") is not None and is_of_dask(array)


class _NotImportedYet:
    """What xarray knows of dask: that no array is of it, until it has been imported."""

    def __init__(self, modules: dict[str, Any], module: Any) -> None:
        self._modules, self._module = modules, module

    @property
    def type(self) -> Any:
        """The classes of its arrays."""
        return self._real().type if hasattr(sys.modules.get("dask.array"), "Array") else ()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real(), name)

    def _real(self) -> Any:
        self._modules["dask"] = found = self._module("dask")
        return found
