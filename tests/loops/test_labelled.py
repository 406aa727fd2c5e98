"""Labelled data at every door: units convert, labels agree, or a sentence says what contradicts."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.refusals import assert_refused
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.scenarios import check_result

N = 120
ZONE = "Europe/Berlin"
TIMES = pd.date_range("2024-07-01 08:00", periods=N, freq="s")
MINUTES = pd.date_range("2024-07-01 08:00", periods=N, freq="min").values
HALF = np.full(N, 0.5)
DAY = fc.constant_day(N / 3600).assign(day=4, start="2024-07-01T08:00", time_zone=ZONE)
SERIES = DAY.to_dataset()
NAMES = ("m_a", "T_a_in", "W_a_in", "T_w_in")
BARE = {name: SERIES[name].values for name in NAMES}


def series_with_set_point(value):
    return {name: SERIES[name] for name in NAMES} | {"T_set": value}


def stream_of(series):
    clock = {"start": "2024-07-01T08:00", "time_zone": ZONE}
    return fc.Boundary.from_days(lambda label: series, day=4, hours=N / 3600, **clock)


ENTRY_POINTS = {
    "command": lambda value: plan_simulation(fc.Loop(), DAY, command=value, warm_up=0).command,
    "Boundary": lambda value: fc.Boundary(**series_with_set_point(value)).series["T_set"],
    "assign": lambda value: DAY.assign(T_set=value).series["T_set"],
    "stream": lambda value: stream_of(series_with_set_point(value)).series["T_set"],
    "assign to a stream": lambda value: stream_of(series_with_set_point(14.0)).assign(T_set=value).series["T_set"],
    "stream of bare arrays": lambda value: stream_of(BARE | {"T_set": value}).series["T_set"],
}


def labelled_array(**coords):
    units = coords.pop("units", None)
    series = xr.DataArray(HALF, dims="elapsed_time")
    for name, values in coords.items():
        series = series.assign_coords({name: values if np.ndim(values) == 0 else ("elapsed_time", values)})
    if units is not None:
        series.coords["elapsed_time"].attrs["units"] = units
    return series


AGREEING = {
    "no labels": HALF,
    "dims alone": labelled_array(),
    "seconds": labelled_array(elapsed_time=np.arange(N)),
    "seconds, with their unit": labelled_array(elapsed_time=np.arange(N), units="s"),
    "minutes": labelled_array(elapsed_time=np.arange(N) / 60, units="min"),
    "durations": labelled_array(elapsed_time=np.arange(N).astype("m8[s]").astype("m8[ns]")),
    "dates": labelled_array(elapsed_time=TIMES.values),
    "dates beside the seconds": labelled_array(elapsed_time=np.arange(N), time=TIMES.values),
    "its day": labelled_array(day=4),
    "its start": labelled_array(start=TIMES.values[0]),
    "pandas, without an index": pd.Series(HALF),
    "pandas, seconds": pd.Series(HALF, np.arange(N)),
    "pandas, durations": pd.Series(HALF, TIMES - TIMES[0]),
    "pandas, dates": pd.Series(HALF, TIMES),
    "pandas, dates in the zone": pd.Series(HALF, TIMES.tz_localize(ZONE)),
    "a DataFrame of days": pd.DataFrame({4: HALF}).rename_axis(index="elapsed_time", columns="day"),
}
WITHOUT_ZONE = ("dates", "dates beside the seconds", "its start", "pandas, dates")
CONTRADICTING = {
    "later seconds": ("time", labelled_array(elapsed_time=np.arange(N) + 60.0)),
    "seconds in descending order": ("time", labelled_array(elapsed_time=np.arange(N)[::-1])),
    "minutes that pass for seconds": ("time", labelled_array(elapsed_time=np.arange(N), units="min")),
    "an unknown unit of time": ("unit", labelled_array(elapsed_time=np.arange(N), units="weeks")),
    "a later date": ("time", labelled_array(elapsed_time=TIMES.values + np.timedelta64(1, "h"))),
    "a later start": ("time", labelled_array(start=TIMES.values[1])),
    "another day": ("shape", labelled_array(day=5)),
    "a clock of minutes": ("time", labelled_array(timestamp=MINUTES)),
    "a clock of minutes for each day": (
        "time", labelled_array().expand_dims(day=[4]).assign_coords(time=(("day", "elapsed_time"), [MINUTES])),
    ),
    "text as time": ("type", labelled_array(elapsed_time=TIMES.strftime("%H:%M:%S").to_numpy(dtype=object))),
    "another dim": ("shape", labelled_array().rename(elapsed_time="kp")),
    "pandas, minutes": ("time", pd.Series(HALF, pd.date_range("2024-07-01 08:00", periods=N, freq="min"))),
    "pandas, a time that is missing": ("time", pd.Series(HALF, [pd.NaT, *TIMES[1:]])),
    "pandas, descending": ("time", pd.Series(HALF, TIMES[::-1])),
    "pandas, a later date": ("time", pd.Series(HALF, TIMES + pd.Timedelta("1s"))),
    "pandas, in another zone": ("time", pd.Series(HALF, TIMES.tz_localize("UTC"))),
    "a DataFrame without names": ("shape", pd.DataFrame({4: HALF})),
    "a DataFrame of one name": (
        "duplicate", pd.DataFrame([[0.5]]).rename_axis(index="elapsed_time", columns="elapsed_time"),
    ),
    "a DataFrame of another day": ("shape", pd.DataFrame({5: HALF}).rename_axis(index="elapsed_time", columns="day")),
    "a Dataset": ("type", xr.Dataset({"T_set": labelled_array()})),
    "a list of labelled arrays": ("type", [labelled_array(day=5)]),
    "units that are no text": ("type", labelled_array().assign_attrs(units=5)),
}  # fmt: skip


@pytest.mark.parametrize("door", ENTRY_POINTS)
@pytest.mark.parametrize("label", AGREEING)
def test_labels_that_agree_leave_the_values_as_they_are(door, label):
    if door == "Boundary" and label in WITHOUT_ZONE:  # the other series have one
        assert_refused("T_set", "time", ENTRY_POINTS[door], AGREEING[label])
    else:
        np.testing.assert_array_equal(ENTRY_POINTS[door](AGREEING[label]), [HALF])


@pytest.mark.parametrize("door", ENTRY_POINTS)
@pytest.mark.parametrize("label", CONTRADICTING)
def test_labels_that_contradict_are_refused(door, label):
    code, value = CONTRADICTING[label]
    if (door, label) == ("stream of bare arrays", "later seconds"):  # nothing else says when they begin
        return
    with pytest.raises(fc.InputError) as caught:
        ENTRY_POINTS[door](value)
    assert {problem.code for problem in caught.value.problems} == {code}
    if door == "Boundary":
        assert_worded(*caught.value.problems)


def test_labels_alone_give_a_boundary_its_clock():
    series = {name: 1.0 for name in NAMES} | {"W_a_in": 0.001}
    local = pd.Series(HALF, TIMES.tz_localize(ZONE))
    alone = fc.Boundary(T_set=local, **series)
    assert (alone.start[0], alone.time_zone) == (np.datetime64("2024-07-01T08:00"), ZONE)
    over_a_change_of_clocks = pd.date_range("2024-10-27 02:59:30", periods=N, freq="s", tz="UTC").tz_convert(ZONE)
    assert fc.Boundary(T_set=pd.Series(HALF, over_a_change_of_clocks), **series).n_steps == N
    assert_refused("time_zone", "time", fc.Boundary, T_set=local, **series, time_zone="UTC")
    assert_refused("start", "time", fc.Boundary, T_set=pd.Series(HALF, TIMES), **series, start="2024-07-01T09:00")


def test_a_start_with_labels_of_other_days_is_refused():
    start = xr.DataArray(TIMES.values[:2], {"day": [2, 1]}, "day")
    bare = {name: series.values for name, series in series_with_set_point(labelled_array()).items()}
    assert_refused("start", "shape", fc.Boundary, **bare, day=[1, 2], start=start)
    several = bare | {"T_w_in": xr.DataArray([6.0, 7.0], {"day": [1, 2]}, "day")}
    assert_refused("T_w_in", "shape", fc.Boundary, **several, day=[2, 1])
    assert fc.Boundary(**several, day=[1, 2]).day.tolist() == [1, 2]


UNITS = [
    ("ti", 2.0, "min", 120.0), ("backlash", 20.0, "%", 0.2), ("kp", 3.0, "%/K", 0.03),
    ("T_initial", 68.0, "degF", 20.0),
    ("noise_std", 0.9, "degF", 0.5), ("pressure", 90.0, "kPa", 90e3), ("m_max", 3600.0, "kg/h", 1.0),
    ("C_w", 8800.0, "J/K", 8.8), ("cp_w", 4186.0, "J/(kg K)", 4.186), ("smooth_rate", 3.0, "1/min", 0.05),
    ("gradient_gain", 0.5, "K-1 s-1", 0.5),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "unit", "ours"), UNITS)
def test_parameters_are_converted_from_their_unit(name, value, unit, ours):
    array = xr.DataArray([value, 1.1 * value], dims="tuning", attrs={"units": unit})
    series = pd.Series([value, 1.1 * value], pd.Index([1, 2], name="tuning"))
    series.attrs["units"] = unit
    for labelled in (array, series):
        parameter = fc.Loop(**{name: labelled})[name]
        assert parameter.dims == ("tuning",)
        assert parameter.values[0] == pytest.approx(ours, rel=1e-12)
    assert fc.Loop(**{name: array[0]})[name] == pytest.approx(ours, rel=1e-12)
    assert_refused(name, "unit", fc.Loop, **{name: array.assign_attrs(units="furlong")})


@pytest.mark.parametrize(
    ("code", "value"),
    [
        ("type", xr.Dataset({"ti": ("x", [1.0])})),
        ("shape", xr.DataArray([5.0, 50.0], {"backlash": [0.1, 0.05]}, "backlash")),
        ("shape", xr.DataArray([5.0, 50.0], {"backlash": [0.05, 0.2]}, "backlash")),
        ("unit", pd.Series([5.0, 50.0], ["a", "b"])),
        ("shape", pd.DataFrame([[1.0]])),
        ("duplicate", pd.DataFrame([[1.0]]).rename_axis(index="x", columns="x")),
        ("shape", xr.DataArray([5.0, 50.0], {"sample": [1, 0]}, "sample")),
        ("type", [xr.DataArray(2.0, attrs={"units": "min"})]),
        ("conflict", ("x", xr.DataArray([1.0, 2.0], dims="x", attrs={"units": "min"}))),
        ("unit", xr.DataArray([1.0, 2.0], {"kp": ("kp", [1, 2], {"units": "%/K"})}, "kp")),
        ("unit", xr.DataArray([1.0, 2.0], {"ti": [2, 3]}, "ti")),
    ],
)
def test_labels_that_a_parameter_cannot_have_are_refused(code, value):
    loop = fc.Loop(backlash=[0.05, 0.1], kp=("sample", [0.01, 0.02]))
    assert_refused("ti", code, loop.assign, ti=value)


def test_series_are_converted_from_their_unit():
    percent, fahrenheit = (xr.DataArray(v * HALF, dims="elapsed_time") for v in (100.0, 118.0))
    np.testing.assert_array_equal(ENTRY_POINTS["command"](percent.assign_attrs(units="%")), [HALF])
    for door in ("Boundary", "assign", "stream"):
        np.testing.assert_allclose(ENTRY_POINTS[door](fahrenheit.assign_attrs(units="degF")), [np.full(N, 15.0)])
        assert_refused("T_set", "unit", ENTRY_POINTS[door], fahrenheit.assign_attrs(units="degR"))
    assert_refused("command", "unit", ENTRY_POINTS["command"], percent.assign_attrs(units="K"))


@pytest.mark.kernel
def test_results_given_back_keep_their_labels():
    ds = fc.simulate(fc.Loop(ti=[60.0, 120.0]), DAY, warm_up=0, traces=["command"])
    minutes = ds.assign_coords(ti=("ti", ds.ti.values / 60, {"units": "min"}))
    assert fc.Loop.from_dataset(minutes)["ti"].values.tolist() == [60.0, 120.0]
    assert fc.Loop.from_dataset(minutes.isel(ti=1))["ti"] == 120.0
    again = fc.simulate(fc.Loop(), DAY, warm_up=0, command=ds["command"].isel(ti=0), traces=["command"])
    np.testing.assert_array_equal(again["command"], ds["command"].isel(ti=0))
    late = ds["command"].isel(ti=0).assign_coords(start=ds.start + np.timedelta64(1, "h"))
    assert_refused("command", "time", fc.simulate, fc.Loop(), DAY, warm_up=0, command=late)
    assert_refused("ds.rmse", "unit", check_result, ds.assign(rmse=ds.rmse.assign_attrs(units="mK")))
    at = xr.DataArray([0.5, 1.0], dims="at", attrs={"units": "min"})
    assert fc.linearise(fc.Loop(), DAY, at=at)["elapsed_time"].values.tolist() == [30, 60]
    assert_refused("at", "type", fc.linearise, fc.Loop(), DAY, at=at.astype(str))
    w = xr.DataArray([1e-3, 2e-3], dims="frequency", attrs={"units": "Hz"})
    linear = fc.linearise(fc.Loop(), DAY, at=9, frequency=w)
    np.testing.assert_allclose(linear["frequency"], 2.0 * np.pi * w.values)
    assert_refused("frequency", "unit", fc.linearise, fc.Loop(), DAY, at=9, frequency=w.assign_attrs(units="K"))


def test_damp_air_is_reported_at_the_pressure_of_the_loop():
    day = DAY.assign(W_a_in=np.r_[HALF[:-1] * 0.02, 0.03])
    with pytest.warns(UserWarning, match=".") as caught:
        plan_simulation(fc.Loop(), day, warm_up=0)
    assert_worded(caught[0].message)
    assert day.dampest[1].endswith(" at second 119")
    plan_simulation(fc.Loop(pressure=65e3), day, warm_up=0)


class Measured:
    """Numbers with a unit, as those of a library that is yet to come."""

    def __init__(self, numbers, unit):
        self.numbers, self.unit = numbers, unit

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.numbers, dtype)


def measure_with(library):
    """A function (numbers, unit) of a library."""
    if library == "a class":
        return Measured
    package = pytest.importorskip("astropy.units" if library == "astropy" else library)
    if library == "pint":
        return package.UnitRegistry().Quantity
    if library == "unyt":
        return package.unyt_array
    from astropy.units import imperial

    return lambda numbers, unit: numbers * (imperial.deg_F if unit == "degF" else package.Unit(unit))


@pytest.mark.parametrize("library", ["a class", "astropy", "pint", "unyt"])
def test_numbers_of_a_library_of_units_are_converted_or_refused(library):
    measure = measure_with(library)
    assert fc.Loop(ti=measure(0.5, "min"))["ti"] == 30.0
    assert fc.Loop(ti=("tuning", measure(np.array([0.5, 1.0]), "min")))["ti"].values.tolist() == [30.0, 60.0]
    fahrenheit = measure(np.full(N, 57.2), "degF")
    for value in (measure(57.2, "degF"), fahrenheit, xr.DataArray(fahrenheit, dims="elapsed_time")):
        if isinstance(value, xr.DataArray) and library in ("a class", "astropy", "unyt"):
            continue  # which xarray makes bare numbers
        np.testing.assert_allclose(DAY.assign(T_set=value).series["T_set"], 14.0)
    assert fc.constant_day(hours=measure(1.0, "hr" if library == "unyt" else "h")).hours == 1.0
    for refused in (measure(1.0, "kg"), [measure(1.0, "kg")], ("tuning", [measure(1.0, "kg")])):
        with pytest.raises(fc.InputError):
            fc.Loop(ti=refused)
    with pytest.raises(fc.InputError):
        fc.sample(4, seed=measure(1, "s"), kp={"uniform": [0.01, 0.05]})


@pytest.mark.parametrize("key", ["units", "unit", "Units", "uom", "Unit of measure", "engineering_units"])
def test_a_unit_counts_under_any_usual_key(key):
    fahrenheit = xr.DataArray(57.2, attrs={key: "°F"})
    np.testing.assert_allclose(DAY.assign(T_set=fahrenheit).series["T_set"], 14.0)
    log = xr.Dataset(
        {"T_sup": ("elapsed_time", [57.2, 57.2], {key: "°F"}), "command": ("elapsed_time", [50, 60], {key: "%"})}
    )
    log = log.assign_coords(elapsed_time=("elapsed_time", [0.0, 1.0], {key: "min"}))
    assert fc.read_log(log).summary()[0] == "2 rows, 60 s apart, in 1 piece: 60 s"
    assert "T_sup [°F]" in fc.read_log(log).summary()[1]
    assert_refused("T_set", "unit", DAY.assign, T_set=fahrenheit.assign_attrs(units_="K"))


def test_a_unit_in_a_name_counts():
    np.testing.assert_allclose(DAY.assign(T_set=pd.Series(np.full(N, 57.2), name="T [degF]")).series["T_set"], 14.0)
    assert fc.Loop(ti=pd.Series([0.5, 1.0], name="ti (min)"))["ti"].values.tolist() == [30.0, 60.0]
    assert_refused("ti", "unit", fc.Loop, ti=pd.Series([0.5, 1.0], name="ti_min"))
    assert_refused("T_set", "unit", DAY.assign, T_set=xr.DataArray(57.2, name="T [degF]", attrs={"units": "K"}))
    with pytest.raises(fc.InputError):
        fc.paper_day(hours=0.05, seed=[1, 2]).isel(xr.DataArray(0, name="x [h]"))


OTHER_CLOCKS = {
    "dates in descending order": TIMES[::-1].values, "later dates": TIMES.values + np.timedelta64(1, "h"),
    "numbers of minutes": 60 * np.arange(N), "durations of minutes": (60 * np.arange(N)).astype("m8[s]"),
    "cftime": xr.date_range("2024-07-01 08:00", periods=N, freq="s", use_cftime=True).values,
    "datetime objects": pd.DatetimeIndex(MINUTES).to_pydatetime().astype(object),
    "text": TIMES.astype(str).to_numpy(dtype=str),
}  # fmt: skip


@pytest.mark.parametrize("label", ["time", "timestamp", "when"])
@pytest.mark.parametrize("clock", OTHER_CLOCKS)
def test_times_under_any_name_are_honoured_or_refused(clock, label):
    series = xr.DataArray(np.full(N, 14.0), {label: ("elapsed_time", OTHER_CLOCKS[clock])}, "elapsed_time")
    with pytest.raises(fc.InputError) as caught:
        DAY.assign(T_set=series)
    if label == "when":
        assert_worded(*caught.value.problems)
    agreeing = series.assign_coords({label: ("elapsed_time", TIMES.values)})
    np.testing.assert_array_equal(DAY.assign(T_set=agreeing).series["T_set"], DAY.assign(T_set=14.0).series["T_set"])
    elsewhere = series.drop_vars(label).assign_coords({label: TIMES[0]})
    assert_refused(label, "time", DAY.assign, T_set=elsewhere)
