"""replay: the simulation's own commands from its own temperatures, and a building's from its record."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc

SIGNALS = ["u", "integral", "command", "estimate", "mode"]
pytestmark = pytest.mark.kernel


def to_log(ds, boundary):
    """A simulation as a log: readings of the sensor, and the set-point."""
    log = ds[["T_measured"]].rename(T_measured="T_sup")
    log["T_set"] = boundary.to_dataset()["T_set"]
    log["enabled"] = boundary.to_dataset()["enabled"]
    return log


@pytest.mark.parametrize(
    "settings",
    [
        {"backlash_estimate": 0.05},
        {"noise_std": 0.1, "sample_time": 5.0, "backlash_estimate": 0.03, "buffer": 0.01},
        {"learning_step": 0.007, "learning_interval": 600, "sensor_resolution": 0.1, "noise_std": 0.05},
        {"backlash_estimate": 0.05, "converged": True},
        {"neutral_zone": 0.01, "slip_jump": 0.03, "leakage": 0.0, "backlash_estimate": 0.05},
    ],
)
def test_a_simulation_fed_back_gives_its_commands_to_the_bit(one_hour_day, settings):
    loop = fc.Loop(**settings)
    ds = fc.simulate(loop, one_hour_day, traces=["T_measured", *SIGNALS], warm_up=0, seed=3)
    replayed = fc.replay(loop, to_log(ds, one_hour_day))
    for name in SIGNALS:
        np.testing.assert_array_equal(replayed[name], ds[name], err_msg=name)
    assert float(replayed["command"].std()) > 0.0


@pytest.mark.parametrize("rest", [{"estimator": "gradient", "backlash_estimate": 0.03}, {"estimator": "identify"}])
def test_an_estimator_is_replayed_too_and_sees_steps_of_an_air_flow_in_the_log(rest):
    day = fc.paper_day(hours=2, seed=1)
    day = day.assign(m_a=day.series["m_a"][0] * np.where(np.arange(7200) % 2000 < 1200, 1.0, 0.8))
    loop = fc.Loop.preset("lbnl").assign(backlash=0.1, noise_std=0.02, **rest)
    ds = fc.simulate(loop, day, traces=["T_measured", "estimate"], warm_up=0)
    assert float(ds["estimate"].std()) > 0.0
    log = to_log(ds, day)
    np.testing.assert_array_equal(fc.replay(loop, log.assign(m_a=day.to_dataset()["m_a"]))["estimate"], ds["estimate"])
    assert not np.array_equal(fc.replay(loop, log)["estimate"], ds["estimate"])


@pytest.mark.filterwarnings("ignore:action = 'heating' with kp")
def test_heating_is_replayed_too():
    day = fc.constant_day(hours=0.5, m_a=1.0, T_a_in=10.0, W_a_in=0.003, T_w_in=50.0, T_set=25.0)
    loop = fc.Loop(action="heating", backlash_estimate=0.05)
    ds = fc.simulate(loop, day, traces=["T_measured", "command"], warm_up=0)
    replayed = fc.replay(loop, to_log(ds, day))
    np.testing.assert_array_equal(replayed["command"], ds["command"])
    assert float(replayed["command"].std()) > 0.0


def test_times_without_operation_reset_the_controller():
    day = fc.paper_day(hours=0.5, seed=1)
    enabled = np.ones(1800)
    enabled[617:907] = 0.0  # between samples, too
    series = {name: values[0] for name, values in day.series.items()} | {"enabled": enabled}
    day = fc.Boundary(**series)
    loop = fc.Loop()
    ds = fc.simulate(loop, day, traces=["T_measured", *SIGNALS], warm_up=0)
    replayed = fc.replay(loop, to_log(ds, day))
    np.testing.assert_array_equal(replayed["command"], ds["command"])
    assert (replayed["u"][617:907] == 0.0).all()


def test_a_log_of_coarse_samples_holds_between_them(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("elapsed_time [s],T_sup [degF],T_set [degC]\n0,59,14\n60,60.8,14\n120,60.8,13\n")
    replayed = fc.replay(fc.Loop(kp=0.1, ti=1e9, sample_time=10.0), path)
    np.testing.assert_allclose(replayed["u"][[0, 59, 60, 119, 120]], [0.1, 0.1, 0.2, 0.2, 0.3], atol=1e-6)


def test_bad_logs_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("elapsed_time [s],T_sup [degC]\n0,15\n60,15\n")
    assert_refused("T_set", "missing", fc.replay, fc.Loop(), path)
    path.write_text("elapsed_time [s],T_sup [degC],T_set [degC]\n0,15,14\n60,15,14\n120,15,14\n999,15,14\n")
    assert_refused("elapsed_time", "time", fc.replay, fc.Loop(), path)
