"""``fc.plot.map`` and ``fc.plot.bands``: medians and bands of what they pool, in per cent where it is a share."""

import numpy as np
import pytest
import xarray as xr
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.rules import by_error
from matplotlib.colors import to_hex

import fastcoil as fc
from fastcoil.base.figures import COLOURS
from fastcoil.deliver.figures import study as plots
from fastcoil.loops.scenarios import coordinate_attrs

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def ds():
    loop = fc.Loop(backlash=[0.02, 0.05, 0.08, 0.11], estimate_ratio=[0.0, 0.5, 1.0, 1.5])
    return fc.simulate(loop, fc.paper_day(hours=1, seed=range(6)), n_jobs=1)


def test_a_map_has_the_median_in_every_cell_and_writes_it_there(ds):
    axes = fc.plot.map(ds)
    expected = ds.rmse.median("day").transpose("backlash", "estimate_ratio").values
    np.testing.assert_allclose(np.asarray(axes.collections[0].get_array()).reshape(4, 4), expected)
    assert [text.get_text() for text in axes.texts] == [f"{value:.2g}" for value in expected.ravel()]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("estimate / backlash [%]", "backlash [%]")
    scale = axes.figure.axes[-1]
    assert scale.get_ylabel() == "RMS error [K]"
    assert "median of 6 days" in axes.get_title(loc="left").replace("\n", " ")


def test_the_letters_of_a_cell_stand_out_from_its_colour(ds):
    axes = fc.plot.map(ds)
    mesh = axes.collections[0]
    for text, colour in zip(axes.texts, mesh.cmap(mesh.norm(mesh.get_array().ravel())), strict=True):
        light = float(np.array([0.2126, 0.7152, 0.0722]) @ colour[:3] ** 2.2)
        ratio = (1.05 / (light + 0.05)) if text.get_color() == "white" else ((light + 0.05) / 0.05)
        assert ratio >= 4.0


def test_a_share_and_a_change_against_a_baseline_are_shown_in_per_cent(ds):
    axes = fc.plot.map(ds.share_off, x="backlash", y="estimate_ratio")
    assert axes.figure.axes[-1].get_ylabel().replace("\n", " ") == "share of time with |e| > 0.5 K [%]"
    largest = 100 * float(ds.share_off.median("day").max())
    assert np.asarray(axes.collections[0].get_array()).max() == pytest.approx(largest)
    change = fc.compare(ds, baseline={"estimate_ratio": 0.0}, over="day", metrics=["rmse"], relative=True)
    axes = fc.plot.map(change.rmse.sel(statistic="median"))
    assert axes.figure.axes[-1].get_ylabel().replace("\n", " ") == "change of RMS error [%]"


def test_a_fine_map_has_no_numbers(ds):
    fine = ds.interp(backlash=np.linspace(0.02, 0.11, 12), estimate_ratio=np.linspace(0, 1.5, 12))
    fine["status"] = fine.status.fillna(0).astype(np.int8)
    assert not fc.plot.map(fine).texts


def test_bands_have_the_median_and_the_tenth_to_ninetieth_percentile_of_each_curve(ds):
    axes = fc.plot.bands(ds, x="estimate_ratio", by="backlash")
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["backlash = 2 %", "backlash = 8 %", "backlash = 11 %"]
    for line, band, backlash, colour in zip(axes.lines, axes.collections, [0.02, 0.08, 0.11], COLOURS, strict=False):
        part = ds.rmse.sel(backlash=backlash)
        np.testing.assert_allclose(line.get_ydata(), part.median("day"))
        np.testing.assert_allclose(line.get_xdata(), [0, 50, 100, 150])
        low, high = part.quantile([0.1, 0.9], "day")
        edges = band.get_paths()[0].vertices[:, 1]
        assert edges.min() == pytest.approx(float(low.min()))
        assert edges.max() == pytest.approx(float(high.max()))
        assert to_hex(line.get_color()) == to_hex(colour)
    assert len({line.get_linestyle() for line in axes.lines[:3]}) == 3
    assert axes.get_ylabel() == "RMS error [K]"


def test_of_many_estimates_the_exact_one_has_a_curve_and_the_heading_says_what_is_left_out(ds):
    many = xr.concat([ds.isel(estimate_ratio=k, drop=True) for k in (0, 1, 1, 1, 2, 2, 3)], "estimate_ratio")
    many = many.assign_coords(estimate_ratio=[0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5])
    axes = fc.plot.bands(many, x="backlash", by="estimate_ratio")
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == [f"estimate / backlash = {n} %" for n in (0, 100, 150)]
    assert "; shown are 3 of 7 values of estimate / backlash" in axes.get_title(loc="left").replace("\n", " ")
    figure = plots.bands(many, "backlash", by="estimate_ratio", metrics=["rmse"])
    assert "shown are 3 of 7 values of estimate" in figure.get_suptitle().replace("\n", " ")
    assert figure.axes[1].get_title(loc="left") == "estimate / backlash = 100 %"
    five = plots.bands(many.isel(estimate_ratio=slice(5)), "backlash", by="estimate_ratio", metrics=["rmse"])
    assert len(five.axes) == 5


def test_one_swept_number_needs_no_name_and_names_make_curves_too(ds):
    axes = fc.plot.bands(ds.isel(estimate_ratio=0), "share_off")
    found = (axes.get_xlabel(), axes.get_ylabel().replace("\n", " "))
    assert found == ("backlash [%]", "share of time with |e| > 0.5 K [%]")
    named = ds.isel(backlash=[0, 1]).rename(backlash="tuning").assign_coords(tuning=["slow", "fast"])
    axes = fc.plot.bands(named, by="tuning")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["slow", "fast"]


def test_what_failed_is_told(ds):
    failed = ds.where(ds.backlash > 0.03).assign(status=ds.status.where(ds.backlash > 0.03, 2))
    heading = fc.plot.map(failed).get_title(loc="left").replace("\n", " ")
    assert heading.endswith("without 24 of 96 scenarios, which failed")
    nothing = (ds * np.nan).assign(status=ds.status)
    assert "no finite value" in [text.get_text() for text in fc.plot.map(nothing).texts]
    assert "no finite value" in [text.get_text() for text in fc.plot.bands(nothing, x="backlash").texts]


def test_figures_of_their_own_are_a_column_wide_legible_and_of_our_colours(ds):
    for axes in (fc.plot.map(ds, "share_off"), fc.plot.bands(ds, x="backlash", by="estimate_ratio")):
        assert axes.figure.get_figwidth() == 3.5
        axes.figure.canvas.draw()
        for text in axes.texts:
            text.remove()  # numbers of a map, which the test of texts does not see as words
        assert_texts_fit(axes.figure)
    assert_palette(axes.figure)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda ds: fc.plot.map(ds, "rms"), "metric = 'rms' is none of this result, did you mean 'rmse'?"),
        (lambda ds: fc.plot.map(ds, x="backlas"), "x = 'backlas' is not a swept number of this result, did you mean "
         "'backlash'?; it has backlash, estimate_ratio"),
        (lambda ds: fc.plot.map(ds, x="backlash", y="backlash"), "backlash is named twice: choose two different axes"),
        (lambda ds: fc.plot.map(ds.isel(backlash=0)), "this result sweeps estimate_ratio: a figure needs 2 swept "
         "numbers"),
        (fc.plot.bands, "this result sweeps backlash, estimate_ratio: say which is x"),
        (lambda ds: fc.plot.bands(ds, x="backlash", by="dya"), "by = 'dya' is no dimension of this result, did you "
         "mean 'day'?; it has "),
        (lambda ds: fc.plot.bands(ds.rmse, "iae"), "metric = 'iae': leave it out, data is one variable already"),
        (lambda ds: fc.plot.bands("ds"), "data is a str: give a Dataset of fastcoil.simulate or open_study, or one of "
         "its variables"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_gets_a_sentence(ds, call, sentence):
    with pytest.raises(fc.InputError) as caught:
        call(ds)
    (found,) = caught.value.problems
    assert found.startswith(sentence)


def test_a_parameter_of_a_rule_has_its_unit_and_what_it_is_and_a_numbered_dim_is_no_axis(ds):
    gains = ds.isel(backlash=[0, 1, 2], estimate_ratio=[0, 1]).rename(backlash="gain", estimate_ratio="seconds")
    gains = gains.assign_coords(gain=[1e-4, 3e-4, 1e-3], seconds=[4.0, 8.0])
    gains["gain"].attrs = coordinate_attrs("gain", by_error.own)
    gains["seconds"].attrs = {"long_name": "seconds"}
    figure = plots.bands(gains, "gain", metrics=["rmse"])
    assert figure.axes[0].get_xlabel() == "gain [K-1 s-1]: how fast it moves"
    assert_texts_fit(figure)
    assert list(plots.standard_figures(gains)) == ["bands"]
    with pytest.raises(fc.InputError, match="'seconds' is not a swept number"):
        plots.bands(gains, "seconds")
    swept = gains.rename(seconds="kp")
    titles = [axes.get_title(loc="left") for axes in plots.bands(swept, "kp", by="gain", metrics=["rmse"]).axes]
    assert titles[-1] == "gain = 0.001 K-1 s-1"
    heading = plots.bands(swept, "kp", metrics=["rmse"]).get_suptitle().replace("\n", " ")
    assert "3 values of gain (0.0001 to 0.001 K-1 s-1)" in heading
