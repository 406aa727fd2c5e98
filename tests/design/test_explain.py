"""A loop explained: the answer is that of the simulation, the numbers are those of theory, and both are reported."""

import math
import re

import numpy as np
import pytest
from helpers.refusals import assert_mistakes

import fastcoil as fc
from fastcoil.design.explain import explain
from fastcoil.design.limit_cycle import HUNTING_INDEX_LIMIT

pytestmark = pytest.mark.kernel

DAY = fc.paper_day(hours=2)
LBNL = fc.Loop.preset("lbnl").assign(noise_std=0.02)


@pytest.fixture(scope="module")
def hunting():
    return explain(LBNL.assign(kp=0.03, ti=10.0), DAY, seed=3)


@pytest.fixture(scope="module")
def quiet():
    return explain(LBNL, DAY)


def table_rows(explanation):
    """Name of a cure → its row of the table."""
    return {name: next(line for line in explanation.text.splitlines() if line.startswith(words)) for name, words in
            zip(explanation.cures["cure"].values, explanation.cures["words"].values, strict=True)}  # fmt: skip


def test_the_loop_as_it_is_and_with_a_cure_is_what_simulate_gives(hunting):
    now = fc.simulate(LBNL.assign(kp=0.03, ti=10.0), DAY, seed=3, n_jobs=1)
    for name in ("rmse", "hunting_swing", "motor_travel"):
        assert float(hunting.cures[name][0]) == float(now[name])
    longer = hunting.cures.sel(cure="longer_ti")
    then = fc.simulate(LBNL.assign(kp=0.03, ti=float(longer["ti"])), DAY, seed=3, n_jobs=1)
    assert float(longer["rmse"]) == float(then["rmse"])
    change, travel = float(then["rmse"] / now["rmse"]) - 1.0, float(then["motor_travel"] / now["motor_travel"])
    row = table_rows(hunting)["longer_ti"]
    assert f"{100 * change:+.0f} %" in row
    assert f"× {travel:.2g}" in row
    assert row.endswith("cures it")


def test_a_loop_that_hunts_says_so_first_with_size_and_period_and_what_to_change(hunting):
    swing, period = float(hunting.cures["hunting_swing"][0]), float(hunting.cures["hunting_period"][0])
    first, why = hunting.text.splitlines()[:2]
    assert first == f"This loop hunts: ± {swing / 2:.2g} K every {period / 60:.2g} min."
    ti = float(hunting.cures.sel(cure="longer_ti")["ti"])
    index = f"hunting index {hunting.hunting_index:.2g};"
    assert f"ti = 10 s, while with this kp the loop needs about {ti:g} s ({index}" in why
    assert str(hunting) == hunting.text
    assert hunting.hunts
    assert hunting.predicted
    assert hunting.why == why
    assert 0.5 < 2.0 * hunting.amplitude / float(hunting.cures["settled_range"][0]) < 2.0
    assert 0.7 < hunting.period / period < 1.4


def test_every_tuning_proposed_has_a_hunting_index_of_0_7_and_is_no_more_cautious_than_it_has_to_be(hunting):
    for name, least in (("lower_kp", 0.62), ("longer_ti", 0.55)):
        assert least < float(hunting.cures.sel(cure=name)["hunting_index"]) <= 0.7 + 1e-3
        assert float(hunting.cures.sel(cure=name)["hunts"]) == 0.0
    assert hunting.recommended in ("lower_kp", "longer_ti", "simc")


def test_the_hunting_index_quoted_is_the_worst_of_the_day_and_the_span_is_reported(hunting):
    index = hunting.points["hunting_index"].values
    assert hunting.hunting_index == index.max()
    assert hunting.points["T_set"].values.tolist() == [13.0, 15.0, 14.0]
    assert f"the hunting index goes from {index.min():.2g} to {index.max():.2g}" in hunting.text
    assert float(hunting.phase.sum()) == pytest.approx(180.0)


def test_a_loop_that_does_not_hunt_reports_how_far_it_is(quiet):
    assert not quiet.hunts
    assert quiet.predicted is False
    assert quiet.text.startswith("This loop does not hunt.")
    factor = float(re.search(r"this one would with ([\d.]+) times this kp", quiet.why)[1])
    assert explain(LBNL.assign(kp=0.018 * factor), DAY).hunting_index == pytest.approx(HUNTING_INDEX_LIMIT, rel=0.03)
    assert math.isnan(quiet.period)


@pytest.mark.filterwarnings("ignore:T_set is 3 degC at best")
def test_where_theory_cannot_tell_it_says_why_and_the_simulation_answers():
    explanation = explain(LBNL.assign(estimator="gradient"), DAY)
    assert explanation.predicted is None
    assert math.isnan(explanation.hunting_index)
    assert "theory cannot tell, since an estimator changes the estimate as it goes." in explanation.why
    assert explanation.points is None
    (day,) = explanation.plot().axes
    assert day.lines[0].get_label() == "as it is"
    assert "a neutral_zone makes small cycles" in explain(LBNL.assign(neutral_zone=0.02), DAY).why
    hot = fc.Boundary(**{n: v[0] for n, v in DAY.series.items() if n != "T_set"}, T_set=3.0)
    assert "the valve is at its end all the time" in explain(LBNL, hot).why


def test_a_swing_that_only_a_slow_motor_keeps_up_is_not_blamed_on_gains_that_are_low_enough():
    slow = LBNL.assign(stroke_time=600.0, backlash=0.15, kp=0.009, ti=6.2)
    explanation = explain(slow, fc.constant_day(8), warm_up=7200)
    assert explanation.hunts
    assert explanation.predicted
    assert explanation.hunting_index < HUNTING_INDEX_LIMIT
    assert explanation.why.startswith("Why: the motor is too slow, with 600 s for a full stroke: ")
    assert "Any backlash triggers it" not in explanation.text


def test_a_hunting_index_that_is_too_large_is_never_reported_as_room_for_a_larger_kp():
    loop = LBNL.assign(kp=0.54, ti=2.58, sample_time=300, stroke_time=300.0, n_volumes=1, backlash=0.0)
    explanation = explain(loop.assign(authority=0.01, rangeability=50.0, m_full=1.6), DAY)
    assert explanation.hunting_index > 100.0
    assert "times this kp" not in explanation.why
    assert "theory predicts no swing large enough to count" in explanation.why


def test_a_day_on_which_nothing_moves_is_reported_without_a_number_that_there_is_not():
    text = explain(LBNL.assign(noise_std=0.0, error_dead_band=0.2), fc.constant_day(2), warm_up=3000).text
    assert "nan" not in text
    assert "e-0" not in text


def test_what_the_hunting_index_leaves_out_is_said():
    explanation = explain(LBNL.assign(error_dead_band=0.3), DAY)
    assert "Not in the hunting index: the error dead band of 0.3 K, which may hold a loop still" in explanation.text
    assert "dead_band" not in explanation.cures["cure"].values


def test_it_says_where_the_converged_march_turns_the_verdict_round_and_only_there():
    loop, day = fc.Loop.preset("paper_like_fast").assign(kp=0.03), fc.constant_day(hours=3)
    explanation = explain(loop, day)
    as_printed, converged = (fc.simulate(loop.assign(air_march=march), day) for march in ("lagged", "quasistatic"))
    assert (float(as_printed.hunts), float(converged.hunts)) == (1.0, 0.0)
    assert explanation.hunts
    assert "as it is, it does not hunt" in explanation.contradiction
    assert explanation.text.splitlines()[0] == explanation.answer
    assert explanation.answer.endswith(explanation.contradiction)
    assert not explain(loop.assign(converged=True), day).contradiction
    assert not explain(loop.assign(kp=0.002), day).contradiction


def test_a_sweep_several_days_and_a_second_beyond_the_end_are_refused_together():
    mistakes = [("loop", "shape"), ("boundary", "shape"), ("at", "value")]
    assert_mistakes(mistakes, explain, LBNL.assign(kp=[0.01, 0.02]), fc.paper_day(hours=1, seed=[1, 2]), at=3600)


def test_the_figure_marks_loop_and_cures_on_the_map_and_draws_both_days(hunting):
    gains, day = hunting.plot().axes
    assert (day.get_xlabel(), gains.get_xlabel()) == ("time from the start [h]", "integral time Ti [s]")
    marks = {line.get_label(): line.get_xydata() for line in gains.lines}
    assert marks["as it is"].tolist() == [[10.0, 0.03]]
    assert marks["longer ti"][0, 0] == float(hunting.cures.sel(cure="longer_ti")["ti"])
    edge = next(line for line in gains.lines if line.get_color() == "black" and line.get_linestyle() == "-")
    limit = np.interp(10.0, edge.get_xdata(), edge.get_ydata())
    assert limit == pytest.approx(0.03 * HUNTING_INDEX_LIMIT / hunting.hunting_index, rel=0.02)
    assert not np.array_equal(day.lines[0].get_ydata(), day.lines[1].get_ydata())
    names = [line.get_label() for line in day.lines]
    assert names == ["as it is", str(hunting.cures.sel(cure=hunting.recommended)["words"].item()), "set-point"]
