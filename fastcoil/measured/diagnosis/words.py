"""A diagnosis in the words of a technician."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fastcoil.measured.diagnosis.cause import BACKLASH, DISTURBANCE, NONE, TUNING
from fastcoil.measured.diagnosis.identify import GOOD
from fastcoil.measured.diagnosis.remedies import WORDS

if TYPE_CHECKING:
    import xarray as xr

    from fastcoil.measured.diagnosis.findings import Findings

_POSSIBLE = ("half_gain", "no_gap", "half_gap", "inverse")
"""Cures; without a known gap only the first."""


def in_words(d: Findings) -> list[str]:
    """The diagnosis, line by line."""
    hours = d.signals.attrs["hours"]
    lines = [f"{d.source}: {hours:.1f} h, a sample every {d.signals.attrs['interval']:g} s"]
    lines += [_gap(d), _hunting(d), *_cures(d), *_either(d)]
    return lines + [f"Note: {note}" for note in d.notes]


def _gap(d: Findings) -> str:
    low, high = (100 * bound for bound in d.interval)
    if d.identified and d.backlash <= GOOD:
        return f"Gap: none to speak of, {100 * d.backlash:.3g} % of the stroke (95 %: {low:.3g} to {high:.3g} %)"
    if d.identified:
        return f"Gap: {100 * d.backlash:.3g} % of the stroke (95 %: {low:.3g} to {high:.3g} %)"
    if np.isnan(d.backlash):
        return f"Gap: cannot tell: {d.reason}"
    return f"Gap: cannot tell; most probable {100 * d.backlash:.3g} % (95 %: {low:.3g} to {high:.3g} %): {d.reason}"


def _hunting(d: Findings) -> str:
    """Whether the loop hunts, and why."""
    size, period = float(d.indices["peak_to_peak"]) / 2, float(d.indices["period"])
    if d.cause == NONE:
        error = float(d.indices["error_rms_settled"])
        held = f": its error is {error:.2g} K (RMS, settled)" if np.isfinite(error) else ""
        return f"Hunting: none{held}"
    if not d.hunts:
        return f"Hunting: cannot tell: {d.because}"
    swings = f"Hunting: ± {size:.2g} K every {_duration(period)}"
    # of the three, the gap is blamed wrongly most often: see the table diagnosis_answers
    blamed = {
        BACKLASH: "probably because of the gap",
        TUNING: "because of the tuning",
        DISTURBANCE: "because of a disturbance",
    }
    return f"{swings}, {blamed[d.cause]}: {d.because}" if d.cause in blamed else f"{swings}; {d.because}"


def _cures(d: Findings) -> list[str]:
    """What the fitted loop would do with another valve, tuning or controller."""
    if d.predictions is None:
        return []
    found = d.predictions.sel(case="as_found")
    cases = [("as_found", "As found"), ("half_gain", "With half the gain")]
    if d.identified and d.backlash > GOOD:
        cases += [
            ("no_gap", "Without the gap"),
            ("half_gap", "With half the gap"),
            ("inverse", "With a backlash inverse"),
        ]
    return [f"{words}: {_told(d.predictions.sel(case=case), found)}" for case, words in cases]


def _either(d: Findings) -> list[str]:
    """What would stop the hunting, best first."""
    if d.predictions is None or not float(d.predictions["hunts"].sel(case="as_found")):
        return []
    calm = d.predictions.where(d.predictions["hunts"] == 0.0, drop=True).sortby("rmse")
    possible = _POSSIBLE if d.identified and d.backlash > GOOD else _POSSIBLE[:1]
    cures = [WORDS[case] for case in calm["case"].values if case in possible]
    return [f"What would stop the hunting: {', or '.join(cures)}"] if cures else []


def _told(one: xr.Dataset, found: xr.Dataset) -> str:
    """One case in words."""
    if str(one["doubt"].values):
        return f"cannot tell: {one['doubt'].values}"
    stands = ", no hunting" if float(found["hunts"]) > float(one["hunts"]) else ""
    return (
        f"error {float(one['rmse']):.2g} K, motor {float(one['travel_per_day']):.0f} strokes a day, stem turns "
        f"{float(one['reversals_per_day']):.0f} times a day{stands}"
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
