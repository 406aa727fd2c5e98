"""The numbers in the answers of ``docs/cost.md`` are those of its tables."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
KINDS = ("stepped", "constant", "design", "weather", "heating")


def rows(name, n_names=2):
    """The first cells of each row → its others, by the head of the column."""
    lines = (ROOT / "studies" / "cost" / "tables" / f"{name}.md").read_text().splitlines()
    head, _, *body = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    return {tuple(row[:n_names]): dict(zip(head[n_names:], row[n_names:], strict=True)) for row in body}


def number(cell):
    """'+0.5 %' of '+0.5 % (+0.4 to +0.7)'."""
    return cell.split(" (")[0].removesuffix(" %")


def between(cells):
    """'0.5 to 1.2 %': the lowest and highest of some medians."""
    low, *_, high = sorted(map(float, cells))
    return f"{low:g} to {high:g}".replace("0 to", "0.0 to") if low == 0 else f"{low:.1f} to {high:.1f}"


def of_kinds(table, start, column):
    """The medians of a column, kind by kind."""
    return [
        number(next(cells[column] for (k, valves), cells in table.items() if k == kind and valves.startswith(start)))
        for kind in KINDS
    ]


def answers():
    """What the page must say."""
    sums, claim, gaps, control = rows("cost_sums"), rows("cost_claim"), rows("cost_backlash", 1), rows("cost_remedies")
    yield f"in the median, by the kind of day: {between(of_kinds(sums, 'all', 'bill with reheat'))} %"
    hunting = of_kinds(sums, "hunt", "bill with reheat")
    yield f"that hunt because of the gap it is {between(hunting)} %"
    money = re.sub(r"\+", "", gaps["7 %",]["USD a year"])
    yield f"{money.split(' (')[0]} USD a year ({money.split(' (')[1]}"
    more = re.sub(r"\+", "", gaps["15 %",]["USD a year"])
    yield f"one of 15 % {more}"
    title = (ROOT / "studies" / "cost" / "tables" / "cost_backlash.md").read_text().splitlines()[0]
    yield "of " + title.split("pays ")[1].split(" USD")[0]
    heat = of_kinds(sums, "all", "heat of the coil")
    yield f"{between(heat).replace('to ', 'to +')} % on every kind of day"
    raised = [claim[k, "all: 384"]["heat of the coil"].split(" %")[0] for k in KINDS]
    yield f"over 1 % more on {min(map(int, raised))} to {max(map(int, raised))} % of the valves"
    peak = of_kinds(sums, "all", "peak of 15 min")
    yield f"+{between(peak).replace('to ', 'to +')} % in the median"
    yield f"on {claim['stepped', 'all: 384']['peak of 15 min'].split(' (')[0]} of the valves where the set-point steps"
    yield f"on {claim['weather', 'all: 384']['peak of 15 min'].split(' (')[0]} on days of weather"
    highest = sums["heating", "hunt by the gap: 34"]["peak of 15 min"]
    yield f"it is {of_kinds(sums, 'hunt', 'peak of 15 min')[0]} % on days with set-point steps, and {highest} at most"
    yield f"{gaps['7 %',]['bill over 1 % up'].split(' (')[0]} of the valves pay over 1 % more"
    evened = of_kinds(sums, "all", "bill, rooms even out a day")
    yield f"the bill rises by {between(evened).replace('to ', 'to +')} %"
    yield f"5 to 95 % of the valves pay {gaps['7 %',]['5 to 95 % of the valves'].replace('+', '')} USD a year more"
    yield f"{hunting[0][1:]} % higher where the set-point steps, {hunting[3][1:]} % on days of weather"
    most = sums["weather", "hunt by the gap: 45"]["bill with reheat, 5 to 95 % of the valves"].split("+")[-1]
    yield f"pay over {most.split('.')[0]} % more on days of weather"
    saved = {
        name: [float(number(control[k, name]["bill with reheat"])) for k in KINDS]
        for name in ("PI by SIMC", "inverse of 95 %", "a valve without a gap")
    }
    mended = saved["a valve without a gap"]
    yield f"the bill with reheat by {max(mended):.1f} to {min(mended):.1f} %"
    yield f"get a part of that**: {max(saved['PI by SIMC']):.1f} to {min(saved['PI by SIMC']):.1f} %"
    yield control["stepped", "PI by SIMC"]["peak of 15 min"]
    inverse = saved["inverse of 95 %"]
    travel = sorted(float(control[k, "inverse of 95 %"]["motor travel"][2:]) for k in KINDS)
    yield f"{max(inverse):.1f} to {min(inverse):.1f} %, and costs × {travel[0]:.1f} to × {travel[-1]:.1f} of the motor"
    off = [gaps[gap,]["hours off by 0.5 K a day"] for gap in ("7 %", "0 %")]
    yield f"{off[0]} h a day instead of {off[1]}"


def test_the_page_says_what_its_tables_say():
    page = re.sub(r"\s+", " ", (ROOT / "docs" / "findings" / "cost.md").read_text())
    missing = [answer for answer in answers() if answer not in page]
    assert not missing
