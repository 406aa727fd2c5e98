"""fastcoil: closed-loop emulation of coil valves with backlash, thousands of loops at once.

Names are loaded on first use: ``import fastcoil`` costs nothing but this file.
"""

from __future__ import annotations

import os
import threading
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastcoil.deliver import figures as plot

    __version__: str
    from fastcoil.base.errors import FastcoilError as FastcoilError
    from fastcoil.base.errors import InputError as InputError
    from fastcoil.base.errors import InputTypeError as InputTypeError
    from fastcoil.base.errors import IntegrityError as IntegrityError
    from fastcoil.base.errors import LockedError as LockedError
    from fastcoil.base.errors import StorageError as StorageError
    from fastcoil.deliver.export.export import export_controller as export_controller
    from fastcoil.deliver.report.report import report as report
    from fastcoil.deliver.report.survey import survey as survey
    from fastcoil.design.explain import explain as explain
    from fastcoil.design.limit_cycle import limit_cycle as limit_cycle
    from fastcoil.design.linearise import linearise as linearise
    from fastcoil.design.nyquist_figure import nyquist as nyquist
    from fastcoil.design.tune import tune as tune
    from fastcoil.loops.boundary import Boundary as Boundary
    from fastcoil.loops.boundary.days import constant_day as constant_day
    from fastcoil.loops.boundary.days import design_day as design_day
    from fastcoil.loops.boundary.days import heating_day as heating_day
    from fastcoil.loops.boundary.days import paper_day as paper_day
    from fastcoil.loops.boundary.weather import weather_day as weather_day
    from fastcoil.loops.boundary.weather_year import weather_year as weather_year
    from fastcoil.loops.loop import Loop as Loop
    from fastcoil.loops.presets import presets as presets
    from fastcoil.loops.simulate import simulate as simulate
    from fastcoil.loops.valve_test import ValveTest as ValveTest
    from fastcoil.measured.diagnose import diagnose as diagnose
    from fastcoil.measured.fit_coil import fit_coil as fit_coil
    from fastcoil.measured.fit_loop import fit_loop as fit_loop
    from fastcoil.measured.fit_valve import fit_valve as fit_valve
    from fastcoil.measured.read_test import read_test as read_test
    from fastcoil.measured.replay import replay as replay
    from fastcoil.model.user_rules import estimator as estimator
    from fastcoil.model.user_rules import law as law
    from fastcoil.model.user_rules import parameter as parameter
    from fastcoil.study.analysis.compare import compare as compare
    from fastcoil.study.analysis.cost import cost as cost
    from fastcoil.study.analysis.sobol import sobol_indices as sobol_indices
    from fastcoil.study.folder.results import open_study as open_study
    from fastcoil.study.run import run_study as run_study

_HOME = {
    "Boundary": "loops.boundary",
    "FastcoilError": "base.errors",
    "InputError": "base.errors",
    "InputTypeError": "base.errors",
    "IntegrityError": "base.errors",
    "LockedError": "base.errors",
    "Loop": "loops.loop",
    "StorageError": "base.errors",
    "ValveTest": "loops.valve_test",
    "compare": "study.analysis.compare",
    "constant_day": "loops.boundary.days",
    "cost": "study.analysis.cost",
    "design_day": "loops.boundary.days",
    "diagnose": "measured.diagnose",
    "estimator": "model.user_rules",
    "explain": "design.explain",
    "export_controller": "deliver.export.export",
    "fit_coil": "measured.fit_coil",
    "fit_loop": "measured.fit_loop",
    "fit_valve": "measured.fit_valve",
    "heating_day": "loops.boundary.days",
    "law": "model.user_rules",
    "limit_cycle": "design.limit_cycle",
    "linearise": "design.linearise",
    "nyquist": "design.nyquist_figure",
    "open_study": "study.folder.results",
    "paper_day": "loops.boundary.days",
    "parameter": "model.user_rules",
    "presets": "loops.presets",
    "read_test": "measured.read_test",
    "replay": "measured.replay",
    "report": "deliver.report.report",
    "run_study": "study.run",
    "simulate": "loops.simulate",
    "sobol_indices": "study.analysis.sobol",
    "survey": "deliver.report.survey",
    "tune": "design.tune",
    "weather_day": "loops.boundary.weather",
    "weather_year": "loops.boundary.weather_year",
}

_loading = threading.RLock()
# a child of a fork inherits a module that another thread is just loading as it is, and would wait for it for ever
os.register_at_fork(before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_loading.release)

__all__ = [*_HOME, "__version__", "parameters", "plot"]  # noqa: PLE0604


def parameters() -> dict[str, Any]:
    """Every parameter of a loop by name: unit, bounds, default and meaning; printed as a list."""
    from fastcoil.model.parameter_table import PARAMETERS, Listing

    return Listing(PARAMETERS)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from fastcoil.base.machine import VERSION

        value: Any = VERSION
    elif name == "plot":
        with _loading:
            value = import_module("fastcoil.deliver.figures")
    elif name in _HOME:
        with _loading:
            value = getattr(import_module(f"fastcoil.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'fastcoil' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
