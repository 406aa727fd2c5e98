"""Tables of the studies are written to files."""

from studies.paper import paper


def test_the_scorecard_quotes_the_tables_of_verdicts(read_table, monkeypatch, tmp_path):
    arguments = {}

    def regenerate(folder, *, quick, report, kinds):
        arguments.update(kinds=list(kinds))
        folder.mkdir(parents=True)
        (folder / "scorecard.md").write_text(
            "# Title\n\nwords\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\nmore\n\n| c |\n| --- |\n| 3 |\n\n"
            "| d |\n| --- |\n| 4 |\n"
        )
        return [], None

    monkeypatch.setattr(paper, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(paper, "regenerate", regenerate)
    monkeypatch.setattr(paper, "write_one_loop", lambda: None)
    paper.main()
    assert read_table("scorecard_changes")[1] == [["a", "b"], ["1", "2"]]
    assert read_table("scorecard")[1] == [["c"], ["3"]]
    assert arguments == {"kinds": ["stepped", "constant", "design"]}
