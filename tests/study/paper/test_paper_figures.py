"""The paper's figures: colours of the palette, texts that fit, axes in per cent and hours."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit

from fastcoil.base.figures import GREY
from fastcoil.deliver.figures import paper as figures
from fastcoil.loops.netcdf import load

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def drawn(folder, card):
    """All figures, by name."""
    return {
        "fig01": figures.valve_curves(load(folder / "fig01.nc")),
        "fig10": figures.tracking(load(folder / "fig10.nc"), "95 %"),
        "fig11": figures.estimates(load(folder / "fig11.nc")),
        "fig12": figures.staircases(load(folder / "fig12.nc")),
        "scorecard": figures.shares(card),
    }


@pytest.mark.parametrize("name", ["fig01", "fig10", "fig11", "fig12", "scorecard"])
def test_texts_fit_and_colours_are_those_of_the_palette(drawn, name):
    assert_palette(drawn[name])
    assert_texts_fit(drawn[name])


def test_estimates_are_in_per_cent_with_a_line_for_each_of_a_few_days(folder, drawn):
    ds = load(folder / "fig11.nc")
    axes = drawn["fig11"].axes[2]
    assert axes.get_xlabel() == "estimate / backlash [%]"
    assert axes.get_xlim() == (0.0, 150.0)
    values = ds.rmse.isel(preset=0).sel(case="no noise")
    *members, median = axes.lines[:5]
    np.testing.assert_allclose(median.get_xdata(), 100 * ds.estimate_ratio)
    np.testing.assert_allclose(median.get_ydata(), values.median(["day", "replicate"]))
    pooled = values.stack(member=["day", "replicate"]).values.T
    np.testing.assert_array_equal(sorted(tuple(m.get_ydata()) for m in members), sorted(map(tuple, pooled)))


def test_the_plain_pi_is_grey_and_time_is_in_hours(folder, drawn):
    ds = load(folder / "fig10.nc").isel(preset=0)
    plain, inverse, _ = drawn["fig10"].axes[0].lines
    assert plain.get_color() == GREY
    assert inverse.get_label() == "inverse with 95 % of the backlash"
    part = ds.T_sup.sel(case="plain PI", elapsed_time=slice(2.75 * 3600, 4.25 * 3600))
    np.testing.assert_array_equal(plain.get_ydata(), part)
    np.testing.assert_allclose(plain.get_xdata(), part.elapsed_time / 3600)


def test_the_scorecard_shows_every_share_and_its_interval_for_every_kind_of_day(card, drawn):
    (axes,) = drawn["scorecard"].axes
    marks = [line for line in axes.lines if line.get_marker() not in ("None", None, "")]
    spans = [tuple(line.get_xdata()) for line in axes.lines if line not in marks]
    kinds = [kind for claim in card["claims"] for kind in claim["kinds"].values()]
    assert [float(line.get_xdata()[0]) for line in marks] == [100 * kind["share"] for kind in kinds]
    for kind in kinds:
        low, high = kind["share_interval"] or (kind["share"], kind["share"])
        assert (100 * low, 100 * high) in spans
    rows = [round(float(line.get_ydata()[0])) for line in marks]
    assert rows == [row for row, claim in enumerate(card["claims"]) for _ in claim["kinds"]]
    labels = [text.get_text() for text in drawn["scorecard"].legends[0].get_texts()]
    assert labels == [*card["kinds"], "no kind of day"]
    looks = {(line.get_marker(), line.get_color()) for line in marks}
    assert len(looks) == len(labels)


def test_a_line_parts_what_changes_with_the_kind_of_day_from_what_does_not(card, drawn):
    (axes,) = drawn["scorecard"].axes
    (line,) = (one for one in axes.lines if list(one.get_xdata()) == [0, 1] and len(set(one.get_ydata())) == 1)
    assert line.get_ydata()[0] == sum(claim["change"] > 0 for claim in card["claims"]) - 0.5
