"""From booleans over the grid to a verdict: the share in which a claim holds, and where it does.

The rule: a claim *holds* if it does so in at least 95 % of the tunings and days, and *does not hold* if it does so in
at most 5 %.  Between, it *holds only if* the tuning lies in a region: the one of ``REGIONS`` and their pairs that
predicts best where the claim holds, by Youden's index (the share of the holding cases that lie inside, less that of the
others).  The shares inside and elsewhere say how sharp the region is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import xarray as xr

from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.paper.runs import BACKLASH, percent

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
