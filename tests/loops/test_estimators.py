"""Which estimator a scenario has, and which parameters go with it."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.scenarios import columns_of

LEARNER = {"learning_step": 0.007, "backlash_estimate": 0.007}


def planned(**parameters):
    return plan_simulation(fc.Loop(**parameters), fc.constant_day(hours=1))


def test_without_a_word_the_learner_is_where_it_has_a_step():
    loop = fc.Loop(learning_step=[0.0, 0.01])
    assert columns_of(loop, loop.sizes, np.arange(2))["estimator"].tolist() == ["none", "learner"]


@pytest.mark.kernel
def test_the_word_changes_no_bits_and_none_switches_the_learner_off(short):
    plain = fc.simulate(fc.Loop(**LEARNER, learning_interval=600), short, warm_up=60)
    words = fc.simulate(fc.Loop(**LEARNER, learning_interval=600, estimator=["none", "learner"]), short, warm_up=60)
    assert words.sel(estimator="learner").rmse.item() == plain.rmse.item()
    assert words.learning_status.values.tolist() == [0.0, plain.learning_status.item()]
    assert words.sel(estimator="none").estimate_final == 0.007


@pytest.mark.kernel
def test_the_inverse_assumes_a_share_of_what_the_estimator_reports(short):
    """None of it: the loop of a plain PI, while the estimate is still reported."""
    learner = LEARNER | {"learning_interval": 600, "learning_early_trip": 1}
    ds = fc.simulate(fc.Loop(**learner, estimate_share=[0.0, 1.0]), short, warm_up=60, traces=["command", "estimate"])
    plain = fc.simulate(fc.Loop(), short, warm_up=60, traces=["command"])
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
            "learning_error_ratio without learning_reference: .* give the number",
        ),
        (LEARNER | {"learning_cap": 0.001}, "it cannot start above learning_cap"),
        ({"estimator": "lerner"}, "estimator = 'lerner': choose 'none' or 'learner' or 'hagglund' or 'gradient'"),
        ({"estimator": "hagglund"}, "estimator = 'hagglund' without plant_gain: give the change of the supply temp"),
        ({"estimator": ["gradient", "hagglund"]}, "estimator = 'hagglund' without plant_gain"),
        ({"estimator": "gradient", "backlash_estimate": 0.21}, "it cannot start above gradient_cap"),
        ({"gradient_gain": 1e-3}, "gradient_gain belongs to the estimator gradient, which no scenario has"),
        ({"hagglund_filter_ratio": 0.2, "estimator": "gradient"}, "hagglund_filter_ratio belongs to the estimator hag"),
        ({"estimator": "hagglund", "plant_gain": 0.0}, "plant_gain = 0 K: must be above 0"),
        ({"estimator": "hagglund", "hagglund_least_half_periods": 4}, "must be whole, from 5 to 1000"),
    ],
)
def test_parameters_without_their_estimator_are_refused_before_anything_runs(parameters, sentence):
    with pytest.raises(fc.InputError, match=sentence):
        planned(**parameters)


def test_a_replay_refuses_an_estimator_without_what_it_reckons_with():
    with pytest.raises(fc.InputError, match="estimator = 'hagglund' without plant_gain"):
        fc.replay(fc.Loop(estimator="hagglund"), "nothing.csv")
