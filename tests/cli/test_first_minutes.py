"""The first minutes: what the command says alone, ``fastcoil demo``, and words that fit who installed it with pip."""

from pathlib import Path

import pytest
from click.shell_completion import BashComplete
from helpers.commands import fastcoil

import fastcoil as package
from fastcoil.cli.main import main
from fastcoil.cli.study import shipped_studies
from fastcoil.study import maintenance


def test_alone_it_leads_to_a_log_a_loop_a_study_and_a_demo():
    result = fastcoil()
    assert result.exit_code == 0
    lines = result.output.splitlines()
    assert len(lines) <= 6
    for command in ("diagnose LOG.csv", "explain lbnl", "init study.toml", "run study.toml", "demo", "--help"):
        assert f"fastcoil {command}" in result.output
        assert command.split()[0] in (*main.commands, "--help")
    assert fastcoil("--help").output.startswith("Usage: ")


@pytest.mark.kernel
@pytest.mark.usefixtures("blank_figures")
def test_the_demo_shows_commands_that_the_user_can_type_and_what_they_say(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = fastcoil("demo", "my demo")
    assert result.exit_code == 0, result.output
    typed = [line[2:].split() for line in result.output.splitlines() if line.startswith("$ fastcoil ")]
    assert [words[1] for words in typed] == ["diagnose", "explain", "run"]
    assert "Gap: 9 % of the stroke" in result.output
    assert "This loop hunts: " in result.output
    assert "Results: sweep" in result.output
    assert Path.cwd() == tmp_path
    folder = tmp_path / "my demo"
    assert {path.name for path in folder.iterdir()} == {"log.csv", "sweep.toml", "sweep"}
    assert maintenance.verify(folder / "sweep") == []
    monkeypatch.chdir(folder)
    again = fastcoil(*typed[0][1:])
    assert again.exit_code == 0
    assert again.output in result.output
    monkeypatch.chdir(tmp_path)
    second_run = fastcoil("demo", "my demo")
    assert second_run.exit_code == 2
    assert "give the name of a new folder" in second_run.output


@pytest.mark.kernel
def test_without_a_folder_the_demo_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("fastcoil.cli.demo._DEMO_COMMANDS", (("Which presets are there?", "fastcoil presets"),))
    result = fastcoil("demo")
    assert result.exit_code == 0, result.output
    assert "paper_like" in result.output
    assert not list(tmp_path.iterdir())


def test_init_says_what_to_type_next(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    output = fastcoil("init", "my study.toml").output
    assert output.endswith("fastcoil plan 'my study.toml', fastcoil run 'my study.toml'\n")


def test_nothing_that_is_installed_speaks_of_make_or_the_environment_of_the_repository():
    texts = {path: path.read_text(encoding="utf-8") for path in Path(package.__file__).parent.rglob("*.py")}
    texts |= shipped_studies()
    for name, text in texts.items():
        assert ".venv" not in text, name
        for target in ("study", "test", "docs", "paper", "lint"):
            assert f"`make {target}" not in text, name
        # what only the repository has is said to be there
        analysis = [line for line in text.splitlines() if line.startswith("# Analysis: ")]
        assert all("in the source repository" in line for line in analysis), name


def test_the_shell_completes_commands_and_options():
    complete = BashComplete(main, {}, "fastcoil", "_FASTCOIL_COMPLETE").get_completions
    assert {item.value for item in complete([], "ex")} == {"explain", "explore", "export"}
    assert [item.value for item in complete(["run"], "--back")] == ["--backend"]
