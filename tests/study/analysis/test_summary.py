"""What an inverse is compared with in the summary of a run: plain Python finds the same."""

import json

import numpy as np
import pytest
from helpers.results import make_result as hand_made

from fastcoil.study.analysis.summary import summary


def make_estimates(rmse, motor_travel):
    """Estimates of 0, 50, 100 and 150 % on five loops, whose errors and travels have these factors."""
    loops = np.linspace(1.0, 1.4, 5)
    metrics = {"rmse": np.outer(rmse, loops), "motor_travel": np.outer(motor_travel, loops)}
    metrics["switch_frequency"] = np.ones((4, 5))
    return hand_made(("estimate_ratio", "sample"), {"estimate_ratio": [0.0, 0.5, 1.0, 1.5]}, **metrics)


def test_days_off_count_in_no_median():
    ds = make_estimates([1.0, 0.8, 0.62, 0.6], [1.0, 1.5, 2.0, 9.0])
    off = ds.copy(deep=True)
    off["rmse"][:, :3], off["motor_travel"][:, :3] = np.nan, 0.0
    sentences = summary(off)
    assert "In 12 of 20 the loop was off all day" in sentences[2]
    assert sentences[3:] == summary(ds.isel(sample=slice(3, None)))[2:]
    days = {"rmse": [[0.2, np.nan, np.nan]] * 2, "motor_travel": [[3.0, 0.0, 0.0], [5.0, 0.0, 0.0]]}
    costs = summary(hand_made(("kp", "day"), {"kp": [0.01, 0.02]}, **days))[-1]
    assert costs == "It costs: the motor travels 3 strokes."


@pytest.mark.parametrize(
    ("stored", "coords", "called"),
    [
        ({}, {}, "plain PI"),
        ({"buffer": 1e-9, "buffer_ratio": 6.0, "noise_std": 0.0}, {}, "plain PI"),
        ({"buffer": 0.02}, {}, "PI with a buffer"),
        ({}, {"buffer": ("estimate_ratio", [0.01] * 4)}, "PI with a buffer"),
        ({"buffer_ratio": 6.0, "noise_std": 0.1}, {}, "PI with a buffer"),
        ({"buffer_ratio": 6.0, "noise_std": 0.0, "buffer_noise": "measured"}, {}, "PI with a buffer"),
    ],
)
def test_a_pi_whose_buffer_holds_reversals_back_is_not_called_plain(stored, coords, called):
    ds = make_estimates([1.0, 0.8, 0.62, 0.6], [1.0, 1.5, 2.0, 9.0]).assign_coords(coords)
    lines = summary(ds.assign_attrs(parameters=json.dumps(stored)))
    assert f"than with the {called} of the same loop" in lines[3]


def test_scenarios_off_their_set_point_for_over_half_of_the_time_are_told():
    share_off, hunts = [0.51, 1.0, 0.5, np.nan], [1.0, 0.0, 1.0, np.nan]
    lines = summary(hand_made(("sample",), rmse=np.ones(4), share_off=share_off, hunts=hunts))
    (sentence,) = [line for line in lines if "off their set-point" in line]
    assert sentence.startswith(
        "2 of 4 are more than 0.5 K off their set-point for over half of the time, 1 of them hunting"
    )
