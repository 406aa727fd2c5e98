"""Logs of real plants: gaps, nights, a second log to validate with, Datasets with timestamps."""

import numpy as np
import pytest
import xarray as xr
from helpers.simulated_logs import (
    COIL_TRUTH,
    VALVE_TRUTH,
    assert_covered,
    coil_log,
    flows,
    joined,
    log_of,
    noisy,
    shifted,
    walk,
)

import fastcoil as fc
from fastcoil.calibrate.result import poor

pytestmark = pytest.mark.kernel


def night(log, hours=1.0):
    """Between two days: no flow, and sensors that tell of the room."""
    n = int(hours * 3600)
    off = log.isel(elapsed_time=np.zeros(n, dtype=int)).copy(deep=True)
    for name, value in (("m_w", 0.0), ("m_a", 0.004), ("T_sup", 24.0), ("T_w_out", 23.0)):
        off[name] = xr.full_like(off[name], value).assign_attrs(log[name].attrs)
    return off.assign_coords(elapsed_time=("elapsed_time", np.arange(n) + 1.0, {"units": "s"}))


@pytest.fixture(scope="module")
def two_days():
    return coil_log(hours=1.5, seed=41), coil_log(hours=1.5, seed=42)


# -------------------------------------------------------------------------------------------- a coil's broken record


@pytest.fixture(scope="module")
def broken(two_days):
    first, second = two_days
    return fc.fit_coil(joined(first, shifted(second, 9000.0)), split=1.0)


def test_after_a_gap_the_record_of_a_coil_begins_anew_with_a_warm_up(broken):
    assert_covered(broken, COIL_TRUTH)
    assert broken.rmse["fit"] == pytest.approx(0.05, rel=0.05)
    assert any("1 gap in time (first: 3601 s between rows 5399 and 5400)" in note for note in broken.notes)
    assert any("2 unbroken pieces, each starting at 20 degC, the first 1800 s of each" in note for note in broken.notes)
    part = broken.residuals["part"].values
    for began in (0, 5400):
        assert set(part[began : began + 1800]) == {"unused"}
        assert set(part[began + 1800 : began + 5400]) == {"fit"}


def test_every_piece_starts_as_the_whole_record_does(two_days):
    """Of the same day twice, with a gap between, the model says the same twice, to the bit."""
    first, _ = two_days
    ds = fc.fit_coil(joined(first, shifted(first, 9000.0)), split=1.0).residuals
    for name in ("T_sup_modelled", "T_w_out_modelled", "wet_volumes"):
        np.testing.assert_array_equal(ds[name].values[:5400], ds[name].values[5400:])


def test_nights_without_air_are_left_out_and_counted(two_days):
    first, second = two_days
    log = joined(first, shifted(night(first), 5399.0), shifted(second, 9000.0))
    fit = fc.fit_coil(log, split=1.0)
    assert_covered(fit, COIL_TRUTH)
    assert fit.rmse["fit"] == pytest.approx(0.05, rel=0.05)
    assert any("3,600 samples in 1 spell left out, no air flows (first in row 5400)" in note for note in fit.notes)
    assert 24.0 not in fit.residuals["T_sup"]


def test_a_declared_shut_off_is_as_one_without_air(two_days):
    first, second = two_days
    log = joined(first, shifted(night(first), 5399.0), shifted(second, 9000.0))
    log["m_a"].values[log["m_a"].values < 0.1] = 1.0
    log["enabled"] = ("elapsed_time", log["T_sup"].values != 24.0)
    fit = fc.fit_coil(log, split=1.0)
    assert fit.rmse["fit"] == pytest.approx(0.05, rel=0.05)
    assert fc.fit_coil(log.drop_vars("enabled"), split=1.0).rmse["fit"] > 0.5


def test_leaving_water_that_stands_still_is_not_compared(two_days):
    log = two_days[0].copy(deep=True)
    log["m_w"][4000:4600] = 0.0
    log["T_w_out"][4000:4600] = 60.0
    fit = fc.fit_coil(log, split=1.0, minimise_on="both")
    assert fit.rmse["fit_T_w_out"] < 3.0
    assert "600 samples of T_w_out not compared: no water flows" in fit.notes


def test_four_pieces_or_more_are_held_back_whole():
    pieces = [shifted(coil_log(hours=h, seed=30 + i), 20000.0 * i) for i, h in enumerate((1.0, 1.5, 0.7, 0.15, 0.8))]
    fit = fc.fit_coil(joined(*pieces), warm_up=600.0)
    ds = fit.residuals
    assert set(ds["batch"].values[ds["part"] == "fit"]) == {0, 1, 2}
    assert set(ds["batch"].values[ds["part"] == "validation"]) == {4}
    assert any("5 unbroken pieces" in note and "(1 shorter than that)" in note for note in fit.notes)


# ------------------------------------------------------------------------------------------ a second log to validate


def test_a_coil_is_validated_with_a_second_log(two_days):
    first, second = two_days
    fit = fc.fit_coil(first, validation=second)
    alone = fc.fit_coil(first, split=1.0)
    assert fit.parameters == pytest.approx(alone.parameters, rel=1e-3)
    assert fit.rmse["validation"] == pytest.approx(0.05, rel=0.1)
    ds = fit.residuals
    assert set(ds["part"].values[:5400]) == {"unused", "fit"}
    assert set(ds["part"].values[5400:]) == {"unused", "validation"}
    assert float(ds["elapsed_time"][5400]) == 0.0
    assert "nothing was held back: the fit is not validated" in alone.notes


def test_a_valve_is_validated_with_a_second_log(tmp_path):
    rng = np.random.default_rng(23)
    logs = [log_of(c := walk(rng), noisy(rng, flows(c, start=s), 0.02)) for s in (0.3, 0.9)]
    fit = fc.fit_valve(logs[0], validation=logs[1])
    assert fit.parameters == fc.fit_valve(logs[0], split=1.0).parameters
    assert_covered(fit, VALVE_TRUTH)
    assert fit.rmse["validation"] == pytest.approx(0.02, rel=0.2)
    other = log_of(c := walk(rng), flows(c, backlash=0.2))
    assert any("the validation errs" in note for note in fc.fit_valve(logs[0], validation=other).notes)


def test_a_fit_to_round_off_is_not_called_worse_in_validation():
    for of_fit in (0.0, 1e-13):
        assert poor({"fit": of_fit, "validation": 3e-13}, np.array([10.0, 20.0]), "T_sup", "units") == []


def test_what_is_wrong_with_the_second_log_names_it(two_days, tmp_path):
    rng = np.random.default_rng(24)
    log = log_of(c := walk(rng), flows(c))
    (tmp_path / "other.csv").write_text("elapsed_time [s],command [1],m_w [kg/s]\n0,0.1,0.2\n60,7,0.2\n")
    with pytest.raises(fc.InputError, match=r"other\.csv: command = 7 in row 3"):
        fc.fit_valve(log, validation=tmp_path / "other.csv")
    with pytest.raises(fc.InputError, match="split and validation both say what is held back"):
        fc.fit_valve(log, validation=log, split=0.5)
    first, second = two_days
    dew_point = second.rename(W_a_in="T_dp_in").assign(T_dp_in=second["T_a_in"] - 5.0)
    dew_point["T_dp_in"].attrs["units"] = "degC"
    with pytest.raises(fc.InputError, match="has no T_dp_in, W_a_in: log the same in both"):
        fc.fit_coil(first, validation=dew_point)


def test_both_figures_show_the_second_log(two_days):
    first, second = two_days
    axes = fc.fit_coil(first, validation=second).plot().axes
    assert axes[0].get_title(loc="left").startswith("fit: RMSE")
    assert axes[1].get_title(loc="left").startswith("validation: RMSE")
    line = axes[1].get_lines()[0]
    assert line.get_xdata()[0] == 0.0
    np.testing.assert_array_equal(line.get_ydata(), second["T_sup"])


# --------------------------------------------------------------------------------------------- Datasets of all kinds


def test_a_dataset_with_timestamps_is_as_one_with_seconds():
    rng = np.random.default_rng(25)
    log = log_of(c := walk(rng, n=200), noisy(rng, flows(c), 0.02))
    stamps = np.datetime64("2024-07-01T08:00") + np.arange(200) * np.timedelta64(60, "s")
    expected = fc.fit_valve(log)
    for name in ("timestamp", "time", "elapsed_time"):
        stamped = log.drop_vars("elapsed_time").rename({"elapsed_time": name}).assign_coords({name: stamps})
        xr.testing.assert_equal(fc.fit_valve(stamped).residuals, expected.residuals)
    since = log.assign_coords(elapsed_time=stamps - stamps[0])
    xr.testing.assert_equal(fc.fit_valve(since).residuals, expected.residuals)


def test_a_dataset_of_other_names_and_units_is_read_as_a_file_would_be():
    rng = np.random.default_rng(26)
    log = log_of(c := walk(rng, n=200), noisy(rng, flows(c), 0.02))
    named = log.rename(command="CHW valve", m_w="CHW flow")
    for name in ("CHW valve", "CHW flow"):
        del named[name].attrs["units"]
    columns = {"command": "CHW valve", "m_w": "CHW flow"}
    units = {"command": "1", "m_w": "kg/s"}
    assert fc.fit_valve(named, columns=columns, units=units).parameters == fc.fit_valve(log).parameters
    with pytest.raises(fc.InputError, match=r"m_w has no unit: give it attrs\['units'\] = 'kg s-1'"):
        fc.fit_valve(named, columns=columns)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ds: ds.drop_vars("m_w"), "m_w is missing"),
        (lambda ds: ds.rename(elapsed_time="t"), "no coordinate elapsed_time, nor timestamp"),
        (lambda ds: ds.expand_dims(loop=2), "choose one loop"),
        (lambda ds: ds.isel(elapsed_time=[0]), "fewer than two samples"),
        (
            lambda ds: ds.assign(m_w=ds["m_w"].astype(str).where(ds["m_w"] > 1.0, "off").assign_attrs(units="kg/s")),
            "m_w = 'off' in row",
        ),
        (lambda ds: ds.where(ds["elapsed_time"] != 300.0), "command is nan in row 5"),
        (lambda ds: ds["m_w"], "log is a DataArray"),
        (lambda ds: ds.to_dataframe(), "log is a DataFrame"),
        (lambda ds: 7, "log is a int"),
    ],
)
def test_bad_datasets_are_refused(change, words):
    log = log_of(c := walk(np.random.default_rng(27), n=60), flows(c))
    with pytest.raises(fc.InputError, match=words):
        fc.fit_valve(change(log))
