"""Figures of a study: what they show, at any width, with plain PI and inverse apart; odd studies never crash them."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.full import full_except
from helpers.refusals import assert_refused
from helpers.results import drawn_result, make_result

import fastcoil as fc
from fastcoil.deliver.figures import swept as plots
from fastcoil.deliver.figures.swept import control_dims
from fastcoil.study.analysis.selected import group_by_parameters

SHAPE = (2, 3, 4, 6)
LONG_TITLE = "A title as long as a question of research may be, with all its conditions and exceptions. "


@pytest.fixture(scope="module")
def study():
    """Named tunings, backlashes and estimates on six days."""
    rng = np.random.default_rng(1)
    metrics = {name: rng.random(SHAPE) for name in (*plots.STANDARD_METRICS, "water_volume")}
    coords = {"tuning": ["slow", "fast"], "backlash": [0.02, 0.05, 0.08], "estimate_ratio": [0.0, 0.5, 1.0, 1.5]}
    return make_result(("tuning", "backlash", "estimate_ratio", "day"), coords, {"title": "A question"}, **metrics)


def test_curves_by_a_second_parameter_have_a_row_each_at_the_recommended_choice(study):
    """The tuning is neither drawn nor pooled; the best and the worst one are drawn too."""
    figure = plots.draw_panels(study, "estimate_ratio", by="backlash", metrics=["rmse"])
    tuning = fc.answer(study).recommend["tuning"]
    assert [axes.get_title(loc="left") for axes in figure.axes] == [f"backlash = {x} %" for x in (2, 5, 8)]
    for axes, backlash in zip(figure.axes, study.backlash.values, strict=True):
        *_, best, worst, line = axes.lines
        np.testing.assert_array_equal(line.get_xdata(), [0, 50, 100, 150])
        medians = study.rmse.sel(backlash=backlash).median("day")
        np.testing.assert_allclose(line.get_ydata(), medians.sel(tuning=tuning))
        np.testing.assert_allclose(best.get_ydata(), medians.min("tuning"))
        np.testing.assert_allclose(worst.get_ydata(), medians.max("tuning"))
        low, high = axes.get_ylim()
        assert (low, high) == figure.axes[0].get_ylim()
        assert low == 0.0 < np.max(line.get_ydata()) < high


def test_a_few_days_are_drawn_one_by_one_and_many_as_a_band(study):
    ds = study.isel(tuning=0, estimate_ratio=0)
    (axes,) = plots.draw_panels(ds, "backlash", metrics=["rmse"]).axes
    low, high = (ds.rmse.quantile(q, "day") for q in (0.1, 0.9))
    (band,) = axes.collections
    edges = band.get_paths()[0].vertices
    assert (edges[:, 1].min(), edges[:, 1].max()) == pytest.approx((float(low.min()), float(high.max())))
    ds = ds.isel(day=slice(2))
    (axes,) = plots.draw_panels(ds, "backlash", metrics=["rmse"]).axes
    assert not axes.collections
    lines = [line.get_ydata() for line in axes.lines[1:]]
    np.testing.assert_allclose(lines, [*ds.rmse.transpose("day", "backlash"), ds.rmse.median("day")])


def test_the_recommended_cell_of_a_map_is_marked_and_its_ticks_are_the_swept_values(study):
    ds = study.isel(tuning=0)
    axes = plots.draw_panels(ds, "estimate_ratio", "backlash", metrics=["rmse"]).axes[0]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["0", "50", "100", "150"]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["2", "5", "8"]
    frame = axes.patches[-1]  # the backlash is no choice: the column of the recommended estimate
    column = [0.0, 0.5, 1.0, 1.5].index(fc.answer(ds).recommend["estimate_ratio"])
    assert (*frame.get_xy(), frame.get_width(), frame.get_height()) == (column, 0, 1, 3)
    gains = make_result(
        ("kp", "ti"), {"kp": [0.01, 0.02, 0.03], "ti": [10.0, 20.0, 40.0]}, rmse=[[3, 2, 3], [3, 1, 3], [3, 3, 3]]
    )
    frame = plots.draw_panels(gains, "ti", "kp", metrics=["rmse"]).axes[0].patches[-1]
    assert (*frame.get_xy(), frame.get_width(), frame.get_height()) == (1, 1, 1, 1)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([30.0, 60.0, 120.0, 240.0], "log"),
        ([0.0, 0.001, 0.003, 0.01], "symlog"),
        ([0.0, 0.5, 0.95, 1.2], "linear"),
        ([0.02, 0.05, 0.08, 0.11], "linear"),
        ([-1.0, 1.0, 10.0, 100.0], "linear"),
    ],
)
def test_an_axis_is_logarithmic_where_the_swept_values_are_spaced_so(values, scale):
    ds = make_result(("ti",), {"ti": values}, rmse=np.arange(4.0))
    axes = plots.draw_panels(ds, "ti", metrics=["rmse"]).axes[0]
    assert axes.get_xscale() == scale
    assert [text.get_text() for text in axes.get_xticklabels()] == [f"{v:.3g}" for v in values]


def test_of_whether_loops_hunt_the_share_is_drawn():
    ds = make_result(
        ("kp", "day"), {"kp": [0.01, 0.02]}, hunts=[[0, 0, 0, 0, 1], [1, 1, 1, 0, 0]], rmse=np.ones((2, 5))
    )
    axes = plots.draw_panels(ds, "kp", metrics=["hunts"]).axes[0]
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), [20.0, 60.0])
    assert not axes.collections, "a share has no band"


@pytest.mark.parametrize("millimetres", full_except([84, 174, None], [84]))
def test_the_standard_figures_are_as_wide_as_asked_and_no_text_is_clipped_or_hides_another(study, millimetres):
    inches = None if millimetres is None else millimetres / 25.4
    for draw in plots.standard_figures(study.assign_attrs(title=2 * LONG_TITLE), inches).values():
        figure = draw()
        assert inches is None or figure.get_figwidth() == inches
        assert_texts_fit(figure)
        assert_palette(figure)


@pytest.mark.parametrize(
    ("sizes", "names"),
    [
        ({}, set()),
        ({"backlash": 1}, set()),
        ({"kp": 2}, {"bands"}),
        ({"kp": 2, "ti": 3}, {"bands"}),  # a map of two columns would be bars
        ({"kp": 3, "ti": 3}, {"maps", "bands"}),
        ({"tuning": 100}, {"tuning"}),
        ({"tuning": 101}, set()),  # more names than a figure takes
    ],
)
def test_a_study_gets_the_figures_that_suit_its_dims(sizes, names):
    coords = {name: 1.0 + np.arange(n) for name, n in sizes.items()}
    if "tuning" in coords:
        coords["tuning"] = coords["tuning"].astype(str)
    assert set(plots.standard_figures(make_result(tuple(sizes), coords, rmse=np.ones(tuple(sizes.values()))))) == names


def test_a_study_in_which_all_failed_still_gets_its_figures(study):
    for draw in plots.standard_figures(study * np.nan).values():
        assert "no finite value" in [text.get_text() for text in draw().axes[0].texts]


@pytest.mark.parametrize(
    ("dim", "values", "is_control"),
    [
        ("estimate_ratio", {"estimate_ratio": [0.0, 1.0]}, True),
        ("estimate_ratio", {"estimate_ratio": [0.5, 1.0]}, False),
        ("remedy", {"backlash_estimate": [0.0, 0.0], "learning_step": [0, 0.01]}, True),
        ("remedy", {"estimator": ["none", "hagglund"]}, True),
        ("remedy", {"ti": [8.0, 30.0]}, False),
        ("controller", {}, True),
        ("sample", {"estimate_ratio": [0.0, 1.0]}, False),
    ],
)
def test_a_plain_pi_among_others_is_seen_by_what_differs(dim, values, is_control):
    coords = {name: (dim, of) for name, of in values.items()}
    assert control_dims(make_result((dim, "kp"), coords, rmse=np.ones((2, 2)))) == [dim] * is_control


def test_the_standard_figures_never_pool_a_plain_pi_with_others(study):
    tuning = plots.standard_figures(study)["tuning"]()
    titles = [" ".join(axes.get_title(loc="left").split()) for axes in tuning.axes]
    shares = ("0 %, plain PI", "50 %", "100 %", "150 %")
    assert [title.removesuffix(", recommended") for title in titles[::3]] == [
        f"estimate / backlash = {share}" for share in shares
    ]
    assert sum("recommended" in title for title in titles[::3]) == 1
    dots = tuning.axes[0].lines[-1].get_xdata()
    found = fc.answer(study)
    worst = found.table.rmse.sel(found.place).idxmax("backlash").item()
    np.testing.assert_allclose(dots, study.rmse.sel(estimate_ratio=0.0, backlash=worst).median("day"))


@pytest.mark.parametrize(("best", "titles"), [(2, (0, 40, 140)), (0, (0, 80, 140))])
def test_of_many_rows_the_first_the_recommended_and_the_last_are_drawn(best, titles):
    """Where the recommended one is the first, the middle row stands between the first and the last."""
    rmse = np.full((2, 8), 0.5)
    rmse[:, best] = 0.1
    estimates = np.linspace(0.0, 1.4, 8)
    ds = make_result(("tuning", "estimate_ratio"), {"tuning": ["a", "b"], "estimate_ratio": estimates}, rmse=rmse)
    figure = plots.draw_panels(ds, "tuning", by="estimate_ratio", metrics=["rmse"])
    shown = [" ".join(axes.get_title(loc="left").split()) for axes in figure.axes]
    assert shown == [
        f"estimate / backlash = {share} %" + ", plain PI" * (share == 0) + ", recommended" * (share == 20 * best)
        for share in titles
    ]


def test_named_controllers_have_rows_and_maps_of_rows_one_scale():
    rng = np.random.default_rng(2)
    dims, labels = ("controller", "kp", "ti", "day"), {"controller": ["pi", "inverse"]}
    ds = make_result(dims, labels, rmse=rng.random((2, 3, 3, 5)))
    ds["rmse"] = ds.rmse * ds.rmse.controller.copy(data=[1.0, 3.0])
    figures = plots.standard_figures(ds)
    meshes = [axes.collections[0] for axes in figures["maps"]().axes if axes.get_title(loc="left")]
    assert len(meshes) == 2
    medians = ds.rmse.median("day")
    assert meshes[0].get_clim() == meshes[1].get_clim() == (float(medians.min()), float(medians.max()))
    bands = figures["bands"]()
    assert [axes.get_title(loc="left") for axes in bands.axes] == ["pi, recommended", "inverse"]
    np.testing.assert_allclose(
        bands.axes[1].lines[-1].get_ydata(), ds.rmse[1].sel(kp=fc.answer(ds).place["kp"]).median("day")
    )


@pytest.mark.parametrize("n", [3, 4])
def test_a_study_of_many_learning_settings_has_a_curve_for_three_and_says_so(n):
    """Steps and intervals, each found by the first half of the days."""
    sizes = {"learning_step": n, "learning_interval": n, "day": 4}
    coords = {"learning_step": 0.002 * np.arange(1, n + 1), "learning_interval": 600.0 * np.arange(1, n + 1)}
    times = np.where(np.arange(4) < 2, 3600.0, np.nan) * np.ones((n, n, 1))
    ones = np.ones((n, n, 4))
    estimates = {"time_identified": times, "estimate_settled": 0.07 * ones, "backlash_final": 0.07 * ones}
    metrics = {name: ones for name in (*plots.STANDARD_METRICS, "switch_frequency")}
    figure = plots.standard_figures(make_result(tuple(sizes), coords, **estimates, **metrics))["learning"]()
    assert_texts_fit(figure)
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == f"learning interval = {10 * n} min"
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 50.0)
    assert ("shown are 3 of 4 values" in " ".join(figure.get_suptitle().split())) == (n == 4)


def test_a_drawn_parameter_is_drawn_with_the_scatter_in_each_group():
    ds = drawn_result(80)
    figure = plots.draw_panels(group_by_parameters(ds, ["kp"]), "kp", metrics=["rmse"])
    (axes,) = figure.axes
    groups = np.array_split(np.argsort(ds.kp.values), 8)
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), [np.median(ds.rmse.values[:, g]) for g in groups])
    edges = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert edges.min() == pytest.approx(min(np.quantile(ds.rmse.values[:, g], 0.1) for g in groups))
    heading = " ".join(figure.get_suptitle().split())
    median = "Line: median of 2 days × 10 samples in each of 8 groups of proportional gain Kp"
    assert heading == f"{median}; band: 10th to 90th percentile"


@pytest.mark.parametrize(
    ("options", "field", "code"),
    [
        ({"by": "tunin"}, "by", "choice"),
        ({"by": "backlash"}, "by", "duplicate"),
        ({"metrics": ["rms"]}, "metrics", "name"),
        ({"by": "tuning", "width": 4.0}, "width", "size"),
    ],
)
def test_rows_that_there_cannot_be_are_refused(study, options, field, code):
    assert_refused(field, code, plots.draw_panels, study, "backlash", **options)
