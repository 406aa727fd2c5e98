"""What the pages say of estimators is what the tables of ``studies/learners.py`` say."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
STEPPED, CONSTANT, HEATING = "set-point steps", "constant set-point", "heating"
KINDS = (STEPPED, CONSTANT, "design days", "weather, 30 % outdoor air", HEATING)
PAPER, AVERAGED, TRIP = "paper's rule", "growing, averaged reference", "growing, error trip too"


def table(name):
    """Row's name → column → cell."""
    lines = (ROOT / "studies" / "tables" / f"learners_{name}.md").read_text().splitlines()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    return {row[0]: dict(zip(head, row, strict=True)) for row in rows}


def least_and_most(cells):
    """'3 to 12 %' of shares with intervals."""
    shares = [int(cell.split(" %")[0]) for cell in cells]
    return f"{min(shares)} to {max(shares)} %"


def percent(cell):
    """Of '12 % (3 to 20), +0.7 %, 4 %' the first number."""
    return int(cell.split(" %")[0])


def answers():
    """What the page of learning must say."""
    wrong, twenty, worse, good = (table(name) for name in ("failures", "twenty", "worse", "good"))
    every, stepped = table("cost"), table("cost_stepped")
    loops, valves = (f"{of}: {STEPPED}" for of in ("four loops", "valves"))
    growing, hagglund, gradient = "growing rule", "Hägglund", "gradient"
    gained = "RMSE, mean change (95 %)"
    yield f"is wrong on {wrong[valves][PAPER]} of the days of these valves, and on {wrong[loops][PAPER]} of those of four"
    yield f"There {worse[loops][PAPER]} of the loops end with an RMSE more than 2 % above that of their plain PI"
    yield f"is wrong on {wrong[loops][growing]} of the days of the four loops that it was chosen on, and on "
    yield f"on {wrong[valves][growing]} of those of the valves"
    yield f"{worse[f'valves: {HEATING}'][growing]} of the worn valves get worse by more than 2 % in heating"
    still = [good[f"no backlash, valves: {kind}"][growing] for kind in KINDS[1:]]
    yield f"of the valves without backlash {least_and_most(still)} by more than 1 % on days without steps"
    yield f"wrong on {wrong[valves][AVERAGED]} of the days"
    yield f"and harms {worse[f'valves: {HEATING}'][AVERAGED]} of the worn valves in heating"
    yield f"With the trip it is wrong on {wrong[valves][TRIP]} and harms {worse[f'valves: {HEATING}'][TRIP]}"
    yield f"is wrong on {wrong[valves][hagglund]} of the days, {stepped[hagglund]['too low']} of all too low"
    yield f"wrong on {wrong[valves][gradient]} of the days, {stepped[gradient]['too high']} of all too high"
    yield f"lowers the RMSE by {every[gradient][gained].lstrip('-')} over all kinds of days"
    yield f"at {every[gradient]['motor travel, median']} of the travel"
    named = [good[f"no backlash, valves: {kind}"][gradient] for kind in KINDS]
    yield f"{least_and_most(named)} of the valves without backlash get worse by more than 1 %"


def identified():
    """What it must say of identification."""
    wrong, twenty, worse, good = (table(name) for name in ("failures", "twenty", "worse", "good"))
    every, stepped = table("cost"), table("cost_stepped")
    one = "identify"
    yield f"wrong on {wrong[f'valves: {STEPPED}'][one]} of the days with set-point steps"
    yield f"on {wrong['four loops: gentler valve'][one]} of those of the four loops with a gentler valve"
    yield f"on {wrong['four loops: authority 0.05'][one]} with an authority of 0.05"
    yield f"{twenty['valves: backlash 0.5 to 2 %'][one]} are off by more than 20 % of the backlash"
    yield f"right since {stepped[one]['right since, median']} in the median"
    yield f"the RMSE falls by {stepped[one]['RMSE, mean change (95 %)'].lstrip('-')}"
    yield f"at {stepped[one]['motor travel, median']} of the travel"
    yield f"{stepped['fixed 95 %']['RMSE, mean change (95 %)'].lstrip('-')} with a known size"
    yield f"after a day of 8 h on the valves of [remedies](remedies.md), {wrong['valves of `remedies`: a day of 8 h'][one]}"
    yield f"after 24 h {wrong['valves of `remedies`: 24 h'][one]}"
    assert all(percent(wrong[f"valves: {kind}"][one]) == 100 for kind in KINDS[1:]), "no estimate without steps"
    assert all(percent(row[one]) == 0 for row in worse.values()), "no loop with backlash gets worse by more than 2 %"
    assert {row["too high"] for row in (every[one], stepped[one])} == {"0 %"}
    alone = good[f"no backlash, valves: {STEPPED}"][one].split(",")[0]
    yield f"Of the valves without backlash {alone} get worse by more than 1 %"


def fronts():
    """Page → what it must say in short."""
    wrong, stepped = table("failures")[f"valves: {STEPPED}"], table("cost_stepped")
    most = f"{wrong['identify']} of the days, the growing rule on {wrong['growing rule']}"
    gained = stepped["identify"]["RMSE, mean change (95 %)"].lstrip("-")
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
