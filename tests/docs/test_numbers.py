"""Numbers, tables and statements on the pages are those of what the studies wrote."""

import re
from pathlib import Path

import pytest
from builder.numbers import FIRST, fill_page, number, pages, rows, table_file

ROOT = Path(__file__).parents[2]
PAGES = pages(ROOT)
RULES = """**Of 1,200 loops (3 % hunt)**

| rule | days | right | RMSE, mean | travel |
| --- | --- | --- | --- | --- |
| hunting index | stepped | 98.9 % (98.4 to 99.3) | -30 % (-34 to -25), × 1.5 | 95.4% |
|  | constant | 12 % | +7 % | 1,200 |
| hunting index, filtered | stepped | 40 % | 0 | 3 |
"""


@pytest.fixture
def root(tmp_path):
    (tmp_path / "studies" / "rules" / "tables").mkdir(parents=True)
    (tmp_path / "studies" / "rules" / "tables" / "rules.md").write_text(RULES)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_quotes_what_its_tables_say(page):
    text = page.read_text()
    assert fill_page(ROOT, text) == text, "run: python docs/builder/numbers.py"
    assert not re.search(r"(?m)^\s*(?:\* )?<!-- number", text), "a line that begins with a comment is no Markdown"


def test_every_table_is_shown_or_linked_and_has_a_name_of_its_own():
    texts = "".join(page.read_text() for page in PAGES)
    for path in (ROOT / "studies").glob("*/tables/*.md"):
        assert table_file(ROOT, path.stem) == path
        marks = (f"<!-- table {path.stem} -->", f"tables/{path.name})", f"{path.parts[-3]}/tables)")
        assert any(mark in texts for mark in marks), path.stem


@pytest.mark.parametrize(
    "mark",
    ["rules | stepped | right", "rules | nobody | right", "rules | hunting index & stepped | r",
     "rule | hunting index | right", "rules | hunting index & stepped | right | of (nothing)",
     "rules | title | (nothing)"],
)  # fmt: skip
def test_a_mark_that_fits_nothing_or_more_than_one_cell_is_refused(root, mark):
    (root / "studies" / "rules" / "tables" / "rules.md").write_text(RULES.replace("travel", "rest"))
    with pytest.raises(ValueError, match=r"fit|are called"):
        number(root, mark)


def test_a_table_is_put_between_its_marks(root):
    page = "a\n\n<!-- table rules -->\nold\n<!-- end rules -->\nb\n"
    assert fill_page(root, page) == f"a\n\n<!-- table rules -->\n\n{RULES}\n<!-- end rules -->\nb\n"


CONVERGED = "fastcoil, quasistatic"
STATEMENTS = [
    ("remedies", "Gains tuned for it do not cure that", 0, ("remedies_tuned", "RMSE against", "learner"), 1, 99),
    ("hunting", "A divisor of 5.5 costs no accuracy", 0, ("hunting_cost", "constant", "(kp K)^"), 0, 0),
    ("learning", "wrong on all of those days", 0, ("learners_failures", "identify", "valves: constant"), 100, 100),
    (
        "learning",
        "No worn valve of the population gets worse",
        0,
        ("learners_worse", "identify", "valves: set-point"),
        0,
        0,
    ),
    ("learning", "hardly ever too high", 0, ("learners_cost", "too high", "identify"), 0, 0),
    ("wear", "changes by less than 0.1 %", 0, ("wear_energy", "gradient"), -0.1, 0.1),
    ("wear", "by as much as 0.8 percentage points", 1, ("wear_energy", "gradient"), -0.8, 0),
    ("heating", "neither preset hunts", 0, ("heating_fresh", "hunting, worn", "own"), 0, 0),
    ("heating", "No valve of up to 15 % makes these loops hunt", 2, ("heating_backlash", "plain PI"), 0, 0),
    ("heating", "`identify` harms no good valve", 0, ("heating_backlash", "`identify`", "X = 0"), 0, 0),
    ("tuning", "the search allowed 5 %", 0, ("tuning", "hunting", "tuned PI"), 0, 5),
    *(
        ("numerics", "within 1 % of it", 0, ("integrators", preset, CONVERGED), -1, 1)
        for preset in ("paper_like", "paper_like_fast", "lbnl", "g36")
    ),
    ("numerics", "That is below 1 %", 1, ("convergence_wet", "heat, % of", "partly wet", "8"), 0, 1),
    ("inverse", "no other parameter exceeds 0.1", 0, ("sensitivity", "95 %, first", "rangeability"), 0.04, 0.1),
]
"""Page, its words, which number of the cells of a table, and the range in which all of them must be."""


@pytest.mark.parametrize(("page", "words", "part", "where", "low", "high"), STATEMENTS)
def test_a_statement_in_words_holds_in_its_table(page, words, part, where, low, high):
    assert words in re.sub(r"\s+", " ", (ROOT / "docs" / "findings" / f"{page}.md").read_text())
    table, column, *labels = where
    table_rows = rows(table_file(ROOT, table).read_text())
    for label in labels:
        table_rows = [row for row in table_rows if any(cell.startswith(label) for cell in row.values())]
    cells = [next(cell for head, cell in row.items() if head.startswith(column)) for row in table_rows]
    assert cells
    assert all(low <= float(FIRST.findall(cell)[part].replace(",", "")) <= high for cell in cells)
