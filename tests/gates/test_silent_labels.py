"""A net for labels: every public call and argument with units, times, dims and types beside the numbers.

A labelled call is silent if it neither raises nor warns, and its numbers are not those of the right call: a foreign or
contradicting label was passed over.  What is read of a Dataset is found out by changing its numbers.
"""

import inspect
import random

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.public_calls import call_with, parameters, public_calls
from matplotlib.artist import Artist

import fastcoil as fc
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.join import POINT_NAMES
from fastcoil.logs.series import COLUMNS
from fastcoil.loops.boundary.series import BOUNDARY_SERIES, CONDITIONS
from fastcoil.model.parameter_table import PARAMETERS

pytestmark = [pytest.mark.kernel, pytest.mark.usefixtures("blank_figures")]

SERIES = BOUNDARY_SERIES | {"command": COLUMNS["command"]}
TRIED_NUMBERS = (1.0, 2, 0.5, 20.0, 90, 300.0)  # for arguments that have no number by default
OTHER_UNITS = {
    "s": ("min", lambda x: x / 60.0), "h": ("min", lambda x: 60.0 * x), "1": ("%", lambda x: 100.0 * x),
    "K": ("degF", lambda x: 1.8 * x), "degC": ("degF", lambda x: 1.8 * x + 32.0), "K-1": ("%/K", lambda x: 100.0 * x),
    "kg s-1": ("kg/h", lambda x: 3600.0 * x), "Pa": ("kPa", lambda x: x / 1000.0), "s-1": ("1/min", lambda x: 60.0 * x),
    "kJ K-1": ("J/K", lambda x: 1000.0 * x), "kJ kg-1 K-1": ("J/(kg K)", lambda x: 1000.0 * x),
}  # fmt: skip
UNIT_KEYS = ("units", "unit", "Units", "uom", "unit_of_measurement", "engineering units")


class Measured:
    """Numbers with a unit, as those of a library that is yet to come."""

    def __init__(self, numbers, unit, attribute="unit"):
        self.numbers = numbers
        setattr(self, attribute, unit)

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.numbers, dtype)

    def __float__(self):
        return float(self.numbers)


class MeasuredArray(np.ndarray):
    units = None


class MeasuredFloat(float):
    unit = None


class MeasuredInteger(int):
    unit = None


def as_subclass(x, unit):
    if np.ndim(x):
        labelled = np.asarray(x, float).view(MeasuredArray)
        labelled.units = unit
    else:
        labelled = MeasuredInteger(x) if isinstance(x, int) and unit == "furlong" else MeasuredFloat(x)
        labelled.unit = unit
    return labelled


def as_labelled(x, dim, **about):
    return xr.DataArray(x, dims=[dim] * np.ndim(x), **about)


UNIT_CARRIERS = {
    "a class with unit": lambda x, dim, unit: Measured(x, unit),
    "a class with units": lambda x, dim, unit: Measured(x, unit, "units"),
    "a subclass": lambda x, dim, unit: as_subclass(x, unit),
    "items": lambda x, dim, unit: [Measured(item, unit) for item in np.atleast_1d(x).tolist()],
    "a Series": lambda x, dim, unit: pd.Series(np.atleast_1d(x), name=f"x [{unit}]"),
    "a name": lambda x, dim, unit: as_labelled(x, dim, name=f"x [{unit}]"),
} | {
    f"attrs {key}": lambda x, dim, unit, key=key: as_labelled(x, dim, attrs={key: unit}) for key in UNIT_KEYS
}  # fmt: skip
TYPES = {
    "float32": np.float32, "array": np.asarray, "objects": lambda x: np.asarray(x, dtype=object),
    "text": lambda x: np.asarray(x).astype(str), "complex": lambda x: np.asarray(x) + 0j,
    "duration": lambda x: np.asarray(x).round().astype("m8[s]"), "masked": lambda x: np.ma.masked_array(x, mask=True),
    "date": lambda x: np.asarray(x).round().astype("M8[s]"),
}  # fmt: skip


def dates(n, unit="s"):
    return np.datetime64("2031-05-04T03:02", "ns") + np.arange(n).astype(f"m8[{unit}]")


CLOCKS = {
    "minutes": lambda n: dates(n, "m"), "dates in descending order": lambda n: dates(n)[::-1],
    "durations of minutes": lambda n: np.arange(n).astype("m8[m]").astype("m8[ns]"),
    "numbers of minutes": lambda n: 60.0 * np.arange(n), "numbers in descending order": lambda n: np.arange(n)[::-1],
    "cftime": lambda n: xr.date_range("2031-05-04", periods=n, freq="min", use_cftime=True).values,
    "datetime objects": lambda n: pd.DatetimeIndex(dates(n, "m")).to_pydatetime().astype(object),
    "text": lambda n: dates(n, "m").astype("M8[s]").astype(str),
}  # fmt: skip
CLOCK_NAMES = ("time", "timestamp", "when")


def numbers_of(result):
    """All numbers of a result, sorted: an order that follows the labels is no difference."""
    found, seen, todo = [np.empty(0)], [], [result]
    while todo:
        each = todo.pop()
        if isinstance(each, (int, float, np.generic, np.ndarray)):
            array = np.asarray(each)
            found += [array.astype(float).ravel()] if array.dtype.kind in "biufmM" else []
            todo += array.ravel().tolist() if array.dtype.kind == "O" else []
        elif not isinstance(each, (str, type)) and not callable(each) and not any(each is other for other in seen):
            seen.append(each)
            todo += parts_of(each)
    return np.sort(np.concatenate(found))


def parts_of(result):
    if isinstance(result, xr.Dataset):
        return [variable.values for variable in result.variables.values()]
    if isinstance(result, (xr.DataArray, fc.Boundary)):
        return [result.to_dataset() if isinstance(result, fc.Boundary) else result.to_dataset(name="values")]
    if isinstance(result, fc.Log):
        return [vars(result.read(ColumnSpec((), POINT_NAMES)))]
    if isinstance(result, Artist):
        axes = result.figure.axes
        drawn = [line.get_xydata() for ax in axes for line in ax.lines]
        return drawn + [shape.get_array() for ax in axes for shape in (*ax.images, *ax.collections)]
    if isinstance(result, (list, tuple)):
        return result
    named = dict(result.items() if isinstance(result, (dict, fc.Loop)) else getattr(result, "__dict__", {}))
    return [part for name, part in named.items() if name != "seconds"]  # that a fit took


def outcome(call, **labelled):
    """The numbers of a call; None if it is refused, or warns."""
    try:
        return numbers_of(call_with(call, **labelled))
    except (fc.FastcoilError, Warning):
        return None
    finally:
        plt.close("all")


def is_same(numbers, right):
    return numbers.shape == right.shape and np.allclose(numbers, right, rtol=1e-5, atol=1e-9, equal_nan=True)


@pytest.fixture(scope="module")
def calls(base_calls):
    """The base calls, with Datasets as logs, a command, and results of two days."""
    seconds = np.arange(160)
    columns = {"elapsed_time": 15.0 * seconds, "T_sup": 14.0 + np.sin(seconds / 8), "T_set": 14.0 + 0.0 * seconds}
    columns |= {"command": 0.5 + 0.1 * np.random.default_rng(1).random(seconds.size)}
    log = xr.Dataset({n: ("elapsed_time", x, {"units": COLUMNS[n].unit}) for n, x in columns.items()})
    log = log.set_coords("elapsed_time")
    dated = base_calls["cost"][1]["ds"].drop_vars("start")
    dates_of_days = {"day": [1, 2], "start": ("day", np.array(["2023-06-01", "2023-06-02"], dtype="M8[s]"))}
    days = xr.concat([dated, dated], "day").assign_coords(dates_of_days)
    changes = {
        "diagnose": {"log": log}, "read_log": {"source": log}, "read_test": {"log": log}, "cost": {"ds": days},
        "compare": {"ds": days, "over": ["day", "replicate"]},
        "simulate": {"command": np.full(180, 0.5)}, "tune": {"limits": {"motor_travel": 1e6}},
        "Loop": {n: p.default for n, p in PARAMETERS.items() if isinstance(p.default, (int, float))},
        "Boundary.assign": base_calls["Boundary"][1],
    }  # fmt: skip
    changes["Loop.assign"] = changes["Loop"]
    merged = {n: (function, given | changes.get(n, {})) for n, (function, given) in base_calls.items()}
    return {n: (function, {k: x for k, x in given.items() if k != "ax"}) for n, (function, given) in merged.items()}


def arguments_of(call):
    """Argument → right value, of a call, with what it has by default."""
    function, given = call
    names = parameters(function)
    defaults = {n: p.default for n, p in inspect.signature(function).parameters.items() if n in names}
    values = {n: x for n, x in (defaults | given).items() if x is not inspect.Parameter.empty}
    return {n: None if isinstance(x, float) and np.isinf(x) else x for n, x in values.items()}


def is_numeric(value):
    if isinstance(value, (list, tuple, dict)):
        return bool(value) and all(map(is_numeric, value.values() if isinstance(value, dict) else value))
    return (
        isinstance(value, (int, float, np.ndarray)) and not isinstance(value, bool) and np.asarray(value).dtype != "O"
    )


def labelled_cases(calls):
    """Every (call, argument, kind of label), a few words each."""
    for name, call in calls.items():
        for argument, value in arguments_of(call).items():
            if isinstance(value, xr.Dataset):
                yield from ((name, argument, *kind) for kind in dataset_kinds(value))
            elif value is None or is_numeric(value):
                kinds = [("foreign unit", carrier) for carrier in UNIT_CARRIERS]
                if unit_of(name, argument) in OTHER_UNITS:
                    kinds += [("other unit", carrier) for carrier in UNIT_CARRIERS]
                kinds += [("type", kind) for kind in TYPES]
                if argument in SERIES and name != "constant_day":
                    kinds += [("clock", clock, label) for clock in CLOCKS for label in ("elapsed_time", *CLOCK_NAMES)]
                    kinds += [("dims", "foreign"), ("dims", "descending"), ("dims", "empty")]
                yield from ((name, argument, *kind) for kind in kinds)


def dataset_kinds(ds):
    for name in ds.variables:
        if ds[name].dtype.kind in "iuf" and name not in ("status", *{*ds.dims} - {"elapsed_time", *PARAMETERS}):
            yield from (("foreign unit", name, key) for key in UNIT_KEYS)
            if ds[name].attrs.get("units") in OTHER_UNITS:
                yield from (("other unit", name, key) for key in UNIT_KEYS)
    if "elapsed_time" in ds.dims:
        yield from (("clock", clock, label) for clock in CLOCKS for label in CLOCK_NAMES)
    yield from (("dims", "empty", dim) for dim in ds.dims)
    # indices of Sobol' draw samples by their position
    yield from (("dims", "descending", dim) for dim in ds.dims if dim != "sample")
    yield from (("dims", "twice", dim) for dim in ds.dims if dim in ("day", "replicate", "sample", *PARAMETERS))
    yield "dims", "transposed"


def unit_of(name, argument):
    """Unit of an argument by the tables; None where they have none."""
    table = CONDITIONS if argument in CONDITIONS and not name.startswith("Boundary") else PARAMETERS | SERIES
    is_condition = name.startswith(("Boundary", "Loop", "weather", "design", "constant", "heating", "simulate"))
    return table[argument].unit if is_condition and argument in table else None


def map_numbers(change, value):
    """A value with each number, or array of numbers, in it changed."""
    if isinstance(value, dict):
        return {key: map_numbers(change, item) for key, item in value.items()}
    return type(value)(map(change, value)) if isinstance(value, (list, tuple)) else change(value)


def right_number(call, argument, value):
    """The value, or of an argument without one a number that the call takes; None if there is none."""
    tried = TRIED_NUMBERS if value is None else (value,)
    return next((number for number in tried if outcome(call, **{argument: number}) is not None), None)


def silent(calls, name, argument, family, *kind):
    """Whether a labelled call is silent."""
    call, value = calls[name], arguments_of(calls[name])[argument]
    if isinstance(value, xr.Dataset):
        labelled = labelled_dataset(value, family, *kind)
    elif (value := right_number(call, argument, value)) is not None:
        labelled = labelled_numbers(value, name, argument, family, *kind)
    numbers = None if value is None else outcome(call, **{argument: labelled})
    if numbers is None:
        return False
    if family not in ("foreign unit", "clock"):
        return not is_same(numbers, outcome(call, **{argument: value}))
    return not isinstance(value, xr.Dataset) or is_read(
        call, argument, "elapsed_time" if family == "clock" else kind[0]
    )


def labelled_numbers(value, name, argument, family, *kind):
    dim = "elapsed_time" if argument in SERIES else "tuning"
    if family == "type":
        return map_numbers(TYPES[kind[0]], value)
    if family == "foreign unit":
        return map_numbers(lambda x: UNIT_CARRIERS[kind[0]](x, dim, "furlong"), value)
    if family == "other unit":
        unit, convert = OTHER_UNITS[unit_of(name, argument)]
        return map_numbers(lambda x: UNIT_CARRIERS[kind[0]](convert(x), dim, unit), value)
    n = np.size(value) if np.ndim(value) else 180
    array = as_labelled(np.broadcast_to(value, n), "elapsed_time")
    if family == "clock":
        clock, label = kind
        return array.assign_coords({label: ("elapsed_time", CLOCKS[clock](n))})
    array = array.assign_coords(elapsed_time=np.arange(n))
    changed = {"foreign": array.rename(elapsed_time="kp"), "empty": array[:0], "descending": array[::-1] + 1e-3 * array}
    return changed[kind[0]]


def labelled_dataset(ds, family, *kind):
    if family == "clock":
        clock, label = kind
        return ds.assign_coords({label: ("elapsed_time", CLOCKS[clock](ds.sizes["elapsed_time"]))})
    if family != "dims":
        name, key = kind
        unit, convert = ("furlong", np.positive) if family == "foreign unit" else OTHER_UNITS[ds[name].attrs["units"]]
        return ds.assign({name: convert(ds[name]).drop_attrs(deep=False).assign_attrs({key: unit})})
    if kind[0] == "transposed":
        return ds.transpose(*reversed(list(ds.dims)))
    change, dim = kind
    n = ds.sizes[dim]
    return ds.isel({dim: {"descending": np.arange(n)[::-1], "empty": [], "twice": [0, *range(n)]}[change]})


def is_read(call, argument, name):
    """Whether a call uses a variable of a Dataset, and does not only pass it on."""
    ds = call[1][argument]
    changed = ds.assign({name: ds[name].copy(data=ds[name].values * 3 + 1)})
    changed = changed.assign_coords({n: c.variable for n, c in ds.coords.items() if n != name})
    numbers, right = (outcome(call, **{argument: each}) for each in (changed, ds))
    passed_on = np.union1d(changed[name], ds[name])
    return numbers is None or not is_same(*(each[~np.isin(each, passed_on)] for each in (numbers, right)))


def assert_none_silent(calls, cases):
    in_silence = [case for case in cases if silent(calls, *case)]
    assert not in_silence, "\n".join(f"{case[0]}({case[1]}): {', '.join(case[2:])}" for case in in_silence)


def test_no_label_is_passed_over_in_silence(calls):
    """Of all labelled calls some at random."""
    assert_none_silent(calls, random.Random(7).sample(list(labelled_cases(calls)), 250))


@pytest.mark.full
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", public_calls())
def test_no_label_of_a_call_is_passed_over_in_silence(calls, name):
    assert_none_silent(calls, labelled_cases({name: calls[name]}))


@pytest.mark.parametrize(
    ("door", "case"),
    [
        ("loops.labelled.carried_unit", ("Loop", "ti", "foreign unit", "attrs uom")),
        ("base.arguments.carried_unit", ("compare", "level", "foreign unit", "a subclass")),
        ("loops.labelled._read_times", ("Boundary.assign", "T_set", "clock", "numbers of minutes", "when")),
        ("logs.table.require_one_clock", ("diagnose", "log", "clock", "cftime", "when")),
        ("study.analysis.cost.check_counted_result", ("cost", "ds", "dims", "twice", "day")),
    ],
)
def test_a_door_that_is_open_is_seen(calls, door, case, monkeypatch):
    assert not silent(calls, *case)
    monkeypatch.setattr(f"fastcoil.{door}", lambda *_: np.zeros(1) if door.endswith("times") else None)
    assert silent(calls, *case)
