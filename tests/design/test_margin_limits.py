"""The hunting index as a limit: that of ``fc.limit_cycle`` at the mean of the seconds that count; or a refusal."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.design.tuning_plan import hunting_indices, plan_tuning

pytestmark = pytest.mark.kernel

HOW = {"warm_up": 60, "evaluations": 16}
POPULATION = fc.Loop(backlash=("sample", [0.0, 0.05, 0.1])), fc.paper_day(hours=0.1, seed=[1, 2])


def test_no_valve_has_a_larger_hunting_index_than_allowed_and_it_is_that_of_limit_cycle():
    tuned = fc.tune(*POPULATION, search={"kp": (0.005, 0.2)}, limits={"hunting_index": (0.6, 1.0)}, n_jobs=1, **HOW)
    group = plan_tuning(*POPULATION, search={"kp": (0.005, 0.2)}, **HOW).training
    means = {name: values[:, 60:].mean(axis=1) for name, values in group.boundary.series.items()}
    steady = {name: np.repeat(values[:, None], 2000, axis=1) for name, values in means.items()}
    for tuning, kp in (("now", 0.03), ("chosen", tuned.parameters["kp"])):
        predicted = fc.limit_cycle(group.loop.assign(kp=kp), fc.Boundary(**steady)).hunting_index
        hunting_index = float(tuned.trained.hunting_index_p100.sel(tuning=tuning, edge="value"))
        assert hunting_index == pytest.approx(float(predicted.max()), rel=1e-6)
    assert float(tuned.trained.hunting_index_p100.sel(tuning="now", edge="value")) > 0.6
    assert tuned.meets_limits
    assert hunting_index <= 0.6
    assert tuned.trained.hunting_index_p100.attrs["long_name"] == "hunting index, largest"


def test_a_ratio_stands_in_for_the_estimate():
    loop, days = POPULATION
    estimates = loop.assign(backlash_estimate=("sample", [0.0, 0.04, 0.08]))
    both = [hunting_indices(swept, days, 60) for swept in (estimates, loop.assign(estimate_ratio=0.8))]
    np.testing.assert_allclose(*both, rtol=1e-9)
    assert not np.allclose(both[0], hunting_indices(loop, days, 60), rtol=0.01)


@pytest.mark.parametrize(
    ("change", "search"),
    [({"slip_jump": 0.0}, {"error_dead_band": (0.0, 0.3)}), ({"learning_step": 0.01}, {"kp": (0.01, 0.1)})],
)
def test_loops_without_a_hunting_index_are_refused(change, search):
    loop, days = POPULATION
    options = {"search": search, "limits": {"hunting_index": 0.8}} | HOW
    assert_refused("hunting_index", "unsupported", plan_tuning, loop.assign(**change), days, **options)
