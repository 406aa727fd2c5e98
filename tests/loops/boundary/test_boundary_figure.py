"""The figure of a boundary: mean and range of its days, a panel for what does something, looks."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit

from fastcoil.loops.boundary.days import paper_day

DAY = paper_day(2.0, 1)
DAYS = paper_day(0.5, range(9))


def panel(figure, label):
    (axes,) = [axes for axes in figure.axes if axes.get_ylabel().replace("\n", " ") == label]
    return axes


def curve(figure, label="air flow [kg/s]", k=0):
    return panel(figure, label).lines[k].get_xydata().T


def test_all_samples_are_averaged_over_hours():
    figure = DAY.plot()
    hours, flow = curve(figure)
    assert figure.axes[-1].get_xlabel() == "time since the start [h]"
    assert (hours[0], hours[-1]) == (0.0, 2.0 - 5 / 3600)
    np.testing.assert_allclose(flow, DAY.series["m_a"].reshape(-1, 5).mean(axis=1), rtol=1e-12)
    _, T_set = curve(figure, "temperature [°C]", 2)
    assert set(T_set) <= set(DAY.series["T_set"][0])
    assert len(figure.axes) == 3


def test_series_that_do_something_have_a_panel():
    figure = DAY.assign(noise=0.1, enabled=(np.arange(7200) > 3600).astype(float), backlash_scale=2.0).plot()
    assert len(figure.axes) == 6
    assert set(curve(figure, "in operation [1]")[1]) <= {0.0, 0.8, 1.0}
    assert (curve(figure, "backlash scale")[1] == 2.0).all()


def test_several_days_are_mean_and_range():
    figure = DAYS.isel([0, 1]).plot()
    pieces = DAYS.series["m_a"][:2].reshape(2, -1, 2)
    np.testing.assert_allclose(curve(figure)[1], pieces.mean(axis=(0, 2)), rtol=1e-12)
    outline = panel(figure, "air flow [kg/s]").collections[0].get_paths()[0].vertices[:, 1]
    assert {*pieces.min(axis=(0, 2)), *pieces.max(axis=(0, 2))} <= set(outline)


@pytest.mark.parametrize("boundary", [DAY, DAYS])
def test_it_looks_as_all_figures_do(boundary):
    figure = boundary.plot()
    assert_texts_fit(figure)
    assert_palette(figure)
