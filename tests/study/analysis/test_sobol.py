"""Sobol' indices of a saltelli design: against closed forms and another implementation."""

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused, refuses

import fastcoil as fc
from fastcoil.model.metric_table import STATUS_CRASHED
from fastcoil.study.file.sample import sample_values

UNIT = {"kp": {"uniform": [0.0, 1.0]}, "ti": {"uniform": [0.0, 1.0]}, "backlash": {"uniform": [0.0, 1.0]}}


def result(function, size=1024):
    """A result whose rmse is a function of three numbers between 0 and 1."""
    x = sample_values({"method": "saltelli", "size": size, "seed": 1} | UNIT)
    ds = xr.Dataset({"rmse": function(*x.values())})
    ds["status"] = xr.zeros_like(ds.rmse, dtype=np.int8)
    return ds


def ishigami(x1, x2, x3):
    x1, x2, x3 = (2.0 * np.pi * x - np.pi for x in (x1, x2, x3))
    return np.sin(x1) + 7.0 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)


def test_a_saltelli_design_takes_one_parameter_after_the_other_from_b():
    x = sample_values({"method": "saltelli", "size": 64, "seed": 3} | UNIT)
    assert x["kp"].dims == ("sample", "design")
    assert x["kp"].design.values.tolist() == ["A", "B", "kp", "ti", "backlash"]
    for name, values in x.items():
        for label in x:
            expected = values.sel(design="B" if label == name else "A", drop=True)
            np.testing.assert_array_equal(values.sel(design=label), expected)
    a, b = (np.stack([v.sel(design=k).values for v in x.values()]) for k in "AB")
    assert np.abs(np.corrcoef(np.concatenate([a, b]))[~np.eye(6, dtype=bool)]).max() < 0.1


def test_indices_are_those_of_scipy():
    from scipy.stats import sobol_indices

    ds = result(ishigami, 512)
    indices = fc.sobol_indices(ds).rmse.sel(edge="value")
    f = {label: ds.rmse.sel(design=label).values for label in ds.design.values}
    theirs = sobol_indices(
        func={"f_A": f["A"][None], "f_B": f["B"][None], "f_AB": np.stack([f[n][None] for n in UNIT])}, n=512
    )
    np.testing.assert_allclose(indices.sel(index="first_order"), theirs.first_order, atol=1e-2)
    np.testing.assert_allclose(indices.sel(index="total"), theirs.total_order, atol=1e-2)


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    covered = []
    for seed in range(30):
        x = sample_values({"method": "saltelli", "size": 128, "seed": seed} | UNIT)
        ds = xr.Dataset({"rmse": x["kp"] + 2.0 * x["ti"] + 0.5 * x["backlash"]})
        ds["status"] = xr.zeros_like(ds.rmse, dtype=np.int8)
        indices = fc.sobol_indices(ds).rmse.sel(index="total", parameter="ti")
        covered.append(float(indices.sel(edge="low")) <= 4.0 / 5.25 <= float(indices.sel(edge="high")))
    assert np.mean(covered) > 0.85


def test_what_does_not_vary_has_no_indices():
    indices = fc.sobol_indices(result(lambda a, b, c: 0.0 * a + 3.3))
    assert bool(indices.rmse.isnull().all())


def test_failed_scenarios_are_refused_unless_they_are_to_be_left_out():
    ds = result(ishigami, 4096)
    ds["status"][5, 2] = ds["status"][9, 0] = STATUS_CRASHED
    with refuses(("drop_failed", "data")):
        fc.sobol_indices(ds)
    indices = fc.sobol_indices(ds, drop_failed=True)
    assert int(indices.rmse_n_samples) == 4094
    np.testing.assert_allclose(indices.rmse.sel(edge="value", index="total"), [0.5576, 0.4424, 0.2437], atol=0.02)


@pytest.mark.parametrize(
    "labels", [["backlash", "B", "ti", "A", "kp"], ["kp", "A", "B"]], ids=["other order", "one parameter"]
)
def test_the_design_is_read_by_its_labels(labels):
    ds = result(ishigami, 256)
    indices, whole = fc.sobol_indices(ds.sel(design=labels)).rmse, fc.sobol_indices(ds).rmse
    assert indices.parameter.values.tolist() == [label for label in labels if label in UNIT]
    xr.testing.assert_allclose(indices, whole.sel(parameter=indices.parameter))


@pytest.mark.parametrize(
    ("change", "options", "field", "code"),
    [
        (lambda ds: ds.isel(design=0), {}, "ds", "shape"),
        (lambda ds: ds.sel(design=["B", "kp", "ti"]), {}, "design", "shape"),
        (lambda ds: ds.sel(design=["A", "B"]), {}, "design", "shape"),
        (lambda ds: ds.sel(design=["A", "B", "kp", "kp"]), {}, "design", "duplicate"),
        (lambda ds: ds, {"metrics": ["rmsee"]}, "metrics", "name"),
        (lambda ds: ds, {"metrics": []}, "metrics", "missing"),
        (lambda ds: ds, {"metrics": ["status"]}, "metrics", "unsupported"),
        (lambda ds: ds.assign(learning_status=ds.status), {"metrics": "learning_status"}, "metrics", "unsupported"),
        (lambda ds: ds, {"level": "0.9"}, "level", "type"),
        (lambda ds: ds.drop_vars("status"), {}, "ds", "data"),
    ],
)
def test_a_mistake_gets_a_sentence(change, options, field, code):
    assert_refused(field, code, fc.sobol_indices, change(result(ishigami, 4)), **options)


@pytest.mark.kernel
def test_a_study_with_a_saltelli_design_runs(tmp_path):
    (tmp_path / "s.toml").write_text(
        '[loop]\npreset = "lbnl"\n[sample]\nmethod = "saltelli"\nsize = 16\nbacklash = { uniform = [0.02, 0.15] }\n'
        "kp = { loguniform = [0.01, 0.03] }\n[boundary]\nhours = 0.75\n"
    )
    ds = fc.run_study(tmp_path / "s.toml", tmp_path / "out")
    assert dict(ds.rmse.sizes) == {"sample": 16, "design": 4}
    indices = fc.sobol_indices(ds, ["rmse", "stem_travel"])
    assert indices.parameter.values.tolist() == ["backlash", "kp"]
    assert float(indices.rmse.sel(edge="value", index="total").max()) > 0.2


def test_indices_of_parameters_that_are_not_uniform_are_those_of_a_closed_form():
    """Of a sum of independent parameters the share of each is that of its variance, whatever its distribution."""
    shapes = {"kp": {"lognormal": [0.02, 0.5]}, "ti": {"beta": [2, 5, 0, 0.2]}, "backlash": {"normal": [0.4, 0.03]}}
    x = sample_values({"method": "saltelli", "size": 4096, "seed": 1} | shapes)
    ds = xr.Dataset({"rmse": x["kp"] + x["ti"] + x["backlash"]}, coords=x)
    ds["status"] = xr.zeros_like(ds.rmse, dtype=np.int8)
    variances = np.array([0.02**2 * np.exp(0.25) * (np.exp(0.25) - 1.0), 0.2**2 * 10.0 / (49.0 * 8.0), 0.03**2])
    indices = fc.sobol_indices(ds).rmse.sel(edge="value")
    for index in ("first_order", "total"):
        np.testing.assert_allclose(indices.sel(index=index), variances / variances.sum(), atol=0.01)


def test_correlated_parameters_are_refused():
    x = sample_values({"method": "saltelli", "size": 256, "seed": 1} | UNIT)
    x["ti"] = 0.5 * (x["ti"] + x["kp"])
    ds = xr.Dataset({"rmse": x["kp"] + x["ti"]}, coords=x)
    ds["status"] = xr.zeros_like(ds.rmse, dtype=np.int8)
    with refuses(("kp", "data")):
        fc.sobol_indices(ds)
