"""Parameters that clash, belong to an estimator, or do not suit the days."""

import warnings

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_mistakes, assert_refused
from helpers.rules import own_pi
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.loops.clashes import warn_mismatch
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.presets import COOLING_PRESETS

LEARNER = {"learning_step": 0.007, "backlash_estimate": 0.007}
BOTH_SOURCES = ("case", ["given", "measured"])
MEASURED = {"buffer_ratio": 6.0, "buffer_noise": "measured"}
LIMITED = {"buffer_swing": 0.1, "plant_gain": 20.0}


def plan_loop(day=None, **parameters):
    return plan_simulation(fc.Loop(**parameters), fc.paper_day(hours=1) if day is None else day)


def day_with_set_points(T_set):
    """A constant hour with these set-points."""
    return fc.constant_day(hours=1, T_set=np.resize(T_set, 3600))


@pytest.mark.parametrize(
    ("field", "code", "parameters"),
    [
        ("buffer_noise", "conflict", {"buffer_noise": "measured"}),
        ("buffer_noise", "conflict", {"buffer_noise": BOTH_SOURCES, "buffer_ratio": ("case", [6.0, 0.0]), **LIMITED}),
        ("buffer_swing", "conflict", LIMITED),
        ("plant_gain", "missing", {**MEASURED, "buffer_swing": 0.1}),
        ("buffer_swing", "missing", MEASURED),
        ("buffer_swing", "missing", {**MEASURED, "buffer_swing": [0.0, 0.1], "plant_gain": 20.0}),
        ("buffer_swing", "value", {**MEASURED, "buffer_swing": [0.1, 25.0], "plant_gain": 20.0}),
        ("buffer_ratio", "value", {"buffer_ratio": 50.0, "kp": [0.1, 1.0], "noise_std": 0.1}),
        ("smooth_rate", "conflict", {"smooth_rate": 1e-3, "compensation": ["inverse", "additive"]}),
        ("estimate_ratio", "value", {"backlash": [0.05, 0.9], "estimate_ratio": [0.5, 1.2]}),
        ("backlash_estimate", "conflict", {"estimate_ratio": 4.0, "learning_step": 0.01}),
        ("error_dead_band", "conflict", {"error_dead_band": [0.1, 5.0]}),
        ("learning_step", "missing", {"estimator": "learner"}),
        ("learning_step", "conflict", {"estimator": "none", "learning_step": 0.007}),
        ("estimate_share", "conflict", {"estimate_share": 0.5, "estimator": "none"}),
        ("learning_reference", "missing", LEARNER | {"learning_error_ratio": 1.5}),
        ("backlash_estimate", "conflict", LEARNER | {"learning_cap": 0.001}),
        ("estimator", "choice", {"estimator": "lerner"}),
        ("plant_gain", "missing", {"estimator": "hagglund"}),
        ("gradient_gain", "conflict", {"gradient_gain": 1e-3}),
    ],
)
def test_parameters_that_clash_are_refused_before_anything_runs(field, code, parameters):
    assert_refused(field, code, plan_loop, **parameters)


def test_every_clash_is_reported():
    mistakes = [("backlash_estimate", "conflict"), ("buffer_noise", "conflict")]
    assert_mistakes(mistakes, plan_loop, estimator="gradient", backlash_estimate=0.21, buffer_noise="measured")


@pytest.mark.parametrize(
    "parameters",
    [
        {**MEASURED, "buffer_swing": 0.1, "plant_gain": [10.0, 30.0]},
        {"buffer_ratio": 50.0, "kp": 1.0, "noise_std": 0.1, "buffer_swing": 0.2, "plant_gain": 20.0},
        {**MEASURED, **LIMITED, "noise_std": 0.1, "kp": 5.0},
        {"buffer_ratio": 6.0, "buffer_noise": BOTH_SOURCES, "buffer_swing": ("case", [0.0, 0.1]), "plant_gain": 20.0},
        {"buffer_ratio": ("case", [0.0, 6.0]), "buffer": ("case", [0.01, 1e-9])},
        {"buffer_ratio": ("case", [0.0, 6.0]), "buffer_noise": ("case", ["measured", "measured"]), **LIMITED},
        {"buffer_ratio": [3.0, 6.0], "noise_std": [0.0, 0.02]},
        {"smooth_rate": 1e-3, "compensation": ["inverse", "smooth"]},
        {"error_dead_band": [0.0, 0.9]},
        {"backlash_estimate": 0.3},
    ],
)
def test_what_goes_together_is_planned(parameters):
    assert plan_loop(**parameters).n_scenarios >= 1


@pytest.mark.parametrize(
    ("day", "dead_band", "is_refused"),
    [
        (day_with_set_points([14.0, 16.0]), 2.0, True),
        (day_with_set_points([14.0, 16.0]), 1.99, False),
        (day_with_set_points([14.0, 14.06]), 0.2, False),  # a record of one set-point
        (fc.paper_day(hours=0.75, seed=[1, 2]), 1.5, True),
        (fc.paper_day(hours=0.75, seed=[1, 2]), 0.9, False),
    ],
)
def test_a_dead_band_that_no_change_of_the_set_point_leaves_is_refused(day, dead_band, is_refused):
    if is_refused:
        assert_refused("error_dead_band", "conflict", plan_loop, day, error_dead_band=dead_band)
    else:
        plan_loop(day, error_dead_band=dead_band)


def test_replay_refuses_the_same():
    columns = {"elapsed_time": [0.0, 60.0, 120.0], "T_sup": [15.0] * 3, "T_set": [14.0, 16.0, 16.0]}
    units = {"elapsed_time": "s", "T_sup": "degC", "T_set": "degC"}
    log = xr.Dataset({name: ("elapsed_time", values, {"units": units[name]}) for name, values in columns.items()})
    assert_refused("error_dead_band", "conflict", fc.replay, fc.Loop(error_dead_band=3.0), log)
    assert_refused("buffer_noise", "conflict", fc.replay, fc.Loop(buffer_noise="measured"), log)
    assert_refused("plant_gain", "missing", fc.replay, fc.Loop(estimator="hagglund"), "nothing.csv")


DAY_HOURS = 0.6
COOLING_DAY = fc.paper_day(hours=DAY_HOURS)
HEATING_DAY = fc.heating_day(hours=DAY_HOURS)
FREE_COOLING = fc.constant_day(DAY_HOURS, T_a_in=8.0, T_w_in=np.linspace(7.0, 9.0, 2160), relative_humidity=0.3)

MISTAKES = {
    "a heating coil on a day of cooling": (fc.Loop.preset("heating"), COOLING_DAY),
    "a room on a day of cooling": (fc.Loop.preset("reheat"), COOLING_DAY),
    "a cooling coil on a day of heating": (fc.Loop.preset("lbnl"), HEATING_DAY),
    "gains of a cooling coil": (fc.Loop(action="heating"), HEATING_DAY),
    "water too cold": (fc.Loop.preset("heating"), fc.heating_day(DAY_HOURS, T_w_in=20.0)),
    "water too warm": (fc.Loop(), fc.constant_day(DAY_HOURS, T_set=5.0)),
    "a set-point in °F": (fc.Loop.preset("lbnl"), fc.constant_day(DAY_HOURS, T_set=57.0)),
    "exchanged": (fc.Loop(), fc.constant_day(DAY_HOURS, T_a_in=14.0, T_set=25.0)),
    "a warm hall": (fc.Loop(action="heating"), fc.constant_day(DAY_HOURS, T_a_in=35.0, T_w_in=60.0)),
    "one action of a sweep": (fc.Loop(action=["heating", "cooling"]), COOLING_DAY),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mismatch_of_loop_and_day_gets_a_warning(mistake):
    with pytest.warns(UserWarning, match=".") as caught:
        warn_mismatch(*MISTAKES[mistake])
    assert len(caught) == 1
    assert_worded(caught[0].message)


RIGHT = {
    **{name: (fc.Loop.preset(name), COOLING_DAY) for name in COOLING_PRESETS},
    "heating": (fc.Loop.preset("heating"), HEATING_DAY),
    "heating_45": (fc.Loop.preset("heating_45"), fc.heating_day(DAY_HOURS, T_w_in=45.0)),
    "water at times warmer than the air": (fc.Loop(), FREE_COOLING),
    "water and air of one temperature": (fc.Loop(), fc.constant_day(DAY_HOURS, T_a_in=20.0, T_w_in=20.0, T_set=20.0)),
    "nothing to do: air colder than the set-point": (fc.Loop(), fc.constant_day(DAY_HOURS, T_a_in=13.0, T_set=14.0)),
    "gains that were chosen": (fc.Loop.preset("lbnl").assign(action="heating", kp=0.0045), HEATING_DAY),
    "gains that are swept": (fc.Loop.preset("lbnl").assign(action="heating", kp=[0.018, 0.01]), HEATING_DAY),
    "cooling gains with tepid water": (fc.Loop(action="heating"), fc.heating_day(DAY_HOURS, T_w_in=35.0)),
    "a law of the user's own": (fc.Loop.preset("lbnl").assign(law=own_pi), HEATING_DAY),
    "an action that kp turns round": (fc.Loop.preset("lbnl").assign(kp=-0.018), HEATING_DAY),
}


@pytest.mark.parametrize("case", RIGHT)
def test_what_may_be_meant_gets_none(case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_mismatch(*RIGHT[case])


@pytest.mark.kernel
def test_a_run_warns_where_it_is_called_and_an_open_loop_does_not():
    with pytest.warns(UserWarning, match="cannot warm") as caught:
        fc.simulate(fc.Loop.preset("heating"), COOLING_DAY, n_jobs=1)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fc.simulate(fc.Loop.preset("heating"), COOLING_DAY, command=np.full(2160, 0.5), n_jobs=1)


@pytest.mark.kernel
def test_the_word_changes_no_bits_and_none_switches_the_learner_off(half_hour_day):
    learner = fc.Loop(**LEARNER, learning_interval=600)
    plain = fc.simulate(learner, half_hour_day, warm_up=60)
    words = fc.simulate(learner.assign(estimator=["none", "learner"]), half_hour_day, warm_up=60)
    assert words.sel(estimator="learner").rmse.item() == plain.rmse.item()
    assert words.learning_status.values.tolist() == [0.0, plain.learning_status.item()]
    assert words.sel(estimator="none").estimate_final == 0.007


@pytest.mark.kernel
def test_the_inverse_assumes_a_share_of_what_the_estimator_reports(half_hour_day):
    """None of it: the loop of a plain PI, while the estimate is still reported."""
    loop = fc.Loop(**LEARNER, learning_interval=600, learning_early_trip=1, estimate_share=[0.0, 1.0])
    ds = fc.simulate(loop, half_hour_day, warm_up=60, traces=["command", "estimate"])
    plain = fc.simulate(fc.Loop(), half_hour_day, warm_up=60, traces=["command"])
    np.testing.assert_array_equal(ds.command.sel(estimate_share=0.0), plain.command)
    assert ds.estimate.sel(estimate_share=0.0).max() > 0.0
