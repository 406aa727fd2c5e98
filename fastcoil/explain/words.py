"""An explanation in the words of an engineer, the answer first."""

from __future__ import annotations

import math

import numpy as np

from fastcoil.explain.cures import DEAD_BAND, INVERSE, LONGER_TI, REPAIRED
from fastcoil.explain.foretold import HUNTS_ABOVE, Foretold
from fastcoil.explain.found import Found
from fastcoil.explain.table import table_of
from fastcoil.outputs import HUNTING_SWING

PART_WORDS = {
    "integral": "integral of the PI",
    "coil": "coil",
    "sensor": "sensor",
    "sampling": "sampling and hold",
    "backlash": "backlash",
}


def sentences(found: Found) -> list[str]:
    """The explanation, line by line."""
    lines = [answer(found), why_of(found), *_agreement(found), *_where(found)]
    lines += [f"Not in the margin: {clause}." for clause in found.left_out]
    lines += _phase(found) + ["", *table_of(found), *_honest(found), *_advice(found), *found.hints]
    if found.value("noise_std") == 0.0 and not found.boundary.series["noise"].any():
        lines.append("No measurement noise is given: with some, the motor travels more than here (--set noise_std=0.02).")
    return lines


def answer(found: Found) -> str:
    """Whether the loop will hunt, in one sentence."""
    told, now = found.foretold, found.now
    if found.failed:
        return "This loop cannot be simulated: temperatures leave the range of the model."
    swings = f"{_kelvin(float(now['hunting_swing']))} peak to peak every {seconds(float(now['hunting_period']))}"
    if found.hunts:
        whatever = ", whatever the size of the backlash" if told is not None and told.hunts and not _rings(found) else ""
        return f"This loop will hunt: about {swings}{whatever}."
    if told is None or not told.hunts:
        return "This loop will not hunt."
    if not float(now["hunting_swing"]) > HUNTING_SWING:
        return "This loop cycles, but hardly: its swing stays below what counts as hunting on this day."
    return "This loop is on the edge: the margin foretells hunting, the simulated day does not count as hunting."


def why_of(found: Found) -> str:
    """The reason, in one sentence or two."""
    told = found.foretold
    if told is None:
        return f"Why: theory cannot tell, since {'; '.join(found.doubts)}.  The answer is that of the simulation."
    if not told.hunts:
        return _why_quiet(found)
    return f"Why: {_too_fast(found)} {_backlash(found)}".rstrip()


def seconds(value: float) -> str:
    """A period in words."""
    if not math.isfinite(value):
        return "now and then"
    return f"{value:.0f} s" if value < 120.0 else f"{value / 60.0:.2g} min"


def _kelvin(value: float) -> str:
    return f"{value:.2g} K"


def _rings(found: Found) -> bool:
    """Whether the loop would swing behind a perfect valve, too."""
    return found.response is not None and found.response.gain_at_180 >= 1.0


def _why_quiet(found: Found) -> str:
    assert found.distance is not None and found.foretold is not None
    how = f"its margin is {found.foretold.margin:.2g}, and a loop hunts above {HUNTS_ABOVE:g}"
    far = f"kp could be {found.distance.kp_factor:.2g} times as large before it does"
    if math.isfinite(found.distance.ti) and found.distance.ti < found.value("ti"):
        far += f", or ti as short as {found.distance.ti:.2g} s"
    return f"Why: {how}.  {far[0].upper()}{far[1:]}."


def _too_fast(found: Found) -> str:
    """Whether the integral or the gain is at fault."""
    assert found.distance is not None and found.foretold is not None
    kp, ti, margin = found.value("kp"), found.value("ti"), found.foretold.margin
    limit = f"(margin {margin:.2g}; a loop hunts above {HUNTS_ABOVE:g})"
    names = list(found.cures["cure"].values)
    if LONGER_TI in names:
        needed = float(found.cures["ti"][names.index(LONGER_TI)])
        return (
            f"the integral is too fast for the coil: ti = {ti:g} s, while with this kp the loop needs about "
            f"{needed:g} s {limit}."
        )
    most = kp * found.distance.kp_factor
    return (
        f"the gain is too high: kp = {kp:g} 1/K, while the loop stands {most:.2g} 1/K with this ti, and no ti is long "
        f"enough for this kp {limit}."
    )


def _backlash(found: Found) -> str:
    size = f"{100.0 * found.value('backlash'):.3g} %"
    if _rings(found):
        return "It would swing behind a perfect valve, too."
    if found.value("backlash") == 0.0:
        return "There is no backlash: it hunts only once there is some."
    return f"Any backlash starts it; that of {size} sets the size of the swing."


def _agreement(found: Found) -> list[str]:
    """What theory foretells beside what the simulation shows."""
    told = found.foretold
    if told is None or found.failed:
        return []
    lines = [f"Foretold: {_foretold(told)}; simulated over the day: {_simulated(found)}."]
    if found.unsure:
        lines.append(f"A margin of {told.margin:.2g} is too near {HUNTS_ABOVE:g} to decide: go by the simulation.")
    elif told.hunts != found.hunts:
        lines.append(f"The two disagree{_reason(found)}: go by the simulation for this day.")
    return lines


def _foretold(told: Foretold) -> str:
    hunting = told.reached[told.cycles.margin[told.reached] > HUNTS_ABOVE]
    swings, periods = 2.0 * told.cycles.amplitude[hunting], told.cycles.period[hunting]
    if not np.isfinite(swings).any():
        return "no cycle" if not hunting.size else "hunting, of a size that theory does not give"
    return f"{_span(swings, _kelvin)} peak to peak every {_span(periods, seconds)}"


def _span(values: np.ndarray, words: object) -> str:
    low, high = (words(float(end)) for end in (np.nanmin(values), np.nanmax(values)))  # type: ignore[operator]
    return low if low == high else f"{low} to {high}"


def _simulated(found: Found) -> str:
    now = found.now
    if not found.hunts:
        return f"no hunting, RMS error {_kelvin(float(now['rmse']))}"
    return f"{_kelvin(float(now['hunting_swing']))} every {seconds(float(now['hunting_period']))}"


def _reason(found: Found) -> str:
    told = found.foretold
    assert told is not None
    if told.hunts and told.n_hunting < told.reached.size:
        return f": only {told.n_hunting} of {told.reached.size} operating points are foretold to hunt"
    if told.hunts and 2.0 * float(np.nanmax(told.cycles.amplitude)) < HUNTING_SWING:
        return f": a swing below {HUNTING_SWING:g} K does not count"
    return "; the valve may be at its end, or the set-point may move too often" if told.hunts else ""


def _where(found: Found) -> list[str]:
    """Which operating point is quoted, and how the margin differs over the day."""
    told = found.foretold
    if told is None:
        return []
    k, reached = told.worst, told.reached
    T_set, hours = told.points.conditions["T_set"][k], told.points.start[k] / 3600.0
    place = f"{T_set:.3g} °C, {hours:.3g} h after the start (opening {100 * float(told.plants.opening[k]):.0f} %)"
    if told.points.size == 1:
        return [f"Where: at {place}."]
    low, high = float(told.cycles.margin[reached].min()), float(told.cycles.margin[reached].max())
    return [
        f"Where: worst at {place}; over the day the margin goes from {low:.2g} to {high:.2g}, above {HUNTS_ABOVE:g} at "
        f"{told.n_hunting} of {reached.size} operating points."
    ]


def _phase(found: Found) -> list[str]:
    if found.phase is None or found.response is None:
        return []
    period = 2.0 * math.pi / float(found.response.w[found.response.critical])
    shares = sorted(found.phase.values.tolist(), reverse=True)
    parts = [str(found.phase["part"].values[k]) for k in np.argsort(-found.phase.values)]
    taken = [f"  {PART_WORDS[part]:<20}{share:>4.0f}°" for part, share in zip(parts, shares, strict=True)]
    return ["", f"Where the 180° of phase go, at one turn in {seconds(period)}:", *taken]


def _honest(found: Found) -> list[str]:
    """What a cure does not do."""
    names, lines = list(found.cures["cure"].values), []
    if not found.hunts:
        if REPAIRED in names:
            error, without = (float(found.cures["rmse"][k]) for k in (0, names.index(REPAIRED)))
            size = f"{100.0 * found.value('backlash'):.3g} %"
            lines.append(
                f"What the backlash of {size} costs anyway: RMSE {_kelvin(error)} instead of {_kelvin(without)}."
            )
        return lines
    if DEAD_BAND in names:
        band = found.cures["error_dead_band"].values[names.index(DEAD_BAND)]
        lines.append(f"The dead band leaves the margin as it is, and holds any error up to {band:g} K.")
    if INVERSE in names and found.foretold is not None:
        k = names.index(INVERSE)
        if float(found.cures["margin"][k]) > HUNTS_ABOVE:
            lines.append("The inverse leaves the margin too large: what is left of the gap keeps the loop swinging.")
    return lines


def _advice(found: Found) -> list[str]:
    if found.failed:
        return []
    if found.best == 0:
        return ["None of these cures it." if found.hunts else "Leave it: none of these gains more than 5 % of the error."]
    now, then = found.now, found.cures.isel(cure=found.best)
    error = float(then["rmse"] / now["rmse"]) - 1.0
    travel = float(then["motor_travel"] / now["motor_travel"]) if float(now["motor_travel"]) else math.nan
    return [f"Take this: {then['words'].item()}: RMSE {100 * error:+.0f} %, motor travel × {travel:.2g}."]
