"""``[run] predict``: what theory foretells stands beside what was simulated, the same however a study was run."""

import netCDF4
import numpy as np
import pytest
from helpers.processes import cut_studies
from helpers.studies import run, run_until_interrupted, write_study

import fastcoil as fc
from fastcoil.design.prediction import predict_study
from fastcoil.loops.plan import plan_simulation
from fastcoil.model.metric_table import PREDICTIONS
from fastcoil.study import maintenance
from fastcoil.study.analysis.summary import summary
from fastcoil.study.run import execute

pytestmark = pytest.mark.kernel

SILENT = """
[loop]
preset = "lbnl"
[sweep]
kp = [0.02, 0.12]
backlash = [0.0, 0.07]
[boundary]
hours = 1
seed = [1, 2]
[run]
warm_up = 600
replicates = 2
"""
STUDY = SILENT + "predict = true\n"
LARGER = STUDY.replace("[0.02, 0.12]", "[0.02, 0.05, 0.12]")


@pytest.fixture(scope="module")
def ds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("foretold") / "out"
    run(STUDY, folder)
    return fc.open_study(folder).load()


def test_it_is_what_limit_cycle_says_of_the_mean_of_each_day(ds):
    loop = fc.Loop.preset("lbnl").assign(kp=[0.02, 0.12], backlash=[0.0, 0.07])
    day = fc.paper_day(hours=1, seed=[1, 2])
    for k in range(2):  # days that last as they are on the mean of what counts
        mean = {name: float(series[k, 600:].mean()) for name, series in day.series.items() if name != "enabled"}
        held = fc.Boundary(
            **{name: np.full(3600, mean[name]) for name in ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")}
        )
        expected = fc.limit_cycle(loop, held)
        for replicate in range(2):
            results = ds.isel(day=k, replicate=replicate)
            for name, of in (("hunting_index", 1.0), ("hunts", 1.0), ("period", 1.0), ("amplitude", 2.0)):
                ours = results["predicted_swing" if name == "amplitude" else f"predicted_{name}"]
                np.testing.assert_allclose(ours.transpose(*expected[name].dims), of * expected[name], rtol=2e-3)
    assert set(np.unique(ds.predicted_hunts)) == {0.0, 1.0}


def test_it_says_which_loops_hunt_when_they_are_simulated(ds):
    predicted, simulated = ds.predicted_hunts.values.ravel().tolist(), ds.hunts.values.ravel().tolist()
    agree = sum(a == b for a, b in zip(predicted, simulated, strict=True)) / len(predicted)
    (line,) = (line for line in summary(ds) if line.startswith("Hunting: "))
    percentage = f"{100 * agree:.1f}"
    counts = f"predicted for {predicted.count(1.0)} of 16 loops, seen in {simulated.count(1.0)}"
    assert line == f"Hunting: {counts}; {percentage} % agree."
    assert agree >= 0.5
    opposite = ds.assign(predicted_hunts=(1.0 - ds.hunts).where(ds.backlash > 0.0))  # and half of them nobody knows
    (line,) = (line for line in summary(opposite) if line.startswith("Hunting: "))
    assert " of 8 loops" in line
    assert line.endswith("; 0.0 % agree.")


def test_it_does_not_depend_on_shards_workers_interruptions_and_extensions(ds, tmp_path, monkeypatch):
    golden = ds.attrs["content_sha256"]
    cut_studies(monkeypatch, 3)
    (tmp_path / "a").mkdir()
    run_until_interrupted(STUDY, tmp_path / "a" / "out", 2)
    assert run(STUDY, tmp_path / "a" / "out", n_jobs=2) == golden
    (tmp_path / "b").mkdir()
    whole = run(LARGER, tmp_path / "b" / "out")
    assert run(LARGER, tmp_path / "a" / "out", extend=True) == whole
    assert maintenance.verify(tmp_path / "a" / "out") == []


def test_it_is_added_to_a_study_that_was_run_without_it(ds, tmp_path):
    out = tmp_path / "out"
    run(SILENT, out)
    assert not PREDICTIONS.keys() & fc.open_study(out).data_vars.keys()
    finished = execute(write_study(STUDY, out), out, n_jobs=1, extend=True)
    assert finished.n_run == 0
    assert finished.results.attrs["content_sha256"] == ds.attrs["content_sha256"]
    with netCDF4.Dataset(out / "results.nc", "a") as file:
        file["predicted_hunting_index"][0] = file["predicted_hunting_index"][0] + 1e-5
    assert "results.nc is damaged" in maintenance.verify(out)[0]


def test_where_theory_says_nothing_it_is_nan_and_says_why(tmp_path):
    text = STUDY.replace("[sweep]", "[sweep]\nerror_dead_band = [0.0, 0.2]").replace("seed = [1, 2]", "seed = 1")
    run(text, tmp_path / "out")
    with fc.open_study(tmp_path / "out") as results:
        is_predicted = results.predicted_hunting_index.notnull().all(
            [d for d in results.predicted_hunting_index.dims if d != "error_dead_band"]
        )
        assert is_predicted.values.tolist() == [True, False]
        assert results.predicted_hunts.isel(error_dead_band=1).isnull().all()
        assert "an error_dead_band stops small cycles" in results.attrs["prediction_note"]
        assert "4 of 8" in results.attrs["prediction_note"]
        (line,) = (line for line in summary(results.load()) if line.startswith("Hunting: "))
    assert " of 8 loops" in line


@pytest.mark.parametrize(("carry_over", "foretold"), [(False, [False, False]), (True, [False, True])])
def test_only_the_first_of_days_in_sequence_has_a_warm_up(carry_over, foretold):
    enabled = np.zeros((2, 1800))
    enabled[:, :500] = 1.0
    days = fc.Boundary(m_a=1.2, T_a_in=25.0, W_a_in=0.011, T_w_in=7.0, T_set=14.0, enabled=enabled)
    plan = plan_simulation(fc.Loop.preset("lbnl"), days, warm_up=600, carry_over=carry_over)
    assert np.isfinite(predict_study(plan)["predicted_hunting_index"]).values.tolist() == foretold
