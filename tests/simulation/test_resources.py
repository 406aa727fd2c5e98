"""Memory and disk of the machine, and results that do not fit."""

from collections import namedtuple

import pytest

import fastcoil as fc
from fastcoil.simulation import resources


def test_bytes_in_words():
    assert resources.gib(1536 * 2**20) == "1.5 GiB"
    assert resources.gib(2**19) == "0.5 MiB"
    assert resources.gib(3000 * 2**30) == "3,000.0 GiB"


def test_available_memory_is_at_most_that_of_the_machine():
    assert 2**20 < resources.available_memory() < 2**50


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
