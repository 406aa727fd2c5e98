"""Studies larger than the memory: merged, hashed, opened and summarised piece by piece, with the same results."""

import mmap
import tracemalloc
import warnings

import numpy as np
import pytest
from helpers.commands import fastcoil
from helpers.processes import cut_studies
from helpers.studies import (
    PLAIN_STUDY,
    TRACED_STUDY,
    copy_run,
    resume_to_end,
    run,
    run_until_interrupted,
    shard_files,
    undisturbed_hash,
    verify_unchanged,
    with_larger_sweep,
    write_study,
)

import fastcoil as fc
from fastcoil.base import arrays
from fastcoil.base.errors import StorageError
from fastcoil.loops import netcdf
from fastcoil.loops.provenance import variable_sha256
from fastcoil.loops.scenarios import join_flat
from fastcoil.loops.simulate import estimate_run_time
from fastcoil.model.metric_table import METRICS
from fastcoil.study import run as runner
from fastcoil.study.analysis.summary import summary
from fastcoil.study.folder import merged, results, state, stored
from fastcoil.study.maintenance import status

pytestmark = pytest.mark.kernel

VOLUMES = TRACED_STUDY.replace('["T_sup", "mode"]', '["mode", "T_c", "T_sup"]')
SEQUENCE = TRACED_STUDY + "carry_over = true\n"


def is_on_disk(values):
    """Whether an array is in a file, and takes no memory of its own."""
    while isinstance(values.base, np.ndarray):
        values = values.base
    return isinstance(values.base, mmap.mmap)


def require_status_only(part):
    """A part, which has nothing else."""
    assert [*part.data_vars] == ["status"]
    return part


@pytest.fixture
def slabs_of_one(monkeypatch):
    """Every slab has one scenario, and every chunk some points of it."""
    monkeypatch.setattr(netcdf, "_SLAB_VALUES", 1)
    monkeypatch.setattr(netcdf, "_CHUNK_VALUES", 5)


# --- the merge --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [VOLUMES, pytest.param(SEQUENCE, marks=pytest.mark.full)], ids=["volumes", "sequence"])
def test_hashes_are_those_of_whole_arrays(out, text, slabs_of_one):
    loop = fc.Loop(noise_std=0.02, backlash=[0.02, 0.07], estimate_ratio=[0.0, 0.9])
    names = ["T_sup", "mode", *(["T_c"] if text == VOLUMES else [])]
    whole = fc.simulate(
        loop, fc.paper_day(hours=0.25, seed=[1, 2, 3]), warm_up=100, traces=names, trace_interval=50,
        carry_over=text == SEQUENCE,
    )  # fmt: skip
    assert run(text, out) == undisturbed_hash(text)
    ds = fc.open_study(out)
    for name in names:
        assert variable_sha256(whole[name].variable) == variable_sha256(ds[name].variable), name
        assert ds[name].identical(whole[name]), name
    assert verify_unchanged(out) == []
    assert run(with_larger_sweep(text), out, extend=True) == undisturbed_hash(with_larger_sweep(text))
    assert verify_unchanged(out) == []


@pytest.mark.parametrize(
    ("error", "extend"), [(StorageError("no room"), False), (KeyboardInterrupt, True)], ids=["full", "killed"]
)
def test_a_merge_that_ends_among_its_slabs_is_done_again(out, monkeypatch, slabs_of_one, error, extend):
    text = with_larger_sweep(SEQUENCE) if extend else SEQUENCE
    if extend:
        copy_run(SEQUENCE, out)
        before = {path.name: path.read_bytes() for path in out.glob("*.nc")}
    begun, original = [], netcdf.trace_slabs

    class EndingSlabs(list):
        def __iter__(self):
            begun.append(self[0])
            yield self[0]
            if len(begun) == 2:  # the second trace
                raise error
            yield from self[1:]

    def slabs_that_end(*words):
        slabs, chunk = original(*words)
        return EndingSlabs(slabs), chunk

    with monkeypatch.context() as patched:
        patched.setattr(netcdf, "trace_slabs", slabs_that_end)
        with pytest.raises((KeyboardInterrupt, StorageError)):
            run(text, out, extend=extend)
    assert shard_files(out)
    assert verify_unchanged(out) == []
    if extend:
        assert {path.name: path.read_bytes() for path in out.glob("*.nc")} == before
    resume_to_end(out, text, extend=extend)


@pytest.mark.full
def test_the_memory_of_a_merge_does_not_grow_with_the_study(tmp_path, monkeypatch):
    monkeypatch.setattr(netcdf, "_SLAB_VALUES", 2**16)
    monkeypatch.setattr(netcdf, "_CHUNK_VALUES", 2**12)
    cut_studies(monkeypatch, 2)
    original, peaks, sizes = runner.publish_results, [], []

    def publish(study_run, *words):
        tracemalloc.start()
        try:
            return original(study_run, *words)
        finally:
            peaks.append(tracemalloc.get_traced_memory()[1])
            sizes.append(study_run.study.plan.trace_bytes)
            tracemalloc.stop()

    monkeypatch.setattr(runner, "publish_results", publish)
    text = TRACED_STUDY.replace('"T_sup", "mode"', '"T_c"').replace("interval = 50", "interval = 1")
    text = text.replace("hours = 0.25", "hours = 0.5")
    for k, days in enumerate((1, 2, 4)):  # the first imports what is needed
        run(text.replace("seed = [1, 2, 3]", f"seed = {[*range(days)]}"), tmp_path / str(k))
    assert sizes[2] == 4 * sizes[0] > 2**18
    assert peaks[2] - peaks[1] < 0.4 * (sizes[2] - sizes[1]), (peaks, sizes)


def test_an_extension_reads_earlier_results_some_scenarios_at_a_time(out, monkeypatch):
    copy_run(PLAIN_STUDY, out)
    original, sizes = merged.StudyRun._earlier_parts, []

    def counted(*words):
        for part in original(*words):
            sizes.append(part.sizes["scenario"])
            yield part

    monkeypatch.setattr(merged, "_VALUES_AT_ONCE", 2 * (len(METRICS) + 1))  # values of two scenarios
    monkeypatch.setattr(state, "_SCENARIOS_AT_ONCE", 5)
    monkeypatch.setattr(merged.StudyRun, "_earlier_parts", counted)
    assert run(with_larger_sweep(PLAIN_STUDY), out, extend=True) == undisturbed_hash(with_larger_sweep(PLAIN_STUDY))
    assert sizes == [2] * 6


def test_a_run_keeps_no_shard_for_a_comparison_with_later_ones(out, monkeypatch):
    cut_studies(monkeypatch, 2)
    original, firsts = merged.StudyRun.commit, []

    def commit(study_run, part):
        original(study_run, part)
        firsts.append(study_run._first_scenario)

    monkeypatch.setattr(merged.StudyRun, "commit", commit)
    assert run(TRACED_STUDY, out) == undisturbed_hash(TRACED_STUDY)
    assert [first.sizes["scenario"] for first in firsts] == [1] * len(firsts) != []


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_what_is_left_on_the_disk_is_foreseen(out, noise):
    text = TRACED_STUDY.replace("[sweep]\nbacklash = [0.02, 0.07]", "[sweep]\nbacklash = { linspace = [0.0, 0.1, 70] }")
    text = text.replace("interval = 50", "interval = 1").replace("std = 0.02", f"std = {noise}")
    plan = write_study(text, out).plan
    run(text, out)
    _, metrics, traces = estimate_run_time(plan, 1)
    _, foreseen = plan.disk_bytes(metrics_left=metrics, traces_left=traces)
    assert foreseen == pytest.approx(sum(path.stat().st_size for path in out.glob("*.nc")), rel=0.2)
    assert traces < 0.7


# --- opened -----------------------------------------------------------------------------------------------------------


def test_traces_have_chunks_for_dask_that_are_read_one_by_one(out, slabs_of_one, monkeypatch):
    pytest.importorskip("dask")
    run(VOLUMES, out)
    ds, read = fc.open_study(out), netcdf._LazyVariable._read
    chunks = ds["T_c"].encoding["preferred_chunks"]
    assert chunks == {"day": 1, "backlash": 1, "estimate_ratio": 1, "volume": 8, "elapsed_time": 18}
    shapes = []

    def counted(self, key):
        shapes.append(read(self, key).shape)
        return read(self, key)

    monkeypatch.setattr(netcdf._LazyVariable, "_read", counted)
    hottest = ds["T_c"].chunk(chunks).max("elapsed_time")
    assert shapes == []
    np.testing.assert_array_equal(hottest.values, ds["T_c"].load().max("elapsed_time").values)
    assert shapes[:-1] == [(1, 1, 1, 8, 18)] * 12


@pytest.mark.usefixtures("blank_figures")
def test_a_summary_a_report_a_figure_and_a_status_load_no_trace(out, tmp_path, monkeypatch):
    text = TRACED_STUDY.replace("backlash = [0.02", "backlash = [0.0, 0.02")
    run(text, out)
    monkeypatch.setattr(netcdf._LazyVariable, "_read", None)
    assert summary(fc.open_study(out))
    for words in (
        ["report", out, "-o", tmp_path / "report.html"],
        ["plot", out, "-x", "backlash", "-o", tmp_path / "figure.png"],
        ["status", out], ["cite", out], ["run", out.with_name("study.toml"), "-o", out],
    ):  # fmt: skip
        command = fastcoil(*words)
        assert command.exit_code == 0, command.output


def test_an_unfinished_study_is_opened_without_traces_that_do_not_fit(out, monkeypatch):
    run_until_interrupted(TRACED_STUDY, out, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fc.open_study(out)["T_sup"].shape == (3, 2, 2, 18)
    monkeypatch.setattr(results, "available_memory", lambda: 1000)
    with pytest.warns(UserWarning, match="unfinished, and its traces, .* KiB, do not fit into memory: they are left"):
        ds = fc.open_study(out)
    assert "T_sup" not in ds
    monkeypatch.setattr(arrays, "MEMMAP_MIN_BYTES", 0)
    assert is_on_disk(results.open_metrics(out)["rmse"].values)
    assert int((ds["status"] == 0).sum()) == 8
    monkeypatch.setattr(
        results, "join_flat", lambda n, parts, **_: join_flat(n, (require_status_only(p) for p in parts))
    )
    assert "Unfinished: 8 of 12 scenarios (8 ok, 4 not_run)" in status(out)


@pytest.mark.full
def test_metrics_that_stay_on_the_disk_are_the_same(out, monkeypatch):
    text = TRACED_STUDY
    copy_run(text, out)
    eager = fc.open_study(out).load()
    monkeypatch.setattr(stored, "_MAX_LOADED_BYTES", 0)
    monkeypatch.setattr(arrays, "MEMMAP_MIN_BYTES", 0)
    lazy = fc.open_study(out)
    assert not isinstance(lazy["rmse"].variable._data, np.ndarray)
    assert [*lazy.data_vars] == [*eager.data_vars]
    assert lazy.load().identical(eager)
    assert is_on_disk(lazy["rmse"].values)
    assert verify_unchanged(out) == []
    assert run(text, out) == undisturbed_hash(text)
    assert run(with_larger_sweep(text), out, extend=True) == undisturbed_hash(with_larger_sweep(text))
