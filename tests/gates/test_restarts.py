"""A command that is killed at any step and given again leaves the same files as one that was never killed: all of them.

The steps are the moments before a file gets its name: run.json, study.toml, each shard, traces, results.nc, each
figure.
"""

import json
import re
import shutil

import pytest
import xarray as xr
from helpers.studies import TRACED_STUDY

from fastcoil.study import maintenance
from fastcoil.study.folder.results import open_study

pytestmark = pytest.mark.kernel

STUDY = TRACED_STUDY.replace("estimate_ratio = [0.0, 0.9]", "").replace(
    "[boundary]", "[cases.inverse]\nwithout = { estimate_ratio = 0.0 }\nfitted = { estimate_ratio = 0.95 }\n[boundary]"
)
"""Two figures."""
FIGURES = ["figures/bands.png", "figures/inverse.png"]
FILES_IN_ORDER = ["run.json", "study.toml", "traces-*.nc", "results.nc", "answer.json", *FIGURES]
"""What gets its name in this order, the shards after the second."""
RUN_ATTRIBUTES = ("date_created", "history", "wall_time_s", "scenario_days_per_s", "n_jobs", "engine")
"""Attributes that say when, how fast and by which workers."""


@pytest.fixture
def command(run_forked, out):
    """Run the study with figures: exit code, number of files that got their name, what it said."""

    def run(*words, **order):
        words = ["run", str(out.with_name("study.toml")), "-o", str(out), *words]
        return run_forked(STUDY, out, arguments=words, of="replace", **order)

    return run


@pytest.fixture(scope="module")
def undisturbed_run(run_forked, tmp_path_factory):
    """All files of a command that was not disturbed, and how many got a name."""
    out = tmp_path_factory.mktemp("undisturbed_run") / "out"
    words = ["run", str(out.with_name("study.toml")), "-o", str(out), "-j", "1"]
    code, steps, output = run_forked(STUDY, out, arguments=words, of="replace")
    assert code == 0, output
    return folder_contents(out), steps


def folder_contents(out):
    """All that is in the folder of a study, but for what says when and by which workers it was computed."""
    contents = {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        name = str(path.relative_to(out))
        if path.suffix == ".nc":
            contents[name] = netcdf(path)
        elif name == "run.json":
            contents[name] = manifest(path)
        else:
            contents[name] = path.read_bytes()
    return contents | {f"{p.relative_to(out)}/": None for p in out.rglob("*") if p.is_dir()}


def netcdf(path):
    """Values and attributes of a file."""
    with xr.open_dataset(path, decode_times=False, decode_timedelta=False) as ds:
        ds.load()
    ds.attrs = {k: v for k, v in ds.attrs.items() if k not in RUN_ATTRIBUTES}
    return ds


def manifest(path):
    """The manifest; of the files that say when they were made, that their hashes are there."""
    entries = json.loads(path.read_text())
    volatile = {"outputs", "checksum", "sha256", "finished", "relative_to"}
    return {k: re.sub("[0-9a-f]{64}", "hash", json.dumps(v)) if k in volatile else v for k, v in entries.items()}


def check_same(contents, expected):
    """The same files, with the same contents."""
    assert list(contents) == list(expected)
    for name, content in expected.items():
        if isinstance(content, xr.Dataset):
            xr.testing.assert_identical(contents[name], content)
        elif name == "run.json":
            expected_entries = {k: v for k, v in content.items() if k != "relative_to"}
            assert {k: v for k, v in contents[name].items() if k != "relative_to"} == expected_entries
        else:
            assert contents[name] == content, name


def kill_and_restart(command, out, undisturbed_run, step, *words):
    """Kill a command before a file gets its name, and give it again, perhaps to other workers."""
    expected, _ = undisturbed_run
    shutil.rmtree(out, ignore_errors=True)
    code, n_named, output = command("-j", "1", kill_before=step)
    assert (code, n_named) == (-9, step), output
    code, _, output = command(*words)
    assert code == 0, output
    assert "note:" not in output
    check_same(folder_contents(out), expected)
    assert maintenance.verify(out) == []
    assert open_study(out).attrs["content_sha256"] == expected["results.nc"].attrs["content_sha256"]
    # once more: all of it is found, none of it is made again
    modified_before = {p: p.stat().st_mtime_ns for p in out.rglob("*.*") if p.is_file() and not p.name.startswith(".")}
    code, _, output = command()
    assert code == 0, output
    assert {p: p.stat().st_mtime_ns for p in modified_before} == modified_before


def test_a_command_that_is_killed_and_given_again_leaves_the_same_files(command, out, undisturbed_run):
    contents, steps = undisturbed_run
    file_names = [name for name in contents if not name.endswith("/") and not name.startswith(".")]
    assert len(file_names) == len(FILES_IN_ORDER)
    assert steps > len(FILES_IN_ORDER)  # the shards too
    kill_and_restart(command, out, undisturbed_run, steps, "-j", "2")


@pytest.mark.full
def test_a_command_that_is_killed_at_any_step_leaves_the_same_files(command, out, undisturbed_run):
    for step in range(1, undisturbed_run[1] + 1):
        kill_and_restart(command, out, undisturbed_run, step, "-j", "3")
