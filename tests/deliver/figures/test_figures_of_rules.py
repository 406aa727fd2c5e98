"""A rule's own parameter is an axis like any other, with the unit and the words that the rule declares."""

from __future__ import annotations

import pytest
from helpers.figure_looks import assert_texts_fit
from helpers.rules import by_error

from fastcoil.deliver.figures import study as plots
from fastcoil.loops.dataset import coordinate_attrs

pytestmark = pytest.mark.kernel


@pytest.fixture
def gains(swept):
    """The result of a sweep of the gain of a rule, and of how often the controller samples."""
    ds = swept.isel(day=0, replicate=0, tuning=0).reset_coords(drop=True).rename(backlash="gain", n_volumes="seconds")
    ds = ds.assign_coords(gain=[1e-4, 3e-4, 1e-3], seconds=[4.0, 8.0])
    ds["gain"].attrs = coordinate_attrs("gain", by_error.own)
    ds["seconds"].attrs = {"long_name": "seconds"}
    return ds


def labels(figure):
    return {text.replace("\n", " ") for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())}


def test_it_has_an_axis_with_its_unit_and_what_it_is(gains):
    figure = plots.bands(gains, "gain", metrics=["rmse"])
    assert "gain [K-1 s-1]: how fast it moves" in labels(figure)
    assert_texts_fit(figure)
    assert list(plots.standard_figures(gains)) == ["bands"]


def test_a_legend_and_a_heading_have_its_unit(gains):
    swept = gains.rename(seconds="kp")
    titles = [axes.get_title(loc="left") for axes in plots.bands(swept, "kp", by="gain", metrics=["rmse"]).axes]
    assert titles[-1] == "gain = 0.001 K-1 s-1"
    heading = plots.bands(swept, "kp", metrics=["rmse"]).get_suptitle().replace("\n", " ")
    assert "3 values of gain (0.0001 to 0.001 K-1 s-1)" in heading
    assert "gain [K-1 s-1]: how fast it moves" in labels(plots.maps(swept, "gain", "kp", ["rmse"]))


def test_a_numbered_dim_of_a_user_is_still_no_axis(gains):
    with pytest.raises(ValueError, match="'seconds' is not a swept number"):
        plots.bands(gains, "seconds")
