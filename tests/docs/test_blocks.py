"""Every block of code on a page is run, or is named here with what is checked instead."""

import click
import pytest
from test_pages import PAGES, blocks, commands, is_named

RUN_IN_ORDER = {"python", "toml", "sh", "text"}
"""Kinds of blocks that ``test_pages`` runs, or compares with what is printed, on every page with Python."""
ELSEWHERE = {
    ("README.md", "console"): "what it prints is compared with the page on diagnosis, in test_pages",
    ("docs/clusters.md", "sh"): "needs a network: names and options are checked, here and in test_pages",
    ("docs/model.md", "math"): "drawn when the site is built",
    ("docs/first-steps.md", "console"): "opens a page and waits: tests/deliver/explore do that",
    ("docs/own-rule.md", "diff"): "applied and tried in test_extending",
    ("docs/hand-over.md", "console"): "run in test_pages, where there is a compiler",
    ("docs/findings/paper.md", "sh"): "minutes of simulation: tests/studies/paper runs it in parts",
    ("docs/clusters.md", "text"): "what `fastcoil plan` says of a study with its own code",
    ("docs/clusters.md", "yaml"): "settings of dask",
}


def test_every_block_is_run_or_named():
    alone = set()
    for page in PAGES:
        kinds = {kind for kind, _ in blocks(page)}
        alone |= {(is_named(page), kind) for kind in kinds - (RUN_IN_ORDER if "python" in kinds else set())}
    assert alone == set(ELSEWHERE)


def named(page, kind):
    """The blocks of a kind on a page of ``docs/``."""
    (path,) = (path for path in PAGES if is_named(path) == f"docs/{page}")
    return [text for _, text in blocks(path, kind)]


def test_the_options_of_dask_exist():
    cli = pytest.importorskip("distributed.cli", reason="dask is an extra")
    from distributed.cli import dask_scheduler, dask_worker

    assert cli
    given = [words for text in named("clusters.md", "sh") for words in commands(text) if words[0] == "dask"]
    assert {words[1] for words in given} == {"scheduler", "worker"}
    for _, name, *words in given:
        command = dask_scheduler.main if name == "scheduler" else dask_worker.main
        assert isinstance(command, click.Command)
        known = {option for p in command.params for option in p.opts}
        assert {word for word in words if word.startswith("--")} <= known
