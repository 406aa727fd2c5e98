"""What the pages say in words, without a number, holds in the tables."""

import re
from pathlib import Path

import pytest
from builder.numbers import FIRST, rows, table_file

ROOT = Path(__file__).parents[2]


def cells(table, column, *parts):
    """Cells of a column in the rows of a table that have a cell beginning with each of ``parts``."""
    found = rows(table_file(ROOT, table).read_text())
    fit = [row for row in found if all(any(cell.startswith(part) for cell in row.values()) for part in parts)]
    assert fit, (table, parts)
    return [next(cell for head, cell in row.items() if head.startswith(column)) for row in fit]


def numbers(table, column, *parts, part=0):
    return [float(FIRST.findall(cell)[part].replace(",", "")) for cell in cells(table, column, *parts)]


def test_the_remedies_that_the_page_names_have_the_lowest_cost_for_what_one_must_know():
    needs, names = (cells("remedies_choice", column) for column in ("one must know", "remedy"))
    costs = numbers("remedies_choice", "RMSE and travel, price 0.1")
    best = {need: name for _, need, name in sorted(zip(costs, needs, names, strict=True), reverse=True)}
    expected = {"PI, kp and ti × 2", "inverse 80 %, buffer 1 %", "inverse 95 %, buffer by noise", "gradient"}
    assert set(best.values()) == expected


def test_the_three_best_remedies_are_the_same_on_every_valve():
    for valves in ("play alone", "neutral zone 1 %", "slip jump 0.3 X", "leakage 0.1 %", "all three"):
        places = zip(cells("remedies_valves", valves), cells("remedies_valves", "remedy"), strict=True)
        ordered = {cell.split(", ")[-1]: name for cell, name in places}
        best = [ordered[place] for place in ("1.", "2.", "3.")]
        assert best == ["additive 95 %", "inverse 95 %, buffer 0.25 %", "inverse 95 %, buffer by noise"]


FOUR = ("quasistatic", "4")
EIGHT = ("quasistatic", "8")
STATEMENTS = [
    ("remedies", "Gains tuned for it do not cure that", 0, ("remedies_tuned", "RMSE against", "learner"), 1, 99),
    ("hunting", "It costs no accuracy", 0, ("hunting_cost", "constant", "(kp K)^"), 0, 0),
    ("learning", "wrong on all of those days", 0, ("learners_failures", "identify", "valves: constant"), 100, 100),
    ("learning", "No worn valve of the population gets worse", 0, ("learners_worse", "identify"), 0, 0),
    ("learning", "hardly ever too high", 0, ("learners_cost", "too high", "identify"), 0, 0),
    ("wear", "changes by less than 0.1 %", 0, ("wear_energy", "gradient"), -0.1, 0.1),
    ("wear", "no controller takes 0.8 percentage points off", 1, ("wear_energy", "gradient"), -0.8, 0),
    ("heating", "neither preset hunts", 0, ("heating_fresh", "hunting, worn", "own"), 0, 0),
    ("heating", "No valve of up to 15 % makes these loops hunt", 2, ("heating_backlash", "plain PI"), 0, 0),
    ("heating", "`identify` harms no good valve", 0, ("heating_backlash", "`identify`", "X = 0"), 0, 0),
    ("tuning", "and nothing hunts", 0, ("tuning", "hunting", "tuned PI"), 0, 0),
    ("numerics", "With 4 it is 3 %", 0, ("convergence_steps", "rmse", "paper_like_fast", *FOUR), 2.5, 3.5),
    ("numerics", "differs from that with 32 by more than 1 %", 0, ("convergence_steps", "rmse", *EIGHT), -1, 1),
    ("numerics", "That is below 1 %", 1, ("convergence_wet", "heat, % of", "partly wet", "8"), 0, 1),
    ("inverse", "no other parameter exceeds 0.1", 0, ("sensitivity", "95 %, first", "rangeability"), 0.04, 0.1),
]
"""Page, its words, which number of the cells of a table, and the range in which all of them must be."""


@pytest.mark.parametrize(("page", "words", "part", "where", "low", "high"), STATEMENTS)
def test_a_statement_holds(page, words, part, where, low, high):
    text = re.sub(r"\s+", " ", (ROOT / "docs" / "findings" / f"{page}.md").read_text())
    assert words in text
    assert all(low <= value <= high for value in numbers(*where, part=part))
