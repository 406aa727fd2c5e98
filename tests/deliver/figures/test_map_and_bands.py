"""``fc.plot.map`` and ``fc.plot.bands``: medians and bands of what they pool, in per cent where it is a share."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.results import make_result
from matplotlib.colors import to_hex

import fastcoil as fc
from fastcoil.base.figures import COLOURS


@pytest.fixture(scope="module")
def ds():
    rng = np.random.default_rng(1)
    coords = {"backlash": [0.02, 0.05, 0.08, 0.11], "estimate_ratio": [0.0, 0.5, 1.0, 1.5]}
    metrics = {name: rng.random((6, 4, 4)) for name in ("rmse", "share_off")}
    return make_result(("day", "backlash", "estimate_ratio"), coords, **metrics)


def test_a_map_has_the_median_in_every_cell(ds):
    (axes,) = fc.plot.map(ds)
    expected = ds.rmse.median("day").transpose("backlash", "estimate_ratio").values
    np.testing.assert_allclose(np.asarray(axes.collections[0].get_array()).reshape(4, 4), expected)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("estimate / backlash [%]", "backlash [%]")
    assert axes.figure.axes[-1].get_ylabel() == "RMS error [K]"
    assert "median of 6 days" in axes.get_title(loc="left").replace("\n", " ")


def test_a_share_and_a_change_against_a_baseline_are_shown_in_per_cent(ds):
    (axes,) = fc.plot.map(ds.share_off, x="backlash", y="estimate_ratio")
    assert axes.figure.axes[-1].get_ylabel().replace("\n", " ") == "share of time with |e| > 0.5 K [%]"
    assert axes.collections[0].get_array().max() == pytest.approx(100 * float(ds.share_off.median("day").max()))
    change = fc.compare(ds, baseline={"estimate_ratio": 0.0}, over="day", metrics=["rmse"], relative=True)
    (axes,) = fc.plot.map(change.rmse.sel(statistic="median"))
    assert axes.figure.axes[-1].get_ylabel().replace("\n", " ") == "change of RMS error [%]"


def test_up_to_three_labels_have_a_curve_each_and_the_heading_says_what_is_left_out(ds):
    (axes,) = fc.plot.bands(ds, x="estimate_ratio", by="backlash")
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["backlash = 2 %", "backlash = 8 %", "backlash = 11 %"]
    curves = axes.lines[1::2]  # each has a line at 0 before it
    for line, backlash, colour in zip(curves, [0.02, 0.08, 0.11], COLOURS, strict=True):
        np.testing.assert_allclose(line.get_ydata(), ds.rmse.sel(backlash=backlash).median("day"))
        np.testing.assert_allclose(line.get_xdata(), [0, 50, 100, 150])
        assert to_hex(line.get_color()) == to_hex(colour)
    assert len({line.get_linestyle() for line in curves}) == len(axes.collections) == 3
    assert axes.get_ylabel() == "RMS error [K]"
    assert "; shown are 3 of 4 values of backlash" in axes.get_title(loc="left").replace("\n", " ")


def test_what_failed_is_told(ds):
    failed = ds.where(ds.backlash > 0.03).assign(status=ds.status.where(ds.backlash > 0.03, 2))
    heading = fc.plot.map(failed)[0].get_title(loc="left").replace("\n", " ")
    assert heading.endswith("without 24 that failed of the 96 scenarios drawn")
    heading = fc.plot.map(failed.assign(status=failed.status.where(failed.status == 0, 3)))[0].get_title(loc="left")
    assert "24 that are not run yet of the 96" in heading.replace("\n", " ")


def test_days_that_are_not_run_are_not_counted_as_pooled(ds):
    unfinished = ds.where(ds.day < 3).assign(status=ds.status.where(ds.day < 3, 3))
    heading = fc.plot.map(unfinished)[0].get_title(loc="left").replace("\n", " ")
    assert "median of 3 of 6 days; " in heading
    assert "without 48 that are not run yet of the 96 scenarios drawn" in heading
    nothing = (ds * np.nan).assign(status=ds.status)
    assert "no finite value" in [text.get_text() for text in fc.plot.map(nothing)[0].texts]
    assert "no finite value" in [text.get_text() for text in fc.plot.bands(nothing, x="backlash")[0].texts]


@pytest.mark.parametrize(
    ("draw", "field", "code"),
    [
        (lambda ds: fc.plot.map(ds, "rms"), "metric", "name"),
        (lambda ds: fc.plot.map(ds, x="backlas"), "x", "name"),
        (lambda ds: fc.plot.map(ds, x="backlash", y="backlash"), "backlash", "duplicate"),
        (lambda ds: fc.plot.map(ds.isel(backlash=0)), "y", "missing"),
        (fc.plot.bands, "x", "missing"),
        (lambda ds: fc.plot.bands(ds, x="backlash", by="dya"), "by", "choice"),
        (lambda ds: fc.plot.map(ds.rmse.assign_coords(backlash=ds.backlash.assign_attrs(units="%"))), "ds.backlash",
         "unit"),
        (lambda ds: fc.plot.bands(ds.rmse, "iae"), "metric", "conflict"),
        (lambda _: fc.plot.bands("ds"), "data", "type"),
    ],
    ids=["metric", "x", "twice", "one axis", "two axes", "by", "unit", "variable", "text"],
)  # fmt: skip
def test_what_cannot_be_drawn_gets_a_sentence(ds, draw, field, code):
    assert_refused(field, code, draw, ds)
