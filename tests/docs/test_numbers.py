"""The numbers on the page of answers are those of the tables that the scripts write."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def row(table, *parts):
    """Column → cell of the only row of a table that has all ``parts`` in its cells."""
    lines = (ROOT / "studies" / "tables" / f"{table}.md").read_text().splitlines()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    (found,) = [cells for cells in rows if all(any(part in cell for cell in cells) for part in parts)]
    return dict(zip(head, found, strict=True))


def share(claim, column="share"):
    """Share of a claim in the scorecard, without its interval."""
    return row("scorecard", claim)[column].split(" (")[0]


def percent(change):
    """'17 %' of '-28 %, -17 %, -7 %', the median."""
    return change.split(", ")[1].lstrip("-")


def times(text):
    """The number of '× 1.66 '."""
    return float(text.lstrip("× "))


def answers():
    """What the page of answers must say."""
    hunts = re.search(r"\((\d+ %) there, 0 % elsewhere\)", row("scorecard", "PI loop hunts")["verdict"])[1]
    of_valves = {name: row("population", f"{name}") for name in ("fixed_60", "learner_growing")}
    buffered, bare = row("population", "fixed_95_buffer"), row("population", "fixed_95", "× 15")
    learned = row("population_learners", "learner_growing")
    ship, cost = row("learning_choice", "all"), row("learning_cost", "all")
    yield f"An inverse of 60 % helps nearly everywhere ({share('inverse of 60 %')})"
    yield f"above the true backlash the switches jump ({share('rise dramatically')})"
    yield f"half hunt ({hunts}), of the others none"
    yield f"falls up to the true backlash ({share('falls consistently')}) and seldom rises beyond it"
    yield f"seldom rises beyond it ({share('the error rises again')})"
    yield f"half of the tunings ({share('rule identifies')})"
    yield f"most of those that hunt ({share('rule identifies', 'hunting')})"
    yield f"Noise makes the inverse switch ({share('switch severely')}); a buffer cures that ({share('cures that')})"
    column = "RMSE: 5 %, median, 95 % of the valves"
    yield f"the RMSE falls by {percent(buffered[column])} in the median, at the motor travel of the plain PI"
    assert times(buffered["motor travel, median"]) == pytest.approx(1.0, abs=0.05)
    yield f"(without the buffer: {times(bare['motor travel, median']):.0f} times that)"
    yield f"60 % of the backlash still gives {percent(of_valves['fixed_60'][column])}"
    yield f"first step {ship['step']}, every {ship['interval']}, ratio {ship['ratio']}, buffer {ship['buffer']}"
    yield f"confirmed within {cost['confirmed, min'].split()[0]} min"
    yield f"{cost['RMSE against known backlash, %'].split()[0].lstrip('+')} % above that of a known backlash"
    yield f"fails in {ship['100 fresh days']} of the cases on fresh days"
    growing = of_valves["learner_growing"]
    yield f"over the population the RMSE falls by {percent(growing[column])}"
    yield f"at {times(growing['motor travel, median']):.1f} times the travel"
    yield f"only {learned['within 80 to 120 %']} of the estimates are right to 20 %"


def test_the_page_of_answers_says_what_the_tables_say():
    page = " ".join((ROOT / "studies" / "README.md").read_text().split())
    assert [sentence for sentence in answers() if sentence not in page] == []
