"""fastcoil: closed-loop emulation of coil valves with backlash, thousands of loops at once.

Names are loaded on first use: ``import fastcoil`` costs nothing but this file.
"""

from __future__ import annotations

import os
import threading
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastcoil import plot as plot

    __version__: str
    from fastcoil.analysis.check_rule import check_rule as check_rule
    from fastcoil.analysis.compare import compare as compare
    from fastcoil.analysis.cost import cost as cost
    from fastcoil.analysis.sobol import sobol_indices as sobol_indices
    from fastcoil.boundary import Boundary as Boundary
    from fastcoil.boundary.days import constant_day as constant_day
    from fastcoil.boundary.days import design_day as design_day
    from fastcoil.boundary.days import paper_day as paper_day
    from fastcoil.boundary.heating_day import heating_day as heating_day
    from fastcoil.boundary.operation.year import weather_year as weather_year
    from fastcoil.boundary.weather import weather_day as weather_day
    from fastcoil.calibrate.coil import fit_coil as fit_coil
    from fastcoil.calibrate.loop import fit_loop as fit_loop
    from fastcoil.calibrate.replay import replay as replay
    from fastcoil.calibrate.valve import fit_valve as fit_valve
    from fastcoil.diagnosis.diagnose import diagnose as diagnose
    from fastcoil.errors import FastcoilError as FastcoilError
    from fastcoil.errors import InputError as InputError
    from fastcoil.errors import InputTypeError as InputTypeError
    from fastcoil.errors import IntegrityError as IntegrityError
    from fastcoil.errors import LockedError as LockedError
    from fastcoil.errors import StorageError as StorageError
    from fastcoil.explanation.explain import explain as explain
    from fastcoil.handover.export import export_controller as export_controller
    from fastcoil.reports.report import report as report
    from fastcoil.rules.parameter import parameter as parameter
    from fastcoil.rules.rule import estimator as estimator
    from fastcoil.rules.rule import law as law
    from fastcoil.simulation.loop import Loop as Loop
    from fastcoil.simulation.presets import presets as presets
    from fastcoil.simulation.simulate import simulate as simulate
    from fastcoil.study.folder.results import open_study as open_study
    from fastcoil.study.runner import run_study as run_study
    from fastcoil.theory.figures import bode as bode
    from fastcoil.theory.figures import nyquist as nyquist
    from fastcoil.theory.limit_cycle import limit_cycle as limit_cycle
    from fastcoil.theory.linearise import linearise as linearise
    from fastcoil.tuning.tune import tune as tune

_HOME = {
    "Boundary": "boundary",
    "FastcoilError": "errors",
    "InputError": "errors",
    "InputTypeError": "errors",
    "IntegrityError": "errors",
    "LockedError": "errors",
    "Loop": "simulation.loop",
    "StorageError": "errors",
    "bode": "theory.figures",
    "check_rule": "analysis.check_rule",
    "compare": "analysis.compare",
    "constant_day": "boundary.days",
    "cost": "analysis.cost",
    "design_day": "boundary.days",
    "diagnose": "diagnosis.diagnose",
    "estimator": "rules.rule",
    "explain": "explanation.explain",
    "export_controller": "handover.export",
    "fit_coil": "calibrate.coil",
    "fit_loop": "calibrate.loop",
    "fit_valve": "calibrate.valve",
    "heating_day": "boundary.heating_day",
    "law": "rules.rule",
    "limit_cycle": "theory.limit_cycle",
    "linearise": "theory.linearise",
    "nyquist": "theory.figures",
    "open_study": "study.folder.results",
    "paper_day": "boundary.days",
    "parameter": "rules.parameter",
    "presets": "simulation.presets",
    "replay": "calibrate.replay",
    "report": "reports.report",
    "run_study": "study.runner",
    "simulate": "simulation.simulate",
    "sobol_indices": "analysis.sobol",
    "tune": "tuning.tune",
    "weather_day": "boundary.weather",
    "weather_year": "boundary.operation.year",
}

_loading = threading.RLock()
# a child of a fork inherits a module that another thread is just loading as it is, and would wait for it for ever
os.register_at_fork(before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_loading.release)

__all__ = [*_HOME, "__version__", "parameters", "plot"]  # noqa: PLE0604


def parameters() -> dict[str, Any]:
    """Every parameter of a loop by name: unit, bounds, default and meaning; printed as a list."""
    from fastcoil.listing import Listing
    from fastcoil.parameter_table import PARAMETERS

    return Listing(PARAMETERS)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from fastcoil.version import package_version

        value: Any = package_version()
    elif name == "plot":
        with _loading:
            value = import_module("fastcoil.plot")
    elif name in _HOME:
        with _loading:
            value = getattr(import_module(f"fastcoil.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'fastcoil' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
