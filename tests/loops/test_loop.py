"""``Loop``: values, attributes, signatures, stand-ins, round trips, text."""

import inspect
import json

import numpy as np
import pytest
import xarray as xr
from builder.stub import STUB, filled
from helpers.refusals import assert_refused
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, RESERVED_DIMS


def test_assign_leaves_the_original_alone():
    loop = fc.Loop()
    changed = loop.assign(backlash=0.1, kp=[0.01, 0.02])
    assert (loop["backlash"], loop["kp"], loop.sizes) == (0.07, 0.03, {})
    assert (changed["backlash"], changed.sizes) == (0.1, {"kp": 2})


def test_estimate_ratio_takes_the_place_of_the_estimate_and_back():
    loop = fc.Loop(estimate_ratio=0.6)
    assert (loop["estimate_ratio"], loop["backlash_estimate"]) == (0.6, None)
    back = loop.assign(backlash_estimate=0.05)
    assert (back["estimate_ratio"], back["backlash_estimate"]) == (None, 0.05)


@pytest.mark.kernel
def test_estimate_ratio_is_the_estimate_over_the_backlash(half_hour_day):
    ratio = fc.simulate(fc.Loop(backlash=[0.05, 0.1], estimate_ratio=[0.5, 1.2]), half_hour_day, warm_up=60)
    pairs = xr.DataArray([[0.5 * 0.05, 1.2 * 0.05], [0.5 * 0.1, 1.2 * 0.1]], dims=("backlash", "estimate_ratio"))
    estimate = fc.simulate(fc.Loop(backlash=[0.05, 0.1], backlash_estimate=pairs), half_hour_day, warm_up=60)
    np.testing.assert_array_equal(ratio.rmse.values, estimate.rmse.values)
    np.testing.assert_array_equal(ratio.estimate_final.values, pairs.values)


def test_installed_valve_takes_the_place_of_the_curve_and_back():
    loop = fc.Loop(rangeability=50.0, authority=0.3, m_full=1.8)
    assert (loop["m_max"], loop["valve_a"], loop["rangeability"]) == (None, None, 50.0)
    assert loop.assign(authority=0.5)["rangeability"] == 50.0
    back = loop.assign(m_max=2.0, valve_a=0.7, valve_b=9.0, valve_c=0.38)
    assert back == fc.Loop()


def test_alternatives_exclude_each_other_and_go_together():
    assert_refused("estimate_ratio", "conflict", fc.Loop, estimate_ratio=0.5, backlash_estimate=0.05)
    assert_refused("rangeability", "conflict", fc.Loop, rangeability=50.0, authority=0.3, m_full=1.8, m_max=2.0)
    assert_refused("authority", "missing", fc.Loop, rangeability=50.0)


@pytest.mark.kernel
@pytest.mark.filterwarnings("ignore:action")
@pytest.mark.parametrize(
    "loop",
    [
        fc.Loop(),
        fc.Loop.preset("g36").assign(backlash=[0.02, 0.07], kp=("tuning", [0.01, 0.02]), ti=("tuning", [10.0, 20.0])),
        fc.Loop(rangeability=[20.0, 50.0], authority=0.3, m_full=1.8, estimate_ratio=[0.5, 1.0], n_volumes=[4, 8]),
        fc.Loop(action=["cooling", "heating"], learning_stop="first_step_down"),
    ],
)
def test_from_dataset_gives_the_loop_back(loop, half_hour_day):
    back = fc.Loop.from_dataset(fc.simulate(loop, half_hour_day, warm_up=60))
    assert back.constants == loop.constants
    assert back.sizes == loop.sizes
    # unlabelled dims have come back with their labels 0, 1, ...
    coordinates = {name: (c.dims, c.values.tolist()) for name, c in back.coordinates().items()}
    assert coordinates == {name: (c.dims, c.values.tolist()) for name, c in loop.coordinates().items()}


@pytest.mark.kernel
def test_from_a_part_of_a_dataset_comes_the_loop_of_that_part(half_hour_day):
    loop = fc.Loop(backlash=[0.02, 0.07], kp=("tuning", [0.01, 0.02]), n_volumes=("tuning", [4, 8]))
    ds = fc.simulate(loop, half_hour_day, warm_up=60)
    assert fc.Loop.from_dataset(ds.isel(backlash=1, tuning=0)) == fc.Loop(backlash=0.07, kp=0.01, n_volumes=4)
    assert fc.Loop.from_dataset(ds.sel(backlash=0.02)).sizes == {"tuning": 2}
    assert list(fc.Loop.from_dataset(ds[["rmse"]]).sizes) == ["backlash", "tuning"]
    turned = fc.Loop(kp=("tuning", [0.01, 0.02]), backlash=[0.02, 0.07])
    assert list(fc.Loop.from_dataset(fc.simulate(turned, half_hour_day, warm_up=60)).sizes) == ["tuning", "backlash"]


def drop_parameters(ds, *names):
    """The result as a version would have made it that does not know these parameters."""
    stored = json.loads(ds.attrs["parameters"])
    return ds.assign_attrs(parameters=json.dumps({n: v for n, v in stored.items() if n not in names}))


@pytest.mark.kernel
@pytest.mark.parametrize(
    "values", [{"estimate_ratio": [0.0, 0.6]}, {"rangeability": [20.0, 50.0], "authority": 0.3, "m_full": 1.8}]
)
def test_parameters_that_an_older_result_lacks_have_their_defaults(values, half_hour_day):
    loop = fc.Loop(**values)
    ds = fc.simulate(loop, half_hour_day, warm_up=60)
    with pytest.warns(UserWarning, match=".") as warned:
        back = fc.Loop.from_dataset(drop_parameters(ds, "learning_stop", "learning_growth"))
    assert_worded(*[warning.message for warning in warned])
    assert {name: back[name] is None for name in PARAMETERS} == {name: loop[name] is None for name in PARAMETERS}
    assert back.constants == loop.constants
    again = fc.simulate(back, half_hour_day, warm_up=60)
    assert bool((again.status == 0).all())
    np.testing.assert_array_equal(again.rmse.values, ds.rmse.values)


@pytest.mark.kernel
def test_a_dataset_without_labels_or_of_another_program_is_refused(half_hour_day):
    ds = fc.simulate(fc.Loop(backlash=[0.02, 0.07]), half_hour_day, warm_up=60)
    assert_refused("backlash", "missing", fc.Loop.from_dataset, ds.drop_vars("backlash"))
    assert_refused("ds", "data", fc.Loop.from_dataset, xr.Dataset())
    assert_refused("ds", "data", fc.Loop.from_dataset, ds.assign_attrs(parameters="{"))


def test_repr_shows_the_dimensions_and_what_differs_from_the_nearest_preset():
    assert repr(fc.Loop()) == "<fastcoil.Loop>\npaper_like"
    assert repr(fc.Loop.preset("heating")) == "<fastcoil.Loop>\nheating"
    assert repr(fc.Loop.preset("lbnl").assign(kp=0.02)).splitlines()[1:] == ["Differs from lbnl:", "  kp = 0.02 K-1"]
    text = repr(fc.Loop(ti=30, backlash=[0.02, 0.07], action="heating"))
    lines = ("backlash: 2", "ti = 30.0 s", "backlash (backlash): 0.02, 0.07", "action = heating")
    assert [line for line in lines if line not in text] == []
    assert "C_w" not in text


def test_names_of_parameters_metrics_traces_and_dims_are_disjoint():
    names = [*PARAMETERS, "status", *METRICS, *TRACES, *RESERVED_DIMS]
    assert len(set(names)) == len(names)
    assert not set(names) & {"method", "tolerance", "drop", "indexers", "missing_dims"}
    assert all(name.isidentifier() for name in names)


def test_every_parameter_is_an_attribute_with_the_value_of_the_loop():
    loop = fc.Loop(backlash=[0.02, 0.07], kp=0.05)
    assert {*fc.parameters()} <= {*dir(loop)}
    assert all(getattr(loop, name) is loop[name] for name in fc.parameters())
    assert not {name for name in vars(fc.Loop) if not name.startswith("_")} & PARAMETERS.keys()
    assert (loop.kp, loop.sizes, loop.estimator) == (0.05, {"backlash": 2}, None)


def test_a_wrong_name_gets_the_nearest_and_no_second_guess_of_python():
    with pytest.raises(AttributeError) as caught:
        fc.Loop().backlsh  # noqa: B018
    assert str(caught.value) == "a Loop has no backlsh, did you mean 'backlash'?"
    assert caught.value.obj is None  # of which python would guess
    assert not hasattr(fc.Loop(), "_repr_latex_")


def test_a_loop_is_not_changed_by_an_attribute_and_says_what_does():
    loop = fc.Loop()
    with pytest.raises(AttributeError, match=r"a Loop does not change: take a copy, loop\.assign\(backlash=…\)"):
        loop.backlash = 0.1
    assert loop == fc.Loop()


def test_the_type_stub_has_the_presets_and_parameters_of_the_table():
    text = STUB.read_text()
    assert filled(text) == text, f"{STUB} lacks a preset or parameter: run `make pages`"


CHECKED_PROGRAM = """
import fastcoil as fc
loop = fc.Loop(backlash=0.1, kp=("tuning", [0.01, 0.02]), action="heating", converged=True)
doubled = loop.backlash * 2, loop["kp"] * 2
loop = loop.assign(**{"gain": 3.0})
fc.Loop(backlsh=0.1)
loop.assign(backlsh=0.1)
"""


MYPY_CONFIG = """
[mypy]
follow_imports = silent
[mypy-numpy.*,xarray.*,fastcoil.base.*,fastcoil.model.*,fastcoil.loops.boundary.*,fastcoil.loops.simulate]
follow_imports = skip
[mypy-fastcoil.design.*,fastcoil.measured.*,fastcoil.study.*,fastcoil.deliver.*,fastcoil.logs.*,fastcoil.loops.netcdf]
follow_imports = skip
"""
"""What a checker of ``Loop`` need not read; without this it takes ten seconds."""


def test_a_type_checker_refuses_a_mistyped_parameter_and_nothing_else(tmp_path):
    mypy = pytest.importorskip("mypy.api")
    (tmp_path / "checked.py").write_text(CHECKED_PROGRAM)
    (tmp_path / "mypy.ini").write_text(MYPY_CONFIG)
    words = ("--config-file", tmp_path / "mypy.ini", "--cache-dir", tmp_path / "cache", tmp_path / "checked.py")
    output, _, _ = mypy.run([*map(str, words)])
    errors = [line.partition("checked.py:")[2] for line in output.splitlines() if ": error:" in line]
    assert [line.split(":")[0] for line in errors] == ["6", "7"], output
    assert all('did you mean "backlash"' in line for line in errors)


def test_the_docstring_of_a_loop_has_a_row_for_each_parameter_and_its_signature_is_short():
    assert str(inspect.signature(fc.Loop)) == "(**values: 'Unpack[Keywords]') -> 'None'"
    border, _, _, *rows = fc.Loop.__doc__.partition("Notes\n-----\n")[2].splitlines()
    rows = [row.split() for row in rows[: rows.index(border)]]
    assert [row[0] for row in rows] == [*PARAMETERS, "converged"]
    assert all(row[-1] == PARAMETERS[row[0]].text.split()[-1] for row in rows[:-1])
    kp = next(row for row in rows if row[0] == "kp")
    assert kp[1:3] == ["K-1", "0.03"]
