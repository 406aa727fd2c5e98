"""Parameters of the controller that clash are refused before anything runs, by ``simulate`` and ``replay`` alike."""

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_only_problem, only_problem, problems

import fastcoil as fc
from fastcoil.loops.plan import plan_simulation

MEASURED = {"buffer_ratio": 6.0, "buffer_noise": "measured"}
LIMITED = {"buffer_swing": 0.1, "plant_gain": 20.0}


def planned(day=None, **parameters):
    return plan_simulation(fc.Loop(**parameters), fc.paper_day(hours=1) if day is None else day)


def day_of(T_set):
    """A constant hour with these set-points."""
    day = fc.constant_day(hours=1)
    return fc.Boundary(**{n: v[0] for n, v in day.series.items()} | {"T_set": np.resize(T_set, 3600)})


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"buffer_noise": "measured"}, ["buffer_noise = 'measured' without buffer_ratio", "give buffer_ratio"]),
        ({"buffer_noise": ["given", "measured"]}, ["without buffer_ratio"]),
        (
            {"buffer_noise": ("case", ["given", "measured"]), "buffer_ratio": ("case", [6.0, 0.0]), **LIMITED},
            ["without buffer_ratio"],
        ),
        (LIMITED, ["buffer_swing without buffer_ratio"]),
        ({**MEASURED, "buffer_swing": 0.1}, ["buffer_swing without plant_gain", "give plant_gain"]),
        (MEASURED, ["buffer_noise = 'measured' without buffer_swing", "give buffer_swing and plant_gain"]),
        ({**MEASURED, "plant_gain": 20.0}, ["without buffer_swing"]),
        ({**MEASURED, "buffer_swing": [0.0, 0.1], "plant_gain": 20.0}, ["without buffer_swing"]),
        (
            {**MEASURED, "buffer_swing": [0.1, 25.0], "plant_gain": 20.0},
            ["buffer_swing / plant_gain", "1.25", "below 1"],
        ),
        ({"buffer_ratio": 50.0, "kp": [0.1, 1.0], "noise_std": 0.1}, ["buffer_ratio × kp × noise_std", "5", "below 1"]),
        ({"smooth_rate": 1e-3, "compensation": ["inverse", "additive"]}, ["smooth_rate without compensation"]),
        ({"error_dead_band": [0.1, 5.0]}, ["error_dead_band = 5 K", "within 1 K", "give less"]),
    ],
)
def test_what_clashes_is_refused_with_a_sentence(parameters, words):
    assert_only_problem(words, planned, **parameters)


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
    ],
)
def test_what_goes_together_is_planned(parameters):
    assert planned(**parameters).n_scenarios >= 1


@pytest.mark.parametrize(
    ("T_set", "dead_band", "refused"),
    [
        ([14.0, 16.0], 2.0, True),
        ([14.0, 16.0], 1.99, False),
        ([14.0], 5.0, False),
        ([14.0, 14.06], 0.2, False),  # a record of one set-point
    ],
)
def test_a_dead_band_that_no_change_of_the_set_point_leaves_is_refused(T_set, dead_band, refused):
    if refused:
        assert "none of their changes would move the valve" in only_problem(
            planned, day_of(T_set), error_dead_band=dead_band
        )
    else:
        planned(day_of(T_set), error_dead_band=dead_band)


def test_the_set_points_of_all_days_count():
    planned(fc.paper_day(hours=0.75, seed=[1, 2]), error_dead_band=0.9)
    with pytest.raises(fc.InputError, match="within 1 K"):
        planned(fc.paper_day(hours=0.75, seed=[1, 2]), error_dead_band=1.5)


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


def test_a_swing_alone_misses_both_the_ratio_and_the_gain():
    found = problems(planned, buffer_swing=0.5)
    assert [problem.partition(":")[0] for problem in found] == [
        "buffer_swing without buffer_ratio", "buffer_swing without plant_gain"
    ]  # fmt: skip
