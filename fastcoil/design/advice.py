"""What to do about a loop: the cures, chosen with theory and tried by simulation, and the one that is recommended."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.design.prediction import Prediction, cycles_at, shortest_ti, simc_gains
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import OFF, SETTLING_TIME, STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS, Scalar

UNSURE = (0.7, 1.0)
"""Margins between which theory does not decide."""
SAFE = 0.7
"""Margin that a cure has to reach."""
AS_IS, LOWER_KP, LONGER_TI, SIMC, DEAD_BAND, INVERSE, BOTH, REPAIRED = (
    "as_it_is", "lower_kp", "longer_ti", "simc", "dead_band", "inverse", "simc_and_inverse", "repaired_valve",
)  # fmt: skip
TUNINGS = (LOWER_KP, LONGER_TI, SIMC)
INVERSE_SHARE, BUFFER_RATIO, BUFFER_SWING = 0.95, 6.0, 0.1
"""Of an inverse with a buffer that goes with the noise; K of the last: what docs/findings/remedies.md recommends."""
LEAST_GAIN = 0.2
"""Smallest plant gain that the buffer may reckon with, K per stroke: the buffer has to stay below 1."""
DEAD_BAND_WIDTHS = (0.1, 0.5)
"""Least and most, K; as wide as the swing is high in between."""
_QUIET_DEAD_BAND = 0.25  # K, where nothing hunts


class Cure(NamedTuple):
    """What may be changed.  words: as a technician says it.  changes: parameter → value."""

    name: str
    words: str
    changes: Mapping[str, Scalar]


def cures_of(loop: Loop, prediction: Prediction | None) -> list[Cure]:
    """What to try on one loop, as it is first; no gains where theory cannot tell, and prediction is None."""
    kp, ti, backlash = (float(loop[name]) for name in ("kp", "ti", "backlash"))  # type: ignore[arg-type]
    found = [Cure(AS_IS, "as it is", {})]

    def add_gains(name: str, kp: float, ti: float, words: str = "") -> dict[str, Scalar]:
        found.append(Cure(name, f"{words}kp {kp:g} 1/K, ti {ti:g} s", {"kp": kp, "ti": ti}))
        return {"kp": kp, "ti": ti}

    if prediction is not None and prediction.margin > SAFE:
        add_gains(LOWER_KP, _rounded(kp * SAFE / prediction.margin, down=True), ti)
        longer = shortest_ti(prediction, SAFE)
        if math.isfinite(longer):
            add_gains(LONGER_TI, kp, _rounded(longer, down=False))
    simc = simc_gains(prediction) if prediction is not None else None
    gains = add_gains(SIMC, _rounded(simc[0]), _rounded(simc[1]), "SIMC: ") if simc is not None else {}
    band = _QUIET_DEAD_BAND
    if prediction is not None and prediction.hunting.size:  # as wide as the swing is high, to 0.05 K
        height = float(np.nanmax(prediction.cycles.amplitude[prediction.reached]))
        band = float(np.clip(math.ceil(round(height / 0.05, 6)) * 0.05, *DEAD_BAND_WIDTHS).round(2))
    if float(loop["error_dead_band"]) < band:  # type: ignore[arg-type]
        found.append(Cure(DEAD_BAND, f"error dead band of {band:g} K", {"error_dead_band": band}))
    if backlash > 0.0:
        if prediction is not None:
            inverse: dict[str, Scalar] = {
                "backlash_estimate": INVERSE_SHARE * backlash,
                "compensation": "inverse",
                "buffer_ratio": BUFFER_RATIO,
                "buffer_noise": "measured",
                "buffer_swing": BUFFER_SWING,
                "plant_gain": max(abs(float(prediction.plants.gain[prediction.worst])), LEAST_GAIN),
            }
            found.append(Cure(INVERSE, f"inverse of {100 * INVERSE_SHARE:g} %, buffer by noise", inverse))
            if gains:
                found.append(Cure(BOTH, "SIMC and this inverse", gains | inverse))
        # no gap, and whatever assumed one is off; a stem cannot stick without a gap in this model
        without = {"backlash": 0.0, "backlash_estimate": 0.0, "slip_jump": 0.0}
        found.append(Cure(REPAIRED, "valve repaired: no backlash", without))
    return found


def _rounded(value: float, *, down: bool | None = None) -> float:
    """A number that somebody types into a controller: two digits, on the safe side if that is said."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    digits = value / scale
    whole = round(digits) if down is None else math.floor(digits + 1e-9) if down else math.ceil(digits - 1e-9)
    return float(f"{whole * scale:.6g}")


def with_cures(loop: Loop, cures: list[Cure]) -> Loop:
    """The loop as a sweep along ``cure``."""
    changed = {}
    for name in dict.fromkeys(name for cure in cures for name in cure.changes):
        own = loop[name] if loop[name] is not None else PARAMETERS[name].default
        given = next(cure.changes[name] for cure in cures if name in cure.changes)
        changed[name] = ("cure", [cure.changes.get(name, given if own is None else own) for cure in cures])
    return loop.assign(**changed)


_POINTS = 43200  # most samples of a trace: one every 2 s of a day
PLAIN = 1.5
"""So many times as large a swing shows that a loop hunts here and not there."""
AS_PREDICTED = 0.7
"""Simulated over predicted swing from which the one counts as the other."""
WORSE, BETTER = 1.05, 0.95
"""RMSE relative to now from which a cure counts as worse, and up to which as better."""


def try_cures(
    loop: Loop, boundary: Boundary, cures: list[Cure], prediction: Prediction | None, warm_up: int, seed: int
) -> xr.Dataset:
    """Simulate and predict every cure on one day: metrics, the trace T_sup and the margin, over ``cure``."""
    every = max(2, -(-boundary.n_steps // _POINTS))
    swept = with_cures(loop, cures)
    ds = simulate(
        swept, boundary, traces=["T_sup"], trace_interval=every, warm_up=warm_up, seed=seed, n_jobs=1,
        progress=False,
    )  # fmt: skip
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    ds = ds if "cure" in ds.dims else ds.expand_dims("cure")
    worst, n_hunting = np.full(len(cures), math.nan), np.zeros(len(cures))
    if prediction is not None:
        cycles = cycles_at(swept, prediction.plants, prediction.reached)
        worst, n_hunting = cycles.margin.max(axis=1), np.count_nonzero(cycles.hunts > 0.0, axis=1)
    return ds.assign_coords(cure=[cure.name for cure in cures]).assign(
        words=("cure", [cure.words for cure in cures]),
        margin=("cure", worst, {"long_name": "largest describing-function margin, predicted"}),
        n_hunting=("cure", n_hunting, {"long_name": "operating points predicted to hunt"}),
    )


def swings_at(points: PointsOfDay, boundary: Boundary, now: xr.Dataset) -> Array:
    """Simulated swing at each operating point, K: max - min of T_sup in settled seconds; NaN if there are none."""
    T_set = boundary.series["T_set"][0]
    seconds = np.arange(T_set.size)
    changed = np.maximum.accumulate(np.where(np.diff(T_set, prepend=T_set[0]) != 0.0, seconds, -SETTLING_TIME))
    of_second = np.where(seconds - changed >= SETTLING_TIME, points.of_second, -1)[
        now["elapsed_time"].values.astype(int)
    ]
    T_sup = now["T_sup"].values
    seen = [T_sup[of_second == k] for k in range(points.size)]
    return np.array([np.ptp(T) if T.size else np.nan for T in seen])


def hunts_uncounted(prediction: Prediction, swings: Array, now: xr.Dataset) -> bool:
    """Whether a loop hunts although the metric does not count it, since it does at times only, or not regularly enough.

    At the operating points at which it is predicted to hunt, the simulated swings are, in the median, ``PLAIN`` times
    those elsewhere; or they are of the size predicted, ``AS_PREDICTED``, and above ``OFF``.
    """
    if now["hunts"] > 0 or not prediction.hunting.size:
        return False
    elsewhere = np.setdiff1d(prediction.reached, prediction.hunting)
    there, rest = (_median(swings[some]) for some in (prediction.hunting, elsewhere))
    expected = 2.0 * _median(prediction.cycles.amplitude[prediction.hunting])
    return there > PLAIN * rest or there > max(AS_PREDICTED * expected, OFF)


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def hunting(ds: xr.Dataset) -> Mask:
    """Which cures leave the loop hunting, as it is first: those whose simulated day hunts.

    Where that is not counted for the loop as it is, those that are predicted to hunt somewhere, too.
    """
    shown, expected = ds["hunts"].values > 0, ds["n_hunting"].values > 0
    return np.asarray(shown | expected if ds["uncounted"] else shown)


def verdict(ds: xr.Dataset, k: int) -> str:
    """What a cure did, in a few words; as it is first in ``ds``."""
    if ds["status"].values[k] != STATUS_OK:
        return "failed"
    before, after = hunting(ds)[[0, k]]
    with np.errstate(divide="ignore", invalid="ignore"):
        error, swing = (float(of[k] / of[0]) for of in (ds["rmse"].values, ds["hunting_swing"].values))
    if not before:
        if after:
            return "makes it hunt"
        return "worse" if error > WORSE else "better" if error < BETTER else "no gain"
    if not after:
        return "cures it, at a larger error" if error > WORSE else "cures it"
    return "still hunts, and worse" if swing > 1.1 else "still hunts, but less" if swing < 0.7 else "still hunts"


def recommended(ds: xr.Dataset, names: list[str]) -> int:
    """Which cure to take: of those that leave no hunting, neither simulated nor predicted, the one with the least RMSE.

    A cure whose margin stays too large comes after these, a dead band or a repaired valve last.  0 where the loop is
    good as it is, or where nothing helps.
    """
    error, margin = ds["rmse"].values, np.nan_to_num(ds["margin"].values)
    good = (ds["status"].values == STATUS_OK) & ~hunting(ds)
    if good[0]:
        good &= (error < BETTER * error[0]) & ~np.isin(names, REPAIRED)
    rank = np.where(np.isin(names, (DEAD_BAND, REPAIRED)), 2, np.where(margin > HUNTS_ABOVE, 1, 0))
    able = [k for k, name in enumerate(names) if good[k] and name != AS_IS]
    return min(able, key=lambda k: (rank[k], error[k]), default=0)
