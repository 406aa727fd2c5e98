"""Every public call, with arguments that are right and cheap, for tests that make them wrong."""

import inspect
import warnings

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import fastcoil as fc
from fastcoil.design.tuning_result import Tuning
from fastcoil.measured.diagnosis import Diagnosis, ValveReading
from fastcoil.measured.fit import Fit
from helpers.air_handler_logs import make_unit_log
from helpers.log_files import COIL_HEADER, VALVE_HEADER, coil_rows, valve_rows, write_csv
from helpers.loop_logs import make_loop_log, write_log
from helpers.rules import Memory, Parameters
from helpers.trend_logs import HEADER, ROWS

_STUDY = "[loop]\nbacklash = 0.05\n[boundary]\nhours = 0.05\n[run]\nwarm_up = 60\n"
_WEATHER = ["hour_of_year", "month", "day", "hour", "T_drybulb_C", "T_dewpoint_C"]


def public_calls():
    """Name → function, of everything that a user calls."""
    functions = {}
    for name in fc.__all__:
        value = getattr(fc, name)
        if isinstance(value, type) and issubclass(value, (BaseException, fc.Log)):  # read_log makes logs
            continue
        if callable(value):
            functions[name] = value
        if isinstance(value, type):
            functions |= _public_methods(name, value)
    for cls in (Fit, Diagnosis, Tuning, ValveReading):
        functions |= _public_methods(cls.__name__, cls)
    functions |= {f"plot.{name}": getattr(fc.plot, name) for name in fc.plot.__all__}
    return {name: call for name, call in functions.items() if parameters(call)}


def _public_methods(name, cls):
    members = {n: getattr(cls, n) for n in vars(cls) if not n.startswith("_") or n == "__getitem__"}
    return {f"{name}.{n}": member for n, member in members.items() if callable(member)}


def parameters(call):
    """The names of its arguments."""
    return [n for n in inspect.signature(call).parameters if n not in ("self", "options")]


@pytest.fixture(scope="module")
def cheap():
    """Fits and readings of which little is tried."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastcoil.measured.fit_coil._N_STARTS", 2)
        patch.setattr("fastcoil.measured.read_test._LIKELIHOOD_RANGE", 0.1)
        yield


@pytest.fixture(scope="module")
def base_calls(tmp_path_factory, cheap):
    """Name → (function, its arguments in a call that is right and cheap)."""
    folder = tmp_path_factory.mktemp("calls")
    day, loop = fc.paper_day(hours=0.05), fc.Loop()
    ds = fc.simulate(fc.Loop(backlash=[0.02, 0.07], kp=[0.01, 0.02]), day, warm_up=60, replicates=2)
    dated = ds.assign_coords(start=np.datetime64("2023-06-01T00:00:00", "s"))
    sampled = xr.Dataset({"status": (("sample", "design"), np.zeros((8, 3), dtype=np.int8))})
    sampled["rmse"] = ("sample", "design"), np.random.default_rng(1).normal(size=(8, 3))
    sampled["design"] = ["A", "B", "kp"]
    sampled["sample"] = range(8)
    # a second apart: with a short max_gap they do not fall into pieces, each of which would have to be fitted
    valve = write_csv(folder / "valve.csv", VALVE_HEADER, [[k, *row[1:]] for k, row in enumerate(valve_rows(80))])
    coil = write_csv(folder / "coil.csv", COIL_HEADER, coil_rows(40))
    trend = write_csv(folder / "trend.csv", HEADER, ROWS)
    weather = write_csv(folder / "weather.csv", _WEATHER, [[h, 1, 1, h, 10.0, 5.0] for h in range(1, 25)])
    toml, out = folder / "study.toml", folder / "out"
    toml.write_text(_STUDY, encoding="utf-8")
    fc.run_study(toml, out)
    series = {name: values[0] for name, values in day.series.items()}
    at_14, seconds = ("elapsed_time", np.full(90, 14.0), {"units": "degC"}), np.arange(300.0)
    recorded = xr.Dataset(
        {"T_sup": at_14, "T_set": at_14}, {"elapsed_time": ("elapsed_time", seconds[:90], {"units": "s"})}
    )
    hunting = write_log(make_loop_log(hours=1.0), folder / "loop.csv")
    tested = write_log(make_loop_log(hours=0.25, interval=15.0), folder / "test.csv")
    when = {"between": (300.0, 600.0), "stroke_time": 90.0}
    plant = {"m_a": 1.2, "T_w_in": 7.0, "T_set": 14.0, "outdoor_fraction": 0.2, "T_return": 24.0, "RH_return": 0.5}
    days = {"hours": 0.05}
    tuning = {"loop": fc.Loop(backlash=[0.0, 0.07]), "boundary": fc.paper_day(hours=0.05, seed=[1, 2]), "n_jobs": 1}
    tuning |= {"search": {"kp": (0.01, 0.1)}, "evaluations": 8, "warm_up": 60}
    rule = {"Parameters": Parameters, "Memory": Memory}
    trace_names = ["T_sup", "command", "opening", "estimate", "mode"]
    traced = fc.simulate(fc.Loop(backlash=[0.02, 0.07], learning_step=0.01), day, warm_up=60, traces=trace_names)
    worn, panels = fc.Loop(backlash=[0.02, 0.07]), Figure().subplots(4)
    predicted = fc.limit_cycle(worn, day, at=10)
    swings = fc.simulate(worn, day, warm_up=60, traces=trace_names)
    return {
        "Boundary": (fc.Boundary, series),
        "Boundary.assign": (day.assign, {}),
        "Boundary.concat": (fc.Boundary.concat, {"boundaries": [day, fc.paper_day(hours=0.05, seed=2)]}),
        "Boundary.from_days": (fc.Boundary.from_days, {"make": lambda label: series, "day": [1, 2], "hours": 0.05}),
        "Boundary.isel": (fc.paper_day(hours=0.05, seed=[1, 2]).isel, {"day": 0}),
        "Boundary.sel": (fc.paper_day(hours=0.05, seed=[1, 2]).sel, {"day": 1}),
        "Boundary.from_csv": (fc.Boundary.from_csv, {"path": trend, "hours": 0.01}),
        "Boundary.from_dataset": (fc.Boundary.from_dataset, {"ds": day.to_dataset()}),
        "Diagnosis.to_toml": (fc.diagnose(hunting).to_toml, {"path": folder / "diagnosis.toml"}),
        "Fit.to_toml": (fc.fit_valve(valve).to_toml, {"path": folder / "fit.toml"}),
        "Tuning.to_toml": (fc.tune(**tuning).to_toml, {"path": folder / "tuning.toml"}),
        "Loop": (fc.Loop, {}),
        "Loop.__getitem__": (loop.__getitem__, {"name": "kp"}),
        "Loop.assign": (fc.Loop(kp=[0.01, 0.02]).assign, {}),
        "Loop.from_dataset": (fc.Loop.from_dataset, {"ds": ds}),
        "Loop.preset": (fc.Loop.preset, {"name": "lbnl"}),
        "ValveReading.to_toml": (fc.read_test(tested, **when).to_toml, {"path": folder / "reading.toml"}),
        "ValveTest": (fc.ValveTest, {"start": 60.0}),
        "answer": (fc.answer, {"results": ds}),
        "compare": (fc.compare, {"ds": ds, "baseline": {"backlash": 0.02}, "over": "replicate"}),
        "constant_day": (fc.constant_day, days),
        "cost": (fc.cost, {"ds": dated, "electricity": 0.2, "demand": 12.0, "heat": 0.05}),
        "design_day": (fc.design_day, days),
        "diagnose": (fc.diagnose, {"log": hunting}),
        "inspect": (fc.inspect, {"log": make_unit_log(0.1), "answers": {"columns": {}, "units": {}}}),
        "estimator": (fc.estimator, rule),
        "explain": (fc.explain, {"loop": loop, "boundary": day, "warm_up": 60}),
        "export_controller": (fc.export_controller, {"loop": loop, "path": folder / "valve.c"}),
        "fit_coil": (fc.fit_coil, {"log": coil, "warm_up": 60}),
        "fit_valve": (fc.fit_valve, {"log": valve, "lag": 0.0}),
        "heating_day": (fc.heating_day, days),
        "law": (fc.law, rule),
        "limit_cycle": (fc.limit_cycle, {"loop": loop, "boundary": day, "at": [10, 20]}),
        "linearise": (fc.linearise, {"loop": loop, "boundary": day, "at": [10, 20], "frequency": [0.01, 0.1]}),
        "open_study": (fc.open_study, {"folder": out}),
        "parameter": (fc.parameter, {"default": 1.0}),
        "paper_day": (fc.paper_day, days),
        "plant": (fc.plant, rule),
        "plot.bands": (fc.plot.bands, {"data": ds, "metric": "iae", "x": "backlash", "by": "kp", "ax": panels[0]}),
        "plot.learning": (fc.plot.learning, {"data": traced, "ax": panels[1]}),
        "plot.limit_cycle": (fc.plot.limit_cycle, {"data": swings, "predicted": predicted, "ax": panels[2]}),
        "plot.map": (fc.plot.map, {"data": ds, "metric": "iae", "x": "backlash", "y": "kp", "ax": panels[0]}),
        "plot.traces": (fc.plot.traces, {"data": traced, "boundary": day, "show": "T_sup", "ax": panels[3]}),
        "read_log": (fc.read_log, {"source": hunting}),
        "read_test": (fc.read_test, {"log": tested, **when}),
        "replay": (fc.replay, {"loop": loop, "log": recorded}),
        "report": (fc.report, {"what": out}),
        "run_study": (fc.run_study, {"path": toml, "out": out}),
        "sample": (fc.sample, {"size": 4, "kp": {"uniform": [0.01, 0.05]}}),
        "simulate": (fc.simulate, {"loop": loop, "boundary": day, "warm_up": 60, "n_jobs": 1}),
        "sobol_indices": (fc.sobol_indices, {"ds": sampled}),
        "survey": (fc.survey, {"logs": {"valve": hunting}, "n_jobs": 1}),
        "time_quantiles": (fc.time_quantiles, {"times": ds.rmse, "over": "replicate"}),
        "tune": (fc.tune, tuning),
        "weather_day": (fc.weather_day, {"path": weather, "days": 1, "hour": 2, **plant, **days}),
    }


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    plt.close("all")


def call_with(base, **changes):
    """The base call with some arguments replaced."""
    function, arguments = base
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "hourly weather is interpolated")
        return function(**(arguments | changes))
