"""The report of `fastcoil paper`: what holds of the paper, claim by claim, with its figures regenerated."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import exists, read_bytes, storage_errors
from fastcoil.base.text import NONE
from fastcoil.deliver.report.computed import cited, here
from fastcoil.deliver.report.page import Block, Code, Facts, Page, Picture, Section, Table, Words, number, share
from fastcoil.deliver.report.regenerate import captions
from fastcoil.study.paper.scorecard import SURELY

_LARGEST = 2**25  # bytes of the scorecard, and of a figure
_PNG = b"\x89PNG\r\n\x1a\n"


def paper_page(scorecard: Path) -> Page:
    """The report of the folder in which a scorecard lies."""
    with storage_errors(scorecard, "read"):
        try:
            return _page(json.loads(read_bytes(scorecard, _LARGEST)), scorecard.parent)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError) as error:
            raise IntegrityError(
                f"{scorecard} is damaged ({type(error).__name__}: {error}): run `fastcoil paper -o {scorecard.parent}` "
                "again"
            ) from None


def _page(card: Mapping[str, Any], folder: Path) -> Page:
    grid, claims = card["grid"], card["claims"]
    failed = int(grid["n_failed"])
    warnings = [str(card["caveat"])]
    warnings += [f"{failed:,} scenarios failed. They count in no share."] if failed else []
    moving = [c for c in claims if c["change"]]
    changing: list[Block] = [_shares(card, moving, "Largest differences first")] if moving else []
    answer = [_in_short(claims), *(_change(c) for c in moving[:3])]
    sections = [
        Section("What changes with the kind of day", changing),
        Section("What does not", [_shares(card, [c for c in claims if not c["change"]], "The other claims")]),
        Section("What contradicts itself", [Words(
            [f"“{c['claim']}” ({c['section']}) {c['verdict']}. {c['why']}" for c in card["identities"]], bullets=True
        )]),
        Section("Figures", _figures(folder, quick=str(card["command"]).endswith("--quick"))),
        Section("Claim by claim", [block for c in claims for block in _claim(c, grid["presets"])]),
        Section("Not simulated", [Words([str(text) for text in card["not_simulated"]], bullets=True)]),
        _how(card),
        here(),
        cited(),
    ]  # fmt: skip
    question = "Which claims of Cai and Braun (2016) hold, for which tunings, and on which kinds of days?"
    return Page("The paper", str(card["title"]), question, warnings, answer, sections)


def _in_short(claims: Iterable[Mapping[str, Any]]) -> str:
    shares = [found["share"] for claim in claims for found in claim["kinds"].values()]
    known = [one for one in shares if one is not None]
    hold, fail = sum(one >= SURELY for one in known), sum(one <= 1.0 - SURELY for one in known)
    return (
        f"Of {len(shares)} verdicts, one for each claim and kind of day, {hold} say that it holds (for {share(SURELY)} "
        f"of tunings × days or more), {fail} that it does not ({share(1.0 - SURELY)} or less), the others that it "
        "depends on the tuning."
    )


def _change(claim: Mapping[str, Any]) -> str:
    shares = ", ".join(f"{share(found['share'])} on {kind} days" for kind, found in claim["kinds"].items())
    return f"Depends on the day: “{claim['claim'].rstrip('.')}” holds in {shares}."


def _shares(card: Mapping[str, Any], claims: list[Mapping[str, Any]], caption: str) -> Table:
    """A row for each claim: on which share of tunings and days it holds, by kind of day."""
    kinds = list(card["kinds"])
    rows = []
    for c in claims:
        cells = [_share(c["kinds"].get(kind)) for kind in kinds]
        other = next((f"{_share(found)} ({kind})" for kind, found in c["kinds"].items() if kind not in kinds), "")
        rows.append([f"{c['claim']} ({c['section']})", *cells, other])
    note = (
        "Share of tunings × days on which the claim holds; in brackets its 95 % interval over such days, where they "
        "differ.  Quiet, coils: of tunings on a day without disturbances, of coils."
    )
    return Table(caption, ["claim", *kinds, "other"], rows, note)


def _share(found: Mapping[str, Any] | None) -> str:
    if found is None:
        return ""
    limits = found["share_interval"]
    within = f" ({100 * limits[0]:.0f} to {100 * limits[1]:.0f})" if limits else ""
    return NONE if found["share"] is None else share(found["share"]) + within


def _figures(folder: Path, *, quick: bool) -> list[Block]:
    found: list[Block] = []
    for name, caption in captions(quick=quick).items():
        path = folder / f"{name}.png"
        if not exists(path):
            found.append(Words([f"{path.name} is missing: run fastcoil paper again."]))
            continue
        png = read_bytes(path, _LARGEST)
        if not png.startswith(_PNG):
            raise ValueError(f"{path.name} is no PNG")
        plain = caption.replace("**", "")
        found.append(Picture(png, plain, plain.partition(".")[0]))
    return found


def _claim(c: Mapping[str, Any], presets: list[str]) -> list[Block]:
    lines = [f"Counts as holding: {c['counts_as_holding']} {c['note']}".strip()]
    for kind, found in c["kinds"].items():
        hunting = found["share_of_hunting"]
        among = "" if hunting is None else f"; {share(hunting)} among the tunings that hunt by themselves"
        lines.append(f"{kind}: {found['verdict_text']}{among}.")
    columns = [*presets, "grid"]
    rows = [
        [
            f"{name}, {kind}",
            *(_number(found["measured"][p][name]) for p in columns),
        ]
        for kind, found in c["kinds"].items()
        for name in found["measured"]["grid"]
    ]
    return [Table(f"{c['claim']} ({c['section']})", ["median over days", *columns], rows), Words(lines, bullets=True)]


def _number(value: float | None) -> str:
    return "never" if value is None else number(value)


def _how(card: Mapping[str, Any]) -> Section:
    grid = card["grid"]
    facts = [
        ("Tunings", f"{grid['n_tunings']} of {grid['n_tunings_tried']}; the others hunt without any backlash"),
        ("Days", f"{len(grid['day_seeds'])} of each kind, seeds {grid['day_seeds'][0]} to {grid['day_seeds'][-1]}"),
        *((f"Days: {name}", str(words)) for name, words in card["kinds"].items()),
        ("Backlash", f"{100 * grid['backlash']:.3g} %"),
        ("Time step", "1 s"),
        ("Noise seed", str(grid["noise_seed"])),
        ("fastcoil", str(card["fastcoil_version"])),
        *((f"content_sha256, {name}", str(found)) for name, found in grid["content_sha256"].items()),
    ]
    return Section("How it was computed", [Facts(facts), Code(str(card["command"]))])
