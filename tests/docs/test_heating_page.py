"""What the page on heating says in words stands in its tables."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = " ".join((ROOT / "docs" / "findings" / "heating.md").read_text().split())


def rows(table):
    """The rows of a table, column → cell."""
    text = (ROOT / "studies" / "heating" / "tables" / f"heating_{table}.md").read_text()
    head, _, *found = ([c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|")
    return [dict(zip(head, row, strict=True)) for row in found]


def numbers(text):
    return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", text)]


def fresh(gains):
    return [row for row in rows("fresh") if row["gains"] == gains]


OVERSHOOT, SETTLING = "overshoot: median, 95 %, most", "settling, s: median, 95 %"
REMEDIES = ("half kp", "95 % inverse", "95 %, buffer by noise", "`identify`", "growing rule")


def test_the_presets_on_fresh_conditions():
    own = fresh("own")
    assert all(row[f"hunting, {of}"].startswith("0 %") for row in own for of in ("X = 0", "worn"))
    most = [numbers(row[OVERSHOOT])[2] for row in own]
    assert "the largest overshoot is {:.0f} and {:.0f} %".format(*most) in PAGE
    assert f"overshoots by up to {most[1]:.0f} %** at some conditions" in PAGE
    assert f"by more than {numbers(own[1][OVERSHOOT])[1]:.0f} % at one in twenty" in PAGE
    assert f"`heating` takes {numbers(own[0][SETTLING])[1]:.0f} s and more to settle" in PAGE
    of_lbnl = [numbers(row[OVERSHOOT])[2] for row in fresh("those of `lbnl`")]
    assert "The gains of `lbnl` overshoot by up to {:.0f} and {:.0f} % there".format(*of_lbnl) in PAGE
    assert all(1500 < numbers(row[SETTLING])[0] < 2200 for row in fresh("those of `g36`"))
    for name in ("paper_like", "paper_like_fast"):
        assert all(numbers(row["hunting, X = 0"])[0] >= 99 for row in fresh(f"those of `{name}`"))


def test_backlash():
    every = rows("backlash")
    assert all(numbers(row["plain PI"])[2] == 0 for row in every)
    errors = {row["valves"]: numbers(row["plain PI"])[0] for row in every if row["days"] == "constant"}
    first = {row["valves"]: numbers(row["plain PI"])[0] for row in every[:4] if row["days"] == "constant"}
    assert f"an RMSE of {first['worn']:.3f} K, the good ones of {first['X = 0']:.3f} K" in PAGE
    assert errors["worn"] > 1.5 * errors["X = 0"]


@pytest.fixture
def changes():
    """Remedy → of worn and of good valves, over coils and days: changes of the error and × travel."""
    found = {}
    for name in REMEDIES:
        of_valves = {}
        for valves in ("worn", "X = 0"):
            cells = [row[name] for row in rows("backlash") if row["valves"] == valves]
            of_valves[valves] = [(numbers(c)[0], float(c.split("× ")[1].split(",")[0])) for c in cells]
        found[name] = of_valves
    return found


def test_remedies(changes):
    inverse, buffered = (changes[name]["worn"] for name in REMEDIES[1:3])
    lower = [-change for change, _ in inverse + buffered]
    assert f"lowers the error of worn valves by {min(lower):.0f} to {max(lower):.0f} %" in PAGE
    bare, with_buffer = ([travel for _, travel in of] for of in (inverse, buffered))
    assert f"at {min(bare):.0f} to {max(bare):.0f} times the motor travel" in PAGE
    assert f"costs {min(with_buffer):.1f} to {max(with_buffer):.1f} times" in PAGE
    assert min(change for change, _ in changes["half kp"]["X = 0"]) >= 33
    assert min(change for change, _ in changes["half kp"]["worn"]) > 0
    harm = [change for change, _ in changes["growing rule"]["X = 0"]]
    assert f"by {min(harm):.0f} to {max(harm):.0f} %, as [elsewhere]" in PAGE
    stepped = [numbers(r["`identify`"])[0] for r in rows("backlash") if (r["days"], r["valves"]) == ("stepped", "worn")]
    assert f"there it gains {min(-c for c in stepped):.0f} to {max(-c for c in stepped):.0f} %" in PAGE
    assert all(change == 0 for change, _ in changes["`identify`"]["X = 0"])
    still = [
        c
        for c, row in zip(changes["`identify`"]["worn"], rows("backlash")[::2], strict=True)
        if row["days"] != "stepped"
    ]
    assert all(change == 0 for change, _ in still)


def test_theory():
    found = rows("theory")
    missed = [numbers(row["missed, swing (median)"])[0] for row in found]
    assert {row["cases"] for row in found} == {"960"}
    assert f"{min(missed):.0f} to {max(missed):.0f} of 960" in PAGE
    large = [numbers(row["missed, swing (median)"])[1] for row in found]
    assert sorted(round(swing) for swing in large)[1:] == [11, 12, 13]
    assert "of 11 to 13 K in the median of three of the rows" in PAGE
    ratios = [numbers(row["swing within × 1.5, over the foretold (median)"])[1] for row in found]
    assert f"by {100 * min(ratios) - 100:.0f} to {100 * max(ratios) - 100:.0f} % in the median" in PAGE
    right = [numbers(row["hunts or not: right"])[0] for row in found]
    assert f"right in {min(right):.0f} to {max(right):.0f} %" in PAGE
