"""fastcoil: closed-loop emulation of coil valves with backlash, thousands of loops at once.

Names are loaded on first use: ``import fastcoil`` costs nothing but this file.
"""

from __future__ import annotations

import os
import threading
from importlib import import_module
from typing import Any

_MODULE_OF_NAME = {
    "Boundary": "loops.boundary",
    "FastcoilError": "base.errors",
    "InputError": "base.errors",
    "InputTypeError": "base.errors",
    "IntegrityError": "base.errors",
    "LockedError": "base.errors",
    "Log": "logs.log",
    "Loop": "loops.loop",
    "StorageError": "base.errors",
    "ValveTest": "loops.valve_test",
    "answer": "study.analysis.answer",
    "compare": "study.analysis.compare",
    "constant_day": "loops.boundary.days",
    "cost": "study.analysis.cost",
    "design_day": "loops.boundary.days",
    "diagnose": "measured.diagnose",
    "estimator": "model.user_rules",
    "explain": "design.explain",
    "export_controller": "deliver.export.export",
    "fit_coil": "measured.fit_coil",
    "fit_valve": "measured.fit_valve",
    "heating_day": "loops.boundary.days",
    "inspect": "measured.air_handler.inspect",
    "law": "model.user_rules",
    "limit_cycle": "design.limit_cycle",
    "linearise": "design.linearise",
    "open_study": "study.folder.results",
    "paper_day": "loops.boundary.days",
    "parameter": "model.user_rules",
    "plant": "model.user_rules",
    "presets": "loops.presets",
    "read_log": "logs.log",
    "read_test": "measured.read_test",
    "replay": "measured.replay",
    "report": "deliver.report.results",
    "run_study": "study.run",
    "sample": "study.file.sample",
    "simulate": "loops.simulate",
    "sobol_indices": "study.analysis.sobol",
    "survey": "deliver.report.survey",
    "time_quantiles": "study.analysis.survival",
    "tune": "design.tune",
    "weather_day": "loops.boundary.weather",
    "weather_year": "loops.boundary.weather",
}

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
            value = getattr(import_module(f"fastcoil.{_MODULE_OF_NAME[name]}"), name)
    else:
        raise AttributeError(f"module 'fastcoil' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
