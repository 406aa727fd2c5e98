"""What holds of the paper, claim by claim, as a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fastcoil.base.text import format_share
from fastcoil.deliver.report.page import (
    Block,
    Code,
    Page,
    Paragraphs,
    Picture,
    Section,
    Table,
    citation_section,
    facts_table,
    versions_section,
)
from fastcoil.loops.provenance import provenance
from studies.paper import grid
from studies.paper.scorecard import HOLDING_SHARE


def captions(*, quick: bool) -> dict[str, str]:
    """Captions of the figures, by file name without suffix."""
    spread = (
        "Line: median over two days; thin lines: each day, with each of two noise realisations where there is noise.  "
        if quick
        else "Line: median over ten days; band: 10th to 90th percentile, over three noise realisations, too, where "
        "there is noise.  "
    )
    return {
        "fig01": "Fig 1. (a) Backlash, Eq (1): opening over command, driven open and closed, with a small loop "
        "inside.  (b) Valve curve, Eq (2).",
        "fig07": "Fig 7. A plain PI controller with 7 % backlash (grey) and without (blue): it hunts with the "
        "backlash, and not without.  Dotted: set-point.",
        "fig09": "Fig 9. An inverse with 60 % of the backlash (blue) against the plain PI (grey).  "
        "Dotted: set-point.",
        "fig10": "Fig 10. An inverse with 95 % of the backlash (blue) against the plain PI (grey).  "
        "Dotted: set-point.",
        "fig11": "Fig 11. Mode switches and tracking error over the estimate relative to the backlash.  " + spread
        + "Dotted: the estimate is the backlash.  The buffer is six standard deviations of the noise on the PI's "
        "output.",
        "fig12": "Fig 12. (a, b) The estimate learned by the rule as printed.  (c, d) The mode switches that it "
        "saw.  (e, f) Variants, each until its first step down, which the dot marks.  Why the rule as printed cannot "
        "keep the paper's three hours: " + grid.explain_three_hours(),
        "scorecard": "Scorecard. Share of the grid in which each claim holds, by kind of day (marks), and its 95 % "
        "interval over days (lines).  Above the line: claims that hold more often on one kind of day than on another.  "
        "Dotted: 5 and 95 %, the limits of the verdicts.",
    }  # fmt: skip


def paper_page(card: Mapping[str, Any], folder: Path) -> Page:
    """The page of a scorecard, with the figures in its folder."""
    tunings, claims = card["grid"], card["claims"]
    n_failed = int(tunings["n_failed"])
    warnings = [str(card["caveat"])]
    warnings += [f"{n_failed:,} scenarios failed. They count in no share."] if n_failed else []
    changing_claims = [c for c in claims if c["change"]]
    changes_caption = (
        "The share differs between two kinds by 10 points or more, and by more than chance; largest differences first"
    )
    columns_note = (
        f"Under hunting: the share among the {tunings['n_hunting']} tunings that hunt by themselves with the backlash, "
        "as the paper's does.  Under the presets: days on which the claim holds."
    )
    shares = [kind["share"] for claim in claims for kind in claim["kinds"].values() if kind["share"] is not None]
    n_hold, n_fail = (
        sum(share >= HOLDING_SHARE for share in shares),
        sum(share <= 1.0 - HOLDING_SHARE for share in shares),
    )
    answer = [
        f"Of {len(shares)} verdicts, one for each claim and kind of day, {n_hold} say that it holds (for "
        f"{format_share(HOLDING_SHARE)} of tunings × days or more), {n_fail} that it does not "
        f"({format_share(1.0 - HOLDING_SHARE)} or less), the "
        "others that it depends on the tuning.",
        *map(_change_sentence, changing_claims[:3]),
    ]
    identities = [f"“{c['claim']}” ({c['section']}) {c['verdict']}. {c['why']}" for c in card["identities"]]
    sections = [
        Section("What changes with the kind of day", [_verdict_table(card, changing_claims, changes_caption)]),
        Section("What does not", [
            _verdict_table(card, [c for c in claims if not c["change"]], "The other claims"),
            Paragraphs([columns_note]),
        ]),
        Section("What contradicts itself", [Paragraphs(identities, bullets=True)]),
        Section("Figures", _figure_blocks(folder, quick=card["quick"])),
        Section("Claim by claim", [block for c in claims for block in _claim_blocks(c, tunings["presets"])]),
        Section("Not simulated", [Paragraphs([str(text) for text in card["not_simulated"]], bullets=True)]),
        _method_section(card),
        versions_section(provenance()),
        citation_section(),
    ]  # fmt: skip
    question = "Which claims of Cai and Braun (2016) hold, for which tunings, and on which kinds of days?"
    return Page("The paper", str(card["title"]), question, warnings, answer, sections)


def _change_sentence(claim: Mapping[str, Any]) -> str:
    shares = ", ".join(f"{format_share(verdict['share'])} on {kind} days" for kind, verdict in claim["kinds"].items())
    return f"Depends on the day: “{claim['claim'].rstrip('.')}” holds in {shares}."


def _verdict_table(card: Mapping[str, Any], claims: Sequence[Mapping[str, Any]], caption: str) -> Table:
    """A row for each claim and kind of day, presets in the last columns."""
    presets, rows = card["grid"]["presets"], []
    for claim in claims:
        for k, (kind, verdict) in enumerate(claim["kinds"].items()):
            first_cells = [claim["section"], claim["claim"]] if k == 0 else ["", ""]
            rows.append(
                [*first_cells, kind, verdict["verdict_text"],
                 _share_or_dash(verdict["share"], verdict["share_interval"]),
                 _share_or_dash(verdict["share_of_hunting"], verdict["share_of_hunting_interval"]),
                 *(f"{verdict['share_of_days'][p] * claim['n_days']:.0f} of {claim['n_days']}" for p in presets)]
            )  # fmt: skip
    return Table(
        caption, ["section", "claim", "days", "verdict", "share", "hunting", *(f"`{p}`" for p in presets)], rows
    )


def _share_or_dash(value: float | None, limits: tuple[float, float] | None) -> str:
    """A share, with its interval if it has one."""
    return "—" if value is None else format_share(value, *(limits or ()))


def _figure_blocks(folder: Path, *, quick: bool) -> list[Block]:
    return [
        Picture((folder / f"{name}.png").read_bytes(), caption, caption.partition(".")[0], f"{name}.png")
        for name, caption in captions(quick=quick).items()
    ]


def _claim_blocks(claim: Mapping[str, Any], presets: list[str]) -> list[Block]:
    lines, rows, columns = (
        [f"Counts as holding: {claim['counts_as_holding']} {claim['note']}".strip()],
        [],
        [*presets, "grid"],
    )
    for kind, verdict in claim["kinds"].items():
        hunting = verdict["share_of_hunting"]
        hunting_text = "" if hunting is None else f"; {format_share(hunting)} among the tunings that hunt by themselves"
        share_text = f"{format_share(verdict['share'], decimals=1)} of {claim['n_tunings']} × {claim['n_days']}"
        lines.append(f"{kind}: {verdict['verdict_text']}; {share_text}{hunting_text}.")
        measured = verdict["measured"]
        for name in measured["grid"]:
            values = [measured[p][name] for p in columns]
            rows.append([name, kind, *("never" if v is None else f"{v:.3g}" for v in values)])
    head = ["median over days", "days", *columns]
    return [Table(f"{claim['claim']} ({claim['section']})", head, rows), Paragraphs(lines, bullets=True)]


def _method_section(card: Mapping[str, Any]) -> Section:
    tunings = card["grid"]
    presets, days, long_days = tunings["presets"], tunings["day_seeds"], tunings["long_day_seeds"]
    gains = {
        f"Gains of the {name}": "; ".join(f"{p}: kp {g[p]['kp']:.3g}/K, ti {g[p]['ti']:.3g} s" for p in presets)
        for name, g in tunings["best_gains"].items()
    }
    rules = [
        "The share is of tunings × days; in brackets its 95 % interval over other such days with the same tunings, "
        "where the days differ.  quiet and coils are no kinds of days: the share is of tunings on a day without "
        "disturbances, and of coils.",
        "Best gains are those of lowest error for the same plant and sample time, found on other days, of all with "
        "which the loop does not hunt without backlash.",
        "A claim holds at a share of 95 % or more, and does not hold at 5 % or less.  Between, the verdict names the "
        "region of tunings that predicts best where it holds, searched for on one half of the grid; the shares inside "
        "and elsewhere are those of the other half.  If the share "
        "elsewhere is 5 % or less, it holds only if a tuning lies there; else it holds in part, more often if it does.",
    ]
    computed = facts_table(
        ("Tunings", f"{tunings['n_tunings']} of {tunings['n_tunings_tried']}: {', '.join(presets)}, and gains × sample "
                    "times × an ideal loop and one with sensor lag and stroke time; the others hunt without backlash"),
        ("Days", f"{len(days)} of 8 h of each kind, seeds {days[0]} to {days[-1]}; where start and step of the learner "
                 f"vary, {len(long_days)} of 24 h, seeds {long_days[0]} to {long_days[-1]}"),
        *((f"Days: {name}", str(words)) for name, words in card["kinds"].items()),
        *gains.items(),
        ("Backlash", f"{100 * tunings['backlash']:.3g} %"),
        ("Time step", "1 s"),
        ("Noise seed", str(tunings["noise_seed"])),
        ("fastcoil", str(card["fastcoil_version"])),
        *((f"content_sha256, {name}", str(sha256)) for name, sha256 in tunings["content_sha256"].items()),
    )  # fmt: skip
    return Section("How it was computed", [Paragraphs(rules), computed, Code(str(card["command"]))])


def page_to_markdown(page: Page) -> str:
    """The whole page in Markdown; its pictures are the files beside it."""
    parts = [f"# {page.title}", page.question, *page.warnings, *page.answer]
    for section in page.sections:
        parts += [f"## {section.title}", *map(_block_to_markdown, section.blocks)]
    return "\n\n".join(parts) + "\n"


def _block_to_markdown(block: Block) -> str:
    if isinstance(block, Paragraphs):
        return "\n".join(f"* {line}" for line in block.lines) if block.bullets else "\n\n".join(block.lines)
    if isinstance(block, Picture):
        return f"![{block.alt}]({block.file})\n\n{block.caption}"
    if isinstance(block, Code):
        return "\n".join(["```text", *block.lines, "```"])
    if not block.head:
        return "\n".join(f"* {name}: {value}" for name, value in block.rows)
    rows = "\n".join("| " + " | ".join(row) + " |" for row in (block.head, ["---"] * len(block.head), *block.rows))
    return "\n\n".join(filter(None, [f"**{block.caption}**", rows, block.note]))
