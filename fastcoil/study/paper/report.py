"""The scorecard to read: in Markdown, and on one screen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fastcoil.study.paper.runs import percent


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    head = list(head)
    return ["| " + " | ".join(r) + " |" for r in (head, ["---"] * len(head), *map(list, rows))]


def _percent(share: float | None, limits: tuple[float, float] | None = None) -> str:
    """Write a share, with its interval if it has one."""
    within = f" ({100 * limits[0]:.0f} to {100 * limits[1]:.0f})" if limits else ""
    return "—" if share is None else percent(share) + within


def _number(value: float | None) -> str:
    return "never" if value is None else f"{value:.3g}"


def _seeds(seeds: list[int]) -> str:
    return f"{len(seeds)} days (seeds {seeds[0]} to {seeds[-1]})"


def verdicts(card: Mapping[str, Any], claims: Iterable[Mapping[str, Any]]) -> list[str]:
    """A table of verdicts: a row for each claim and kind of day, presets in the last columns."""
    presets, rows = card["grid"]["presets"], []
    for claim in claims:
        for k, (kind, c) in enumerate(claim["kinds"].items()):
            first = [claim["section"], claim["claim"]] if k == 0 else ["", ""]
            rows.append(
                [*first, kind, c["verdict_text"], _percent(c["share"], c["share_interval"]),
                 _percent(c["share_of_hunting"], c["share_of_hunting_interval"]),
                 *(f"{c['share_of_days'][p] * claim['n_days']:.0f} of {claim['n_days']}" for p in presets)]
            )  # fmt: skip
    return _table(["section", "claim", "days", "verdict", "share", "hunting", *(f"`{p}`" for p in presets)], rows)


def markdown(card: Mapping[str, Any], captions: Mapping[str, str]) -> str:
    """Write the scorecard: tables of verdicts, what changes with the days first, then claim by claim, then figures."""
    grid, claims = card["grid"], card["claims"]
    kinds = "; ".join(f"*{name}*: {words}" for name, words in card["kinds"].items())
    best = "; ".join(
        f"`{p}`: "
        + ", ".join(f"{name} {g[p]['kp']:.3g}/K and {g[p]['ti']:.3g} s" for name, g in grid["best_gains"].items())
        for p in grid["presets"]
    )
    lines = [
        f"# {card['title']}", "",
        f"Made by `{card['command']}`, every number by simulation.  {card['caveat']}", "",
        f"The grid: {grid['n_tunings_tried']} tunings ({', '.join(grid['presets'])}, and gains × sample times × an "
        f"ideal loop and one with sensor lag and stroke time).  {grid['n_left_out']} of them hunt without any backlash "
        f"and are left out.  The other {grid['n_tunings']} run on {_seeds(grid['day_seeds'])} of 8 h of each kind.  "
        f"Where start and step of the learner vary, they run on {_seeds(grid['long_day_seeds'])} of 24 h.  Noise seed "
        f"{grid['noise_seed']}, backlash {percent(grid['backlash'])}.  The share is of tunings × days.  In brackets: "
        "its 95 % interval over other such days with the same tunings, where the days differ.", "",
        f"Kinds of days: {kinds}.  *quiet* and *coils* are no kinds of days: the share is of tunings on a day without "
        "disturbances, and of coils.", "",
        "Best gains are those of lowest error for the same plant and sample time, found on other days, of all with "
        f"which the loop does not hunt without backlash.  {best}.", "",
        "A claim *holds* at a share of 95 % or more, and *does not hold* at 5 % or less.  Between, the verdict names "
        "the region of tunings, of those tried on this same grid, that predicts best where it holds.  If the share "
        "elsewhere is 5 % or less, it *holds only if* a tuning lies there; else it *holds in part, more often if* it "
        "does.", "",
        "## What changes with the kind of day", "",
        "The share differs between two kinds by 10 points or more, and by more than chance; largest differences first.",
        "", *verdicts(card, [c for c in claims if c["change"]]), "",
        "## What does not", "", *verdicts(card, [c for c in claims if not c["change"]]),
        "", f"Under *hunting*: the share among the {grid['n_hunting']} tunings that hunt by themselves with the "
        "backlash, as the paper's does.  Under the presets: days on which the claim holds.", "",
        "## What contradicts itself", "",
        *(f"* \"{c['claim']}\" ({c['section']}) {c['verdict']}.  {c['why']}" for c in card["identities"]), "",
        "## Claim by claim", "",
    ]  # fmt: skip
    for c in claims:
        lines += [f"### {c['claim']} ({c['section']})", ""]
        lines += [f"Counts as holding: {c['counts_as_holding']}  {c['note']}".rstrip(), ""]
        rows = []
        for kind, found in c["kinds"].items():
            share = f"{percent(found['share'], 1)} of {c['n_tunings']} × {c['n_days']}"
            lines.append(f"* {kind}: **{found['verdict_text']}**; {share}.")
            of = found["measured"]
            rows += [[n, kind, *(_number(of[p][n]) for p in (*grid["presets"], "grid"))] for n in of["grid"]]
        head = ["median over days", "days", *(f"`{p}`" for p in grid["presets"]), "grid"]
        lines += ["", *_table(head, rows), ""]
    lines += ["## Figures", "", card["caveat"], ""]
    for name, caption in captions.items():
        lines += [f"![{name}]({name}.png)", "", caption, ""]
    lines += ["## Not simulated", "", *(f"* {text}" for text in card["not_simulated"])]
    return "\n".join(lines) + "\n"


def screen(card: Mapping[str, Any]) -> list[str]:
    """Write the shares, a line for each claim; what changes with the kind of day first."""
    grid, kinds = card["grid"], card["kinds"]
    lines = [
        f"{card['title']}: {grid['n_tunings']} tunings × {len(grid['day_seeds'])} days of each kind "
        f"({grid['n_left_out']} of {grid['n_tunings_tried']} left out: they hunt without backlash)",
        *(f"  {name}: {words}" for name, words in kinds.items()),
        "Shares in which a claim holds, by kind of day:",
    ]
    head = "".join(f"{name:>10}" for name in kinds)
    parts = (
        ("changes with the kind of day", [c for c in card["claims"] if c["change"]]),
        ("does not", [c for c in card["claims"] if not c["change"]]),
    )
    for title, claims in parts:
        lines.append(f"{head}  {title}")
        for c in claims:
            shares = [percent(found["share"]) for found in c["kinds"].values()]
            cells = "".join(f"{share:>10}" for share in shares).ljust(len(head))
            lines.append(f"{cells}  {c['claim']}")
    lines += [f"{'no share':>10}".ljust(len(head)) + f"  {c['claim']}  It {c['verdict']}." for c in card["identities"]]
    return lines
