"""``fastcoil init``: the template, and the studies that come with fastcoil."""

from pathlib import Path

import pytest
from helpers.commands import assert_command_refused, fastcoil

from fastcoil.cli.study import shipped_studies

ROOT = Path(__file__).parents[2]
STUDIES = {path.stem: path for path in (ROOT / "studies").glob("*/*.toml")}


@pytest.mark.kernel
def test_init_writes_a_study_that_plans_and_never_overwrites(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fastcoil("init", "mine.toml").exit_code == 0
    assert fastcoil("plan", "mine.toml").exit_code == 0
    assert_command_refused("init", "mine.toml")


def test_every_study_of_the_repository_is_shipped_as_it_is():
    assert shipped_studies() == {name: path.read_text(encoding="utf-8") for name, path in STUDIES.items()}


def test_a_shipped_study_is_written_under_its_name_or_another(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second = fastcoil("init", "--from", "robustness"), fastcoil("init", "--from", "robustness", "mine.toml")
    assert (first.exit_code, second.exit_code) == (0, 0), first.output
    expected = STUDIES["robustness"].read_bytes()
    assert (tmp_path / "robustness.toml").read_bytes() == (tmp_path / "mine.toml").read_bytes() == expected
    assert "fastcoil run mine.toml" in second.output
    assert "Analysis" not in second.output
    assert_command_refused("init", "--from", "robustness")


def test_an_unknown_study_is_answered_with_the_nearest_and_the_list(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    wrong = fastcoil("init", "--from", "robustnes")
    assert wrong.exit_code == 2
    assert "did you mean 'robustness'?" in wrong.output
    assert all(name in wrong.output for name in STUDIES)
    assert not list(tmp_path.iterdir())
