"""``fastcoil join``: a new file or none, and words that say how it was made."""

from helpers.commands import assert_command_refused, fastcoil

CSV_ROWS = "\n".join(f"{k:02}/07/2024 0{k % 10}:00,{k}" for k in range(10, 28))


def test_files_are_joined_and_how_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "command.csv").write_text(f"Time,Value (%)\n{CSV_ROWS}\n")
    (tmp_path / "SAT.csv").write_text(f"Time,Value\n{CSV_ROWS}\n")
    options = ["--column", "T_sup=SAT.csv", "--unit", "T_sup=degC", "--step", 3600]
    result = fastcoil("join", "command.csv", "SAT.csv", *options)
    assert result.exit_code == 0, result.output
    log = (tmp_path / "log.csv").read_text()
    assert log.startswith("timestamp,command [1],T_sup [degC]\n2024-07-10T00:00:00,0.1,10")
    assert "command.csv: timestamp read as dd/mm/yyyy: a number exceeds 12 in row" in result.output
    assert "Joined:  log.csv" in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["SAT.csv", "command.csv", "log.csv"]


def test_no_file_is_replaced_and_nothing_is_left_of_a_refused_call(tmp_path):
    command, foreign = tmp_path / "command.csv", tmp_path / "mine.csv"
    command.write_text(f"Time,Value (%)\n{CSV_ROWS}\n")
    foreign.write_text("mine")
    for out in (foreign, command, tmp_path, tmp_path / "none" / "x.csv", tmp_path / "x.txt"):
        assert_command_refused("join", command, "-o", out)
    assert foreign.read_text() == "mine"
    options = [("--unit", "command=furlong"), ("--time-format", "x"), ("--step", 0), ("--max-gap", 0)]
    for arguments in ([], [tmp_path / "none.csv"], *([command, *option] for option in options)):
        assert_command_refused("join", *arguments, "-o", tmp_path / "new.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["command.csv", "mine.csv"]
