"""The numbers in the answers of ``docs/remedies.md`` are those of its tables."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]


def table(name):
    """Row's name → column → cell."""
    lines = (ROOT / "studies" / "tables" / f"{name}.md").read_text().splitlines()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("|"))
    return {cells[0]: dict(zip(head, cells, strict=True)) for cells in rows}


def answers():
    """What the page must say."""
    simc, cost, harm = (table(f"remedies_simc{part}") for part in ("", "_cost", "_by_backlash"))
    best, best_cost = table("remedies"), table("remedies_cost")

    def gain(name, of=simc):
        return of[name]["all"]

    def travel(name, of=cost):
        return of[name]["motor travel, median"]

    def whole(cell):
        return f"{float(cell.rstrip('%')):.0f} %"

    size = simc["(RMSE of plain PI, median)"]
    yield f"RMSE of {size['all']} in the median, of {float(size['stepped'].split()[0]):.2f} K where the set-point steps"
    shares = [float(row["time beyond 0.5 K"].rstrip("%")) for row in cost.values()]
    assert max(shares[1:]) - min(shares[1:]) < 2.0
    band = "PI, dead band 0.25 K"
    yield f"0.25 K costs {gain(band)} of RMSE for a travel of {travel(band)}"
    yield f"{whole(best_cost[band]['hunting'])} of the days hunt, and the motor travels {travel(band, best_cost)}"
    learner = "learner (growing)"
    yield f"costs {gain(learner)} of RMSE at {travel(learner)} of travel"
    yield f"{whole(cost[learner]['over 1 % worse in'])} of the valves get worse"
    yield f"On a valve without backlash the RMSE rises by {harm[learner]['0%']} in the median"
    yield f"Behind the best gains it costs {gain(learner, best)}, and {whole(best_cost[learner]['hunting'])} of the days"
    yield f"[its page](own-rule.md): {gain('a rule of your own')}"
    yield f"little good: {gain('Hägglund, inverse')} behind the gains of SIMC"
    assert gain("Hägglund, inverse", best).startswith("-0 %")
    over = "inverse 120 %, buffer 1 %"
    yield f"costs {gain(over)} at {travel(over)} of travel; {whole(cost[over]['hunting'])} of the days hunt"
    yield f"{travel('inverse 95 %, no buffer')} and {travel('smooth inverse 95 %')}"
    yield f"cost {gain('PI as found')} against SIMC"
    yield f"gain another {gain('best PI')}, at {travel('best PI')} of travel"
    noise = "inverse 95 %, buffer by noise"
    yield f"{gain(noise)} at {travel(noise)} of travel.  A perfect valve would gain {gain('(a valve without backlash)')}"
    small = "inverse 95 %, buffer 0.25 %"
    yield f"A fixed buffer of 0.25 % gains {gain(small)} at {travel(small)}"
    rough = "inverse 80 %, buffer 1 %"
    yield f"{gain(rough)} at {travel(rough)} of travel and {cost[rough]['reversals']} of the reversals"
    yield f"at a good valve: {harm[rough]['0%']} in the median"
    yield f"{gain('gradient')} at {travel('gradient')} of travel"
    yield f"and {whole(cost['gradient']['over 1 % worse in'])} of the valves get worse"
    yield f"does what the inverse does: {gain('additive 95 %')}"
    half = "PI, half its kp"
    yield f"{travel(half)} of the travel for {gain(half)}"


def test_the_answers_say_what_the_tables_say():
    page = " ".join((ROOT / "docs" / "remedies.md").read_text().split())
    assert [sentence for sentence in answers() if " ".join(sentence.split()) not in page] == []
