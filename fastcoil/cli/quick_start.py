"""What makes a command start quickly: no look at each new object, no dask that nobody uses.

Both touch the whole process, so only one that is nothing but this command does them.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

OWN_PROCESS = "a process of its own"
"""What ``fastcoil.__main__`` gives to the context of a command."""


@contextmanager
def quick_start() -> Iterator[None]:
    """Import in this context what a command needs, with xarray.

    What is imported stays: Python does not look for garbage in it, which takes 0.1 s, neither here nor later.
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
