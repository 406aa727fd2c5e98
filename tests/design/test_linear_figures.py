"""The Nyquist plot: the thick curves are L, the thin ones -1/N, the dots the cycles."""

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


def test_a_figure_is_readable(loops, day):
    for loop in (loops, fc.Loop(backlash=0.0)):
        figure = fc.nyquist(loop, day)
        assert_texts_fit(figure)
        assert_palette(figure)


@pytest.mark.filterwarnings("error")
def test_a_set_point_out_of_reach_and_a_gain_of_0_are_drawn_and_named():
    figure = fc.nyquist(fc.Loop.preset("lbnl").assign(kp=[0.0, 0.02]), fc.constant_day(1.0, T_set=2.0))
    words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert len(words) == 2
    assert all("set-point out of reach" in one for one in words)


def curves(axes):
    return [line.get_xydata() for line in axes.lines if len(line.get_xydata()) > 1000]


def complex_of(line):
    return line.get_xydata() @ np.array([1.0, 1.0j])


def test_nyquist_says_what_limit_cycle_predicts_and_its_dots_are_the_cycle_or_lie_on_both_curves(loops, day):
    predicted = fc.limit_cycle(loops, day)
    axes = fc.nyquist(loops, day).axes[0]
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    dots = [complex_of(line) for line in axes.lines if line.get_marker() == "o"]
    thin = [complex_of(line) for line in axes.lines if line.get_label() == "_-1/N"]
    thick = [line @ np.array([1.0, 1.0j]) for line in curves(axes)]
    for k, (text, marked, minus_1_over_N, L) in enumerate(zip(texts, dots, thin, thick, strict=True)):
        one = predicted.isel(ti=k)
        ends = "hunts" if one.hunts > 0 else "does not hunt"
        assert text == f"integral time Ti = {float(one.ti):g} s: margin {float(one.margin):.2g}, {ends}"
        assert np.abs(L - marked[0]).min() < 0.01
        at = 2.0 * np.pi / one.period if one.hunts > 0 else one.frequency
        there = fc.linearise(loops.assign(ti=float(one.ti)), day, frequency=[float(at)])
        assert abs(marked[0]) == pytest.approx(float(there.loop_magnitude.squeeze()), rel=1e-3)
        assert marked.size == (1 if one.hunts > 0 else 2)
        if marked.size == 2:
            assert np.angle(marked[0] / marked[1]) == pytest.approx(0.0, abs=1e-9)
            assert np.abs(minus_1_over_N - marked[1]).min() < 0.02
    assert set(predicted.hunts.values) == {0.0, 1.0}, "both ends of a sentence are tested"


def test_without_a_gap_minus_1_over_N_begins_at_minus_1(day):
    axes = fc.nyquist(fc.Loop(backlash=0.0, sample_time=5, ti=60.0), day).axes[0]
    (minus_1_over_N,) = (complex_of(line) for line in axes.lines if line.get_label() == "_-1/N")
    # the curve of the plant behind N is known at 17 openings only
    assert minus_1_over_N[0] == pytest.approx(-1.0, abs=0.05)


def test_more_loops_than_colours_are_refused(day):
    assert problems(fc.nyquist, fc.Loop(kp=[0.01, 0.02, 0.03, 0.04]), day) == [
        "4 loops: a figure shows up to 3, select some"
    ]
