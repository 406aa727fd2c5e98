"""What the page of wear says is what the tables of ``studies/wear/wear.py`` say."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
STEPPED, CONSTANT, REAL, MORNINGS = "stepped", "constant", "weather", "weather, steps on one day in six"
ONE, SHORT, KNOWN = "identify", "identify, memory 8 h", "95 % of the gap of the first day"
RULE = "paper's rule"


def table(name, *keys):
    """Row's name → column → cell; ``keys``: the columns that make a name, the first by default."""
    lines = (ROOT / "studies" / "wear" / "tables" / f"wear_{name}.md").read_text().splitlines()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    named = (dict(zip(head, row, strict=True)) for row in rows)
    return {tuple(row[key] for key in keys) if keys else next(iter(row.values())): row for row in named}


def part(cell, k):
    """Of '-13 % (-15 to -11), × 1.27, × 1.08' one."""
    return cell.split(", ")[k]


def times(cell, k):
    """'1.27 times' of '× 1.27'."""
    return f"{part(cell, k).removeprefix('× ')} times"


def fall(cell):
    """'13 % (11 to 15)' of '-13 % (-15 to -11)'."""
    middle, low, high = re.match(r"-(\d+) % \(-(\d+) to -(\d+)\)", cell).groups()
    return f"{middle} % ({high} to {low})"


def median(cell):
    """Of '1,387, 3,005', a number and another with commas of their own, the first."""
    return cell.split(", ")[0]


def answers():
    """What the page must say of those who control."""
    wrong, cost, good, energy = (table(name) for name in ("follow", "cost", "good", "energy"))
    yield f"it is wrong on {wrong[REAL][ONE]} of the days"
    assert {wrong[kind][ONE] for kind in (REAL, CONSTANT, "heating")} == {wrong[REAL][ONE]}
    yield f"on one day in six it is wrong on {wrong[MORNINGS][ONE]}"
    repaired = [wrong[f"{kind}: repaired"] for kind in (STEPPED, MORNINGS)]
    yield f"{repaired[0][ONE]} of its estimates are wrong then with steps every day, {repaired[1][ONE]} with"
    yield f"these are {repaired[0][SHORT]} and {repaired[1][SHORT]}"
    paper, gradient = (cost[name] for name in (RULE, "gradient"))
    yield f"the motor travels {times(paper[REAL], 1)} as far, and the gap grows {times(paper[REAL], 2)} as fast"
    yield f"the gap grows {times(gradient[STEPPED], 2)} as fast with set-point steps"
    yield f"is wrong on {wrong[STEPPED]['Hägglund']} of the days with steps"
    yield f"on {wrong[STEPPED][KNOWN]} of the days at the end"
    yield f"the RMSE is {fall(cost[KNOWN][STEPPED])} below that of plain PI"
    yield f"({part(wrong[STEPPED][ONE], 0)} of its estimates are wrong) and lowers the RMSE by"
    yield f"by {fall(cost[ONE][STEPPED])}, learning included"
    yield f"so the gap grows {times(cost[ONE][STEPPED], 2)} as fast"
    lacks = [float(row["plain PI"].split(" ")[0]) for row in energy.values()]
    yield f"{min(lacks):.1f} to {max(lacks):.1f} % of the coil's heat under plain PI"
    yield f"makes {part(good[STEPPED][RULE], 0)} of them worse by more than 1 % where the set-point steps"
    yield f"`gradient` {part(good[CONSTANT]['gradient'], 0)} where it stands still"
    assert {part(row[ONE], 0) for row in good.values()} == {"0 % (0 to 6)"}
    heat = [
        float(part(row[name], 0).split(" ")[0]) for row in energy.values() for name in (ONE, "gradient", "Hägglund")
    ]
    assert max(map(abs, heat)) < 0.1
    assert (
        min(float(part(c, 1)) for row in energy.values() for n, c in row.items() if n not in ("days", "plain PI"))
        > -0.8
    )


def lives():
    """What it must say of motors and gaps."""
    life, feedback = table("life", "days", "controller"), table("feedback")
    whole = {name: row["ratio"].split(" (")[0] for name, row in table("whole_year").items()}
    yield f"The gap grows {times(whole['growth of the gap'], 0)} as much in the whole year"
    assert 0.75 < float(whole["travel of the motor"].removeprefix("× ")) < 0.85, "about a fifth too many"
    hunting = "stepped, fast gains, loops that hunt"
    yield f"its motor travels {median(life[hunting, 'plain PI']['motor, strokes'])} strokes a year under plain PI"
    yield f"and {median(life[hunting, ONE]['motor, strokes'])} with `identify`"
    calm = life[REAL, "plain PI"]
    yield f"uses {median(calm['of the strokes'])} % of the strokes in a real year"
    yield f"turns round often: {median(calm['reversals'])} times"
    used = float(median(life[hunting, "plain PI"]["of the strokes"]))
    yield f"uses up {used:.0f} % of the strokes in a year"
    assert round(5200 / used) == 11, "weeks"
    yield f"it is {feedback['constant, fast gains']['loops that hunt'].split(', ')[0]} of what was given"
    assert {row["loops that do not hunt"].split(" (")[0] for row in feedback.values()} <= {"× 0.98", "× 0.99", "× 1.00"}


def noticed():
    """What it must say of those who notice."""
    found = table("noticed")
    known, five, off = (found[f"bank of models, plant {how}"] for how in ("known", "5 % off", "15 % off"))
    at_once, constant = "three times as large at once, stepped", "three times as large at once, constant"
    slowly = "within five days, constant"
    yield f"notices {part(known[constant], 0)} of the loose linkages, after {part(known[constant], 1)} in the median"
    yield f"slow growth after {part(known[slowly], 1)}"
    yield f"With 5 % it notices {part(five[constant], 0)} where the set-point is constant"
    yield f"with 15 % {part(off[constant], 0)}:"
    yield f"`identify` knows no plant and notices {part(found[ONE][at_once], 0)} where the set-point steps"
    yield f"after {part(found[ONE][at_once], 1)}, and {part(found[ONE][constant], 0)} where it does not"
    yield f"raises a false alarm on {known['false: constant gap']} of those"


def test_the_page_says_what_the_tables_say():
    page = " ".join((ROOT / "docs" / "findings" / "wear.md").read_text().split())
    said = [*answers(), *lives(), *noticed()]
    assert [words for words in said if words not in page] == []
