"""A command that is killed at any step and given again leaves the same files as one that was never killed: all of them.

The steps are the moments before a file gets its name: run.json, study.toml, each shard, traces, results.nc, each
figure.
"""

import json
import re
import shutil

import pytest
import xarray as xr
from helpers.studies import TRACED

from fastcoil.study import maintenance
from fastcoil.study.folder.results import open_study

pytestmark = pytest.mark.kernel

STUDY = TRACED.replace("estimate_ratio = [0.0, 0.9]", "").replace(
    "[boundary]", "[cases.inverse]\nwithout = { estimate_ratio = 0.0 }\nfitted = { estimate_ratio = 0.95 }\n[boundary]"
)
"""Two figures."""
FILES = ["run.json", "study.toml", "traces-*.nc", "results.nc", "figures/bands.png", "figures/inverse.png"]
"""What gets its name in this order, the shards after the second."""
OF_THE_RUN = ("date_created", "history", "wall_time_s", "scenario_days_per_s", "n_jobs", "engine")
"""Attributes that say when, how fast and by which workers."""


@pytest.fixture
def command(forked, out):
    """Run the study with figures: exit code, number of files that got their name, what it said."""

    def run(*words, **order):
        words = ["run", str(out.with_name("study.toml")), "-o", str(out), *words]
        return forked(STUDY, out, arguments=words, of="replace", **order)

    return run


@pytest.fixture(scope="module")
def undisturbed(forked, tmp_path_factory):
    """All files of a command that was not disturbed, and how many got a name."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    words = ["run", str(out.with_name("study.toml")), "-o", str(out), "-j", "1"]
    code, steps, said = forked(STUDY, out, arguments=words, of="replace")
    assert code == 0, said
    return everything(out), steps


def everything(out):
    """All that is in the folder of a study, but for what says when and by which workers it was computed."""
    found = {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        name = str(path.relative_to(out))
        if path.suffix == ".nc":
            found[name] = netcdf(path)
        elif name == "run.json":
            found[name] = manifest(path)
        else:
            found[name] = path.read_bytes()
    folders = {f"{p.relative_to(out)}/": None for p in out.rglob("*") if p.is_dir()}
    return found | folders


def netcdf(path):
    """Values and attributes of a file."""
    with xr.open_dataset(path, decode_times=False, decode_timedelta=False) as ds:
        ds.load()
    ds.attrs = {k: v for k, v in ds.attrs.items() if k not in OF_THE_RUN}
    return ds


def manifest(path):
    """The manifest; of the files that say when they were made, that their hashes are there."""
    found = json.loads(path.read_text())
    volatile = {"outputs", "checksum", "sha256", "finished", "relative_to"}
    return {k: re.sub("[0-9a-f]{64}", "hash", json.dumps(v)) if k in volatile else v for k, v in found.items()}


def check_same(found, expected):
    """The same files, with the same contents."""
    assert list(found) == list(expected)
    for name, content in expected.items():
        if isinstance(content, xr.Dataset):
            xr.testing.assert_identical(found[name], content)
        elif name == "run.json":
            known = {k: v for k, v in content.items() if k != "relative_to"}
            assert {k: v for k, v in found[name].items() if k != "relative_to"} == known
        else:
            assert found[name] == content, name


def kill_and_restart(command, out, undisturbed, step, *words):
    """Kill a command before a file gets its name, and give it again, perhaps to other workers."""
    expected, _ = undisturbed
    shutil.rmtree(out, ignore_errors=True)
    code, done, said = command("-j", "1", kill_before=step)
    assert (code, done) == (-9, step), said
    code, _, said = command(*words)
    assert code == 0, said
    assert "note:" not in said
    check_same(everything(out), expected)
    assert maintenance.verify(out) == []
    assert open_study(out).attrs["content_sha256"] == expected["results.nc"].attrs["content_sha256"]
    # once more: all of it is found, none of it is made again
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.*") if p.is_file() and not p.name.startswith(".")}
    code, _, said = command()
    assert code == 0, said
    assert {p: p.stat().st_mtime_ns for p in before} == before


def test_a_command_that_is_killed_and_given_again_leaves_the_same_files(command, out, undisturbed):
    found, steps = undisturbed
    kept = [name for name in found if not name.endswith("/") and not name.startswith(".")]
    assert len(kept) == len(FILES)
    assert steps > len(FILES)  # the shards too
    kill_and_restart(command, out, undisturbed, steps, "-j", "2")


@pytest.mark.full
def test_a_command_that_is_killed_at_any_step_leaves_the_same_files(command, out, undisturbed):
    for step in range(1, undisturbed[1] + 1):
        kill_and_restart(command, out, undisturbed, step, "-j", "3")
