"""Fits that are validated with a second log."""

import numpy as np
import pytest
from helpers.simulated_logs import (
    VALVE_TRUTH,
    assert_covered,
    coil_log,
    flows,
    log_of,
    noisy,
    walk,
)

import fastcoil as fc
from fastcoil.calibrate.result import poor

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def two_days():
    return coil_log(hours=1.5, seed=41), coil_log(hours=1.5, seed=42)


@pytest.fixture(scope="module")
def validated(two_days):
    first, second = two_days
    return fc.fit_coil(first, validation=second)


def test_a_coil_is_validated_with_a_second_log(two_days, validated):
    fit, alone = validated, fc.fit_coil(two_days[0], split=1.0)
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


def test_both_figures_show_the_second_log(two_days, validated):
    axes = validated.plot().axes
    assert axes[0].get_title(loc="left").startswith("fit: RMSE")
    assert axes[1].get_title(loc="left").startswith("validation: RMSE")
    line = axes[1].get_lines()[0]
    assert line.get_xdata()[0] == 0.0
    np.testing.assert_array_equal(line.get_ydata(), two_days[1]["T_sup"])
