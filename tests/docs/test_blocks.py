"""Every block of code on a page is run, or is named here with what is checked instead."""

import subprocess
import sys
from types import SimpleNamespace

import click
import pytest
from helpers.commands import fastcoil
from helpers.processes import child_environment
from helpers.studies import PLAIN_STUDY, undisturbed_hash
from test_pages import PAGES, blocks, commands, is_named

import fastcoil as fc

RUN_IN_ORDER = {"python", "toml", "sh", "text"}
"""Kinds of blocks that ``test_pages`` runs, or compares with what is printed, on every page with Python."""
CHECKED_ELSEWHERE = {
    ("README.md", "console"): "what it prints is compared with the page on diagnosis, in test_pages",
    ("docs/clusters.md", "sh"): "needs a network: names and options are checked, here and in test_pages",
    ("docs/model.md", "math"): "drawn when the site is built",
    ("docs/first-steps.md", "console"): "opens a page and waits: tests/deliver/explore do that",
    ("docs/own-rule.md", "diff"): "applied and tried in test_extending",
    ("docs/hand-over.md", "console"): "run in test_pages, where there is a compiler",
    ("docs/findings/paper.md", "sh"): "minutes of simulation: tests/studies/paper runs it in parts",
    ("docs/clusters.md", "text"): "what `fastcoil plan` says of a study with its own code",
    ("docs/clusters.md", "yaml"): "settings of dask",
    ("docs/clusters.md", "bash"): "run below, without a queue",
    ("docs/clusters.md", "py"): "run below, without a queue",
}


def test_every_block_is_run_or_named():
    not_run = set()
    for page in PAGES:
        kinds = {kind for kind, _ in blocks(page)}
        not_run |= {(is_named(page), kind) for kind in kinds - (RUN_IN_ORDER if "python" in kinds else set())}
    assert not_run == set(CHECKED_ELSEWHERE)


def blocks_of_kind(page, kind):
    """The blocks of a kind on a page of ``docs/``."""
    (path,) = (path for path in PAGES if is_named(path) == f"docs/{page}")
    return [text for _, text in blocks(path, kind)]


def test_the_options_of_dask_exist():
    cli = pytest.importorskip("distributed.cli", reason="dask is an extra")
    from distributed.cli import dask_scheduler, dask_worker

    assert cli
    all_commands = [words for text in blocks_of_kind("clusters.md", "sh") for words in commands(text)]
    dask_commands = [words for words in all_commands if words[0] == "dask"]
    assert {words[1] for words in dask_commands} == {"scheduler", "worker"}
    for _, name, *words in dask_commands:
        command = dask_scheduler.main if name == "scheduler" else dask_worker.main
        assert isinstance(command, click.Command)
        options_known = {option for p in command.params for option in p.opts}
        assert {word for word in words if word.startswith("--")} <= options_known


@pytest.mark.kernel
@pytest.mark.parametrize("kind", ["SLURM", "PBS"])
def test_the_scripts_for_job_arrays_run(kind, tmp_path, monkeypatch):
    """By bash alone: ``sbatch`` is a function that runs one task of the array; what depends on it runs the rest.

    What bash calls is noted, and called here afterwards.
    """
    (tmp_path / "study.toml").write_text(PLAIN_STUDY)
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    command = tmp_path / ".venv" / "bin" / "fastcoil"
    command.write_text('#!/bin/sh\necho "$@" >> called\n')
    command.chmod(0o755)
    array, merge, submit, pbs = blocks_of_kind("clusters.md", "bash")
    (tmp_path / "array.sh").write_text(array if kind == "SLURM" else pbs)
    (tmp_path / "merge.sh").write_text(merge)
    (tmp_path / "bash").write_text(
        "set -e\nexport SLURM_CPUS_PER_TASK=1 PBS_O_WORKDIR=$PWD\nsbatch() {\n"
        "for k in $([ $2 = array.sh ] && echo 3 || echo 0)\n"
        "do SLURM_ARRAY_TASK_ID=$k PBS_ARRAY_INDEX=$k bash $2; done\n"
        f"}}\n{submit}"
    )
    subprocess.run(["bash", "bash"], cwd=tmp_path, env=child_environment(), timeout=300, check=True)
    monkeypatch.chdir(tmp_path)
    task, merge = (tmp_path / "called").read_text().splitlines()
    for words in (task, merge):
        result = fastcoil(*words.split(), "--no-figures")
        assert result.exit_code == 0, result.output
        assert "finished: nothing to do" not in result.output
    assert "--shard 3/8" in task
    assert fc.open_study(tmp_path / "results" / "study").attrs["content_sha256"] == undisturbed_hash(PLAIN_STUDY)


@pytest.mark.kernel
def test_the_script_for_dask_jobqueue_runs(tmp_path, monkeypatch):
    """Without a cluster, which tests/study/workers has: what it asks for is run here."""

    class Cluster:
        scheduler_address, scale = "tcp://127.0.0.1:8786", lambda self, jobs: None

        def __init__(self, cores, processes, memory, walltime):
            assert cores == processes

        __enter__, __exit__ = lambda self: self, lambda *_: None

    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "dask_jobqueue", SimpleNamespace(SLURMCluster=Cluster))
    (tmp_path / "study.toml").write_text(PLAIN_STUDY)
    run = fc.run_study

    def run_here(*words, backend, scheduler, **options):
        assert (backend, scheduler) == ("dask", Cluster.scheduler_address)
        return run(*words, **options)

    monkeypatch.setattr(fc, "run_study", run_here)
    exec(blocks_of_kind("clusters.md", "py")[0], {"__name__": "__main__"})
    assert fc.open_study("results/study").attrs["content_sha256"] == undisturbed_hash(PLAIN_STUDY)
