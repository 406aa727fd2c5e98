"""Tables of the studies are written to files."""

from __future__ import annotations

from studies import common
from studies.paper import paper


def test_a_table_is_written_into_the_folder_of_its_question(written):
    common.write_table("folder/one", "A \\title", ["a", "b"], [["1", "2"]])
    assert written("one") == ("A \\title", [["a", "b"], ["1", "2"]])


def test_the_scorecard_quotes_the_tables_of_verdicts(written, monkeypatch, tmp_path):
    asked = {}

    def regenerate(folder, *, quick, report, kinds, command):
        asked.update(kinds=list(kinds), command=command)
        folder.mkdir(parents=True)
        (folder / "scorecard.md").write_text(
            "# Title\n\nwords\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\nmore\n\n| c |\n| --- |\n| 3 |\n\n"
            "| d |\n| --- |\n| 4 |\n"
        )

    monkeypatch.setattr(paper, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(paper, "regenerate", regenerate)
    monkeypatch.setattr(paper, "one_loop", lambda: None)
    paper.main()
    assert written("scorecard_changes")[1] == [["a", "b"], ["1", "2"]]
    assert written("scorecard")[1] == [["c"], ["3"]]
    assert asked == {"kinds": ["stepped", "constant", "design"], "command": "python -m studies paper"}


def test_the_scorecard_knows_weather_where_there_is_a_file(tmp_path):
    path = tmp_path / "weather.csv"
    assert "weather" not in paper.all_kinds(path)
    hours = range(1, 8761)
    lines = [f"{h},1,1,{(h - 1) % 24 + 1},{20 + h % 7 + h // 100 % 3},12" for h in hours]
    path.write_text("hour_of_year,month,day,hour,T_drybulb_C,T_dewpoint_C\n" + "\n".join(lines) + "\n")
    weather = paper.all_kinds(path)["weather"]
    one, other = weather(2, (1, 2)).series["T_a_in"]
    assert (one != other).any()
    day, stepped = weather(2, (1,)), paper.KINDS["stepped"](2, (1,))
    assert (day.series["m_a"] == stepped.series["m_a"]).all()
    assert set(day.series["T_set"].ravel()) == {14.0}
