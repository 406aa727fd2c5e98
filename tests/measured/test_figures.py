"""The figures of a fit: axes in per cent, colours of the palette, texts that fit, shaded times explained."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.simulated_logs import coil_log, flows, log_of, noisy, walk

import fastcoil as fc

pytestmark = pytest.mark.kernel


def test_a_valve_is_shown_over_commands_in_per_cent():
    rng = np.random.default_rng(1)
    fit = fc.fit_valve(log_of(command := walk(rng), noisy(rng, flows(command), 0.02)))
    figure = fit.plot()
    _, curves, profile = figure.axes
    assert [axes.get_xlabel() for axes in (curves, profile)] == ["command [%]", "backlash [%]"]
    opening, _ = curves.lines
    assert (opening.get_xdata()[0], opening.get_xdata()[-1]) == (0.0, 100.0)
    points = [tuple(row) for dots in curves.collections for row in dots.get_offsets()]
    measured = zip(100 * fit.residuals["command"].values, fit.residuals["m_w"].values, strict=True)
    assert set(points) <= set(measured)
    np.testing.assert_allclose(profile.lines[0].get_xdata(), 100 * fit.profile["backlash"])
    low, high = fit.intervals["backlash"]
    assert profile.get_title() == f"Profile: 95 % interval {100 * low:.3g} to {100 * high:.3g} %"
    assert_palette(figure)
    assert_texts_fit(figure)


def test_a_coil_is_shown_with_the_warm_up_in_grey():
    figure = fc.fit_coil(coil_log(hours=1.5, seed=41)).plot()
    assert figure.get_supxlabel() == "Grey: not compared"
    assert {axes.get_xlabel() for axes in figure.axes} == {"", "time [h]"}
    assert_palette(figure)
    assert_texts_fit(figure)
