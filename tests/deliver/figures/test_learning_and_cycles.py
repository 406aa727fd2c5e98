"""``fc.plot.learning`` and ``fc.plot.limit_cycle``: estimates against the true gap, swings against those predicted."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.refusals import assert_refused

import fastcoil as fc

pytestmark = pytest.mark.kernel
DAY = fc.paper_day(hours=1)


@pytest.fixture(scope="module")
def learning_result():
    loop = fc.Loop(learning_step=[0.0117, 0.02])
    return fc.simulate(loop, fc.paper_day(), traces=["estimate"], trace_interval=30, n_jobs=1)


@pytest.fixture(scope="module")
def swings_and_prediction():
    loop, day = fc.Loop(backlash=[0.0, 0.07]), fc.paper_day(hours=2)
    return fc.simulate(loop, day, traces=["command", "opening"], trace_interval=5, n_jobs=1), fc.limit_cycle(loop, day)


def test_an_estimate_climbs_to_the_true_gap_and_marks_where_it_got_there(learning_result):
    scenario = learning_result.isel(learning_step=0)
    (axes,) = fc.plot.learning(scenario)
    lines = {line.get_label(): line for line in axes.lines}
    np.testing.assert_array_equal(lines["estimate"].get_ydata(), 100 * scenario.estimate)
    assert lines["estimate"].get_drawstyle() == "steps-post"
    np.testing.assert_allclose(lines["true backlash"].get_ydata(), 7.0)
    reached, confirmed = (line for line in axes.lines if line.get_marker() in "os")
    assert reached.get_xdata()[0] == float(scenario.learn_time_reached) / 3600
    assert confirmed.get_xdata()[0] == float(scenario.learn_time_confirmed) / 3600
    assert reached.get_ydata()[0] == pytest.approx(6.99, abs=0.6)
    assert axes.get_ylabel() == "backlash estimate [%]"


def test_the_plane_holds_the_last_swings_between_the_edges_of_the_gap(swings_and_prediction):
    ds, predicted = swings_and_prediction
    scenario = ds.isel(backlash=1)
    (axes,) = fc.plot.limit_cycle(scenario, predicted)
    (loop,) = (line for line in axes.lines if line.get_color() == "#004488")
    command, opening = loop.get_xdata() / 100, loop.get_ydata() / 100
    assert command.size == pytest.approx(4 * float(scenario.hunting_period) / 5, abs=2)
    low, high = (command - 0.07) / 0.93, command / 0.93
    assert (low - 1e-9 <= opening).all()
    assert (opening <= high + 1e-9).all()
    edges = [line.get_ydata()[0] - 100 * command.min() / 0.93 for line in axes.lines if line.get_color() == "black"]
    assert sorted(edges) == [pytest.approx(-7 / 0.93), pytest.approx(0.0, abs=1e-9)]
    heading = axes.get_title(loc="left").replace("\n", " ")
    swing, period = float(scenario.hunting_swing), float(scenario.hunting_period)
    predicted = predicted.isel(backlash=1)
    assert f"simulated ± {swing / 2:.2g} K every {period:.0f} s" in heading
    assert f"predicted ± {float(predicted.amplitude):.2g} K every {float(predicted.period):.0f} s" in heading
    assert f"hunting index {float(predicted.hunting_index):.2g}" in heading


def test_each_of_several_loops_is_compared_with_what_was_predicted_of_it(swings_and_prediction):
    (axes,) = fc.plot.limit_cycle(*swings_and_prediction)
    first, second = axes.get_title(loc="left").replace("\n", " ").split("backlash = 7 %")
    assert "backlash = 0 %: simulated" in first
    assert "predicted no swing" in first
    assert "predicted no swing" not in second
    assert_texts_fit(axes.figure)
    assert_palette(axes.figure)


def test_a_loop_that_failed_has_no_plane(swings_and_prediction):
    ds, _ = swings_and_prediction
    assert [text.get_text() for text in fc.plot.limit_cycle(ds * np.nan)[0].texts] == ["no finite value"]
    half = ds.where(ds.backlash > 0.0)
    assert np.isfinite(fc.plot.limit_cycle(half.assign_attrs(ds.attrs))[0].get_ylim()).all()


@pytest.mark.parametrize(
    ("draw", "field", "code"),
    [
        (lambda ds, _: fc.plot.limit_cycle(ds.drop_vars("command")), "data", "missing"),
        (lambda ds, _: fc.plot.learning(ds), "data", "missing"),
        (lambda ds, _: fc.plot.limit_cycle(ds, ds), "predicted", "missing"),
        (lambda ds, p: fc.plot.limit_cycle(ds, p.assign_coords(backlash=[1, 2])), "predicted", "shape"),
        (lambda ds, _: fc.plot.limit_cycle(ds, fc.limit_cycle(fc.Loop(ti=400.0), DAY)), "predicted", "conflict"),
    ],
    ids=["no command", "no estimate", "no prediction", "other labels", "another loop"],
)
def test_what_is_missing_gets_a_sentence(swings_and_prediction, draw, field, code):
    assert_refused(field, code, draw, *swings_and_prediction)
