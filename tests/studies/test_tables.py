"""Tables of the studies are written to files."""

from studies.paper import paper


def test_the_scorecard_quotes_the_tables_of_verdicts(written, monkeypatch, tmp_path):
    asked = {}

    def regenerate(folder, *, quick, report, kinds):
        asked.update(kinds=list(kinds))
        folder.mkdir(parents=True)
        (folder / "scorecard.md").write_text(
            "# Title\n\nwords\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\nmore\n\n| c |\n| --- |\n| 3 |\n\n"
            "| d |\n| --- |\n| 4 |\n"
        )
        return [], None

    monkeypatch.setattr(paper, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(paper, "regenerate", regenerate)
    monkeypatch.setattr(paper, "one_loop", lambda: None)
    paper.main()
    assert written("scorecard_changes")[1] == [["a", "b"], ["1", "2"]]
    assert written("scorecard")[1] == [["c"], ["3"]]
    assert asked == {"kinds": ["stepped", "constant", "design"]}


def test_the_scorecard_knows_weather_where_there_is_a_file(tmp_path, weather):
    assert "weather" not in paper.all_kinds(tmp_path / "none.csv")
    of_weather = paper.all_kinds(weather)["weather"]
    one, other = of_weather(2, (1, 2)).series["T_a_in"]
    assert (one != other).any()
    day, stepped = of_weather(2, (1,)), paper.KINDS["stepped"](2, (1,))
    assert (day.series["m_a"] == stepped.series["m_a"]).all()
    assert set(day.series["T_set"].ravel()) == {14.0}
