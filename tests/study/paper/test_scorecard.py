"""The scorecard: every claim with all its fields, the same as data, in Markdown and on the screen."""

from __future__ import annotations

import jsonschema
import pytest

from fastcoil.loops.netcdf import load
from fastcoil.loops.presets import COOLING
from fastcoil.study.paper import grid as runs
from fastcoil.study.paper import scorecard as verdicts
from fastcoil.study.paper.claims import CLAIMS
from fastcoil.study.paper.grid import KINDS, words

pytestmark = pytest.mark.kernel

NUMBER = {"type": "number", "minimum": 0, "maximum": 1}
INTERVAL = {"type": ["array", "null"], "items": NUMBER, "minItems": 2, "maxItems": 2}
KIND_SCHEMA = {
    "type": "object",
    "required": ["measured", "verdict", "condition", "share", "share_interval", "share_of_hunting",
                 "share_of_hunting_interval", "share_of_days"],
    "properties": {
        "verdict": {"enum": ["holds", "holds only if", "does not hold"]},
        "condition": {"type": ["string", "null"]},
        "share": NUMBER,
        "share_interval": INTERVAL,
        "share_of_hunting_interval": INTERVAL,
        "share_where_condition": NUMBER | {"type": ["number", "null"]},
        "share_of_hunting": NUMBER | {"type": ["number", "null"]},
        "share_elsewhere": NUMBER | {"type": ["number", "null"]},
        "share_of_days": {"required": list(COOLING), "additionalProperties": NUMBER},
        "measured": {
            "required": [*COOLING, "grid"],
            "additionalProperties": {"minProperties": 1, "additionalProperties": {"type": ["number", "null"]}},
        },
    },
}  # fmt: skip
CLAIM_SCHEMA = {
    "type": "object",
    "required": ["name", "section", "claim", "counts_as_holding", "n_tunings", "n_days", "change", "kinds"],
    "properties": {
        "section": {"type": "string", "pattern": "^[0-9]"},
        "claim": {"type": "string", "minLength": 10},
        "counts_as_holding": {"type": "string", "minLength": 10},
        "n_tunings": {"type": "integer", "minimum": 1},
        "n_days": {"type": "integer", "minimum": 1},
        "change": NUMBER,
        "kinds": {"additionalProperties": KIND_SCHEMA, "minProperties": 1},
    },
}


def test_the_scorecard_has_every_claim_with_all_fields_on_every_kind_of_day(card):
    assert sorted(c["name"] for c in card["claims"]) == sorted(c.name for c in CLAIMS)
    for claim in card["claims"]:
        jsonschema.validate(claim, CLAIM_SCHEMA)
        by_day = claim["evidence"] not in ("quiet", "coils")
        assert list(claim["kinds"]) == (list(KINDS) if by_day else [claim["evidence"]])
    assert "digitised" in card["caveat"]
    assert "Quick mode" in card["caveat"]
    assert list(card["kinds"]) == list(KINDS)
    of_hunting = {c["name"]: c["kinds"] for c in card["claims"]}
    without = {name for name, kinds in of_hunting.items() for k in kinds.values() if k["share_of_hunting"] is None}
    assert without == {"hunts", "volumes"}


def test_what_changes_with_the_kind_of_day_comes_first_the_largest_change_before_all(card):
    changes = [c["change"] for c in card["claims"]]
    assert changes == sorted(changes, reverse=True)
    assert changes[0] >= verdicts.MATTERS
    assert changes[-1] == 0.0
    for claim in card["claims"]:
        if claim["change"]:
            shares = [k["share"] for k in claim["kinds"].values()]
            assert max(shares) - min(shares) >= claim["change"] - 1e-12
            assert any(abs(abs(a - b) - claim["change"]) < 1e-12 for a in shares for b in shares)


@pytest.mark.parametrize(
    ("name", "one", "factor", "other"),
    [
        ("rises", "100 %", 1.01, "120 %"),
        ("against best PI", "95 %", 1 / 0.99, "best PI"),
        ("best PI alone", "best PI", 1 / 0.99, "95 %"),
        ("best against best", "best inverse", 1 / 0.99, "best PI"),
        ("against dead band", "95 %", 1 / 0.99, "dead band"),
    ],
)
def test_a_share_is_what_plain_python_counts(folder, card, name, one, factor, other):
    """Tunings × days of a kind on which the other error exceeds one by over 1 %; without those that always hunt."""
    quiet, days = load(folder / "grid_quiet.nc"), load(folder / "grid_days.nc")
    (claim,) = (c for c in card["claims"] if c["name"] == name)
    for kind in KINDS:
        counted = []
        for tuning in quiet.tuning.values:
            if not bool(quiet.hunts.sel(case="no backlash", tuning=tuning)):
                rmse = days.rmse.sel(kind=kind, tuning=tuning)
                pairs = zip(rmse.sel(case=one).values, rmse.sel(case=other).values, strict=True)
                counted += [b > factor * a for a, b in pairs]
        assert claim["kinds"][kind]["share"] == pytest.approx(sum(counted) / len(counted))
        assert claim["n_tunings"] * claim["n_days"] == len(counted)


def test_the_scorecard_to_read_and_the_screen_say_the_same(folder, card):
    text, said = (folder / "scorecard.md").read_text(), (folder / "said.txt").read_text()
    for claim in card["claims"]:
        (line,) = (line for line in said.splitlines() if line.endswith(f"  {claim['claim']}"))
        shares = [runs.percent(k["share"]) for k in claim["kinds"].values()]
        assert line.removesuffix(claim["claim"]).split() == " ".join(shares).split()
        first = True
        for kind, found in claim["kinds"].items():
            limits = found["share_interval"]
            within = " ({:.0f} to {:.0f})".format(*(100 * x for x in limits)) if limits else ""
            head = claim["claim"] if first else ""
            row = f"| {head} | {kind} | {found['verdict_text']} | {runs.percent(found['share'])}{within} |"
            assert row in text
            first = False
    changed, rest = text.split("## What does not\n")
    assert all((f"| {c['claim']} |" in changed) == (c["change"] > 0) for c in card["claims"])
    assert runs.arithmetic() in rest
    for table in text.split("\n\n"):
        assert len({line.count(" | ") for line in table.splitlines() if line.startswith("|")}) <= 1
    assert len(said.splitlines()) < 60
    assert "scorecard.md" in said


def test_the_kinds_of_days_are_told_on_the_screen_and_in_the_text(folder):
    for text in (folder / "said.txt", folder / "scorecard.md"):
        for name, make in KINDS.items():
            assert f"{name}" in text.read_text()
            assert words(make) in text.read_text()
