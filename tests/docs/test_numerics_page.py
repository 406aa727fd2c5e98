"""What the page on numerics says in words stands in its tables."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = " ".join((ROOT / "docs" / "findings" / "numerics.md").read_text().split())
DAYS = ("stepped", "constant", "design", "weather", "heating")


def cells(table, *start):
    """Column → cell of the row of a table that begins so."""
    text = (ROOT / "studies" / "numerics" / "tables" / f"convergence_{table}.md").read_text()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|")
    (found,) = [row for row in rows if tuple(row[: len(start)]) == start]
    return dict(zip(head, found, strict=True))


def numbers(cell):
    return [float(n) for n in re.findall(r"[-+]?\d+(?:\.\d+)?", cell)]


def test_what_fails():
    hunts, swing = "hunts, X = 7%", "swing, X = 7%"
    fast = {kind: cells("kinds", kind, "paper_like_fast") for kind in DAYS[:4]}
    assert [numbers(fast[kind][hunts])[:2] for kind in fast] == [[8, 0], [8, 0], [8, 3], [8, 8]]
    swings = [numbers(fast[kind][swing])[::-1][1:] for kind in ("stepped", "constant")]
    assert "by {:.2f} K instead of {:.2f} K and by {:.2f} K instead of {:.2f} K".format(*swings[0], *swings[1]) in PAGE
    one = cells("backlash", "paper_like_fast", "7%")
    rmse, period, travel = (numbers(one[name]) for name in ("RMSE, K", "period, s", "motor travel, strokes"))
    assert (
        f"the RMSE is {rmse[1]:.3f} K, not {rmse[0]:.3f} K, the period {period[1]:.0f} s, not {period[0]:.0f} s" in PAGE
    )
    assert 0.45 < travel[1] / travel[0] < 0.55
    over = numbers(cells("claims", "paper_like_fast")["RMSE, inverse of 120 %"])
    assert f"takes {-over[0]:.0f} % of its error as printed, and {-over[1]:.0f} % converged" in PAGE
    rmse = numbers(cells("backlash", "paper_like", "7%")["RMSE, K"])
    assert f"moves by a fifth**: {rmse[0]:.3f} → {rmse[1]:.3f} K" in PAGE
    assert 0.18 < 1.0 - rmse[1] / rmse[0] < 0.22
    of_day = [numbers(cells("kinds", kind, "paper_like")[hunts])[:2] for kind in DAYS[:2]]
    assert of_day == [[8, 4], [8, 8]]


def test_what_survives():
    slow = [numbers(cells("steps", name, "lagged", "1")["rmse"])[0] for name in ("lbnl", "g36")]
    assert "at 7 % backlash {} % and {} % of the RMSE".format(*slow) in PAGE
    heating = [numbers(cells("steps", name, "lagged", "1")["rmse"])[0] for name in ("heating", "heating_45")]
    assert heating == [1.0, 1.0]
    assert "coils 1.0 % each" in PAGE
    of_kinds = [cells("hunting", kind) for kind in DAYS]
    printed, converged = ([numbers(row[f"hunt {way}"])[0] for row in of_kinds] for way in ("as printed", "converged"))
    shares = (min(converged), max(converged), min(printed), max(printed))
    assert "{:.0f} to {:.0f} % hunt converged, {:.0f} to {:.0f} % as printed".format(*shares) in PAGE
    ways = ("hunt only as printed", "hunt only converged")
    less, more = ([numbers(row[way])[0] for row in of_kinds] for way in ways)
    assert 1.5 <= min(a + b for a, b in zip(less, more, strict=True))
    assert max(a + b for a, b in zip(less, more, strict=True)) < 3.5
    assert max(more) <= 0.3
    inverse = [cells("remedies", kind, "inverse, 95 %, buffer 1 %") for kind in DAYS]
    moves = [numbers(row["RMSE against the plain PI, median"]) for row in inverse]
    assert max(abs(a - b) for a, b in moves) < 1.0
    changes = max(numbers(row["better or worse changes"])[0] for row in inverse)
    assert f"whether the inverse beats the plain PI changes in at most {changes} % of the cases" in PAGE
    growing = [numbers(cells("remedies", k, "growing rule")["right or wrong changes"])[0] for k in DAYS]
    assert f"Of the answers of the growing rule {min(growing):.0f} to {max(growing):.0f} % change" in PAGE
    right = [numbers(cells("remedies", kind, "identify")["estimate right"]) for kind in DAYS]
    assert max(abs(a - b) for a, b in right) <= 0.2


def test_the_substeps_are_enough_and_fewer_are_not():
    eight, four = (
        [abs(numbers(cells("steps", name, "quasistatic", n)["rmse"])[0])
         for name in ("paper_like", "paper_like_fast", "lbnl", "g36")]
        for n in ("8", "4")
    )  # fmt: skip
    assert max(eight) <= 1.0
    assert round(max(four)) == 3


def test_partly_wet_volumes_matter_by_less_than_a_per_cent():
    wet, dry = (
        numbers(cells("wet", f"{kind}", "8")["heat, % of the heat"])[1] for kind in ("partly wet (15)", "dry (21)")
    )
    assert f"by {wet} % at most, against {dry} % for a dry one" in PAGE
    assert wet < 1.0
