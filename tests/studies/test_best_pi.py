"""``studies/days.py`` and ``robustness/best_pi.py``: kinds of days, the model of a step, and gains."""

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import days as kinds
from studies.robustness import best_pi

WITHOUT_WEATHER = (kinds.STEPPED, kinds.CONSTANT, kinds.DESIGN, kinds.HEATING)


@pytest.fixture
def two_hours(monkeypatch):
    """Short days, few gains."""
    monkeypatch.setattr(kinds, "HOURS", 2)
    monkeypatch.setattr(best_pi, "KP", np.array([0.02, 0.05]))
    monkeypatch.setattr(best_pi, "TI", np.array([40.0, 100.0]))


@pytest.mark.parametrize("kind", WITHOUT_WEATHER)
def test_days_of_a_kind_differ_and_come_again(kind):
    days, again = kinds.make_days(kind, [5, 6]), kinds.make_days(kind, [6])
    assert days.day.tolist() == [5, 6]
    for name in ("m_a", "T_a_in", "T_w_in"):
        assert not np.allclose(days.series[name][0], days.series[name][1])
        np.testing.assert_array_equal(days.series[name][1], again.series[name][0])
    assert (np.count_nonzero(np.diff(days.series["T_set"])) > 0) == (kind == kinds.STEPPED)
    colder = days.series["T_a_in"] < days.series["T_set"]
    assert colder.all() if kind == kinds.HEATING else not colder.any()


def test_days_of_weather_come_only_with_a_file(tmp_path, weather_file):
    assert kinds.WEATHER not in kinds.kinds(tmp_path / "none.csv")
    assert kinds.WEATHER in kinds.kinds(weather_file)
    days = kinds.make_days(kinds.WEATHER, [1, 2], weather_file)
    assert not np.allclose(days.series["T_a_in"][0], days.series["T_a_in"][1])


@pytest.mark.parametrize(("gain", "tau", "theta"), [(20.0, 60.0, 30.0), (8.0, 200.0, 20.0)])
def test_the_model_of_a_first_order_plant_is_that_plant(monkeypatch, gain, tau, theta):
    def response(loop, kind, level):
        t = np.arange(0.0, best_pi.RESPONSE_SECONDS, best_pi.RESPONSE_INTERVAL)
        rise = np.where(t > theta, 1.0 - np.exp(-(t - theta) / tau), 0.0)
        T = 25.0 - gain * (level + best_pi.STEP_SIZE * rise)
        return xr.DataArray(T, dims="elapsed_time", coords={"elapsed_time": t})

    monkeypatch.setattr(best_pi, "_step_response", response)
    loop = fc.Loop(sample_time=10.0)
    model = best_pi.fit_first_order(loop, kinds.CONSTANT)
    assert float(model.gain) == pytest.approx(gain, rel=0.01)
    assert float(model.tau) == pytest.approx(tau, rel=0.1)
    assert float(model.theta) == pytest.approx(theta + 5.0, abs=4.0)
    gains = best_pi.simc_gains(loop, kinds.CONSTANT)
    assert float(gains.kp) == pytest.approx(tau / (gain * 2 * (theta + 5.0)), rel=0.25)
    assert float(gains.plant_gain) == pytest.approx(gain, rel=0.01)
    assert float(gains.ti) == pytest.approx(min(tau, 8 * (theta + 5.0)), rel=0.25)


@pytest.mark.kernel
def test_the_best_gains_have_the_lowest_error_on_the_search_days(two_hours):
    loop = fc.Loop.preset("lbnl").assign(backlash=("valve", [0.02, 0.1]))
    best = best_pi.best_gains(loop, [kinds.CONSTANT], [1])
    ds = fc.simulate(loop.assign(kp=[0.02, 0.05], ti=[40.0, 100.0]), kinds.make_days(kinds.CONSTANT, [1])).isel(day=0)
    for k in range(2):
        lowest = min(ds.rmse.isel(valve=k).values.ravel())
        assert float(ds.rmse.isel(valve=k).sel(kp=float(best.kp[k]), ti=float(best.ti[k]))) == lowest
