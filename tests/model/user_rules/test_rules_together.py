"""A loop with rules that do not fit it, or one another, is refused with a sentence."""

import numpy as np
import pytest
from helpers.rules import Memory, Parameters, by_error, by_switches, constant_rule, make_parameters, own_pi

import fastcoil as fc


def equally_fine(now, p, memory):
    return 0.1, memory


def test_functions_that_are_no_rules():
    for arguments, sentence in (
        ({"estimator": constant_rule}, "fine is a plain function: put @fc.estimator"),
        ({"estimator": own_pi}, "own_pi is made with @fc.law: give law = own_pi"),
        ({"estimator": [by_error, fc.estimator(Parameters, Memory)(constant_rule)], "gain": 2.0}, "gain = 2"),
        ({"estimator": by_error, "gain": "a"}, "gain = 'a': give a number"),
    ):
        with pytest.raises(fc.InputError, match=sentence) as error_info:
            fc.Loop(**arguments)
        assert len(error_info.value.problems) == 1
    with pytest.raises(fc.InputError, match="two rules are called by_error"):
        fc.Loop(estimator=[by_error, fc.estimator(Parameters, Memory)(by_error.parts[0].__class__(
            constant_rule.__code__, {}, "by_error"))])  # fmt: skip


def test_two_rules_that_declare_a_parameter_differently():
    fine_rule = fc.estimator(make_parameters(gain=0.5), Memory)(constant_rule)
    with pytest.raises(fc.InputError, match="gain is a parameter of by_error and another one of fine: rename one"):
        fc.Loop(estimator=[by_error, fine_rule])
    assert fc.Loop(estimator=by_error).assign(estimator=fine_rule)["gain"] == 0.5
    same_declarations = [
        fc.estimator(make_parameters(share=0.5), Memory)(function) for function in (constant_rule, equally_fine)
    ]
    assert fc.Loop(estimator=same_declarations)["share"] == 0.5


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
