"""An explanation in the words of an engineer, the answer first."""

from __future__ import annotations

import math

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.explanation.answer import MINUTES, answer_of, kelvin, number, per_cent, seconds, simulated, why_of
from fastcoil.design.explanation.cures import DEAD_BAND, INVERSE, REPAIRED
from fastcoil.design.explanation.predicted import Foretold
from fastcoil.design.explanation.table import table_of
from fastcoil.design.explanation.theory import Found, Told
from fastcoil.design.theory.cycles import HUNTS_ABOVE

_LEAST_SHARE = 0.5
"""Degrees; less is not told."""
_PARTS = {
    "integral": "integral of the PI",
    "coil": "coil",
    "sensor": "sensor",
    "sampling": "sampling and hold",
    "backlash": "backlash (and motor)",
}


def sentences(found: Found) -> list[str]:
    """The explanation, line by line."""
    lines = [answer_of(found), why_of(found)]
    if found.told is not None:
        lines += [*_agreement(found, found.told), *_where(found.told)]
        lines += [f"Not in the margin: {clause}." for clause in found.left_out]
        lines += ["", *_phase(found.told)]
    lines += ["", *table_of(found), *_honest(found), *_advice(found), *found.hints]
    if not found.value("noise_std") and not found.boundary.series["noise"].any():
        lines.append("No measurement noise is given: with some the motor travels more (--set noise_std=0.02).")
    return lines


def _agreement(found: Found, told: Told) -> list[str]:
    """What theory foretells beside what the simulation shows."""
    if found.failed:
        return []
    shown = simulated(found) if found.hunts else f"no hunting, RMS error {kelvin(float(found.now['rmse']))}"
    lines = [f"Foretold: {_foretold(told.foretold)}; simulated over the day: {shown}."]
    if told.unsure:
        margin = f"{told.foretold.margin:.2g}"
        lines.append(f"A margin of {margin} is too near {HUNTS_ABOVE:g} to decide: go by the simulation.")
    elif told.foretold.hunts != found.hunts:
        lines.append(f"The two disagree: {_reason(found, told)}.")
    return lines


def _foretold(told: Foretold) -> str:
    hunting = told.reached[told.cycles.hunts[told.reached].astype(bool)]
    if not hunting.size:
        return "no cycle"
    swings, periods = 2.0 * told.cycles.amplitude[hunting], told.cycles.period[hunting]
    if not np.isfinite(swings).any():
        return "a cycle, of a size that theory does not give"
    every = _span(periods, "s") if float(np.nanmax(periods)) < MINUTES else _span(periods / 60.0, "min")
    return f"{_span(swings, 'K')} peak to peak every {every}"


def _span(values: Array, unit: str) -> str:
    low, high = (number(float(end)) for end in (np.nanmin(values), np.nanmax(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _reason(found: Found, told: Told) -> str:
    """Why the simulated day may not show what is foretold, and whom to believe."""
    foretold = told.foretold
    both = (foretold.hunting, foretold.elsewhere)
    if found.needs_cure and not found.hunts and all(np.isfinite(told.swings[some]).any() for some in both):
        swings = [kelvin(float(np.nanmedian(told.swings[some]))) for some in both]
        return (
            "it hunts for too small a part of the day to count.  Where it is foretold to hunt, T_sup swings by "
            f"{swings[0]} in the simulation (median), elsewhere by {swings[1]}"
        )
    if foretold.hunts:
        return "its swing is too small or not regular enough to count; go by the simulation for this day"
    return "go by the simulation for this day"


def _where(told: Told) -> list[str]:
    """Which operating point is quoted, what happens there, and how the margin differs over the day."""
    foretold = told.foretold
    k, margin = foretold.worst, foretold.cycles.margin[foretold.reached]
    T_set, hours = float(foretold.points.conditions["T_set"][k]), float(foretold.points.start[k]) / 3600.0
    opening = 100 * float(foretold.plants.opening[k])
    place = f"{T_set:.3g} °C, {hours:.3g} h after the start (opening {opening:.0f} %){_there(told, k)}"
    if foretold.points.size == 1:
        return [f"Where: at {place}."]
    return [
        f"Where: worst at {place}.  Over the day the margin goes from {margin.min():.2g} to {margin.max():.2g}, and "
        f"{foretold.n_hunting} of {margin.size} operating points are foretold to hunt."
    ]


def _there(told: Told, k: int) -> str:
    """Foretold and simulated swing at one operating point."""
    swing, shown = 2.0 * float(told.foretold.cycles.amplitude[k]), float(told.swings[k])
    if not math.isfinite(swing) or not math.isfinite(shown):
        return ""
    return f": {kelvin(swing)} foretold, {kelvin(shown)} simulated"


def _phase(told: Told) -> list[str]:
    """What each part of the loop takes, the largest first."""
    order = np.argsort(-told.phase.values)
    shares = [(str(told.phase["part"].values[k]), float(told.phase[k])) for k in order]
    taken = [f"  {_PARTS[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= _LEAST_SHARE]
    return [f"Where the 180° of phase go, at one swing in {seconds(float(told.phase.attrs['period']))}:", *taken]


def _honest(found: Found) -> list[str]:
    """What a cure does not do; what backlash costs a loop that does not hunt."""
    repaired, band, inverse = (found.cured(name) for name in (REPAIRED, DEAD_BAND, INVERSE))
    if not found.needs_cure:
        if repaired is None or found.failed:
            return []
        error, without = (kelvin(float(found.cures["rmse"][k])) for k in (0, repaired))
        size = per_cent(found.value("backlash"))
        if error == without:
            return []
        return [f"What the backlash of {size} costs anyway: RMSE {error} instead of {without}."]
    lines = []
    if band is not None:
        width = found.with_cure("error_dead_band", band)
        lines.append(f"The dead band leaves the margin as it is, and holds any error up to {width:g} K.")
    if inverse is not None and float(found.cures["margin"][inverse]) > HUNTS_ABOVE:
        lines.append("The inverse leaves the margin too large: what is left of the gap may keep up a smaller swing.")
    return lines


def _advice(found: Found) -> list[str]:
    if found.failed:
        return []
    if not found.best:
        if found.needs_cure:
            return ["None of these cures it."]
        if found.lost:
            return ["None of these makes it hold its set-point."]
        return ["Leave it: none of these takes 5 % off the error."]
    now, then = found.now, found.cures.isel(cure=found.best)
    error = float(then["rmse"] / now["rmse"]) - 1.0
    travel, before = float(then["motor_travel"]), float(now["motor_travel"])
    moved = f", motor travel × {number(travel / before)}" if before else ""
    then_do = "Do this" if found.needs_cure else "If the error matters"
    return [f"{then_do}: {then['words'].item()}: RMSE {100 * error:+.0f} %{moved}."]
