"""Figures of a given width: whole, legible, and with plain PI and inverse apart."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.results import drawn, result

from fastcoil.base.errors import InputError
from fastcoil.deliver.figures import study as plots
from fastcoil.deliver.figures.study import control_dims
from fastcoil.study.analysis.paired import relative_to
from fastcoil.study.analysis.selected import binned

SHAPE = (2, 2, 3, 6)


@pytest.fixture(scope="module")
def swept():
    """Named tunings, backlashes and estimates on six days."""
    rng = np.random.default_rng(1)
    metrics = {name: rng.random(SHAPE) for name in plots.STANDARD_METRICS}
    coords = {"tuning": ["as_found", "faster"], "backlash": [0.02, 0.07], "estimate_ratio": [0.0, 0.5, 1.0]}
    dims = ("tuning", "backlash", "estimate_ratio", "day")
    return result(dims, coords, {"title": "Which estimate suits the valves of a building?"}, **metrics)


@pytest.mark.parametrize(
    ("millimetres", "relative"),
    [
        (84, True),
        (174, False),
        pytest.param(84, False, marks=pytest.mark.full),
        pytest.param(174, True, marks=pytest.mark.full),
    ],
)
def test_the_standard_figures_are_as_wide_as_asked_and_nothing_is_clipped(swept, millimetres, relative):
    ds = relative_to(swept, {"estimate_ratio": 0}, "estimate / backlash = 0 %") if relative else swept
    for draw in plots.standard_figures(ds, millimetres / 25.4).values():
        figure = draw()
        assert figure.get_figwidth() * 25.4 == pytest.approx(millimetres)
        assert_texts_fit(figure)
        assert_palette(figure)
        assert {text.get_fontsize() for axes in figure.axes for text in (axes.title, axes.xaxis.label)} == {9.0}


def test_a_narrow_figure_has_its_panels_one_above_the_other(swept):
    figure = plots.maps(swept, "estimate_ratio", "backlash", width=84 / 25.4)
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    assert len({axes.get_subplotspec().colspan.start for axes in panels}) == 1
    with pytest.raises(InputError, match="a figure of 84 mm takes 1 panel abreast, not one for each of 3 metrics"):
        plots.bands(swept, "estimate_ratio", by="backlash", width=84 / 25.4)


@pytest.mark.parametrize(
    ("dim", "values", "is_control"),
    [
        ("estimate_ratio", {"estimate_ratio": [0.0, 1.0]}, True),
        ("estimate_ratio", {"estimate_ratio": [0.5, 1.0]}, False),
        ("remedy", {"backlash_estimate": [0.0, 0.05]}, True),
        ("remedy", {"backlash_estimate": [0.0, 0.0], "learning_step": [0, 0.01]}, True),
        ("remedy", {"estimator": ["none", "hagglund"]}, True),
        ("remedy", {"ti": [8.0, 30.0]}, False),
        ("controller", {}, True),
        ("sample", {"estimate_ratio": [0.0, 1.0]}, False),
    ],
)
def test_a_plain_pi_among_others_is_seen_by_what_differs(dim, values, is_control):
    coords = {name: (dim, of) for name, of in values.items()}
    assert control_dims(result((dim, "kp"), coords, rmse=np.ones((2, 2)))) == [dim] * is_control


def test_the_standard_figures_never_pool_a_plain_pi_with_others(swept):
    three = swept.rename(day="kp")
    for draw in plots.standard_figures(three).values():
        assert "0 being the plain PI" not in draw().get_suptitle()
    tuning = plots.standard_figures(swept)["tuning"]()
    titles = [axes.get_title(loc="left") for axes in tuning.axes]
    assert titles[::3] == [
        "estimate / backlash = 0 %, plain PI",
        "estimate / backlash = 50 %",
        "estimate / backlash = 100 %",
    ]
    dots = tuning.axes[0].lines[-1].get_xdata()
    np.testing.assert_allclose(dots, swept.rmse.sel(estimate_ratio=0.0).median(["backlash", "day"]))


def test_named_controllers_have_rows_and_maps_of_rows_one_scale():
    rng = np.random.default_rng(2)
    ds = result(("controller", "kp", "ti", "day"), {"controller": ["pi", "inverse"]}, rmse=rng.random((2, 3, 3, 5)))
    ds["rmse"] = ds.rmse * ds.rmse.controller.copy(data=[1.0, 3.0])
    figures = plots.standard_figures(ds)
    meshes = [axes.collections[0] for axes in figures["maps"]().axes if axes.get_xlabel()]
    assert len(meshes) == 2
    medians = ds.rmse.median("day")
    assert meshes[0].get_clim() == meshes[1].get_clim() == (float(medians.min()), float(medians.max()))
    bands = figures["bands"]()
    assert [axes.get_title(loc="left") for axes in bands.axes] == ["pi", "inverse"]
    np.testing.assert_allclose(bands.axes[1].lines[-1].get_ydata(), ds.rmse[1].median(["kp", "day"]))


def test_a_drawn_parameter_is_drawn_with_the_scatter_in_each_group():
    ds = drawn(80)
    figure = plots.bands(binned(ds, ["kp"]), "kp", metrics=["rmse"])
    (axes,) = figure.axes
    groups = np.array_split(np.argsort(ds.kp.values), 8)
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), [np.median(ds.rmse.values[:, g]) for g in groups])
    edges = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert edges.min() == pytest.approx(min(np.quantile(ds.rmse.values[:, g], 0.1) for g in groups))
    heading = " ".join(figure.get_suptitle().split())
    assert heading == (
        "Line: median of 2 days × 10 samples in each of 8 groups of proportional gain Kp; band: 10th to 90th percentile"
    )


def test_empty_places_of_groups_count_neither_as_failed_nor_as_scenarios():
    ds = drawn(101)
    ds.status[0, 3] = 1
    heading = " ".join(plots.maps(binned(ds, ["kp", "ti"]), "kp", "ti", ["rmse"]).get_suptitle().split())
    assert heading.endswith("; without 1 of 202 scenarios, which failed")


def test_changes_are_in_per_cent_around_a_line_at_0(swept):
    against = relative_to(swept, {"estimate_ratio": 0}, "the plain PI")
    (axes,) = plots.bands(against, "backlash", metrics=["switch_frequency"]).axes
    assert axes.get_ylabel() == "change of mode switches per\n10 min [%]"
    assert any(list(line.get_ydata()) == [0.0, 0.0] for line in axes.lines)
    median = 100 * against.switch_frequency.median(["tuning", "estimate_ratio", "day"])
    assert any(np.allclose(line.get_ydata(), median) for line in axes.lines if len(line.get_ydata()) == 2)


def test_rows_that_there_cannot_be_are_refused(swept):
    with pytest.raises(InputError, match="by = 'tunin' is no dimension of this result, did you mean 'tuning'"):
        plots.bands(swept, "backlash", by="tunin")
    with pytest.raises(InputError, match="backlash is named twice"):
        plots.bands(swept, "backlash", by="backlash")


def test_of_many_controllers_the_first_the_middle_and_the_last_have_rows():
    names = [f"rule {k}" for k in range(9)]
    ds = result(("controller", "kp", "day"), {"controller": names}, rmse=np.random.default_rng(3).random((9, 3, 5)))
    titles = [axes.get_title(loc="left") for axes in plots.standard_figures(ds)["bands"]().axes]
    assert titles == ["rule 0", "rule 4", "rule 8"]
