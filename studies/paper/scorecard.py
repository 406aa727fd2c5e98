"""The scorecard: every claim, its numbers, and in which share of the grid and where it holds, by kind of day.

The rule: a claim *holds* if it does so in at least 95 % of the tunings and days, and *does not hold* if it does so in
at most 5 %.  Between, it *holds only if* the tuning lies in a region: the one of ``REGIONS`` and their pairs that
predicts best where the claim holds, by Youden's index (the share of the holding cases that lie inside, less that of
the others).  Of so many regions the best looks better than it is, so it is searched for on one half of the tunings,
drawn at random, and the shares inside and elsewhere, which say how sharp it is, are those of the other half.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import t

from fastcoil.base.machine import VERSION
from fastcoil.base.text import format_share
from fastcoil.model.parameter_table import PARAMETERS
from studies.paper.claims import CLAIMS, IDENTITIES, Claim
from studies.paper.grid import BACKLASH, SEED, preset_labels

HOLDS, ONLY_IF, DOES_NOT_HOLD = "holds", "holds only if", "does not hold"
HOLDING_SHARE = 0.95
CONFIDENCE = 0.95  # confidence of the intervals of shares
LEAST_YOUDEN_INDEX = 0.3  # lowest Youden index of a region that is worth naming
LEAST_DIFFERENCE = 0.1  # least difference of shares between kinds of days that is worth reporting
PAIR_GAIN = 0.1  # by how much the index of a pair of regions must exceed that of any single one


Region = Callable[[xr.Dataset], xr.DataArray]


def _side_regions(
    feature: str, words: Callable[[float], str], above: Sequence[float], below: Sequence[float]
) -> dict[str, tuple[str, Region]]:
    """The regions on either side of some limits."""

    def region(limit: float, sign: int) -> tuple[str, Region]:
        return feature, lambda f: sign * f[feature] >= sign * limit

    regions = {f"{words(limit)} or more": region(limit, 1) for limit in above}
    return regions | {f"{words(limit)} or less": region(limit, -1) for limit in below}


REGIONS: dict[str, tuple[str, Region]] = {
    f"the loop hunts by itself with {format_share(BACKLASH)} backlash": ("hunts", lambda f: f["hunts"]),
    "the loop does not hunt by itself": ("hunts", lambda f: ~f["hunts"]),
    "sensor and actuator are ideal": ("ideal", lambda f: f["ideal"]),
    "the sensor lags and the actuator takes its time": ("ideal", lambda f: ~f["ideal"]),
    **_side_regions("overshoot", lambda x: f"the overshoot is {format_share(x)}", (0.05, 0.2, 0.4), (0.05, 0.2, 0.4)),
    **_side_regions("sample_time", "the sample time is {} s".format, (10, 15, 30), (5, 10, 15)),
    **_side_regions("ti", "Ti is {} s".format, (20, 60, 150), (20, 60, 150)),
    **_side_regions("kp", "Kp is {}/K".format, (0.01, 0.02, 0.04), (0.01, 0.02, 0.04)),
    "at full flow the water of one of eight volumes is renewed in 1 to 1.125 s": (
        "renewal",
        lambda f: (f["renewal"] >= 1.0) & (f["renewal"] < 9 / 8),
    ),
}
"""Words → the feature of a tuning that the region is about, and the region."""


class Verdict(NamedTuple):
    """``condition`` and the shares inside and elsewhere are given only where the claim holds in a part of the grid."""

    word: str
    share: float
    text: str
    condition: str | None = None
    inside: float | None = None
    elsewhere: float | None = None


def features(quiet: xr.Dataset) -> xr.Dataset:
    """Features of every tuning: gains, sample time, overshoot, whether it hunts with the backlash, ideal or not."""
    columns = {name: quiet[name] for name in ("kp", "ti", "sample_time", "overshoot")}
    columns["hunts"] = quiet["hunts"].sel(case="plain PI", drop=True)
    columns["ideal"] = quiet["stroke_time"] == 0.0
    return xr.Dataset(columns)


def coil_features(coils: xr.Dataset) -> xr.Dataset:
    """Feature of every coil: seconds in which full flow renews the water of one of eight volumes."""
    return xr.Dataset({"renewal": coils["C_w"] / (coils["full_flow"] * float(str(PARAMETERS["cp_w"].default)))})


def is_calm_without_backlash(quiet: xr.Dataset) -> xr.DataArray:
    """Find the tunings that do not hunt without backlash."""
    return ~quiet["hunts"].sel(case="no backlash", drop=True)


def share_interval(holds: xr.DataArray) -> tuple[float, float] | None:
    """95 % interval of the share that other days would give on the same tunings; None without days, or where all agree.

    Tunings are chosen and days are drawn, and all tunings share the days.  So this is Student's interval of the mean of
    the days' shares, clipped to 0 and 1: few days make it wide, however many tunings there are.
    """
    of_day = holds.mean([d for d in holds.dims if d != "day"])
    share, half = float(of_day.mean()), _half_width(of_day)
    return (max(share - half, 0.0), min(share + half, 1.0)) if half else None


def _half_width(of_day: xr.DataArray) -> float:
    """Half the width of Student's interval of the mean over days; 0 for a single day."""
    n_days = of_day.sizes.get("day", 1)
    if n_days < 2:
        return 0.0
    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, n_days - 1) * of_day.std(ddof=1) / n_days**0.5)


def kind_difference(holds: xr.DataArray) -> float:
    """By how much the share differs between kinds of days, over dims ``kind`` and ``day``; 0 where it may be chance.

    The largest difference of two kinds counts if it is at least ``LEAST_DIFFERENCE`` and its 95 % interval excludes 0.
    Days of two kinds with the same seed are a pair, so it is Student's interval of the mean of their differences.
    """
    of_day = holds.mean([d for d in holds.dims if d not in ("kind", "day")])
    pairs = combinations(range(holds.sizes.get("kind", 1)), 2)
    differences = [of_day.isel(kind=first) - of_day.isel(kind=second) for first, second in pairs]
    sizes = [(abs(float(difference.mean())), _half_width(difference)) for difference in differences]
    return max((size for size, half in sizes if size >= LEAST_DIFFERENCE and size > half), default=0.0)


def judge_claim(holds: xr.DataArray, tuning_features: xr.Dataset, excluded_feature: str = "") -> Verdict:
    """Judge ``holds``, over ``tuning`` and perhaps ``day``; regions of ``excluded_feature`` are not tried."""
    share = float(holds.mean())
    if share >= HOLDING_SHARE or share <= 1.0 - HOLDING_SHARE:
        word = HOLDS if share >= HOLDING_SHARE else DOES_NOT_HOLD
        return Verdict(word, share, word)
    rate = holds.mean([d for d in holds.dims if d != "tuning"]).values
    is_searched = np.random.default_rng(SEED).permutation(rate.size) < rate.size // 2
    best, best_gain, best_region = "", LEAST_YOUDEN_INDEX, np.zeros(rate.size, dtype=bool)
    for words, region, margin in _candidate_regions(tuning_features, excluded_feature):
        gain = _youden_index(rate[is_searched], region[is_searched])
        if gain - margin > best_gain and 0 < region[~is_searched].sum() < (~is_searched).sum():
            best, best_gain, best_region = words, gain - margin, region
    if not best:
        return Verdict(ONLY_IF, share, "holds in part (no region tried predicts where)")
    parts = (best_region & ~is_searched, ~best_region & ~is_searched)
    is_inside, elsewhere = (float(rate[part].mean()) for part in parts)
    share_texts = [format_share(is_inside), format_share(elsewhere)]
    if "day" not in holds.dims:  # each tuning is judged once, so that counts say more
        share_texts = [f"{round(rate[part].sum())} of {part.sum()}" for part in parts]
    prefix = ONLY_IF if elsewhere <= 1.0 - HOLDING_SHARE else "holds in part, more often if"
    text = f"{prefix} {best} ({share_texts[0]} there, {share_texts[1]} elsewhere)"
    return Verdict(ONLY_IF, share, text, best, is_inside, elsewhere)


def _youden_index(rate: np.ndarray, region: np.ndarray) -> float:
    """Share of the holding cases that lie in the region, less that of the others; 0 where one of the two is missing."""
    holds, fails = rate.sum(), (1 - rate).sum()
    return float(rate[region].sum() / holds - (1 - rate)[region].sum() / fails) if holds and fails else 0.0


def _candidate_regions(tuning_features: xr.Dataset, excluded_feature: str) -> Iterator[tuple[str, np.ndarray, float]]:
    """Yield words, region (tuning,), and by how much its index must exceed that of the others."""
    single: list[tuple[str, str, np.ndarray]] = []
    for words, (feature, region) in REGIONS.items():
        is_inside = (
            region(tuning_features).values
            if feature in tuning_features and feature != excluded_feature
            else np.zeros(1)
        )
        if 0 < is_inside.sum() < is_inside.size:
            single.append((words, feature, is_inside))
            yield words, is_inside, 0.0
    for (first, first_feature, first_region), (second, second_feature, second_region) in combinations(single, 2):
        if first_feature != second_feature and (first_region & second_region).any():
            yield f"{first} and {second}", first_region & second_region, PAIR_GAIN


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


def scorecard(evidence: Mapping[str, xr.Dataset], kinds: Mapping[str, str], *, quick: bool = False) -> dict[str, Any]:
    """Judge every claim on the Datasets of the grid, given by name; returns plain data.

    ``kinds`` are the kinds of days in words.  Claims that hold more often on one kind of day than another come first.
    """
    quiet, days = evidence["quiet"], evidence["days"]
    is_sound, presets = is_calm_without_backlash(quiet), preset_labels(quiet["tuning"])
    gains = {
        name: {p: {n: float(days[n].sel(tuning=p, case=name)) for n in ("kp", "ti")} for p in presets}
        for name in ("best PI", "best inverse")
    }
    claims = [assess_claim(claim, evidence[claim.evidence], quiet) for claim in CLAIMS]
    return {
        "title": "What holds of Cai and Braun (2016), and where",
        "command": "python -m studies paper",
        "quick": quick,
        "caveat": CAVEAT + ("  Quick mode: too few tunings and days to be quoted." if quick else ""),
        "fastcoil_version": VERSION,
        "kinds": dict(kinds),
        "grid": {
            "n_tunings_tried": int(is_sound.size),
            "n_left_out": int((~is_sound).sum()),
            "n_tunings": int(is_sound.sum()),
            "n_hunting": int(features(quiet)["hunts"].sel(tuning=is_sound.values).sum()),
            "presets": presets,
            **{name: sorted({float(x) for x in quiet[name].values}) for name in ("kp", "ti", "sample_time")},
            "backlash": BACKLASH,
            "day_seeds": [int(d) for d in days["day"]],
            "long_day_seeds": [int(d) for d in evidence["starts"]["day"]],
            "noise_seed": SEED,
            "best_gains": gains,
            "n_failed": sum(int((ds["status"] != 0).sum()) for ds in evidence.values() if "status" in ds),
            "content_sha256": {name: str(ds.attrs["content_sha256"]) for name, ds in evidence.items()},
        },
        "claims": sorted(claims, key=lambda c: -c["change"]),
        "identities": [
            dict(zip(("section", "claim", "verdict", "why"), identity, strict=True)) for identity in IDENTITIES
        ],
        "not_simulated": list(NOT_SIMULATED),
    }


def assess_claim(claim: Claim, ds: xr.Dataset, quiet: xr.Dataset) -> dict[str, Any]:
    """Judge one claim; returns its words, and by kind of day its numbers and the verdict, as plain data.

    What is judged on no kind of day, but on the quiet day or on coils, has the name of its evidence for a kind.
    ``change`` is by how much the share differs between the kinds, 0 where that may be chance.
    """
    measured = {"holds": claim.holds(ds)} | claim.numbers(ds)
    all_tunings = xr.Dataset({name: values.reset_coords(drop=True) for name, values in measured.items()})
    if "kind" not in all_tunings.dims:
        all_tunings = all_tunings.expand_dims(kind=[claim.evidence])
    is_of_coils = claim.evidence == "coils"
    calm_tunings = all_tunings if is_of_coils else all_tunings.sel(tuning=is_calm_without_backlash(quiet).values)
    tuning_features = coil_features(ds) if is_of_coils else features(quiet).sel(tuning=calm_tunings["tuning"])
    by_kind = {
        str(kind): _assess_kind(claim, all_tunings.sel(kind=kind), calm_tunings.sel(kind=kind), tuning_features)
        for kind in all_tunings["kind"].values
    }
    return {
        "name": claim.name,
        "section": claim.section,
        "claim": claim.words,
        "counts_as_holding": claim.criterion,
        "note": claim.note,
        "evidence": claim.evidence,
        "change": kind_difference(calm_tunings["holds"]),
        "n_tunings": int(calm_tunings.sizes["tuning"]),
        "n_days": int(calm_tunings["holds"].sizes.get("day", 1)),
        "kinds": by_kind,
    }


def _assess_kind(
    claim: Claim, all_tunings: xr.Dataset, calm_tunings: xr.Dataset, tuning_features: xr.Dataset
) -> dict[str, Any]:
    """The verdict on one kind of day, and the medians of what was measured."""
    holds, is_hunting_claim = calm_tunings["holds"], claim.name == "hunts"
    verdict = judge_claim(holds, tuning_features, "hunts" if is_hunting_claim else "")
    # tunings that hunt with the backlash, as the paper's does
    is_hunting = (
        tuning_features["hunts"].values
        if "hunts" in tuning_features and not is_hunting_claim
        else np.zeros(1, dtype=bool)
    )
    hunting = holds.sel(tuning=is_hunting) if is_hunting.any() else None
    presets = preset_labels(all_tunings["tuning"])
    measured = {p: all_tunings.sel(tuning=p) for p in presets} | {"grid": calm_tunings}
    return {
        "verdict": verdict.word,
        "condition": verdict.condition,
        "share": verdict.share,
        "share_interval": share_interval(holds),
        "share_of_hunting": None if hunting is None else float(hunting.mean()),
        "share_of_hunting_interval": None if hunting is None else share_interval(hunting),
        "share_where_condition": verdict.inside,
        "share_elsewhere": verdict.elsewhere,
        "verdict_text": verdict.text,
        "share_of_days": {p: float(all_tunings["holds"].sel(tuning=p).mean()) for p in presets},
        "measured": {p: _medians(values.drop_vars("holds")) for p, values in measured.items()},
    }


def _medians(numbers: xr.Dataset) -> dict[str, float | None]:
    """Medians over tunings and days; None for a time that never came within the run, or NaN."""
    medians = {str(name): float(values.median()) for name, values in numbers.data_vars.items()}
    return {name: value if math.isfinite(value) else None for name, value in medians.items()}
