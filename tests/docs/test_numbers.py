"""Numbers and tables on the pages are those that the studies wrote."""

import re
from pathlib import Path

import pytest
from builder.numbers import filled, number, pages, table_file

ROOT = Path(__file__).parents[2]
PAGES = pages(ROOT)
RULES = """**Of 1,200 loops (3 % hunt)**

| rule | days | right | RMSE, mean | travel |
| --- | --- | --- | --- | --- |
| margin | stepped | 98.9 % (98.4 to 99.3) | -30 % (-34 to -25), × 1.5 | 95.4% |
|  | constant | 12 % | +7 % | 1,200 |
| margin, filtered | stepped | 40 % | 0 | 3 |
"""


@pytest.fixture
def root(tmp_path):
    (tmp_path / "studies" / "rules" / "tables").mkdir(parents=True)
    (tmp_path / "studies" / "rules" / "tables" / "rules.md").write_text(RULES)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_quotes_what_its_tables_say(page):
    text = page.read_text()
    assert filled(ROOT, text) == text, "run: python docs/builder/numbers.py"
    assert not re.search(r"(?m)^\s*(?:\* )?<!-- number", text), "a line that begins with a comment is no Markdown"


def test_every_table_is_shown_or_linked_and_has_a_name_of_its_own():
    texts = "".join(page.read_text() for page in PAGES)
    for path in (ROOT / "studies").glob("*/tables/*.md"):
        assert table_file(ROOT, path.stem) == path
        shown = (f"<!-- table {path.stem} -->", f"tables/{path.name})", f"{path.parts[-3]}/tables)")
        assert any(mark in texts for mark in shown), path.stem


@pytest.mark.parametrize(
    ("mark", "text"),
    [
        ("margin & stepped | right", "98.9 % (98.4 to 99.3)"),
        ("margin & stepped | right | short", "98.9 %"),
        ("margin & constant | RMSE", "+7 %"),
        ("margin & stepped | RMSE | part 1, unsigned", "30 % (25 to 34)"),
        ("margin & stepped | RMSE | part 2", "× 1.5"),
        ("margin & stepped | RMSE | part 1, bare", "-30"),
        ("margin & stepped | travel | whole", "95 %"),
        ("margin | travel | range", "95.4 to 1,200"),
        ("margin & stepped | right | of to ([\\d.]+)", "99.3"),
        ("margin, f | right", "40 %"),
        ("title | (\\d+) % hunt", "3"),
    ],
)
def test_a_mark_names_a_cell_and_how_to_write_it(root, mark, text):
    page = f"<!-- number rules | {mark} -->old<!-- /number -->"
    assert filled(root, page) == f"<!-- number rules | {mark} -->{text}<!-- /number -->"


@pytest.mark.parametrize(
    "mark",
    ["rules | stepped | right", "rules | nobody | right", "rules | margin & stepped | r", "rule | margin | right",
     "rules | margin & stepped | right | of (nothing)", "rules | title | (nothing)"],
)  # fmt: skip
def test_a_mark_that_fits_nothing_or_more_than_one_cell_is_refused(root, mark):
    (root / "studies" / "rules" / "tables" / "rules.md").write_text(RULES.replace("travel", "rest"))
    with pytest.raises(ValueError, match=r"fit|are called"):
        number(root, mark)


def test_a_table_is_put_between_its_marks(root):
    page = "a\n\n<!-- table rules -->\nold\n<!-- end rules -->\nb\n"
    assert filled(root, page) == f"a\n\n<!-- table rules -->\n\n{RULES}\n<!-- end rules -->\nb\n"
