"""Every file of a study, damaged at random: the right numbers or a sentence, in bounded time, and nothing else."""

import random
import shutil
import time
import warnings

import numpy as np
import pytest
from helpers.damage import damage_bytes, edit_json
from helpers.studies import DAYS, TRACED_STUDY, run, run_until_interrupted, undisturbed_hash

import fastcoil as fc
from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.loops import netcdf
from fastcoil.study import maintenance
from fastcoil.study.folder import stored

pytestmark = pytest.mark.kernel

_MAX_SECONDS = 60.0
"""Seconds; a hint that something hangs, not a measure."""


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """Folders by what happened to them before, and the right numbers."""
    place = tmp_path_factory.mktemp("originals")
    run(TRACED_STUDY, place / "finished")
    with fc.open_study(place / "finished") as ds:
        right = ds.load()
    run_until_interrupted(TRACED_STUDY, place / "unfinished", DAYS - 1)
    shutil.copytree(place / "finished", place / "without run.json", ignore=shutil.ignore_patterns("run.json"))
    return place, right


def find_files(folder):
    """The files that may be damaged."""
    return sorted(p for p in folder.rglob("*") if p.is_file() and p.name != ".lock")


def check_results(results, right):
    """Whatever was computed is right."""
    done = (results["status"] == 0).values
    assert set(np.unique(results["status"].values)) <= {0, 3}
    for name in ("rmse", "switch_frequency", "T_sup", "mode"):
        np.testing.assert_array_equal(results[name].values[done], right[name].values[done], err_msg=name)
    for name in right.coords:
        np.testing.assert_array_equal(results[name].values, right[name].values, err_msg=str(name))


def run_or_error(what):
    """What a command gives, or the error that it may end with."""
    start = time.monotonic()
    try:
        return what()
    except (IntegrityError, InputError) as error:
        return error
    finally:
        assert time.monotonic() - start < _MAX_SECONDS


def clear_caches():
    """What this process knows of files: they are written faster than the clock of the file system runs."""
    netcdf._sha256_of.cache_clear()
    netcdf._readable_files.clear()


def damage_and_repair(originals, out, kind, seed):
    """Damage one file, use every command, and see whether a run repairs what can be repaired."""
    place, right = originals
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(place / kind, out)
    dice = random.Random(f"{kind} {seed}")
    path = dice.choice(find_files(out))
    good = path.read_bytes()
    bad = edit_json(good, dice, stored.checksum) if path.suffix == ".json" and seed % 2 else damage_bytes(good, dice)
    path.unlink()
    path.write_bytes(bad)
    clear_caches()
    label = f"{kind} {seed}: {path.name}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        opened = run_or_error(lambda: fc.open_study(out).load())
        if not isinstance(opened, Exception):
            check_results(opened, right)
        run_or_error(lambda: maintenance.status(out))
        problems = run_or_error(lambda: maintenance.verify(out))
        second_run = run_or_error(lambda: run(TRACED_STUDY, out))
        if isinstance(second_run, Exception):
            assert problems, label
            return False
        assert second_run == undisturbed_hash(TRACED_STUDY), label
        assert maintenance.verify(out) == [], label
        check_results(fc.open_study(out).load(), right)
    return problems == []


def damage_and_repair_all(originals, out, kind, seeds):
    """Many of them; some must do no harm, and most must."""
    harmless = sum(damage_and_repair(originals, out, kind, seed) for seed in seeds)
    assert harmless < len(seeds)


@pytest.mark.parametrize(
    ("kind", "seeds"),
    [
        ("finished", range(3)),
        ("unfinished", range(2)),
        ("without run.json", range(1)),
        pytest.param("finished", range(3, 700), marks=pytest.mark.full),
        pytest.param("unfinished", range(2, 300), marks=pytest.mark.full),
        pytest.param("without run.json", range(1, 100), marks=pytest.mark.full),
    ],
)
def test_damage_gives_the_right_numbers_or_a_sentence(originals, out, kind, seeds):
    damage_and_repair_all(originals, out, kind, seeds)
