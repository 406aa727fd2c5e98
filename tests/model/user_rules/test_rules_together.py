"""A loop with rules that do not fit it, or one another, is refused with a sentence."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.rules import Memory, Parameters, by_error, by_switches, constant_rule, make_parameters, own_pi

import fastcoil as fc


def equally_fine(now, p, memory):
    return 0.1, memory


def test_functions_that_are_no_rules():
    assert_refused("estimator", "type", fc.Loop, estimator=constant_rule)
    assert_refused("estimator", "conflict", fc.Loop, estimator=own_pi)
    rules = [by_error, fc.estimator(Parameters, Memory)(constant_rule)]
    assert_refused("gain", "value", fc.Loop, estimator=rules, gain=2.0)
    assert_refused("gain", "type", fc.Loop, estimator=by_error, gain="a")
    namesake = by_error.parts[0].__class__(constant_rule.__code__, {}, "by_error")
    assert_refused("estimator", "duplicate", fc.Loop, estimator=[by_error, fc.estimator(Parameters, Memory)(namesake)])


def test_two_rules_that_declare_a_parameter_differently():
    half = fc.estimator(make_parameters(gain=0.5), Memory)(constant_rule)
    assert_refused("gain", "duplicate", fc.Loop, estimator=[by_error, half])
    assert fc.Loop(estimator=by_error).assign(estimator=half)["gain"] == 0.5
    alike = [fc.estimator(make_parameters(share=0.5), Memory)(function) for function in (constant_rule, equally_fine)]
    assert fc.Loop(estimator=alike)["share"] == 0.5


@pytest.mark.kernel
def test_a_replay_gives_the_commands_of_the_simulation():
    loop = fc.Loop(law=own_pi, estimator=[by_error, by_switches], noise_std=0.05)
    day = fc.paper_day(hours=1)
    traces = ["T_measured", "command", "estimate"]
    ds = fc.simulate(loop, day, traces=traces, warm_up=0)
    for k in range(2):
        log = day.to_dataset()[["T_set", "m_a"]].assign(T_sup=ds["T_measured"].isel(estimator=k, drop=True))
        replayed = fc.replay(loop, log)
        for name in ("command", "estimate"):
            np.testing.assert_array_equal(replayed[name].isel(estimator=k), ds[name].isel(estimator=k))
