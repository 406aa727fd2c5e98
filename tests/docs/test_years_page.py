"""The numbers in the text on the year are those of its tables."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "years.md").read_text(encoding="utf-8")
TEXT = re.sub(
    r"<!-- table (\w+) -->.*?<!-- end \1 -->", "", PAGE[PAGE.index("## What backlash costs") :], flags=re.DOTALL
)


def rows(name):
    """Cells of a table by valve and controller."""
    lines = (ROOT / "studies" / "year" / "tables" / f"{name}.md").read_text(encoding="utf-8").splitlines()[4:]
    cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines]
    return {(row[0], row[1]): row[2:] for row in cells}


def said(words):
    return " ".join(words.split()) in " ".join(TEXT.split())


def test_money():
    costs = rows("year_cost")
    assert said(f"15 % adds {costs['loose', 'plain PI'][2].strip('+')}")
    assert said(f"2 % adds {costs['new', 'plain PI'][2].strip('+')}")
    assert said(f"15 % pay more than {costs['loose', 'plain PI'][1].split('to +')[1]} USD more")
    pi, ours = (costs["loose", name][0].replace("+", "").split(" ", 1) for name in ("plain PI", "identify"))
    assert said(f"the {pi[0]} USD {pi[1]} of a 15 % gap become {' '.join(ours)}")


def test_valves():
    valves = rows("year_valve")
    assert said(
        f"{valves['loose', 'identify'][4]} strokes in the year instead of {valves['loose', 'plain PI'][4]} at 15 %"
    )
    assert said(f"{valves['sound', 'identify'][4]} instead of {valves['sound', 'plain PI'][4]} on a sound valve")
    middle, largest = re.fullmatch(r"(.*) \(to (.*)\)", valves["loose", "plain PI"][0]).groups()
    assert said(f"15 % ends at {largest}, while the median is {middle}")
    errors = [valves[key][2] for key in (("loose", "identify"), ("sound", "plain PI"), ("loose", "plain PI"))]
    assert said(f"{errors[0]}, where it is {errors[1]} with a sound valve and {errors[2]} under plain PI")
    assert said(f"on sound valves {valves['sound', 'Hägglund'][5]} of the days hunt by it")


def test_estimates():
    found = rows("year_estimate")
    wrong, late = found["new", "identify"][:2]
    assert said(f"{wrong} of its estimates are wrong at a gap of 2 %, {late} in the last quarter")
    assert said(f"in the last quarter {found['used', 'identify'][1]} of its estimates are wrong at 7 %")
    assert said(f"On sound valves {found['sound', 'identify'][2]} loops see a wrong estimate")
    assert all(cells[4].startswith("0 %") for key, cells in found.items() if key[1] == "identify")
