"""A compiled rule against its own Python."""

import numpy as np
import pytest
from helpers.rules import Memory, Parameters, by_error, by_switches, own_pi

import fastcoil as fc
from fastcoil.study.analysis import check_rule as module

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("rule", [by_error, by_switches, own_pi])
@pytest.mark.filterwarnings("ignore:action = 'heating', but the water")
def test_rules_are_what_they_say(rule, short):
    enabled = np.ones(short.n_steps)
    enabled[1000:1217] = 0.0
    series = {n: values[0] for n, values in short.series.items()}
    day = fc.Boundary(**{**series, "enabled": enabled, "T_set": series["T_set"] + 12.0})
    more = {"noise_std": 0.05, "sensor_resolution": 0.1, "sample_time": 10, "action": "heating"}
    loop = fc.Loop(**{"estimator": by_error, rule.kind: rule}, gain=0.01, backlash_estimate=0.01, **more)
    assert fc.check_rule(rule, loop, day) <= 1e-12


def test_rules_see_what_happens(short):
    """Every field of the sample is used: one that were wrong would show."""
    for kind in (fc.estimator, fc.law):

        @kind(Parameters, Memory)
        def all_fields(now, p, memory):
            seen = now.t / 1e4 + now.T_set / 20 + now.m_a + now.T / 20 + now.e + now.u + now.command + now.mode
            return abs(seen + now.switches / 10 + now.estimate + memory.integral) % 1.0, Memory(seen)

        loop = fc.Loop(noise_std=0.02) if kind is fc.estimator else fc.Loop(noise_std=0.02, estimator=by_error)
        assert fc.check_rule(all_fields, loop, short) < 1e-9


def test_the_first_sample_at_which_they_differ_is_named(short):
    @fc.estimator(Parameters, Memory)
    def overflows(now, p, memory):
        k = 10 ** (1 + int(now.t / 30))  # exact in Python, 64 bits when compiled
        return (k % 7) / 7, memory

    with pytest.raises(fc.InputError, match="overflows compiled and in plain Python differ from t = 570 s on: "):
        fc.check_rule(overflows, None, short)


def test_what_only_python_raises_is_said(short):
    @fc.estimator(Parameters, Memory)
    def divides(now, p, memory):
        return 1.0 / (now.t - 600.0), memory

    with pytest.raises(fc.InputError, match="divides raises ZeroDivisionError in plain Python at t = 600 s"):
        fc.check_rule(divides, None, short)


def test_a_loop_that_fails_and_calls_that_are_wrong(short, monkeypatch):
    @fc.law(Parameters, Memory)
    def lost(now, p, memory):
        return np.nan, memory

    with pytest.raises(fc.InputError, match="lost: the loop ends with the status non_finite"):
        fc.check_rule(lost, None, short)
    monkeypatch.setattr(module, "simulate", lambda *words, **more: pytest.fail("it ran"))
    for words, sentence in (
        ((by_error.parts[0],), "rule is a function: give a function with @fc.estimator"),
        ((by_error, fc.Loop(kp=[0.01, 0.02])), "one loop and one day: leave out the dims kp"),
        ((by_error, None, fc.paper_day(hours=1, seed=[1, 2])), "leave out the dims day"),
    ):
        with pytest.raises(fc.InputError, match=sentence):
            fc.check_rule(*words)


def test_python_is_called_before_anything_is_compiled(short, monkeypatch):
    monkeypatch.setattr("fastcoil.model.user_rules.Rule.check", lambda rule: pytest.fail("it was compiled"))
    for kind, t in ((fc.estimator, 30), (fc.law, 0)):

        @kind(Parameters, Memory)
        def past_the_end(now, p, memory):
            return (0.1, 0.2)[2 + int(now.t)], memory

        with pytest.raises(fc.InputError, match=f"raises IndexError in plain Python at t = {t} s"):
            fc.check_rule(past_the_end, None, short)


TABLE = tuple(0.01 * k for k in range(100))
PLANE = ((0.1, 0.2), (0.3, 0.4))


def test_a_table_is_a_tuple_with_a_limited_index(short):
    @fc.estimator(Parameters, Memory)
    def looks_up(now, p, memory):
        x = now.t / 30.0
        k = min(max(int(x), 0), 98)
        return TABLE[k] + (x - k) * (TABLE[k + 1] - TABLE[k]), memory

    @fc.law(Parameters, Memory)
    def looks_twice(now, p, memory):
        return PLANE[int(now.T) % 2][min(max(int(now.e), 0), 1)], memory

    assert fc.check_rule(looks_up, None, short) <= 1e-12
    assert fc.check_rule(looks_twice, None, short) <= 1e-12
