"""Figures: what they show, and that odd studies get a figure or none, never a crash."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit

import fastcoil as fc
from fastcoil.base.figures import GREY, write
from fastcoil.deliver.figures import study as plots

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def swept():
    loop = fc.Loop().assign(
        backlash=[0.02, 0.05, 0.08], estimate_ratio=[0.0, 0.5, 1.0, 1.5], kp=("tuning", [0.02, 0.03])
    )
    return fc.simulate(loop, fc.paper_day(hours=1))


def test_curves_by_a_second_parameter_have_a_row_each_with_its_median(swept):
    figure = plots.bands(swept, "estimate_ratio", by="backlash", metrics=["rmse"])
    shown = [[line for line in axes.lines if line.get_label().startswith("backlash")] for axes in figure.axes]
    assert [line.get_label() for (line,) in shown] == ["backlash = 2 %", "backlash = 5 %", "backlash = 8 %"]
    assert [axes.get_title(loc="left") for axes in figure.axes] == [line.get_label() for (line,) in shown]
    for (line,), backlash in zip(shown, swept.backlash.values, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), [0, 50, 100, 150])
        np.testing.assert_allclose(line.get_ydata(), swept.rmse.sel(backlash=backlash).median("tuning"))
    for axes in figure.axes:
        low, high = axes.get_ylim()
        assert low == 0.0
        assert all(np.max(line.get_ydata()) < high for line in axes.lines if len(line.get_xdata()) == 4)
    others = [line for line in figure.axes[0].lines if line.get_color() == GREY]
    np.testing.assert_allclose(others[1].get_ydata(), swept.rmse.sel(backlash=0.08).median("tuning"))


def test_a_few_members_are_drawn_one_by_one_and_many_as_a_band(swept):
    (axes,) = plots.bands(swept, "backlash", metrics=["rmse"]).axes
    low, high = (swept.rmse.quantile(q, ["estimate_ratio", "tuning"]) for q in (0.1, 0.9))
    (band,) = axes.collections
    edges = band.get_paths()[0].vertices
    assert edges[:, 1].min() == pytest.approx(float(low.min()))
    assert edges[:, 1].max() == pytest.approx(float(high.max()))
    assert len(axes.lines) == 1
    (axes,) = plots.bands(swept.isel(estimate_ratio=0), "backlash", metrics=["rmse"]).axes
    assert not axes.collections
    *members, median = axes.lines
    for member, tuning in zip(members, (0, 1), strict=True):
        np.testing.assert_array_equal(member.get_ydata(), swept.rmse.isel(estimate_ratio=0, tuning=tuning))
    np.testing.assert_allclose(median.get_ydata(), swept.rmse.isel(estimate_ratio=0).median("tuning"))
    (axes,) = plots.bands(swept.isel(estimate_ratio=0, tuning=0), "backlash", metrics=["rmse"]).axes
    assert len(axes.lines) == 1


def test_alternatives_show_the_median_and_the_range_or_each_of_a_few(swept):
    named = swept.assign_coords(tuning=["slow", "fast"])
    (axes,) = plots.alternatives(named, "tuning", ["rmse"]).axes
    (ranges,) = axes.collections
    low, high = (named.rmse.quantile(q, ["backlash", "estimate_ratio"]) for q in (0.1, 0.9))
    np.testing.assert_allclose([segment[:, 0] for segment in ranges.get_segments()], np.transpose([low, high]))
    np.testing.assert_allclose(axes.lines[-1].get_xdata(), named.rmse.median(["backlash", "estimate_ratio"]))
    assert [label.get_text() for label in axes.get_yticklabels()] == ["slow", "fast"]
    (axes,) = plots.alternatives(named.isel(backlash=[0, 1], estimate_ratio=0), "tuning", ["rmse"]).axes
    assert not axes.collections
    members = [line.get_xdata() for line in axes.lines[:-1]]
    np.testing.assert_array_equal(members, named.rmse.isel(backlash=[0, 1], estimate_ratio=0))


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda ds: plots.maps(ds, "estimate_ratio", "backlash"), "Colour: median of 2 tunings; dotted: estimate ="),
        (
            lambda ds: plots.bands(ds, "backlash"),
            "Line: median of 4 values of estimate / backlash (0 to 150 %, 0 being the plain PI) × 2 tunings = "
            "8 scenarios; band: 10th to 90th percentile",
        ),
        (
            lambda ds: plots.bands(ds, "estimate_ratio", by="backlash"),
            "Line: median of 2 tunings; thin lines: each of these; grey: medians of the other rows; dotted: estimate =",
        ),
        (
            lambda ds: plots.alternatives(ds.isel(backlash=0), "tuning"),
            "Dot: median of 4 values of estimate / backlash (0 to 150 %, 0 being the plain PI); small dots: each",
        ),
        (lambda ds: plots.bands(ds.isel(tuning=0), "estimate_ratio", by="backlash"), "Line: a single scenario; grey:"),
    ],
)
def test_the_heading_says_what_is_pooled_and_what_the_marks_are(swept, draw, words):
    named = swept.assign_coords(tuning=["slow", "fast"]).assign_attrs(title="A question")
    title, *heading = draw(named).get_suptitle().splitlines()
    assert title == "A question"
    assert " ".join(heading).startswith(words)


LONG = "A title that somebody made as long as a question of research may be, with all its conditions and exceptions. "


def test_no_text_leaves_its_figure_or_hides_another(swept):
    metrics = ["learn_time_reached", "rmse", "coil_energy", "water_volume"]
    long = swept.assign_attrs(title=2 * LONG).assign_coords(tuning=["slow", "fast"])
    for figure in (
        plots.maps(long, "estimate_ratio", "backlash", metrics),
        plots.bands(long, "estimate_ratio", "backlash", metrics),
        plots.bands(long, "backlash", None, metrics),
        plots.alternatives(long, "tuning", metrics),
    ):
        assert_texts_fit(figure)
        assert_palette(figure)


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
def test_a_study_gets_the_figures_that_suit_its_dims(loop, names):
    assert set(plots.standard_figures(fc.simulate(loop, fc.paper_day(hours=0.6)))) == names


def test_more_alternatives_than_a_figure_can_name_get_none(swept):
    for n, names in ((100, {"tuning"}), (101, set())):
        many = swept.isel(backlash=0, estimate_ratio=0, tuning=np.zeros(n, dtype=int))
        assert set(plots.standard_figures(many.assign_coords(tuning=[f"tuning {k}" for k in range(n)]))) == names


def test_a_study_in_which_all_failed_still_gets_its_figures(swept, tmp_path):
    failed = (swept * np.nan).assign_coords(tuning=["slow", "fast"])
    figures = {name: draw() for name, draw in plots.standard_figures(failed).items()}
    figures["curves"] = plots.bands(failed, "backlash")
    for figure in figures.values():
        assert "no finite value" in [text.get_text() for text in figure.axes[0].texts]
    write(figures, tmp_path)
    assert (tmp_path / "maps.png").exists()
