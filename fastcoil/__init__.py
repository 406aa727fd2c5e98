"""fastcoil: closed-loop emulation of coil valves with backlash, thousands of loops at once.

Names are loaded on first use, each from the module that the stub `__init__.pyi` imports it from: ``import fastcoil``
costs nothing but these two files.
"""

from __future__ import annotations

import os
import threading
from importlib import import_module
from typing import Any

with open(f"{__file__}i", encoding="utf-8") as _stub:  # lines such as: from fastcoil.loops.loop import Loop as Loop
    _MODULE_OF_NAME = {words[5]: words[1] for words in map(str.split, _stub) if words[4:5] == ["as"]}

_import_lock = threading.RLock()
# a child of a fork inherits a module that another thread is just loading as it is, and would wait for it for ever
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(
        before=_import_lock.acquire, after_in_parent=_import_lock.release, after_in_child=_import_lock.release
    )

__all__ = [*_MODULE_OF_NAME, "__version__", "parameters", "plot"]  # noqa: PLE0604


def parameters() -> dict[str, Any]:
    """Return every parameter of a loop by name.

    Returns
    -------
    dict of str to Parameter
        Each with unit, bounds, default and meaning; printed as a list.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.parameters()["kp"].unit
    'K-1'
    """
    from fastcoil.model.parameter_table import PARAMETERS, ParameterListing

    return ParameterListing(PARAMETERS)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from fastcoil.base.machine import VERSION

        value: Any = VERSION
    elif name == "plot":
        with _import_lock:
            value = import_module("fastcoil.deliver.figures")
    elif name in _MODULE_OF_NAME:
        with _import_lock:
            value = getattr(import_module(_MODULE_OF_NAME[name]), name)
    else:
        raise AttributeError(f"module 'fastcoil' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
