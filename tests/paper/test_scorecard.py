"""The scorecard: every claim with all its fields, the same as data, in Markdown and on the screen."""

from __future__ import annotations

import jsonschema
import pytest

from fastcoil.paper import runs
from fastcoil.paper.claims import CLAIMS
from fastcoil.simulation.presets import PRESETS

pytestmark = pytest.mark.kernel

NUMBER = {"type": "number", "minimum": 0, "maximum": 1}
INTERVAL = {"type": ["array", "null"], "items": NUMBER, "minItems": 2, "maxItems": 2}
CLAIM_SCHEMA = {
    "type": "object",
    "required": ["name", "section", "claim", "counts_as_holding", "measured", "verdict", "condition", "share",
                 "share_interval", "share_of_hunting", "share_of_hunting_interval", "share_of_days", "n_tunings",
                 "n_days"],
    "properties": {
        "section": {"type": "string", "pattern": "^[0-9]"},
        "claim": {"type": "string", "minLength": 10},
        "counts_as_holding": {"type": "string", "minLength": 10},
        "verdict": {"enum": ["holds", "holds only if", "does not hold"]},
        "condition": {"type": ["string", "null"]},
        "share": NUMBER,
        "share_interval": INTERVAL,
        "share_of_hunting_interval": INTERVAL,
        "share_where_condition": NUMBER | {"type": ["number", "null"]},
        "share_of_hunting": NUMBER | {"type": ["number", "null"]},
        "share_elsewhere": NUMBER | {"type": ["number", "null"]},
        "n_tunings": {"type": "integer", "minimum": 1},
        "n_days": {"type": "integer", "minimum": 1},
        "share_of_days": {"required": list(PRESETS), "additionalProperties": NUMBER},
        "measured": {
            "required": [*PRESETS, "grid"],
            "additionalProperties": {"minProperties": 1, "additionalProperties": {"type": ["number", "null"]}},
        },
    },
}  # fmt: skip


def test_the_scorecard_has_every_claim_with_all_fields(card):
    assert [c["name"] for c in card["claims"]] == [c.name for c in CLAIMS]
    for claim in card["claims"]:
        jsonschema.validate(claim, CLAIM_SCHEMA)
    assert "digitised" in card["caveat"]
    assert "Quick mode" in card["caveat"]
    of_hunting = {claim["name"]: claim["share_of_hunting"] for claim in card["claims"]}
    assert {name for name, share in of_hunting.items() if share is None} == {"hunts", "volumes"}


def test_the_scorecard_to_read_and_the_screen_say_the_same(folder, card):
    text, said = (folder / "scorecard.md").read_text(), (folder / "said.txt").read_text()
    for claim in card["claims"]:
        assert claim["claim"] in said
        limits = claim["share_interval"]
        within = " ({:.0f} to {:.0f})".format(*(100 * x for x in limits)) if limits else ""
        assert f"| {claim['claim']} | {claim['verdict_text']} | {runs.percent(claim['share'])}{within} |" in text
    assert runs.arithmetic() in text
    for table in text.split("\n\n"):
        assert len({line.count(" | ") for line in table.splitlines() if line.startswith("|")}) <= 1
    assert len(said.splitlines()) < 60
    assert "scorecard.md" in said
