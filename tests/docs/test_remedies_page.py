"""The numbers in the answers of ``docs/remedies.md`` are those of its tables."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]


def cells(name):
    """(name, column → cell) of every row; of columns with one name the first counts."""
    lines = (ROOT / "studies" / "remedies" / "tables" / f"{name}.md").read_text().splitlines()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    return [(row[0], dict(reversed(list(zip(head, row, strict=True))))) for row in rows]


def table(name):
    """Row's name → column → cell."""
    return dict(cells(name))


def answers():
    """What the page must say."""
    simc, cost, harm = (table(f"remedies_simc{part}") for part in ("", "_cost", "_by_backlash"))
    best, best_cost = table("remedies"), table("remedies_cost")
    left = table("remedies_found")
    tuned = {(name, row["price of travel"]): row for name, row in cells("remedies_tuned")}

    def gain(name, of=simc):
        return of[name]["all"]

    def travel(name, of=cost):
        return of[name]["motor travel, median"]

    def whole(cell):
        return f"{float(cell.rstrip('%')):.0f} %"

    size = simc["(RMSE of plain PI, median)"]
    yield f"RMSE of {size['all']} in the median, of {float(size['stepped'].split()[0]):.2f} K where the set-point steps"
    off = {name: float(row["time beyond 0.5 K"].rstrip("%")) for name, row in cost.items()}
    assert all(abs(share - off["PI by SIMC"]) < 2.0 for name, share in off.items() if name != "PI as found")
    learner, band = "learner (growing)", "PI, dead band 0.25 K"
    yield f"costs {gain(learner)} of RMSE at {travel(learner)} of travel"
    yield f"and {whole(cost[learner]['over 1 % worse in'])} of the valves get worse.  On"
    yield f"On a valve without backlash the RMSE rises by {harm[learner]['0%']} in the median"
    yield f"PI it costs {gain(learner, best)}, and {whole(best_cost[learner]['hunting'])} of the days"
    yield f"steps it does gain: {simc[learner]['stepped']}, and {left[learner]['stepped']} behind the gains as found"
    yield f"On all days it costs {gain(learner, left)} there, too"
    assert float(tuned[learner, "0"]["RMSE against the best PI (95 %)"].split()[0]) > 0.0
    yield f"[a rule of your own](own-rule.md): {gain('a rule of your own')}"
    yield f"little good: {gain('Hägglund, inverse')}"
    assert gain("Hägglund, inverse", best).startswith("-0 %")
    yield f"(`gradient`) gains {gain('gradient')} at {travel('gradient')} of travel"
    yield f"as a cure for backlash.**  0.25 K costs {gain(band)}"
    yield f"on {whole(best_cost[band]['hunting'])} of the days with those that are best for plain PI"
    yield f"at {travel(band, best_cost)} of the travel"
    over = "inverse 120 %, buffer 1 %"
    yield f"costs {gain(over)} at {travel(over)} of travel; {whole(cost[over]['hunting'])} of the days hunt"
    yield f"{travel('inverse 95 %, no buffer')} and {travel('smooth inverse 95 %')}"
    yield f"cost {gain('PI as found')} against SIMC"
    double = "PI, kp and ti × 2"
    yield f"give another {gain(double)} at {travel(double)} of travel"
    yield f"and {whole(cost[double]['over 1 % worse in'])} of the valves get worse.  The"
    yield f"from days of trials, give {gain('best PI')} at {travel('best PI')}"
    noise, small, rough = (f"inverse {x}" for x in ("95 %, buffer by noise", "95 %, buffer 0.25 %", "80 %, buffer 1 %"))
    yield f"{gain(noise)} at {travel(noise)} of travel"
    yield f"A perfect valve would give {gain('(a valve without backlash)')}"
    yield f"A fixed buffer of 0.25 % gives {gain(small)} at {travel(small)}"
    yield f"one of 1 % {gain('inverse 95 %, buffer 1 %')} at {travel('inverse 95 %, buffer 1 %')}"
    own = tuned[noise, "0.1"]
    lower = own["RMSE against the best PI (95 %)"].split(" %")[0].lstrip("-")
    yield f"an RMSE {lower} % lower than the best PI at nearly the same travel, {own['travel']}"
    yield f"{gain(rough)} at {travel(rough)} of travel and {cost[rough]['reversals']} of the reversals"
    yield f"the buffer alone costs {harm[rough]['0%']} in the median"
    yield f"does what the inverse does: {gain('additive 95 %')} at {travel('additive 95 %')}"
    yield f"noise gives {gain(noise, left)} at {travel(noise, left)} of travel"
    yield f"80 % with 1 % gives {gain(rough, left)} at {travel(rough, left)}"
    half = "PI, half its kp"
    yield f"0.25 K leaves {travel(band)} of the travel and {cost[band]['reversals']} of the reversals"
    yield f"half the kp {travel(half)} of the travel for {gain(half)}"
    yield f"Where the set-point steps, the dead band costs {simc[band]['stepped']}"


def test_the_choice_is_the_one_of_the_table():
    """The lowest cost with a price of travel, for each thing that one may know."""
    found = {}
    for _, row in cells("remedies_choice"):
        found.setdefault(row["one must know"], []).append(
            (float(row["RMSE and travel, price 0.1"].split()[0]), row["remedy"])
        )
    assert {needs: min(rows)[1] for needs, rows in found.items()} == {
        "nothing": "PI, kp and ti × 2",
        "the size, to 20 %": "inverse 80 %, buffer 1 %",
        "the size, to 5 %": "inverse 95 %, buffer by noise",
        "a rule that finds it": "gradient",
    }


def test_the_answers_say_what_the_tables_say():
    page = " ".join((ROOT / "docs" / "remedies.md").read_text().split())
    assert [sentence for sentence in answers() if " ".join(sentence.split()) not in page] == []


def test_the_three_best_remedies_are_the_same_on_every_valve():
    rows = table("remedies_valves")
    for variant in rows["additive 95 %"].keys() - {"remedy"}:
        places = {row[variant].split(", ")[-1]: name for name, row in rows.items()}
        best = [places[place] for place in ("1.", "2.", "3.")]
        assert best == ["additive 95 %", "inverse 95 %, buffer 0.25 %", "inverse 95 %, buffer by noise"]
