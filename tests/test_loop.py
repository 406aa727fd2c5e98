"""``Loop``: presets, the ways to sweep a parameter, stand-ins, round trips, and every sentence about bad input."""

import math

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.layout import Layout
from fastcoil.outputs import METRICS, TRACES
from fastcoil.parameter_table import PARAMETERS, RESERVED_DIMS
from fastcoil.scenario import PRESETS

COMMON = {
    "C_w": 8.8, "beta1": 0.32, "beta2": -0.20, "beta3": 0.40, "beta4": -0.45, "beta5": 0.42, "beta6": -0.42,
    "cp_w": 4.186, "cp_a": 1.02, "pressure": 101325.0, "n_volumes": 8, "air_march": "lagged", "T_initial": 20.0,
    "m_max": 2.0, "valve_a": 0.7, "valve_b": 9.0, "valve_c": 0.38,
    "rangeability": None, "authority": None, "m_full": None, "backlash": 0.07,
    "command_resolution": 0.0, "noise_std": 0.0, "sensor_resolution": 0.0, "action": "cooling",
    "backlash_estimate": 0.0, "estimate_ratio": None, "buffer": 1e-9, "learning_step": 0.0, "learning_interval": 1800.0,
    "learning_ratio": 2.0, "learning_floor": 0.0, "learning_cap": 0.25, "learning_stop": "never",
    "learning_min_switches": 0.0, "learning_max_reference": 1.0, "learning_early_trip": 0.0, "learning_growth": 1.0,
    "learning_shrink": 1.0, "learning_final": 1.0,
}  # fmt: skip
VARYING = ("C_c", "kp", "ti", "sample_time", "sensor_time_constant", "stroke_time")
DESIGN_TABLE = {
    "paper_like": (30.0, 0.03, 8.0, 30.0, 0.0, 0.0),
    "paper_like_fast": (10.0, 0.05, 5.0, 10.0, 0.0, 0.0),
    "lbnl": (10.0, 0.018, 30.0, 15.0, 30.0, 90.0),
    "g36": (10.0, 0.05, 600.0, 5.0, 30.0, 90.0),
}


def problems(*args, **values):
    """The sentences with which a loop is refused."""
    with pytest.raises(fc.InputError) as caught:
        fc.Loop(*args, **values)
    assert caught.value.exit_code == 2
    return caught.value.problems


# Presets and values


@pytest.mark.parametrize("name", DESIGN_TABLE)
def test_presets_are_the_design_table(name):
    loop = fc.Loop.preset(name)
    expected = COMMON | dict(zip(VARYING, DESIGN_TABLE[name], strict=True))
    assert {p: loop[p] for p in PARAMETERS} == expected


def test_every_preset_is_tested_and_the_default_is_paper_like():
    assert PRESETS.keys() == DESIGN_TABLE.keys()
    assert fc.Loop() == fc.Loop.preset("paper_like")


def test_assign_leaves_the_original_alone():
    loop = fc.Loop()
    changed = loop.assign(backlash=0.1, kp=[0.01, 0.02])
    assert (loop["backlash"], loop["kp"], loop.sizes) == (0.07, 0.03, {})
    assert (changed["backlash"], changed.sizes) == (0.1, {"kp": 2})
    with pytest.raises(AttributeError):
        loop.backlash = 0.1


@pytest.mark.parametrize(("given", "kept"), [(8, 8), (8.0, 8), (np.int64(8), 8), (np.float64(8), 8)])
def test_n_volumes_is_an_integer_and_all_other_numbers_are_floats(given, kept):
    loop = fc.Loop(n_volumes=given, sample_time=given)
    assert (loop["n_volumes"], type(loop["n_volumes"])) == (kept, int)
    assert (loop["sample_time"], type(loop["sample_time"])) == (8.0, float)


@pytest.mark.parametrize(
    ("name", "value"),
    [("backlash", 0.0), ("backlash", 0.9), ("n_volumes", 64), ("sample_time", 1), ("kp", 0), ("kp", -0.1)],
)
def test_bounds_are_inclusive(name, value):
    assert fc.Loop(**{name: value})[name] == value


def test_equality():
    loop = fc.Loop(backlash=[0.02, 0.07])
    assert loop == fc.Loop(backlash=[0.02, 0.07])
    assert loop != fc.Loop(backlash=[0.02, 0.08])
    assert loop != fc.Loop(backlash=0.02)
    assert loop != "loop"


# Sweeps


def test_a_list_is_a_dimension_of_its_own():
    loop = fc.Loop(backlash=[0.02, 0.07, 0.15], kp=np.array([0.01, 0.02]), air_march=["quasistatic", "lagged"])
    assert loop.sizes == {"backlash": 3, "kp": 2, "air_march": 2}
    assert loop.coordinates()["backlash"].values.tolist() == [0.02, 0.07, 0.15]
    assert loop.coordinates()["air_march"].values.tolist() == ["quasistatic", "lagged"]


def test_a_pair_is_zipped_along_a_shared_dimension():
    loop = fc.Loop(kp=("tuning", [0.01, 0.02]), ti=("tuning", [10.0, 20.0]))
    assert loop.sizes == {"tuning": 2}
    assert loop.coordinates()["ti"].dims == ("tuning",)


def test_a_dataarray_keeps_its_dims_and_labels():
    kp = xr.DataArray([0.01, 0.02], dims="controller", coords={"controller": ["slow", "fast"]})
    loop = fc.Loop(kp=kp, backlash=xr.DataArray(np.full((2, 3), 0.05), dims=("controller", "size")))
    assert loop.sizes == {"controller": 2, "size": 3}
    assert loop.coordinates()["controller"].values.tolist() == ["slow", "fast"]


def test_dims_come_in_the_order_of_assignment_and_a_changed_sweep_comes_last():
    loop = fc.Loop(kp=[0.01, 0.02], backlash=[0.05, 0.07])
    assert list(loop.sizes) == ["kp", "backlash"]
    assert list(loop.assign(kp=[0.01, 0.03]).sizes) == ["backlash", "kp"]
    assert list(loop.assign(kp=0.02).sizes) == ["backlash"]


def test_axis_labels_are_rounded_so_that_sel_finds_them():
    axis = np.linspace(0.01, 0.15, 15)
    assert 0.07 not in axis.tolist()
    labels = fc.Loop(backlash=axis).coordinates()["backlash"]
    assert labels.assign_coords(backlash=labels).sel(backlash=0.07) == 0.07
    zipped = fc.Loop(backlash=("sample", axis))["backlash"]
    assert zipped.values.tolist() == axis.tolist()


def columns(loop, n_days=None, replicates=1):
    """Parameters of all scenarios, in their flat order."""
    day = fc.paper_day(hours=0.1, seed=list(range(n_days)) if n_days else 1)
    layout = Layout(loop, day, replicates)
    layout.check_together()
    return layout, layout.columns(np.arange(layout.size))


def test_scenarios_are_the_product_of_the_dimensions_last_one_fastest():
    loop = fc.Loop(backlash=[0.05, 0.07], kp=("tuning", [0.01, 0.02, 0.03]), ti=("tuning", [10.0, 20.0, 30.0]))
    layout, found = columns(loop, n_days=2, replicates=2)
    assert layout.sizes == {"day": 2, "backlash": 2, "tuning": 3, "replicate": 2}
    assert found["replicate"].tolist() == [0, 1] * 12
    assert found["kp"].tolist() == [0.01, 0.01, 0.02, 0.02, 0.03, 0.03] * 4
    assert found["ti"].tolist() == [10.0, 10.0, 20.0, 20.0, 30.0, 30.0] * 4
    assert found["backlash"].tolist() == ([0.05] * 6 + [0.07] * 6) * 2
    assert found["day"].tolist() == [0] * 12 + [1] * 12
    assert np.all(found["C_c"] == 30.0)
    assert np.all(np.isnan(found["rangeability"]))


def test_any_slice_of_the_scenarios_is_that_of_all_of_them():
    loop = fc.Loop(backlash=np.linspace(0.0, 0.1, 7), kp=[0.01, 0.02, 0.03], action=["heating", "cooling"])
    layout, found = columns(loop)
    some = layout.columns(np.arange(5, 29))
    assert all(some[name].tolist() == found[name][5:29].tolist() for name in ("backlash", "kp", "action"))


def test_describe_names_the_place_of_a_scenario():
    layout, _ = columns(fc.Loop(backlash=[0.05, 0.07], air_march=["lagged", "quasistatic"]))
    assert layout.describe(2) == "backlash=0.07, air_march=lagged"


# Stand-ins


def test_estimate_ratio_takes_the_place_of_the_estimate_and_back():
    loop = fc.Loop(estimate_ratio=0.6)
    assert (loop["estimate_ratio"], loop["backlash_estimate"]) == (0.6, None)
    back = loop.assign(backlash_estimate=0.05)
    assert (back["estimate_ratio"], back["backlash_estimate"]) == (None, 0.05)


@pytest.mark.kernel
def test_estimate_ratio_is_the_estimate_over_the_backlash(short):
    ratio = fc.simulate(fc.Loop(backlash=[0.05, 0.1], estimate_ratio=[0.5, 1.2]), short, warm_up=60)
    pairs = xr.DataArray([[0.5 * 0.05, 1.2 * 0.05], [0.5 * 0.1, 1.2 * 0.1]], dims=("backlash", "estimate_ratio"))
    estimate = fc.simulate(fc.Loop(backlash=[0.05, 0.1], backlash_estimate=pairs), short, warm_up=60)
    np.testing.assert_array_equal(ratio.rmse.values, estimate.rmse.values)
    np.testing.assert_array_equal(ratio.estimate_final.values, pairs.values)


def test_installed_valve_takes_the_place_of_the_curve_and_back():
    loop = fc.Loop(rangeability=50.0, authority=0.3, m_full=1.8)
    assert (loop["m_max"], loop["valve_a"], loop["rangeability"]) == (None, None, 50.0)
    assert loop.assign(authority=0.5)["rangeability"] == 50.0
    back = loop.assign(m_max=2.0, valve_a=0.7, valve_b=9.0, valve_c=0.38)
    assert back == fc.Loop()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"estimate_ratio": 0.5, "backlash_estimate": 0.05}, ["estimate_ratio", "backlash_estimate"]),
        ({"rangeability": 50.0, "authority": 0.3, "m_full": 1.8, "m_max": 2.0}, ["rangeability", "m_max"]),
        ({"rangeability": 50.0}, ["authority", "m_full", "missing"]),
    ],
)
def test_alternatives_exclude_each_other_and_go_together(values, words):
    (problem,) = problems(**values)
    assert all(word in problem for word in words)


def test_part_of_a_curve_does_not_replace_an_installed_valve():
    with pytest.raises(fc.InputError, match=r"valve_b.*valve_c"):
        fc.Loop(rangeability=50.0, authority=0.3, m_full=1.8).assign(m_max=2.0, valve_a=0.7)


# Round trips and repr


@pytest.mark.kernel
@pytest.mark.parametrize(
    "loop",
    [
        fc.Loop(),
        fc.Loop.preset("g36").assign(backlash=[0.02, 0.07], kp=("tuning", [0.01, 0.02]), ti=("tuning", [10.0, 20.0])),
        fc.Loop(rangeability=[20.0, 50.0], authority=0.3, m_full=1.8, estimate_ratio=[0.5, 1.0], n_volumes=[4, 8]),
        fc.Loop(action=["cooling", "heating"], learning_stop="first_step_down"),
    ],
)
def test_from_dataset_gives_the_loop_back(loop, short):
    back = fc.Loop.from_dataset(fc.simulate(loop, short, warm_up=60))
    assert back.constants == loop.constants
    assert back.sizes == loop.sizes
    # unlabelled dims have come back with their labels 0, 1, ...
    coordinates, expected = back.coordinates(), loop.coordinates()
    assert coordinates.keys() == expected.keys()
    for name, labels in expected.items():
        assert coordinates[name].dims == labels.dims
        np.testing.assert_array_equal(coordinates[name].values, labels.values)


@pytest.mark.kernel
def test_from_dataset_keeps_the_order_of_the_dims(short):
    loop = fc.Loop(kp=("tuning", [0.01, 0.02]), backlash=[0.02, 0.07])
    assert list(fc.Loop.from_dataset(fc.simulate(loop, short, warm_up=60)).sizes) == ["tuning", "backlash"]


@pytest.mark.kernel
def test_from_a_part_of_a_dataset_comes_the_loop_of_that_part(short):
    loop = fc.Loop(backlash=[0.02, 0.07], kp=("tuning", [0.01, 0.02]), n_volumes=("tuning", [4, 8]))
    ds = fc.simulate(loop, short, warm_up=60)
    assert fc.Loop.from_dataset(ds.isel(backlash=1, tuning=0)) == fc.Loop(backlash=0.07, kp=0.01, n_volumes=4)
    assert fc.Loop.from_dataset(ds.sel(backlash=0.02)).sizes == {"tuning": 2}


@pytest.mark.kernel
def test_one_metric_of_a_dataset_is_enough(short):
    ds = fc.simulate(fc.Loop(backlash=[0.02, 0.07]), short, warm_up=60)
    assert fc.Loop.from_dataset(ds[["rmse"]]).sizes == {"backlash": 2}


def test_from_a_foreign_dataset_is_refused():
    with pytest.raises(fc.InputError, match="not made by fastcoil"):
        fc.Loop.from_dataset(xr.Dataset())


def test_repr_shows_the_dimensions_and_what_differs_from_paper_like():
    assert repr(fc.Loop()) == "<fastcoil.Loop>\npaper_like"
    text = repr(fc.Loop(ti=30, backlash=[0.02, 0.07], action="heating"))
    assert "backlash: 2" in text
    assert "ti = 30.0 s" in text
    assert "backlash (backlash): 0.02 0.07" in text
    assert "action = heating" in text
    assert "C_w" not in text


def test_repr_shows_units_whole():
    assert "kp = 0.05 K-1" in repr(fc.Loop(kp=0.05))


# Bad input


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("backlash", 0.91, ["backlash = 0.91", "0 to 0.9"]),
        ("backlash", -0.01, ["backlash = -0.01", "0 to 0.9"]),
        ("backlash_estimate", 1.0, ["backlash_estimate = 1", "below 1"]),
        ("ti", 0.0, ["ti = 0 s", "above 0"]),
        ("ti", -3, ["ti = -3 s", "above 0"]),
        ("sample_time", 1.5, ["sample_time = 1.5 s", "whole"]),
        ("sample_time", 0, ["sample_time = 0 s", "from 1"]),
        ("learning_interval", 599, ["learning_interval = 599 s", "600"]),
        ("learning_step", -0.1, ["learning_step = -0.1", "0 to 0.25"]),
        ("noise_std", -1e-300, ["noise_std = -1e-300 K", "at least 0"]),
        ("kp", math.nan, ["kp = nan", "finite"]),
        ("kp", math.inf, ["kp = inf", "finite"]),
        ("C_w", -math.inf, ["C_w = -inf", "finite"]),
        ("kp", True, ["kp = True", "number"]),
        ("kp", np.True_, ["kp = True", "number"]),
        ("kp", "0.1", ["kp = '0.1'", "number"]),
        ("kp", None, ["kp = None", "number"]),
        ("kp", {0.1}, ["kp = {0.1}", "number"]),
        ("kp", 1j, ["kp = 1j", "number"]),
        ("n_volumes", 8.5, ["n_volumes = 8.5", "whole", "1 to 64"]),
        ("n_volumes", [8, 65], ["n_volumes = 65", "1 to 64"]),
        ("action", "cool", ["action = 'cool'", "'cooling' or 'heating'"]),
        ("action", 1, ["action = 1", "'cooling' or 'heating'"]),
        ("air_march", ["lagged", "printed"], ["air_march = 'printed'", "'lagged' or 'quasistatic'"]),
        ("backlash", [], ["backlash = []", "at least one"]),
        ("backlash", ("size", []), ["backlash = []", "at least one"]),
        ("backlash", [0.07, 0.05, 0.07], ["backlash", "0.07", "twice"]),
        ("backlash", [0.07, 0.07 + 1e-15], ["backlash", "0.07", "twice"]),
        ("backlash", [0.05, math.nan], ["backlash = nan", "finite"]),
        ("backlash", [0.05, 0.95, 1.5], ["backlash = 0.95", "0 to 0.9", "1 more"]),
        ("backlash", [0.05, "0.07"], ["backlash = '0.07'", "number"]),
        ("backlash", [0.05, True], ["backlash = True", "number"]),
        ("backlash", [[0.05], [0.07]], ["backlash = [0.05]", "DataArray"]),
        ("backlash", np.array([[0.05], [0.07]]), ["backlash", "DataArray"]),
        ("kp", [0.05, True], ["kp = True", "number"]),
        ("backlash", ("size", 0.05), ["backlash", "list"]),
        ("backlash", xr.DataArray([True, False], dims="size"), ["backlash", "bool", "numbers"]),
        ("backlash", xr.DataArray([0.05j], dims="size"), ["backlash", "complex", "numbers"]),
        ("backlash", xr.DataArray(np.full((2, 2), 0.05), dims=("backlash", "size")), ["backlash", "dimension"]),
        ("backlash", ("method", [0.05, 0.07]), ["'method'", "dimension"]),
        ("backlash", ("my size", [0.05, 0.07]), ["'my size'", "dimension"]),
    ],
)
def test_a_bad_value_is_named_with_the_cure(name, value, words):
    (problem,) = problems(**{name: value})
    assert all(word in problem for word in words), problem


@pytest.mark.parametrize("dim", ["day", "replicate", "volume", "elapsed_time", "rmse", "T_sup"])
def test_dims_of_results_cannot_be_swept(dim):
    (problem,) = problems(backlash=(dim, [0.05, 0.07]))
    assert repr(dim) in problem
    assert "taken" in problem


def test_status_cannot_be_swept():
    assert problems(backlash=("status", [0.05, 0.07]))


def test_a_dim_cannot_have_the_name_of_a_parameter_that_has_another_value():
    with pytest.raises(fc.InputError):
        columns(fc.Loop(backlash=("buffer", [0.05, 0.07])))


@pytest.mark.parametrize("dim", ["sample", "controller", "tuning"])
def test_reserved_dims_of_sweeps_can_be_swept(dim):
    assert dim in RESERVED_DIMS
    assert fc.Loop(backlash=(dim, [0.05, 0.07])).sizes == {dim: 2}


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("baklash", "backlash"), ("sampletime", "sample_time"), ("C_W", "C_w"), ("Kp", "kp")],
)
def test_an_unknown_name_is_answered_with_the_nearest(wrong, right):
    (problem,) = problems(**{wrong: 0.1})
    assert wrong in problem
    assert repr(right) in problem
    with pytest.raises(fc.InputError, match=right):
        fc.Loop()[wrong]


def test_an_unknown_name_like_no_other_is_answered_without_a_guess():
    (problem,) = problems(zzz=1.0)
    assert "did you mean" not in problem


def test_unknown_preset():
    with pytest.raises(fc.InputError, match=r"'paperlike'.*'paper_like'.*lbnl, g36"):
        fc.Loop.preset("paperlike")


@pytest.mark.parametrize("name", [None, ["lbnl"]])
def test_a_preset_is_a_word(name):
    with pytest.raises(fc.InputError):
        fc.Loop.preset(name)


def test_all_mistakes_are_reported_at_once():
    found = problems(
        baklash=0.1, ti=0.0, kp=math.nan, action="cool", backlash=[], estimate_ratio=0.5, backlash_estimate=0.1
    )
    assert len(found) == 6
    words = ["baklash", "ti = 0", "kp = nan", "action = 'cool'", "backlash = []", "estimate_ratio"]
    assert all(word in problem for word, problem in zip(words, found, strict=True))


@pytest.mark.parametrize("values", [{"kp": [0.1, [0.2, 0.3]]}, {"kp": 10**400}], ids=["ragged list", "huge integer"])
def test_what_numpy_cannot_read_is_refused_in_our_words(values):
    assert problems(**values)


def zipped_problem(**values):
    with pytest.raises(fc.InputError) as caught:
        columns(fc.Loop(**values))
    return str(caught.value)


def test_zipped_parameters_of_different_length():
    problem = zipped_problem(kp=("tuning", [0.01, 0.02]), ti=("tuning", [10.0, 20.0, 30.0]))
    assert all(word in problem for word in ("ti", "'tuning'", "3", "2", "same length"))


def differing_labels():
    slow, fast = (xr.DataArray([0.01, 0.02], dims="case", coords={"case": names}) for names in (["a", "b"], ["a", "c"]))
    return fc.Loop(kp=slow, backlash=fast)


def test_labels_of_one_dim_that_differ():
    with pytest.raises(fc.InputError, match=r"'case'.*backlash"):
        differing_labels().coordinates()
    own = xr.DataArray([1.0, 2.0], dims="ti", coords={"ti": [10.0, 21.0]})
    with pytest.raises(fc.InputError, match="'ti'"):
        fc.Loop(ti=[10.0, 20.0], kp=own).coordinates()


def test_labels_of_one_dim_that_differ_are_found_before_anything_runs():
    with pytest.raises(fc.InputError):
        columns(differing_labels())


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"backlash": [0.05, 0.9], "estimate_ratio": [0.5, 1.2]}, ["estimate_ratio", "1.08", "below 1"]),
        ({"backlash_estimate": [0.0, 0.3], "learning_step": 0.01}, ["backlash_estimate", "0.3", "learning_cap"]),
        ({"estimate_ratio": 4.0, "learning_step": 0.01}, ["0.28", "learning_cap"]),
    ],
)
def test_values_that_do_not_go_together(values, words):
    problem = zipped_problem(**values)
    assert all(word in problem for word in words), problem


def test_an_estimate_above_the_cap_is_fine_without_learning():
    assert columns(fc.Loop(backlash_estimate=0.3))[0].size == 1


def test_names_of_parameters_metrics_traces_and_dims_are_disjoint():
    names = [*PARAMETERS, "status", *METRICS, *TRACES, *RESERVED_DIMS]
    assert len(set(names)) == len(names)
    assert not set(names) & {"method", "tolerance", "drop", "indexers", "missing_dims"}
    assert all(name.isidentifier() for name in names)
