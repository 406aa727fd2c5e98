"""[run] precision: samples are drawn until the mean of a metric is known as precisely as asked."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.full import full_except
from helpers.refusals import assert_refused
from helpers.studies import run_until_stopped, write_study
from scipy import stats

import fastcoil as fc
from fastcoil.study.analysis.precision import MIN_BATCHES, Precision
from fastcoil.study.analysis.summary import summary
from fastcoil.study.file.sample import sample_values
from fastcoil.study.maintenance import status
from fastcoil.study.run import execute

SHAPES = {"kp": {"uniform": [0.0, 1.0]}, "ti": {"lognormal": [1.0, 0.5]}, "backlash": {"beta": [2, 5, 0, 1]}}
MEAN = 0.5**2 + 0.5 * np.exp(0.125) / 4.0 + float(stats.beta(2, 5).sf(0.4))


def made_metric(x):
    """A result like that of a loop: smooth, with a jump."""
    return x["kp"] ** 2 * 0.75 + x["ti"] / 8.0 + (x["backlash"] > 0.4)


def draw_results(method, seed, batches, size):
    x = sample_values({"method": method, "size": size, "seed": seed} | SHAPES, batches=batches)
    ds = xr.Dataset({"rmse": made_metric(x)})
    ds["status"] = xr.zeros_like(ds.rmse, dtype=np.int8)
    return ds


@pytest.mark.parametrize(("method", "half_width"), [("sobol", 0.02), ("random", 0.1)])
def test_the_mean_is_within_the_asked_half_width_at_least_as_often_as_is_said(method, half_width):
    precision = Precision("rmse", half_width, False, {}, size=8, most=8 * 48)
    whole, right, drew = draw_results(method, 1, 60 * 48, 8), 0, set()
    for study in range(60):
        ds = whole.isel(sample=slice(study * 384, (study + 1) * 384))
        n = next(n for n in precision.batch_counts if precision.is_enough(ds.isel(sample=slice(8 * n))))
        drew.add(n)
        right += abs(float(ds.rmse[: 8 * n].mean()) - MEAN) <= half_width
    assert drew == {32, 48}
    assert right >= 0.9 * 60


def test_the_half_width_is_that_of_students_interval_over_batches():
    means = np.random.default_rng(3).normal(2.0, 0.3, 20)
    rmse = (means[:, np.newaxis] + [-0.5, 0.5]).ravel()
    ds = xr.Dataset({"rmse": (("case", "sample"), np.stack([rmse, 3.0 * rmse]))}, {"case": ["a", "b"]})
    ds["status"] = xr.zeros_like(ds.rmse, dtype=np.int8)

    def halves(relative=False, **baseline):
        return Precision("rmse", 0.1, relative, baseline, 2, 200).half_widths(ds)[0].values

    low, high = stats.t(19, means.mean(), stats.sem(means)).interval(0.95)
    half = 0.5 * (high - low) * np.sqrt(19.0 / stats.chi2(19).ppf(0.05))
    np.testing.assert_allclose(halves(), [half, 3.0 * half])
    np.testing.assert_allclose(halves(relative=True), 2 * [half / means.mean()])
    np.testing.assert_allclose(halves(case="a"), [0.0, 2.0 * half])
    np.testing.assert_allclose(halves(relative=True, case="a"), [0.0, 0.0], atol=1e-15)


STUDY = """
title = "precise"
[loop]
preset = "lbnl"
[sample]
method = "{method}"
size = 2
backlash = {{ uniform = [0.02, 0.12] }}
kp = {{ lognormal = [0.01, 0.5] }}
[sweep]
estimate_ratio = [0.0, 1.0]
[boundary]
kind = "paper_day"
hours = 0.5
[run]
warm_up = 60
precision = {{ metric = "rmse", half_width = {half_width}, relative = true{more} }}
"""


def study_text(half_width=0.1, more="", method="sobol"):
    return STUDY.format(half_width=half_width, more=more, method=method)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A study that is judged three times."""
    out = tmp_path_factory.mktemp("whole") / "out"
    return execute(write_study(study_text(), out), out, n_jobs=1).results


@pytest.mark.kernel
def test_samples_are_drawn_until_every_case_is_as_precise_as_asked(whole):
    precision = Precision("rmse", 0.1, True, {}, 2, 256)
    n = whole.sizes["sample"] // 2
    assert n in precision.batch_counts[1:-1]
    for judged in precision.batch_counts:
        enough = precision.reached_half_width(whole.isel(sample=slice(2 * judged))) <= 0.1
        assert enough == (judged == n)
        if enough:
            break
    reached = json.loads(whole.attrs["precision_reached"])
    assert reached == {"half_width": precision.reached_half_width(whole), "samples": 2 * n, "reached": True}
    (line,) = [line for line in summary(whole) if line.startswith("Precision")]
    assert line.startswith("Precision: mean of rmse to ± 10 % (95 %); ± ")
    assert line.endswith(f"in the least certain of 2 cases from {2 * n} samples.")


@pytest.mark.kernel
@pytest.mark.parametrize("shards", full_except([1, 2], [2]))
def test_an_interrupted_study_draws_the_same_samples(whole, tmp_path, shards, monkeypatch):
    monkeypatch.setattr("fastcoil.loops.plan._LANE_STEPS_PER_SHARD", 1.0)
    out = tmp_path / "out"
    study = write_study(study_text(), out)
    run_until_stopped(study, out, shards)
    assert status(out)[1].startswith("Unfinished")
    resumed = execute(study, out, n_jobs=2).results
    assert resumed.attrs["content_sha256"] == whole.attrs["content_sha256"]
    assert execute(study, out, n_jobs=1).n_run == 0
    assert fc.open_study(out).sizes["sample"] == whole.sizes["sample"]


@pytest.mark.kernel
def test_a_study_that_was_stopped_between_two_rounds_goes_on(whole, tmp_path):
    out = tmp_path / "out"
    study = write_study(study_text(), out)

    def stop(n_missing, n, what):
        if "asked" in what:
            raise KeyboardInterrupt
        return lambda n: None

    with pytest.raises(KeyboardInterrupt):
        execute(study, out, n_jobs=1, progress=stop)
    lines = status(out)
    assert lines[1].startswith("Unfinished: 128 of 128")
    assert lines[2].endswith("from 64 samples: draw more.")
    assert lines[-1].startswith("To resume")
    assert (
        fc.run_study(out.with_name("study.toml"), out, n_jobs=1).attrs["content_sha256"]
        == whole.attrs["content_sha256"]
    )


@pytest.mark.kernel
def test_more_precision_extends_a_study_and_changes_no_sample(whole, tmp_path):
    plain, out = tmp_path / "plain", tmp_path / "out"
    without_precision = study_text().replace("precision", "# precision")
    execute(write_study(without_precision, plain), plain, n_jobs=1)
    execute(write_study(study_text(), plain), plain, n_jobs=1, extend=True)
    xr.testing.assert_equal(fc.open_study(plain), whole)
    extended = execute(write_study(study_text(0.08), plain), plain, n_jobs=1, extend=True)
    fresh = execute(write_study(study_text(0.08), out), out, n_jobs=1)
    assert extended.results.attrs["content_sha256"] == fresh.results.attrs["content_sha256"]
    assert 0 < extended.n_run < fresh.n_run
    first = fresh.results.isel(sample=slice(whole.sizes["sample"]))
    xr.testing.assert_equal(first, whole)


@pytest.mark.kernel
def test_a_study_that_ends_at_its_cap_says_so(tmp_path):
    out = tmp_path / "out"
    study = write_study(study_text(0.001, ", most = 70", "latin_hypercube"), out)
    ds = execute(study, out, n_jobs=1).results
    assert ds.sizes["sample"] == 70
    assert json.loads(ds.attrs["precision_reached"])["reached"] is False
    assert status(out)[2].endswith("from 70 samples, the most allowed: raise most, or half_width.")
    assert status(out)[1].startswith("Finished")


MISTAKES = [
    ('metric = "rmsee", half_width = 0.1', "metric", "choice"),
    ('metric = "rmse", half_width = 0.0', "half_width", "value"),
    ('metric = "rmse", half_width = -1', "half_width", "value"),
    ('metric = "rmse", half_width = 0.1, most = 20', "most", "value"),
    ('metric = "rmse", half_width = 0.1, baseline = { ratio = 0 }', "baseline", "name"),
    ('metric = "rmse", half_width = 0.1, baseline = { estimate_ratio = 2 }', "baseline", "choice"),
    ("half_width = 0.1", "metric", "missing"),
    ('metric = "rmse", half_width = "narrow"', "half_width", "type"),
    ('metric = "rmse", halfwidth = 0.1, half_width = 1', "halfwidth", "name"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "field", "code"), MISTAKES)
def test_a_mistake_gets_one_sentence(tmp_path, table, field, code):
    text = study_text().replace('metric = "rmse", half_width = 0.1, relative = true', table)
    assert_refused(field, code, write_study, text.replace("hours = 0.5", "hours = 1"), tmp_path / "out")


def test_precision_needs_independent_samples(tmp_path):
    assert_refused("method", "conflict", write_study, study_text(method="saltelli"), tmp_path / "out")


def test_the_fewest_batches_are_drawn_first(tmp_path):
    study = write_study(study_text(), tmp_path / "out")
    assert (study.batches, study.plan.layout.loop.sizes["sample"]) == (MIN_BATCHES, 2 * MIN_BATCHES)
    assert study.precision.batch_counts == [32, 48, 72, 108, 128]
