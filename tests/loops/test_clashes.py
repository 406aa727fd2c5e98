"""Parameters that clash, belong to an estimator, or do not suit the days."""

import warnings

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_only_problem, only_problem
from helpers.rules import own_pi

import fastcoil as fc
from fastcoil.loops.clashes import warn_mismatch
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.presets import COOLING_PRESETS

MEASURED = {"buffer_ratio": 6.0, "buffer_noise": "measured"}
LIMITED = {"buffer_swing": 0.1, "plant_gain": 20.0}


def plan_loop(day=None, **parameters):
    return plan_simulation(fc.Loop(**parameters), fc.paper_day(hours=1) if day is None else day)


def day_with_set_points(T_set):
    """A constant hour with these set-points."""
    day = fc.constant_day(hours=1)
    return fc.Boundary(**{n: v[0] for n, v in day.series.items()} | {"T_set": np.resize(T_set, 3600)})


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"buffer_noise": "measured"}, ["buffer_noise = 'measured' without buffer_ratio", "give buffer_ratio"]),
        (
            {"buffer_noise": ("case", ["given", "measured"]), "buffer_ratio": ("case", [6.0, 0.0]), **LIMITED},
            ["without buffer_ratio"],
        ),
        (LIMITED, ["buffer_swing without buffer_ratio"]),
        ({**MEASURED, "buffer_swing": 0.1}, ["buffer_swing without plant_gain", "give plant_gain"]),
        (MEASURED, ["buffer_noise = 'measured' without buffer_swing", "give buffer_swing and plant_gain"]),
        ({**MEASURED, "buffer_swing": [0.0, 0.1], "plant_gain": 20.0}, ["without buffer_swing"]),
        (
            {**MEASURED, "buffer_swing": [0.1, 25.0], "plant_gain": 20.0},
            ["buffer_swing / plant_gain", "1.25", "below 1"],
        ),
        ({"buffer_ratio": 50.0, "kp": [0.1, 1.0], "noise_std": 0.1}, ["buffer_ratio × kp × noise_std", "5", "below 1"]),
        ({"smooth_rate": 1e-3, "compensation": ["inverse", "additive"]}, ["smooth_rate without compensation"]),
        ({"backlash": [0.05, 0.9], "estimate_ratio": [0.5, 1.2]}, ["estimate_ratio", "1.08", "below 1"]),
        ({"estimate_ratio": 4.0, "learning_step": 0.01}, ["0.28", "learning_cap"]),
        ({"error_dead_band": [0.1, 5.0]}, ["error_dead_band = 5 K", "within 1 K", "give less"]),
    ],
)
def test_what_clashes_is_refused_with_a_sentence(parameters, words):
    assert_only_problem(words, plan_loop, **parameters)


@pytest.mark.parametrize(
    "parameters",
    [
        {**MEASURED, "buffer_swing": 0.1, "plant_gain": [10.0, 30.0]},
        {"buffer_ratio": 50.0, "kp": 1.0, "noise_std": 0.1, "buffer_swing": 0.2, "plant_gain": 20.0},
        {**MEASURED, **LIMITED, "noise_std": 0.1, "kp": 5.0},
        {
            "buffer_ratio": 6.0,
            "buffer_noise": ("case", ["given", "measured"]),
            "buffer_swing": ("case", [0.0, 0.1]),
            "plant_gain": 20.0,
        },
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
        assert "would not move the valve" in only_problem(plan_loop, day, error_dead_band=dead_band)
    else:
        plan_loop(day, error_dead_band=dead_band)


def test_replay_refuses_the_same():
    log = xr.Dataset(
        {
            "T_sup": ("elapsed_time", [15.0] * 3, {"units": "degC"}),
            "T_set": ("elapsed_time", [14.0, 16.0, 16.0], {"units": "degC"}),
        },
        coords={"elapsed_time": ("elapsed_time", [0.0, 60.0, 120.0], {"units": "s"})},
    )
    with pytest.raises(fc.InputError, match="within 2 K"):
        fc.replay(fc.Loop(error_dead_band=3.0), log)
    with pytest.raises(fc.InputError, match="without buffer_ratio"):
        fc.replay(fc.Loop(buffer_noise="measured"), log)
    with pytest.raises(fc.InputError, match="estimator = 'hagglund' without plant_gain"):
        fc.replay(fc.Loop(estimator="hagglund"), "nothing.csv")


DAY_HOURS = 0.6
COOLING_DAY = fc.paper_day(hours=DAY_HOURS)
HEATING_DAY = fc.heating_day(hours=DAY_HOURS)
FREE_COOLING = fc.constant_day(DAY_HOURS, T_a_in=8.0, T_w_in=np.linspace(7.0, 9.0, 2160), relative_humidity=0.3)


MISTAKES = {
    "a heating coil on a day of cooling": (fc.Loop.preset("heating"), COOLING_DAY, "action = 'heating'.*cannot warm"),
    "a cooling coil on a day of heating": (fc.Loop.preset("lbnl"), HEATING_DAY, "action = 'cooling'.*cannot cool"),
    "gains of a cooling coil": (fc.Loop(action="heating"), HEATING_DAY, r"kp = 0\.03 1/K and ti = 8 s.*paper_like"),
    "water too cold": (
        fc.Loop.preset("heating"),
        fc.heating_day(DAY_HOURS, T_w_in=20.0),
        "T_set is 24 degC at best: .* cannot warm",
    ),
    "water too warm": (
        fc.Loop(),
        fc.constant_day(DAY_HOURS, T_set=5.0),
        "T_set is 5 degC at best: .* cannot cool",
    ),
    "a set-point in °F": (
        fc.Loop.preset("lbnl"),
        fc.constant_day(DAY_HOURS, T_set=57.0),
        "nothing to cool: T_set is 57",
    ),
    "exchanged": (
        fc.Loop(),
        fc.constant_day(DAY_HOURS, T_a_in=14.0, T_set=25.0),
        "the air is 14 degC.* exchange T_set",
    ),
    "a warm hall": (fc.Loop(action="heating"), fc.constant_day(DAY_HOURS, T_a_in=35.0, T_w_in=60.0), "nothing to warm"),
    "one action of a sweep": (fc.Loop(action=["heating", "cooling"]), COOLING_DAY, "cannot warm"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_cannot_be_meant_is_told(mistake):
    loop, day, words = MISTAKES[mistake]
    with pytest.warns(UserWarning, match=words) as caught:
        warn_mismatch(loop, day)
    assert len(caught) == 1


RIGHT = {
    **{name: (fc.Loop.preset(name), COOLING_DAY) for name in COOLING_PRESETS},
    "heating": (fc.Loop.preset("heating"), HEATING_DAY),
    "heating_45": (fc.Loop.preset("heating_45"), fc.heating_day(DAY_HOURS, T_w_in=45.0)),
    "water at times warmer than the air": (fc.Loop(), FREE_COOLING),
    "water and air of one temperature": (fc.Loop(), fc.constant_day(DAY_HOURS, T_a_in=20.0, T_w_in=20.0, T_set=20.0)),
    "nothing to do: the air is colder than the set-point": (
        fc.Loop(),
        fc.constant_day(DAY_HOURS, T_a_in=13.0, T_set=14.0),
    ),
    "gains that were chosen": (fc.Loop.preset("lbnl").assign(action="heating", kp=0.0045), HEATING_DAY),
    "gains that are swept": (fc.Loop.preset("lbnl").assign(action="heating", kp=[0.018, 0.01]), HEATING_DAY),
    "cooling gains with tepid water": (fc.Loop(action="heating"), fc.heating_day(DAY_HOURS, T_w_in=35.0)),
    "a law of the user's own": (fc.Loop.preset("lbnl").assign(law=own_pi), HEATING_DAY),
    "an action that kp turns round": (fc.Loop.preset("lbnl").assign(kp=-0.018), HEATING_DAY),
}


@pytest.mark.parametrize("case", RIGHT)
def test_what_may_be_meant_is_not_told(case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_mismatch(*RIGHT[case])


@pytest.mark.kernel
def test_a_run_is_told_where_it_is_called_and_an_open_loop_is_not():
    with pytest.warns(UserWarning, match="cannot warm") as caught:
        fc.simulate(fc.Loop.preset("heating"), COOLING_DAY, n_jobs=1)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fc.simulate(fc.Loop.preset("heating"), COOLING_DAY, command=np.full(2160, 0.5), n_jobs=1)


LEARNER = {"learning_step": 0.007, "backlash_estimate": 0.007}


@pytest.mark.kernel
def test_the_word_changes_no_bits_and_none_switches_the_learner_off(half_hour_day):
    plain = fc.simulate(fc.Loop(**LEARNER, learning_interval=600), half_hour_day, warm_up=60)
    words = fc.simulate(
        fc.Loop(**LEARNER, learning_interval=600, estimator=["none", "learner"]), half_hour_day, warm_up=60
    )
    assert words.sel(estimator="learner").rmse.item() == plain.rmse.item()
    assert words.learning_status.values.tolist() == [0.0, plain.learning_status.item()]
    assert words.sel(estimator="none").estimate_final == 0.007


@pytest.mark.kernel
def test_the_inverse_assumes_a_share_of_what_the_estimator_reports(half_hour_day):
    """None of it: the loop of a plain PI, while the estimate is still reported."""
    learner = LEARNER | {"learning_interval": 600, "learning_early_trip": 1}
    ds = fc.simulate(
        fc.Loop(**learner, estimate_share=[0.0, 1.0]), half_hour_day, warm_up=60, traces=["command", "estimate"]
    )
    plain = fc.simulate(fc.Loop(), half_hour_day, warm_up=60, traces=["command"])
    np.testing.assert_array_equal(ds.command.sel(estimate_share=0.0), plain.command)
    assert ds.estimate.sel(estimate_share=0.0).max() > 0.0


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"estimator": "learner"}, "estimator = 'learner' with learning_step = 0"),
        ({"estimator": "none", "learning_step": 0.007}, "learning_step belongs to the estimator learner, which no"),
        ({"estimate_share": 0.5, "estimator": "none"}, "estimate_share without an estimator"),
        (
            LEARNER | {"learning_error_ratio": 1.5},
            "learning_error_ratio without learning_reference: give the number",
        ),
        (LEARNER | {"learning_cap": 0.001}, "it cannot start above learning_cap"),
        ({"estimator": "lerner"}, "estimator = 'lerner': choose 'none' or 'learner' or 'hagglund' or 'gradient'"),
        ({"estimator": "hagglund"}, "estimator = 'hagglund' without plant_gain: give the change of the supply temp"),
        ({"estimator": "gradient", "backlash_estimate": 0.21}, "it cannot start above gradient_cap"),
        ({"gradient_gain": 1e-3}, "gradient_gain belongs to the estimator gradient, which no scenario has"),
        ({"hagglund_filter_ratio": 0.2, "estimator": "gradient"}, "hagglund_filter_ratio belongs to the estimator hag"),
    ],
)
def test_parameters_without_their_estimator_are_refused_before_anything_runs(parameters, sentence):
    with pytest.raises(fc.InputError, match=sentence):
        plan_loop(**parameters)
