"""Bode and Nyquist plots: the curves are L, the marks are the margins."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.refusals import problems

import fastcoil as fc

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def day():
    return fc.constant_day(1.0)


@pytest.fixture(scope="module")
def loops():
    return fc.Loop.preset("lbnl").assign(ti=[10.0, 30.0, 100.0])


@pytest.mark.parametrize("draw", [fc.bode, fc.nyquist])
def test_a_figure_is_readable(draw, loops, day):
    for loop in (loops, fc.Loop(), fc.Loop(backlash=0.0, sample_time=1)):
        figure = draw(loop, day)
        assert_texts_fit(figure)
        assert_palette(figure)


def curves(axes):
    return [line.get_xydata() for line in axes.lines if len(line.get_xydata()) > 1000]


def test_bode_shows_the_margins_of_linearise(loops, day):
    figure = fc.bode(loops, day)
    size, phase = figure.axes
    w = np.array([0.005, 0.02, 0.08])
    linear = fc.linearise(loops, day, frequency=w)
    for k, (sizes, phases) in enumerate(zip(curves(size), curves(phase), strict=True)):
        one = linear.isel(ti=k)
        np.testing.assert_allclose(
            np.exp(np.interp(w, sizes[:, 0], np.log(sizes[:, 1]))), one.loop_magnitude, rtol=1e-3
        )
        np.testing.assert_allclose(np.interp(w, phases[:, 0], phases[:, 1]), one.loop_phase, atol=0.1)
    texts = [text.get_text() for text in size.get_legend().get_texts()]
    assert texts[0] == (
        f"integral time Ti = 10 s: gain margin {float(linear.gain_margin[0]):.2g}, "
        f"phase margin {float(linear.phase_margin[0]):.0f}°"
    )
    marks = [line.get_xydata() for line in size.lines if line.get_marker() == "o"]
    np.testing.assert_allclose([1.0 / mark[0, 1] for mark in marks], linear.gain_margin, rtol=0.01)
    marks = [line.get_xydata() for line in phase.lines if line.get_marker() == "o"]
    np.testing.assert_allclose([mark[0, 1] + 180.0 for mark in marks], linear.phase_margin, atol=0.3)


def test_nyquist_shows_the_gap_only_where_there_is_one(day):
    with_gap, without = (fc.nyquist(fc.Loop(backlash=size), day).axes[0] for size in (0.07, 0.0))
    texts = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in (with_gap, without)]
    assert texts[0][0] == "-1/N of the gap"
    assert texts[0][1].startswith("margin ")
    assert texts[1] == ["L"]


def test_the_dots_of_nyquist_lie_on_both_curves_in_one_direction(loops, day):
    axes = fc.nyquist(loops, day).axes[0]
    (minus_1_over_N,) = (line.get_xydata() for line in axes.lines if line.get_label() == "-1/N of the gap")
    dots = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
    assert len(dots) == 3
    for pair, L in zip(dots, (c for c in curves(axes)), strict=True):
        on_L, on_N = pair @ np.array([1.0, 1.0j])
        assert np.angle(on_L / on_N) == pytest.approx(0.0, abs=1e-9)
        assert np.abs(L @ np.array([1.0, 1.0j]) - on_L).min() < 0.01
        assert np.abs(minus_1_over_N @ np.array([1.0, 1.0j]) - on_N).min() < 0.02


@pytest.mark.parametrize("draw", [fc.bode, fc.nyquist])
def test_more_loops_than_colours_are_refused(draw, day):
    assert problems(draw, fc.Loop(kp=[0.01, 0.02, 0.03, 0.04]), day) == ["4 loops: a figure shows up to 3, select some"]
