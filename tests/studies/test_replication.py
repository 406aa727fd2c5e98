"""Running a study again says which cells of its tables changed, and a sample writes nothing."""

import importlib
from types import SimpleNamespace

import pytest

import studies.__main__ as command
from studies import common
from studies.common import compare_rows, compare_with_tables, write_table

HEAD = ["days", "loops", "share"]
ROWS = [["constant", "hunt", "1 %"], ["constant", "calm", "2 %"], ["stepped", "hunt", "3 %"]]


@pytest.fixture
def table(tmp_path, monkeypatch):
    """A table as it stands, and its path."""
    monkeypatch.setattr(common, "OUTPUT_FOLDER", tmp_path)
    write_table("of/shares", "Shares", HEAD, ROWS)
    return tmp_path / "of" / "tables" / "shares.md"


@pytest.mark.parametrize("is_sample", [True, False])
def test_the_same_numbers_change_no_cell(table, is_sample):
    before = table.read_text()
    with compare_with_tables(is_sample=is_sample) as replication:
        write_table("of/shares", "Shares", HEAD, ROWS)
    assert (replication.changes, sum(replication.cell_counts)) == ([], 9)
    assert table.read_text() == before


def test_a_sample_names_the_cell_that_changed_and_leaves_the_table(table):
    before = table.read_text()
    with compare_with_tables(is_sample=True) as replication:
        compare_rows("of/shares", [["constant", "calm", "4 %"]])
    assert replication.changes == ["of/shares: constant | share: 2 % → 4 %"]
    assert table.read_text() == before


def test_a_whole_run_names_it_and_writes_the_table(table):
    with compare_with_tables(is_sample=False) as replication:
        write_table("of/shares", "Shares, anew", HEAD, [*ROWS[:2], ["stepped", "hunt", "5 %"]])
    assert replication.changes == ["of/shares: title: Shares → Shares, anew", "of/shares: stepped | share: 3 % → 5 %"]
    assert "5 %" in table.read_text()


@pytest.mark.parametrize(("head", "rows"), [(HEAD, ROWS[:2]), (HEAD[:2], [row[:2] for row in ROWS])])
def test_a_row_or_a_column_that_is_missing_is_named(table, head, rows):
    with compare_with_tables(is_sample=False) as replication:
        write_table("of/shares", "Shares", head, rows)
    assert len(replication.changes) == 1
    assert replication.changes[0].startswith("of/shares: other columns, or ")


def test_the_command_ends_with_1_if_a_sample_changed(table, monkeypatch, capsys):
    study = SimpleNamespace(SEED=7, sample=lambda: compare_rows("of/shares", [["stepped", "hunt", "9 %"]]))
    monkeypatch.setattr(command, "questions", lambda: {"one": command.Question("?", "of.one", "minutes")})
    monkeypatch.setattr(command.importlib, "import_module", {"of.one": study}.__getitem__)
    assert command.main(["--sample"]) == 1
    output = capsys.readouterr().out
    assert "one: SEED = 7" in output
    assert "one: 1 of 3 cells changed" in output
    assert output.endswith("Changed:\n  of/shares: stepped | share: 3 % → 9 %\n")


def test_an_unknown_study_or_option_is_refused():
    with pytest.raises(SystemExit, match="no study 'robustnes'; did you mean 'robustness'"):
        command.main(["robustnes"])
    with pytest.raises(SystemExit, match="no option --samples: give --all or --sample"):
        command.main(["--samples"])


@pytest.mark.parametrize("name", command.questions())
def test_every_study_has_a_sample_or_says_why_it_has_none(name):
    question = command.questions()[name]
    module = importlib.import_module(question.module)
    has_sample = hasattr(module, "sample") or question.time in command.QUICK_TIMES
    assert has_sample != hasattr(module, "NO_SAMPLE")
