"""Figures: what they show, and that odd studies get a figure or none, never a crash."""

from __future__ import annotations

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.plots import study as plots

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def swept():
    loop = fc.Loop().assign(
        backlash=[0.02, 0.05, 0.08], estimate_ratio=[0.0, 0.5, 1.0, 1.5], kp=("tuning", [0.02, 0.03])
    )
    return fc.simulate(loop, fc.paper_day(hours=1))


def test_a_map_shows_the_median_over_the_other_dims(swept):
    figure = plots.maps(swept, "estimate_ratio", "backlash", ["rmse"])
    (mesh,) = figure.axes[0].collections
    expected = swept.rmse.median("tuning").transpose("backlash", "estimate_ratio")
    np.testing.assert_allclose(np.asarray(mesh.get_array()).ravel(), expected.values.ravel())


def test_a_band_shows_the_median_by_value_of_a_second_parameter(swept):
    figure = plots.bands(swept, "estimate_ratio", by="backlash", metrics=["rmse"])
    lines = [line for line in figure.axes[0].lines if line.get_label().startswith("backlash")]
    assert [line.get_label() for line in lines] == ["backlash = 0.02", "backlash = 0.05", "backlash = 0.08"]
    np.testing.assert_allclose(lines[1].get_ydata(), swept.rmse.sel(backlash=0.05).median("tuning"))


def test_an_axis_named_twice_is_refused_once(swept):
    for draw in (plots.maps, plots.bands):
        with pytest.raises(fc.InputError) as caught:
            draw(swept, "backlash", "backlash")
        assert caught.value.problems == ["backlash is named twice: choose two different axes"]


def test_axes_carry_units(swept):
    figure = plots.bands(swept, "backlash", metrics=["rmse", "water_volume"])
    assert [axes.get_ylabel() for axes in figure.axes] == ["RMS control error [K]", "water through the coil [m3]"]


@pytest.mark.parametrize(
    ("loop", "names"),
    [
        (fc.Loop(), set()),
        (fc.Loop(backlash=[0.07]), set()),
        (fc.Loop(kp=[0.02, 0.03]), {"bands"}),
        (fc.Loop(kp=[0.02, 0.03], ti=[8, 30]), {"maps", "bands"}),
        (fc.Loop(air_march=["lagged", "quasistatic"]), {"air_march"}),
    ],
)
def test_a_study_gets_the_figures_that_suit_its_dims(loop, names, tmp_path):
    ds = fc.simulate(loop, fc.paper_day(hours=1))
    figures = plots.standard_figures(ds)
    assert set(figures) == names
    assert len(plots.write(figures, tmp_path)) == len(names)


def test_a_study_in_which_all_failed_still_gets_its_figures(swept, tmp_path):
    with pytest.warns(RuntimeWarning, match="All-NaN"):
        figures = plots.standard_figures(swept * np.nan)
    plots.write(figures, tmp_path)
    assert (tmp_path / "maps.png").exists()
