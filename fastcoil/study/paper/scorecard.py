"""The scorecard: every claim, its numbers, and in which share of the grid and where it holds, by kind of day.

The rule: a claim *holds* if it does so in at least 95 % of the tunings and days, and *does not hold* if it does so in
at most 5 %.  Between, it *holds only if* the tuning lies in a region: the one of ``REGIONS`` and their pairs that
predicts best where the claim holds, by Youden's index (the share of the holding cases that lie inside, less that of the
others).  The shares inside and elsewhere say how sharp the region is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.machine import package_version
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.paper.claims import CLAIMS, IDENTITIES, Claim
from fastcoil.study.paper.grid import BACKLASH, SEED, named, percent

HOLDS, ONLY_IF, DOES_NOT_HOLD = "holds", "holds only if", "does not hold"
SURELY = 0.95
LEVEL = 0.95
"""Confidence of the intervals of shares."""
WORTH_NAMING = 0.3
"""Lowest Youden index of a region that is worth naming."""
MATTERS = 0.1
"""Least difference of shares between kinds of days that is worth reporting."""
PAIR_GAIN = 0.1
"""By how much the index of a pair of regions must exceed that of any single one."""


def _above(name: str, limit: float) -> Callable[[xr.Dataset], xr.DataArray]:
    return lambda features: features[name] >= limit


def _below(name: str, limit: float) -> Callable[[xr.Dataset], xr.DataArray]:
    return lambda features: features[name] <= limit


REGIONS: dict[str, tuple[str, Callable[[xr.Dataset], xr.DataArray]]] = {
    f"the loop hunts by itself with {percent(BACKLASH)} backlash": ("hunts", lambda f: f["hunts"]),
    "the loop does not hunt by itself": ("hunts", lambda f: ~f["hunts"]),
    "sensor and actuator are ideal": ("ideal", lambda f: f["ideal"]),
    "the sensor lags and the actuator takes its time": ("ideal", lambda f: ~f["ideal"]),
    **{f"the overshoot is {percent(x)} or more": ("overshoot", _above("overshoot", x)) for x in (0.05, 0.2, 0.4)},
    **{f"the overshoot is {percent(x)} or less": ("overshoot", _below("overshoot", x)) for x in (0.05, 0.2, 0.4)},
    **{f"the sample time is {x} s or more": ("sample_time", _above("sample_time", x)) for x in (10, 15, 30)},
    **{f"the sample time is {x} s or less": ("sample_time", _below("sample_time", x)) for x in (5, 10, 15)},
    **{f"Ti is {x} s or more": ("ti", _above("ti", x)) for x in (20, 60, 150)},
    **{f"Ti is {x} s or less": ("ti", _below("ti", x)) for x in (20, 60, 150)},
    **{f"Kp is {x}/K or more": ("kp", _above("kp", x)) for x in (0.01, 0.02, 0.04)},
    **{f"Kp is {x}/K or less": ("kp", _below("kp", x)) for x in (0.01, 0.02, 0.04)},
    "at full flow the water of one of eight volumes is renewed in 1 to 1.125 s": (
        "renewal",
        lambda f: (f["renewal"] >= 1.0) & (f["renewal"] < 9 / 8),
    ),
}
"""Words → the feature of a tuning that the region is about, and the region."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """``condition`` and the shares inside and elsewhere are given only where the claim holds in a part of the grid.

    ``sizes``: how many tunings lie inside and elsewhere, where each is judged once, so that counts say more.
    """

    word: str
    share: float
    condition: str | None = None
    inside: float | None = None
    elsewhere: float | None = None
    sizes: tuple[int, int] | None = None

    @property
    def text(self) -> str:
        """The verdict in one line."""
        if self.word != ONLY_IF:
            return self.word
        if self.condition is None or self.inside is None or self.elsewhere is None:
            return "holds in part (no region tried predicts where)"
        when = ONLY_IF if self.elsewhere <= 1.0 - SURELY else "holds in part, more often if"
        there, elsewhere = percent(self.inside), percent(self.elsewhere)
        if self.sizes is not None:
            there, elsewhere = (
                f"{round(share * n)} of {n}" for share, n in zip((self.inside, self.elsewhere), self.sizes, strict=True)
            )
        return f"{when} {self.condition} ({there} there, {elsewhere} elsewhere)"


def features(quiet: xr.Dataset) -> xr.Dataset:
    """Features of every tuning: gains, sample time, overshoot, whether it hunts with the backlash, ideal or not."""
    known = {name: quiet[name] for name in ("kp", "ti", "sample_time", "overshoot")}
    known["hunts"] = quiet["hunts"].sel(case="plain PI", drop=True)
    known["ideal"] = quiet["stroke_time"] == 0.0
    return xr.Dataset(known)


def coil_features(coils: xr.Dataset) -> xr.Dataset:
    """Feature of every coil: seconds in which full flow renews the water of one of eight volumes."""
    return xr.Dataset({"renewal": coils["C_w"] / (coils["full_flow"] * float(str(PARAMETERS["cp_w"].default)))})


def sound(quiet: xr.Dataset) -> xr.DataArray:
    """Find the tunings that do not hunt without backlash."""
    return ~quiet["hunts"].sel(case="no backlash", drop=True)


def interval(holds: xr.DataArray) -> tuple[float, float] | None:
    """95 % interval of the share that other days would give on the same tunings; None without days, or where all agree.

    Tunings are chosen and days are drawn, and all tunings share the days.  So this is Student's interval of the mean of
    the days' shares, clipped to 0 and 1: few days make it wide, however many tunings there are.
    """
    of_day = holds.mean([d for d in holds.dims if d != "day"])
    half = _half_width(of_day)
    if half == 0.0:
        return None
    share = float(of_day.mean())
    return max(share - half, 0.0), min(share + half, 1.0)


def _half_width(of_day: xr.DataArray) -> float:
    """Half the width of Student's interval of the mean over days; 0 for a single day."""
    n_days = of_day.sizes.get("day", 1)
    if n_days < 2:
        return 0.0
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * LEVEL, n_days - 1) * of_day.std(ddof=1) / n_days**0.5)


def change(holds: xr.DataArray) -> float:
    """By how much the share differs between kinds of days, over dims ``kind`` and ``day``; 0 where it may be chance.

    The largest difference of two kinds counts if it is at least ``MATTERS`` and its 95 % interval leaves out 0.  Days
    of two kinds with the same seed are a pair, so it is Student's interval of the mean of their differences.
    """
    of_day = holds.mean([d for d in holds.dims if d not in ("kind", "day")])
    largest = 0.0
    for one, other in combinations(range(holds.sizes.get("kind", 1)), 2):
        differences = of_day.isel(kind=one) - of_day.isel(kind=other)
        size = abs(float(differences.mean()))
        if size >= max(MATTERS, largest) and size > _half_width(differences):
            largest = size
    return largest


def judge(holds: xr.DataArray, known: xr.Dataset, about: str = "") -> Verdict:
    """Judge ``holds``, over ``tuning`` and perhaps ``day``; regions about the feature ``about`` are not tried."""
    share = float(holds.mean())
    if share >= SURELY or share <= 1.0 - SURELY:
        return Verdict(HOLDS if share >= SURELY else DOES_NOT_HOLD, share)
    rate = holds.mean([d for d in holds.dims if d != "tuning"]).values
    best, gained, chosen = "", WORTH_NAMING, np.zeros(rate.size, dtype=bool)
    for words, region, margin in _regions(known, about):
        gain = rate[region].sum() / rate.sum() - (1 - rate)[region].sum() / (1 - rate).sum()
        if gain - margin > gained:
            best, gained, chosen = words, gain - margin, region
    if not best:
        return Verdict(ONLY_IF, share)
    sizes = None if "day" in holds.dims else (int(chosen.sum()), int((~chosen).sum()))
    return Verdict(ONLY_IF, share, best, float(rate[chosen].mean()), float(rate[~chosen].mean()), sizes)


def _regions(known: xr.Dataset, about: str) -> Iterator[tuple[str, np.ndarray, float]]:
    """Yield words, region (tuning,), and by how much its index must exceed that of the others."""
    single = [
        (words, feature, region(known).values)
        for words, (feature, region) in REGIONS.items()
        if feature in known and feature != about
    ]
    single = [(words, feature, region) for words, feature, region in single if 0 < region.sum() < region.size]
    yield from ((words, region, 0.0) for words, _, region in single)
    for (one, of_one, a), (other, of_other, b) in combinations(single, 2):
        if of_one != of_other and (a & b).any():
            yield f"{one} and {other}", a & b, PAIR_GAIN


COMMAND = "fastcoil paper"
CAVEAT = (
    "Generated by the model; nothing is digitised from the paper.  The presets are generic loops, searched for so that "
    "the paper's phenomena appear; none is the paper's unpublished fit."
)
NOT_SIMULATED = (
    "Figs 2, 4 and 5 compare the model with measurements that are not published.",
    "Figs 3, 6 and 8 are drawings of the model.",
    "The paper announces experimental tests and does not show them.",
    "The paper calls the rule more robust to disturbances than Hägglund's estimator and gives no comparison.",
)


def scorecard(
    evidence: Mapping[str, xr.Dataset], kinds: Mapping[str, str], *, command: str = COMMAND, quick: bool = False
) -> dict[str, Any]:
    """Judge every claim on the Datasets of the grid, given by name; returns plain data.

    ``kinds`` are the kinds of days in words, ``command`` is what the reader may run.  Claims that hold more often on
    one kind of day than on another come first.
    """
    quiet, days = evidence["quiet"], evidence["days"]
    is_sound = sound(quiet)
    claims = [assess(claim, evidence[claim.evidence], quiet) for claim in CLAIMS]
    return {
        "title": "What holds of Cai and Braun (2016), and where",
        "command": f"{command} --quick" if quick else command,
        "caveat": CAVEAT + ("  Quick mode: too few tunings and days to be quoted." if quick else ""),
        "fastcoil_version": package_version(),
        "kinds": dict(kinds),
        "grid": {
            "n_tunings_tried": int(is_sound.size),
            "n_left_out": int((~is_sound).sum()),
            "n_tunings": int(is_sound.sum()),
            "n_hunting": int(features(quiet)["hunts"].sel(tuning=is_sound.values).sum()),
            "presets": named(quiet["tuning"]),
            **{name: sorted({float(x) for x in quiet[name].values}) for name in ("kp", "ti", "sample_time")},
            "backlash": BACKLASH,
            "day_seeds": [int(d) for d in days["day"]],
            "long_day_seeds": [int(d) for d in evidence["starts"]["day"]],
            "noise_seed": SEED,
            "best_gains": {
                name: {
                    p: {n: float(days[n].sel(tuning=p, case=name)) for n in ("kp", "ti")}
                    for p in named(quiet["tuning"])
                }
                for name in ("best PI", "best inverse")
            },
            "n_failed": sum(int((ds["status"] != 0).sum()) for ds in evidence.values() if "status" in ds),
            "content_sha256": {name: str(ds.attrs["content_sha256"]) for name, ds in evidence.items()},
        },
        "claims": sorted(claims, key=lambda c: -c["change"]),
        "identities": [dict(zip(("section", "claim", "verdict", "why"), one, strict=True)) for one in IDENTITIES],
        "not_simulated": list(NOT_SIMULATED),
    }


def assess(claim: Claim, ds: xr.Dataset, quiet: xr.Dataset) -> dict[str, Any]:
    """Judge one claim; returns its words, and by kind of day its numbers and the verdict, as plain data.

    What is judged on no kind of day, but on the quiet day or on coils, has the name of its evidence for a kind.
    ``change`` is by how much the share differs between the kinds, 0 where that may be chance.
    """
    holds, numbers = claim.holds(ds), claim.numbers(ds)
    of_coils = claim.evidence == "coils"
    if "kind" not in holds.dims:
        holds = holds.expand_dims(kind=[claim.evidence])
        numbers = {name: values.expand_dims(kind=[claim.evidence]) for name, values in numbers.items()}
    judged = holds if of_coils else holds.sel(tuning=sound(quiet).values)
    known = coil_features(ds) if of_coils else features(quiet).sel(tuning=judged["tuning"])
    return {
        "name": claim.name,
        "section": claim.section,
        "claim": claim.words,
        "counts_as_holding": claim.when,
        "note": claim.note,
        "evidence": claim.evidence,
        "change": change(judged),
        "n_tunings": int(judged.sizes["tuning"]),
        "n_days": int(judged.sizes.get("day", 1)),
        "kinds": {
            str(kind): _of_kind(
                claim.name == "hunts",
                holds.sel(kind=kind),
                judged.sel(kind=kind),
                known,
                {name: values.sel(kind=kind) for name, values in numbers.items()},
            )
            for kind in holds["kind"].values
        },
    }


def _of_kind(
    of_hunting: bool, holds: xr.DataArray, judged: xr.DataArray, known: xr.Dataset, numbers: Mapping[str, xr.DataArray]
) -> dict[str, Any]:
    """The verdict on one kind of day, and the medians of what was measured."""
    verdict = judge(judged, known, "hunts" if of_hunting else "")
    hunting = None if of_hunting else _of_hunting(judged, known)
    presets = named(holds["tuning"])
    return {
        "verdict": verdict.word,
        "condition": verdict.condition,
        "share": verdict.share,
        "share_interval": interval(judged),
        "share_of_hunting": None if hunting is None else float(hunting.mean()),
        "share_of_hunting_interval": None if hunting is None else interval(hunting),
        "share_where_condition": verdict.inside,
        "share_elsewhere": verdict.elsewhere,
        "verdict_text": verdict.text,
        "share_of_days": {p: float(holds.sel(tuning=p).mean()) for p in presets},
        "measured": {p: {n: _median(v.sel(tuning=p)) for n, v in numbers.items()} for p in presets}
        | {"grid": {n: _median(v.sel(tuning=judged["tuning"])) for n, v in numbers.items()}},
    }


def _of_hunting(holds: xr.DataArray, known: xr.Dataset) -> xr.DataArray | None:
    """Select the tunings that hunt with the backlash, as the paper's does; None if no tuning does."""
    if "hunts" not in known or not known["hunts"].any():
        return None
    return holds.sel(tuning=known["hunts"].values)


def _median(values: xr.DataArray) -> float | None:
    """Median over tunings and days; None for a time that never came within the run, or NaN."""
    value = float(values.median())
    return value if math.isfinite(value) else None
