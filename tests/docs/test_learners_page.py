"""What the pages say of estimators is what the tables of ``studies/learning/learners.py`` say."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
STEPPED, CONSTANT, HEATING = "set-point steps", "constant set-point", "heating"
KINDS = (STEPPED, CONSTANT, "design days", "weather, 30 % outdoor air", HEATING)
PAPER, AVERAGED, TRIP = "paper's rule", "growing, averaged reference", "growing, error trip too"


def table(name):
    """Row's name → column → cell."""
    lines = (ROOT / "studies" / "learning" / "tables" / f"learners_{name}.md").read_text().splitlines()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    return {row[0]: dict(zip(head, row, strict=True)) for row in rows}


def least_and_most(cells):
    """'3 to 12 %' of shares with intervals."""
    shares = [int(cell.split(" %")[0]) for cell in cells]
    return f"{min(shares)} to {max(shares)} %"


def percent(cell):
    """Of '12 % (3 to 20), +0.7 %, 4 %' the first number."""
    return int(cell.split(" %")[0])


def fall(cell):
    """'29 % (27 to 31)' of '-29 % (-31 to -27)'."""
    middle, low, high = re.fullmatch(r"-(\d+) % \(-(\d+) to -(\d+)\)", cell).groups()
    return f"{middle} % ({high} to {low})"


def answers():
    """What the page of learning must say."""
    wrong, twenty, worse, good = (table(name) for name in ("failures", "twenty", "worse", "good"))
    every, stepped = table("cost"), table("cost_stepped")
    loops, valves = (f"{of}: {STEPPED}" for of in ("four loops", "valves"))
    growing, hagglund, gradient = "growing rule", "Hägglund", "gradient"
    gained = "RMSE, mean change (95 %)"
    yield f"is wrong on {wrong[valves][PAPER]} of the days of these valves"
    yield f"and on {wrong[loops][PAPER]} of those of four loops"
    yield f"There {worse[loops][PAPER]} of the loops end with an RMSE more than 2 % above that of their plain PI"
    yield f"is wrong on {wrong[loops][growing]} of the days of the four loops that it was chosen on"
    yield f"and on {wrong[valves][growing]} of those of the valves"
    yield f"{worse[f'valves: {HEATING}'][growing]} of the worn valves get worse by more than 2 % in heating"
    still = [good[f"no backlash, valves: {kind}"][growing] for kind in KINDS[1:]]
    yield f"of the valves without backlash {least_and_most(still)} by more than 1 % on days without steps"
    yield f"wrong on {wrong[valves][AVERAGED]} of the days"
    yield f"and harms {worse[f'valves: {HEATING}'][AVERAGED]} of the worn valves in heating"
    yield f"With the trip it is wrong on {wrong[valves][TRIP]} and harms {worse[f'valves: {HEATING}'][TRIP]}"
    yield f"is wrong on {wrong[valves][hagglund]} of the days, too low on {stepped[hagglund]['too low']}"
    yield f"wrong on {wrong[valves][gradient]} of the days, too high on {stepped[gradient]['too high']}"
    yield f"lowers the RMSE by {fall(every[gradient][gained])} over all kinds of days"
    yield f"at {every[gradient]['motor travel, median']} of the travel"
    named = [good[f"no backlash, valves: {kind}"][gradient] for kind in KINDS]
    yield f"{least_and_most(named)} of the valves without backlash get worse by more than 1 %"


def identified():
    """What it must say of identification."""
    wrong, twenty, worse, good = (table(name) for name in ("failures", "twenty", "worse", "good"))
    every, stepped, morning = table("cost"), table("cost_stepped"), table("cost_morning")
    one, known, gained = "identify", "identify, stroke time known", "RMSE, mean change (95 %)"
    installed = [wrong[f"four loops: {what}"] for what in ("gentler valve", "authority 0.05")]
    of_remedies = [wrong[f"valves of `remedies`: {how_long}"][one] for how_long in ("a day of 8 h", "24 h")]
    yield f"wrong on {wrong[f'valves: {STEPPED}'][one]} of the days with set-point steps"
    yield f"on {installed[0][one]} of those of the four loops with a gentler valve, and on {installed[1][one]} with"
    small = wrong["four loops: backlash 2 %"]
    yield f"With 2 % of backlash there it is wrong on {small[one]}, the growing rule on {small['growing rule']}"
    yield f"the motor's stroke time these are {installed[0][known]} and {installed[1][known]}"
    yield f"{twenty['valves: backlash 0.5 to 2 %'][one]} are off by more than 20 % of the backlash"
    yield f"right from {stepped[one]['right since, median']} on in the median"
    yield f"the RMSE falls by {fall(stepped[one][gained])}"
    yield f"at {stepped[one]['motor travel, median']} of the travel"
    yield f"{fall(stepped['fixed 95 %'][gained])} with a known size"
    yield f"after a day of 8 h on the valves of [remedies](remedies.md) on {of_remedies[0]}"
    yield f"after 24 h on {of_remedies[1]}"
    assert all(percent(wrong[f"valves: {kind}"][one]) == 100 for kind in KINDS[1:]), "no estimate without steps"
    assert all(percent(row[one]) == 0 for row in worse.values()), "no loop with backlash gets worse by more than 2 %"
    assert {row["too high"] for row in (every[one], stepped[one])} == {"0 %"}
    alone = [good[f"no backlash, {of}: {STEPPED}"][one].split(",")[0] for of in ("valves", "four loops")]
    yield f"Of the valves without backlash {alone[0]} get worse by more than 1 %, of the four loops {alone[1]}"
    yield f"After a morning of steps it is right on {morning[one]['right at the end (95 %)']} of the days"
    yield f"the rest of the day included, falls by {fall(morning[one][gained])}"


def fronts():
    """Page → what it must say in short."""
    wrong, stepped = table("failures")[f"valves: {STEPPED}"], table("cost_stepped")
    most = f"{wrong['identify']} of the days, the growing rule on {wrong['growing rule']}"
    gained = fall(stepped["identify"]["RMSE, mean change (95 %)"])
    yield "studies/README.md", f"is wrong on {most}, the rule of the paper on {wrong[PAPER]}"
    yield (
        "studies/README.md",
        f"lowers the RMSE by {gained} at {stepped['identify']['motor travel, median']} of the travel",
    )
    yield "docs/populations.md", f"`identify` is wrong on {most}"


def test_the_page_of_learning_says_what_the_tables_say():
    page = " ".join((ROOT / "docs" / "learning.md").read_text().split())
    expected = [" ".join(sentence.split()) for sentence in (*answers(), *identified())]
    assert [sentence for sentence in expected if sentence not in page] == []


def test_the_fronts_of_other_pages_say_it_in_short():
    missing = []
    for page, sentence in fronts():
        text = " ".join((ROOT / page).read_text().split())
        missing += [] if " ".join(sentence.split()) in text else [(page, sentence)]
    assert missing == []
