"""The public names, for type checkers and editors; `__init__.py` reads here from where to load each on first use."""

from fastcoil.base.errors import FastcoilError as FastcoilError
from fastcoil.base.errors import InputError as InputError
from fastcoil.base.errors import InputTypeError as InputTypeError
from fastcoil.base.errors import IntegrityError as IntegrityError
from fastcoil.base.errors import LockedError as LockedError
from fastcoil.base.errors import StorageError as StorageError
from fastcoil.deliver import figures
from fastcoil.deliver.export.export import export_controller as export_controller
from fastcoil.deliver.report.results import report as report
from fastcoil.deliver.report.survey import survey as survey
from fastcoil.design.explain import explain as explain
from fastcoil.design.limit_cycle import limit_cycle as limit_cycle
from fastcoil.design.linearise import linearise as linearise
from fastcoil.design.tune import tune as tune
from fastcoil.logs.log import Log as Log
from fastcoil.logs.log import read_log as read_log
from fastcoil.loops.boundary import Boundary as Boundary
from fastcoil.loops.boundary.days import constant_day as constant_day
from fastcoil.loops.boundary.days import design_day as design_day
from fastcoil.loops.boundary.days import heating_day as heating_day
from fastcoil.loops.boundary.days import paper_day as paper_day
from fastcoil.loops.boundary.weather import weather_day as weather_day
from fastcoil.loops.loop import Loop as Loop
from fastcoil.loops.presets import presets as presets
from fastcoil.loops.simulate import simulate as simulate
from fastcoil.loops.valve_test import ValveTest as ValveTest
from fastcoil.measured.air_handler.inspect import inspect as inspect
from fastcoil.measured.diagnose import diagnose as diagnose
from fastcoil.measured.fit_coil import fit_coil as fit_coil
from fastcoil.measured.fit_valve import fit_valve as fit_valve
from fastcoil.measured.read_test import read_test as read_test
from fastcoil.measured.replay import replay as replay
from fastcoil.model.parameter_table import Parameter
from fastcoil.model.user_rules import estimator as estimator
from fastcoil.model.user_rules import law as law
from fastcoil.model.user_rules import parameter as parameter
from fastcoil.model.user_rules import plant as plant
from fastcoil.study.analysis.answer import answer as answer
from fastcoil.study.analysis.compare import compare as compare
from fastcoil.study.analysis.cost import cost as cost
from fastcoil.study.analysis.sobol import sobol_indices as sobol_indices
from fastcoil.study.analysis.survival import time_quantiles as time_quantiles
from fastcoil.study.file.sample import sample as sample
from fastcoil.study.folder.results import open_study as open_study
from fastcoil.study.run import run_study as run_study

__version__: str
plot = figures

def parameters() -> dict[str, Parameter]: ...
