"""Memory and disk of the machine, and results that do not fit."""

from collections import namedtuple

import pytest

import fastcoil as fc
from fastcoil.loops import plan as resources


def test_results_that_do_not_fit_into_memory_are_refused(monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 2**30)
    resources.check_memory(2**30, 5)
    with pytest.raises(fc.InputError, match=r"12,000 scenarios need 2\.0 GiB .* 1\.0 GiB are available: sweep fewer"):
        resources.check_memory(2**31, 12_000)


def test_results_that_do_not_fit_on_the_disk_are_refused(tmp_path, monkeypatch):
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(resources.shutil, "disk_usage", lambda path: usage(2**30 if path == tmp_path else 0))
    resources.check_disk(2**30, tmp_path / "results" / "mine")
    with pytest.raises(fc.InputError, match=r"needs up to 2\.0 GiB on disk, 1\.0 GiB are free in .*: choose another"):
        resources.check_disk(2**31, tmp_path / "results" / "mine")


def test_workers_that_do_not_fit_are_refused_with_the_number_that_does(monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 700 * 2**20)
    resources.check_workers(100 * 2**20, 300 * 2**20, 2)
    with pytest.raises(fc.InputError) as caught:
        resources.check_workers(100 * 2**20, 300 * 2**20, 8)
    assert str(caught.value) == (
        "8 workers of 300.0 MiB do not fit into the 700.0 MiB of memory that are available, of which the results need "
        "100.0 MiB: use -j 2"
    )
    with pytest.raises(fc.InputError, match=r"needs 900\.0 MiB of memory with one worker, 700\.0 MiB are available"):
        resources.check_workers(600 * 2**20, 300 * 2**20, 8)
