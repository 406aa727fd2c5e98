"""The Nyquist plot: the thick curves are L, the thin ones -1/N, the dots the cycles."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit

import fastcoil as fc

pytestmark = pytest.mark.kernel

DAY = fc.constant_day(1.0)
LOOPS = fc.Loop.preset("lbnl").assign(ti=[8.0, 30.0, 100.0])


def test_a_figure_is_readable():
    for loop in (LOOPS, fc.Loop(backlash=0.0)):
        figure = fc.nyquist(loop, DAY)
        assert_texts_fit(figure)
        assert_palette(figure)


def complex_of(line):
    return line.get_xydata() @ np.array([1.0, 1.0j])


def test_nyquist_says_what_limit_cycle_predicts_and_its_dots_are_the_cycle_or_lie_on_both_curves():
    predicted = fc.limit_cycle(LOOPS, DAY)
    axes = fc.nyquist(LOOPS, DAY).axes[0]
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    dots = [complex_of(line) for line in axes.lines if line.get_marker() == "o"]
    thin = [complex_of(line) for line in axes.lines if line.get_label() == "_-1/N"]
    thick = [complex_of(line) for line in axes.lines if len(line.get_xydata()) > 1000]
    for k, (text, marked, minus_1_over_N, L) in enumerate(zip(texts, dots, thin, thick, strict=True)):
        cycle = predicted.isel(ti=k)
        ends = "hunts" if cycle.hunts > 0 else "does not hunt"
        index = f"hunting index {float(cycle.hunting_index):.2g}"
        assert text == f"integral time Ti = {float(cycle.ti):g} s: {index}, {ends}"
        assert np.abs(L - marked[0]).min() < 0.01
        at = 2.0 * np.pi / cycle.period if cycle.hunts > 0 else cycle.frequency
        linear = fc.linearise(LOOPS.assign(ti=float(cycle.ti)), DAY, frequency=[float(at)])
        assert abs(marked[0]) == pytest.approx(float(linear.loop_magnitude.squeeze()), rel=1e-3)
        assert marked.size == (1 if cycle.hunts > 0 else 2)
        if marked.size == 2:
            assert np.angle(marked[0] / marked[1]) == pytest.approx(0.0, abs=1e-9)
            assert np.abs(minus_1_over_N - marked[1]).min() < 0.02 * abs(marked[1])
    assert set(predicted.hunts.values) == {0.0, 1.0}, "both ends of a sentence are tested"
