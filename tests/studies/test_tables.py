"""Tables of the studies are written to files, and pages quote them as they are."""

from __future__ import annotations

import re

import report
import scorecard

STUDIES, PAGES = report.HERE, report.PAGES


def test_a_table_is_written_into_the_pages_that_quote_it(written, tmp_path):
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    page.write_text(
        "before\n\n<!-- table one -->\nold\n<!-- end one -->\n\n<!-- table two -->\nkept\n<!-- end two -->\n"
    )
    for _ in range(2):
        report.write_table("one", "A \\title", ["a", "b"], [["1", "2"]])
    assert written("one") == ("A \\title", [["a", "b"], ["1", "2"]])
    table = "**A \\title**\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    assert page.read_text() == (
        f"before\n\n<!-- table one -->\n\n{table}\n<!-- end one -->\n\n<!-- table two -->\nkept\n<!-- end two -->\n"
    )


def test_every_table_is_quoted_by_exactly_one_page_as_it_is():
    quoted = []
    for page in sorted(PAGES.glob("*.md")):
        text = page.read_text()
        for name in re.findall("<!-- table (.*) -->", text):
            table = (STUDIES / "tables" / f"{name}.md").read_text()
            assert report.quoting(text, name, table) == text, f"{page.name} quotes an old {name}: run its script"
            assert f"<!-- end {name} -->" in text
            quoted.append(name)
    assert sorted(quoted) == sorted(path.stem for path in (STUDIES / "tables").iterdir())


def test_the_scorecard_quotes_the_first_table_of_the_paper_s(written, monkeypatch, tmp_path):
    def regenerate(folder, *, quick):
        folder.mkdir(parents=True)
        (folder / "scorecard.md").write_text(
            "# Title\n\nwords\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\nmore\n\n| c |\n| --- |\n| 3 |\n"
        )

    monkeypatch.setattr(scorecard, "HERE", tmp_path / "studies")
    monkeypatch.setattr(scorecard, "regenerate", regenerate)
    scorecard.main()
    assert written("scorecard")[1] == [["a", "b"], ["1", "2"]]
