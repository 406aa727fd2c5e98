"""The numbers on the page of answers are those of the tables that the scripts write."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def rows(table):
    """Column → cell of each row of a table; an empty cell says what the one above it says."""
    lines = (next((ROOT / "studies").glob(f"*/tables/{table}.md"))).read_text().splitlines()
    head, _, *found = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    above = head
    for cells in found:
        above = [cell or old for cell, old in zip(cells, above, strict=True)]
        yield dict(zip(head, above, strict=True))


def row(table, *parts):
    """The only row of a table that has all ``parts`` in its cells."""
    (found,) = [of for of in rows(table) if all(any(part in cell for cell in of.values()) for part in parts)]
    return found


def named(table, name):
    """The row of a table whose first cell is ``name``."""
    (found,) = [of for of in rows(table) if next(iter(of.values())) == name]
    return found


def verdict(claim, kind="stepped"):
    """The row of a claim on a kind of day, in either table of the scorecard."""
    (found,) = [
        of for table in ("scorecard_changes", "scorecard") for of in rows(table)
        if claim in of["claim"] and of["days"] == kind
    ]  # fmt: skip
    return found


def share(claim, kind="stepped", column="share"):
    """Share of a claim in the scorecard, without its interval."""
    return verdict(claim, kind)[column].split(" (")[0]


def percent(change):
    """'17 %' of '-28 %, -17 %, -7 %', the median."""
    return change.split(", ")[1].lstrip("-")


def times(text):
    """The number of '× 1.66 '."""
    return float(text.lstrip("× "))


def answers():
    """What the page of answers must say."""
    simc, tuned, own = (named("robustness_baselines", name) for name in ("PI by SIMC", "best plain PI", "plain PI"))
    hunts = re.search(r"\((\d+ of \d+) there, (\d+ of \d+) elsewhere\)", verdict("PI loop hunts", "quiet")["verdict"])
    of_valves = {name: named("population", name) for name in ("fixed_60", "learner_growing")}
    buffered, bare = named("population", "fixed_95_buffer"), named("population", "fixed_95")
    learned = row("population_learners", "learner_growing")
    ship, cost = row("learning_choice", "all"), row("learning_cost", "all")
    better, best, noisy = (
        "A better tuning does more",
        "With the best gains for each, an",
        "for each, noise and a buffer",
    )
    # tuning
    yield f"gains by SIMC take {simc['at 7 %'].lstrip('-')} of the error at 7 % backlash"
    assert (simc["motor travel"], own["motor travel"]) == ("× 0.1", "× 1.0"), "nine tenths of the motor's travel"
    assert tuned["RMSE at 2 %"].startswith("+"), "gains for a worn valve are wrong for a good one"
    yield f"the best plain PI does more than an inverse of 95 % on {share(better)}, "
    yield f"on days with a constant set-point on {share(better, 'constant')} "
    # inverse
    title = (ROOT / "studies" / "inverse" / "tables" / "population.md").read_text().splitlines()[0]
    yield re.search(r"population of ([\d,]+ valves and loops on \d+ days)", title)[1].replace("population", "")
    column = "RMSE: 5 %, median, 95 % of the valves"
    yield f"95 % lowers the RMSE by {percent(buffered[column])} in the median, at the motor travel of the plain PI"
    assert times(buffered["motor travel, median"]) == pytest.approx(1.0, abs=0.05)
    yield f"(without the buffer: {times(bare['motor travel, median']):.0f} times that)"
    yield f"60 % of the backlash still gives {percent(of_valves['fixed_60'][column])}"
    yield f"ahead of the plain PI on {share(best)} of the tunings with set-point steps and on all without"
    assert {share(best, kind) for kind in ("constant", "design", "weather")} == {"100 %"}
    yield f"with 0.05 K of noise and a buffer on {share(noisy)} and {share(noisy, 'constant')}"
    seven = named("conditions_heating", "7%")
    assert float(seven["95 %, buffer 1 %"]) > 0.95 * float(seven["plain PI"]), "it leaves nothing of the gain"
    # learner
    yield f"first step {ship['step']}, every {ship['interval']}, ratio {ship['ratio']}, buffer {ship['buffer']}"
    yield f"confirmed within {cost['confirmed, min'].split()[0]} min"
    yield f"fails in {ship['100 fresh days']} of the cases on fresh days"
    yield f"only {learned['within 80 to 120 % (95 % over valves and days)']} of the estimates are right to 20 %"
    growing = of_valves["learner_growing"]
    yield f"The RMSE falls by {percent(growing[column])}"
    yield f"at {times(growing['motor travel, median']):.1f} times the travel"
    worst = max(times(of["settled RMSE with the rule"]) for of in rows("conditions_good_valve"))
    warm = max(float(of["growing rule"]) / float(of["plain PI"]) for of in rows("conditions_heating"))
    yield f"settled error up to {worst:.1f} times that of the plain PI, in heating up to {warm:.1f} times"
    # paper
    yield f"An inverse of 60 % helps nearly everywhere ({share('inverse of 60 %')})"
    yield f"above the true backlash the switches jump ({share('rise dramatically')})"
    yield f"half do ({hunts[1]}), of the others next to none: {hunts[2]}"
    yield f"falls up to the true backlash ({share('falls consistently')}) and seldom rises beyond it"
    yield f"seldom rises beyond it ({share('the error rises again')}) where the set-point steps"
    yield f"rises beyond the true backlash in {share('the error rises again', 'constant')}"
    yield f"half of the tunings ({share('rule identifies')})"
    yield f"most of those that hunt ({share('rule identifies', column='hunting')})"
    yield f"Noise makes the inverse switch ({share('switch severely')}); a buffer cures that ({share('cures that')})"


def test_the_page_of_answers_says_what_the_tables_say():
    page = " ".join((ROOT / "studies" / "README.md").read_text().split())
    assert [sentence for sentence in answers() if sentence not in page] == []


def pages():
    """Page → what it must say."""
    hunts = re.search(r"\((\d+) of \d+ there, (\d+) of (\d+) elsewhere\)", verdict("PI loop hunts", "quiet")["verdict"])
    assert hunts[2] == "1", "of so many such loops one does"
    yield "conditions", f"of the {hunts[3]} such loops of the [scorecard](paper.md#what-holds) one does"
    rises, best = "the error rises again", "The best estimate is the true backlash"
    better, with_best, noisy = (
        "A better tuning does more",
        "With the best gains for each, an",
        "for each, noise and a buffer",
    )
    yield "paper", f"rises beyond the true backlash in {share(rises)} of the tunings"
    yield "paper", f"the true backlash or slightly less is best in {share(best)}"
    yield "paper", f"these are {share(rises, 'constant')} and {share(best, 'constant')}"
    nearly = [share("tracks almost perfectly", kind).rstrip(" %") for kind in ("constant", "stepped")]
    yield "paper", "is nearly perfect in {} instead of {} %".format(*nearly)
    peaks = [int(share("peak demand", kind).rstrip(" %")) for kind in ("stepped", "constant", "design", "weather")]
    yield "paper", f"in {min(peaks)} to {max(peaks)} %"
    yield "paper", f"more than an inverse of 95 % on {share(better)} of the tunings as they are"
    yield "paper", f"where it stands still, on {share(better, 'constant')}"
    yield "paper", f"on top of the best PI helps nearly everywhere ({share('helps the best PI')})"
    yield "paper", f"the inverse is ahead on {share(with_best)} with steps, and on all without"
    shrunk = [share(noisy, kind).rstrip(" %") for kind in ("stepped", "constant", "design")]
    yield "paper", "that shrinks to {} and {} %, and to {} % on design days".format(*shrunk)
    learned = named("population_learners", "learner_growing")[WITHIN]
    middle, low, high = re.findall(r"\d+", learned)
    yield (
        "populations",
        f"{middle} % of the growing rule's estimates are within 80 to 120 % ({low} to {high} % over",
    )
    at = named("robustness", "0.95")
    yield (
        "inverse",
        f"of the 26 plain PIs in {float(at['lower RMSE than the best plain PI in'].rstrip('%')):.0f} % of the",
    )
    between = [of["lower RMSE in"] for of in rows("robustness") if 0.5 <= float(of["estimate / backlash"]) <= 1.2]
    assert {f"{float(cell.rstrip('%')):.0f}" for cell in between} <= {"96", "97"}
    yield "inverse", "to 120 % of it the error falls in 96 % of the loops"
    band = named("robustness_baselines", "error dead band of 0.5 K")
    yield "inverse", f"0.5 K takes {band['at 7 %'].lstrip('-')} of the error at 7 %"
    assert float(band["RMSE at 2 %"].rstrip(" %")) > 100, "and more than doubles it at 2 %"
    tuned, exact = (
        named("robustness_baselines", "best plain PI"),
        named("robustness_baselines", "best PI, inverse of 95 %"),
    )
    assert abs(float(tuned["RMSE"].rstrip(" %")) + 60) < 5, "do as much as the inverse"
    assert exact["hunting in"] == "15 of 15", "with an inverse the loop hunts"


WITHIN = "within 80 to 120 % (95 % over valves and days)"


def test_the_pages_say_what_their_tables_say():
    texts = {path.stem: " ".join(path.read_text().split()) for path in (ROOT / "docs").glob("*.md")}
    assert [(page, sentence) for page, sentence in pages() if sentence not in texts[page]] == []
