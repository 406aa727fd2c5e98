"""A rule of the user's own in a loop: its parameters, its results, and lanes that do not notice one another."""

import numpy as np
import pytest
from helpers.rules import Memory, Parameters, by_error, by_switches, own_pi

import fastcoil as fc
from fastcoil.model.estimators.interface import Sample
from fastcoil.model.parameter_table import PARAMETERS

KI = 0.03 * 30.0 / 8.0
"""Gain with which ``own_pi`` is the PI of the default loop."""


def test_a_rule_brings_its_parameters_to_that_loop_alone():
    loop = fc.Loop(estimator=by_error, gain=[1e-4, 3e-4])
    assert loop["estimator"] == "by_error"
    assert loop.sizes == {"gain": 2}
    assert fc.Loop(estimator=by_error)["gain"] == 3e-4
    assert "by_error" not in PARAMETERS["estimator"].choices
    with pytest.raises(fc.InputError, match="gain is not a parameter"):
        fc.Loop(gain=1e-4)
    assert "estimator = by_error" in repr(fc.Loop(estimator=by_error))
    assert "gain = 0.5 K-1 s-1" in repr(fc.Loop(estimator=by_error, gain=0.5))


def test_a_rule_of_the_same_name_replaces_the_one_before_and_keeps_what_was_assigned():
    again = fc.estimator(Parameters, Memory)(by_error.parts[0])
    loop = fc.Loop(estimator=by_error, gain=0.5).assign(estimator=again)
    assert loop["gain"] == 0.5
    assert loop.rules["by_error"] is again


@pytest.mark.kernel
def test_the_result_has_the_parameters_as_coordinates_and_gives_the_loop_back(half_hour_day):
    loop = fc.Loop(estimator=["none", by_error], gain=[1e-4, 3e-4])
    ds = fc.simulate(loop, half_hour_day, warm_up=60)
    assert ds["gain"].attrs == {"long_name": "gain", "units": "K-1 s-1", "comment": "how fast it moves"}
    assert ds.sel(estimator="by_error").estimate_final.values.tolist() != [0.0, 0.0]
    assert fc.Loop.from_dataset(ds, rules=[by_error]) == loop
    with pytest.raises(fc.InputError, match="the result has the estimator by_error: give its rule"):
        fc.Loop.from_dataset(ds)


@pytest.mark.kernel
def test_lanes_of_rules_words_and_laws_keep_their_bits_beside_one_another(half_hour_day):
    """By pairs: each alone, and all of them in one call."""
    estimators = ["none", "learner", by_error, by_switches]
    common = {"learning_step": 0.007, "learning_interval": 600, "noise_std": 0.05, "gain": 1e-3}
    together = fc.Loop(estimator=estimators, law=["pi", own_pi], sample_time=[10, 30], **common)
    ds = fc.simulate(together, half_hour_day, warm_up=60, traces=["command", "estimate"])
    for name, estimator in zip(ds.estimator.values, estimators, strict=True):
        for law in ("pi", own_pi):
            word = getattr(law, "name", law)
            parameters = {n: v for n, v in common.items() if not n.startswith("learning") or name == "learner"}
            if not {name, word} & {"by_error", "by_switches", "own_pi"}:
                del parameters["gain"]
            loop = fc.Loop(estimator=estimator, law=law, sample_time=30, **parameters)
            alone = fc.simulate(loop, half_hour_day, warm_up=60, traces=["command", "estimate"])
            lane = ds.sel(estimator=name, law=word, sample_time=30)
            np.testing.assert_array_equal(lane.command, alone.command)
            np.testing.assert_array_equal(lane.estimate, alone.estimate)
    rows = ds.sel(sample_time=30).command.values.reshape(-1, ds.elapsed_time.size)
    assert len({tuple(row) for row in rows}) >= 6, "the rules differ"


@pytest.mark.kernel
def test_a_law_takes_the_place_of_the_pi_and_the_inverse_stays_behind_it(half_hour_day):
    inverse = {"backlash_estimate": 0.07, "noise_std": 0.02, "sample_time": 30}
    ds = fc.simulate(
        fc.Loop(law=["pi", own_pi], gain=KI, **inverse), half_hour_day, warm_up=60, traces=["u", "command", "integral"]
    )
    np.testing.assert_allclose(ds.command.sel(law="own_pi"), ds.command.sel(law="pi"), rtol=0, atol=1e-12)
    assert not ds.integral.sel(law="own_pi").any()
    assert (ds.command != ds.u).any()


TABLE = tuple(0.01 * k for k in range(10))


@pytest.mark.kernel
def test_a_compiled_law_answers_as_its_python_to_the_sample_that_the_traces_show(half_hour_day):
    @fc.law(Parameters, Memory)
    def all_fields(now, p, memory):
        seen = now.t / 1e4 + now.T_set / 20 + now.m_a + now.T / 20 + now.e + now.u + now.command + now.mode
        return abs(seen + now.switches / 10 + now.estimate + TABLE[min(max(int(10 * now.u), 0), 9)]) % 1.0, memory

    loop = fc.Loop(law=all_fields, estimator=by_error, noise_std=0.02, gain=1e-3)
    traces = ["T_measured", "u", "command", "mode", "estimate"]
    ds = fc.simulate(loop, half_hour_day, warm_up=0, traces=traces)
    T, u, command, mode, estimate = (ds[n].values.astype(float) for n in traces)
    T_set, m_a = (half_hour_day.series[n][0] for n in ("T_set", "m_a"))
    switches = np.cumsum(np.diff(mode, prepend=-1.0) != 0.0)
    for t in range(30, u.size, 30):
        before = (u[t - 1], command[t - 1], mode[t - 1], float(switches[t - 1]))
        now = Sample(float(t), T_set[t], m_a[t], T[t], T[t] - T_set[t], *before, estimate[t], 0.0)
        assert u[t] == pytest.approx(all_fields(now, None, Memory())[0], abs=1e-9)


@pytest.mark.kernel
def test_u_and_estimate_are_limited_to_0_to_1(half_hour_day):
    @fc.estimator(Parameters, Memory)
    def large(now, p, memory):
        return 5.0, memory

    @fc.law(Parameters, Memory)
    def full(now, p, memory):
        return -3.0 if now.t < 600 else np.inf, memory

    with pytest.warns(UserWarning, match="large: the estimate is at its limit of 1 at the end of 1 of 1 runs: it is a"):
        ds = fc.simulate(fc.Loop(estimator=large, law=full), half_hour_day, warm_up=60, traces=["u", "estimate"])
    assert [float(ds.u.min()), float(ds.u.max()), float(ds.estimate.max())] == [0.0, 1.0, 1.0]
    assert ds.status == 0


@pytest.mark.kernel
@pytest.mark.parametrize("make", [fc.estimator, fc.law])
def test_one_nan_of_a_rule_is_in_the_status_even_if_numbers_follow(half_hour_day, make):
    @make(Parameters, Memory)
    def once(now, p, memory):
        return np.nan if now.t == 600 else 0.1, memory

    kind = once.kind
    ds = fc.simulate(fc.Loop(**{kind: [once, PARAMETERS[kind].choices[0]]}), half_hour_day, warm_up=60)
    assert ds.status.values.tolist() == [1, 0]


@pytest.mark.kernel
def test_a_helper_that_changes_is_compiled_again(half_hour_day):
    scope = {"LEVEL": 0.125}

    def final_estimate(factor):
        exec(
            f"def helper():\n    return LEVEL * {factor}\ndef rule(now, p, memory):\n    return helper(), memory", scope
        )
        rule = fc.estimator(Parameters, Memory)(scope["rule"])
        return float(fc.simulate(fc.Loop(estimator=rule), half_hour_day, warm_up=60).estimate_final), rule

    assert final_estimate(1.0)[0] == 0.125
    estimate, rule = final_estimate(2.0)
    assert estimate == 0.25
    scope["LEVEL"] = 0.25
    assert float(fc.simulate(fc.Loop(estimator=rule), half_hour_day, warm_up=60).estimate_final) == 0.5


@fc.law(Parameters, Memory)
def counting(now, p, memory):
    return memory.calls / 100, Memory(calls=memory.calls + 1)


@pytest.mark.kernel
def test_a_dead_band_holds_the_u_of_a_law_whose_memory_goes_on():
    T_set = np.where(np.arange(1200) < 615, 22.0, 14.0)
    day = fc.Boundary(m_a=1.2, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=T_set)
    u = fc.simulate(fc.Loop(law=counting, error_dead_band=5.0), day, warm_up=0, traces=["u"]).u.values
    assert [u[0], u[629], u[630], u[660]] == [0.0, 0.0, 0.21, 0.22]


@pytest.mark.kernel
def test_where_the_loop_is_off_the_law_begins_again():
    enabled = np.ones(1200)
    enabled[300:615] = 0.0
    day = fc.Boundary(m_a=1.2, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=14.0, enabled=enabled)
    u = fc.simulate(fc.Loop(law=counting), day, warm_up=0, traces=["u"]).u.values
    assert [u[299], u[300], u[629], u[630], u[660]] == [0.09, 0.0, 0.0, 0.0, 0.01]
