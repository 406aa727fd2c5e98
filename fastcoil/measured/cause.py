"""Why a loop swings (the gap of its valve, its tuning, or a disturbance), and what would change it."""

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.measured.fitted_loop import FittedLoop, Outcome, too_little, what_if
from fastcoil.measured.measures import SMOOTH, Measures, Swing, running_mean

NONE, BACKLASH, TUNING, DISTURBANCE, UNKNOWN = "none", "backlash", "tuning", "disturbance", "unknown"
FULL_SWING = 0.6
WHOLE_STROKE = 0.95
"""Swing of the command that no gap makes, fraction of stroke: the loop is unstable, the ends of the valve hold it.
Where a test has measured the gap, only a swing from end to end is."""
ALIKE, LEAST_SIZE = 1.6, 0.5
"""A model swings as the log does if the periods differ by less than this factor, and if its swing has at least this
share of the logged one."""
GAINS, _MOST = (1.0 / 1.1, 1.0, 1.1), 2
"""Factors on the gain of the model, which no log resolves exactly, and how many of these have to agree."""
FAR_FROM_HUNTING = 1.25
"""Factor on the gain with which a loop may not hunt either, for its swing to be called a disturbance."""
_CLEARLY, _CALM, _VERY_ALIKE = 1.2, 1.4, (1.25, 0.75, 2.0)
"""For a gap whose size the log does not resolve to be blamed: factor by which the gain may be larger or smaller and the
loop still hunts with it; factor with which it stays calm without it; by how much the periods may differ, and the least
and largest swing of the model over the logged one."""
_KICKED, _LEAST_KICK = 600.0, 1.0
"""Seconds and K by which the set-point is off at first, so that a cycle that needs a start gets it."""


_TIMES_GAP, _WELL_EXPLAINED, _TIMES_SWING = 5.0, 0.9, 2.0
"""A gap is not blamed for a command that swings over more than so many times its size, nor for a swing that is larger
than that of the model where the command explains a smaller share of the changes of the temperature, nor on a day whose
fast disturbances are so many times as large as its swing."""


REMAINS, DIES, MOVES = 0.5, 0.75, 0.25
"""Share of a swing that remains while the command is held, above which it comes from outside; periods of the swing for
which the command has to be held for a swing that dies to be the loop's own; K that the temperature drifts on calm days
in such a hold, and that it has to move for something outside to be blamed."""


class Cause(NamedTuple):
    """The cause, one word of those above, and why, a sentence."""

    name: str
    because: str


class Known(NamedTuple):
    """What else is known of a loop."""

    identified: bool  # whether log or test resolves the backlash; if neither does, the model has to be clear
    measured: bool = False  # whether it was a test, to which the plant was fitted as well
    own: bool = False  # whether the swing is known to be the loop's own


def dies(measures: Measures, held_swing: float, held_for: float) -> bool:
    """Whether a swing dies while the command is held for ``held_for`` s, and is the loop's own."""
    swing = measures.swing
    return held_swing <= REMAINS * swing.peak_to_peak and held_for >= DIES * swing.period


def cause_of(measures: Measures, fitted: FittedLoop | str, known: Known) -> Cause:
    """Judge why a loop swings.

    The fitted loop is simulated on the day of the log with all fast disturbances taken away, with its gap and without.
    What still swings then is a limit cycle of the loop.  Noise is taken away as well where no test has measured the
    gap: what a log calls noise may be more.

    measures: what the log shows.  fitted: the loop as a model, or why there is none; one that does not repeat its log
    to the letter may do.
    """
    swing, stroke = measures.swing, measures.command_swing
    if not swing.is_regular:
        return Cause(UNKNOWN, measures.blind) if measures.blind else Cause(NONE, "there is no regular swing")
    if stroke > (WHOLE_STROKE if known.measured else FULL_SWING):
        return Cause(TUNING, f"the command swings over {100 * stroke:.0f} % of the stroke, more than a gap can cause")
    if isinstance(fitted, str):
        return Cause(UNKNOWN, f"the loop could not be modelled: {fitted}")
    if sentence := too_little(fitted):
        return Cause(UNKNOWN, sentence)
    return _of_model(fitted, measures, known)


def after_hold(cause: Cause, measures: Measures, held_swing: float, held_for: float) -> Cause:
    """The cause where a test held the command for ``held_for`` s, and the temperature moved by ``held_swing`` K."""
    swing = measures.swing
    if not np.isfinite(held_swing):
        return cause
    if not swing.is_regular:
        moved = f"the temperature moved by {held_swing:.2g} K while the command was held"
        return Cause(DISTURBANCE, moved) if held_swing > MOVES else cause
    share = f"{100 * held_swing / swing.peak_to_peak:.0f} % of the swing remained while the command was held"
    if held_swing > max(REMAINS * swing.peak_to_peak, MOVES):
        return Cause(DISTURBANCE, share)
    if cause.name == DISTURBANCE and dies(measures, held_swing, held_for):
        return Cause(TUNING, f"only {share}, and the gap does not explain it")
    return cause


def _of_model(fitted: FittedLoop, measures: Measures, known: Known) -> Cause:
    swing = measures.swing
    quiet = by_itself(fitted, swing, noise=known.measured)
    # with how many gains the loop swings by itself as the log does
    with_gap, without = (
        sum(_swings_alike(quiet.played(gap, gain), swing) for gain in GAINS) for gap in (fitted.backlash, 0.0)
    )
    if without >= _MOST:
        return Cause(TUNING, "the loop would hunt even with a perfect valve")
    if with_gap >= _MOST and without == 0:
        return _of_gap(fitted, quiet, measures, known)
    if with_gap == 0 and not quiet.played(fitted.backlash, FAR_FROM_HUNTING).hunts:
        return Cause(
            DISTURBANCE,
            "the loop would not hunt by itself: look for a swing from outside, in the water or the entering air",
        )
    return Cause(
        UNKNOWN,
        "a 10 % change of the loop gain decides whether the loop would hunt by itself, and the log does not show the "
        "gain that accurately",
    )


def by_itself(fitted: FittedLoop, swing: Swing, *, noise: bool = False) -> FittedLoop:
    """The loop on its day without any disturbance as fast as the swing, and without noise unless it is asked for."""
    day, step = fitted.day, fitted.plant.step
    slow = _smooth(day.disturbance, max(3, round(2.0 * swing.period / step)))
    started = np.arange(day.T_set.size) * step >= _KICKED
    kick = np.where(started, 0.0, max(swing.peak_to_peak, _LEAST_KICK))
    seen = day.noise if noise else np.zeros_like(day.noise)
    return fitted._replace(day=day._replace(disturbance=slow, noise=seen, T_set=day.T_set + kick))


def _smooth(series: Array, width: int) -> Array:
    return running_mean(series, np.ones(series.size, dtype=bool), width)


def _of_gap(fitted: FittedLoop, quiet: FittedLoop, measures: Measures, known: Known) -> Cause:
    """The cause where the model hunts with its gap and not without."""
    if because := _more_than_the_gap(fitted, quiet, measures, known):
        return Cause(UNKNOWN, f"the loop would hunt with its gap and not without, but {because}")
    if known.identified or known.own:
        return Cause(BACKLASH, "the loop would not hunt without it")
    because = f"it would hunt with a gap of {100 * fitted.backlash:.2g} % and not without"
    if _is_clear(quiet, measures.swing):
        return Cause(BACKLASH, f"{because}; the size is not identified")
    return Cause(UNKNOWN, f"{because}, but the gap is not identified")


def _more_than_the_gap(fitted: FittedLoop, quiet: FittedLoop, measures: Measures, known: Known) -> str:
    """What speaks for another cause of a swing that the gap alone would make, too, or nothing."""
    swing, plant = measures.swing, fitted.plant
    if measures.command_swing > _TIMES_GAP * fitted.backlash and not known.measured:
        return f"the command swings by {measures.command_swing / fitted.backlash:.0f} times the gap"
    if known.own:
        return ""
    if plant.explained < _WELL_EXPLAINED and 2.0 * quiet.played(quiet.backlash).amplitude < swing.peak_to_peak:
        return "by less than the log shows: something outside the loop seems to add to the swing"
    smooth = _smooth(fitted.day.disturbance, max(1, round(swing.period / SMOOTH / plant.step)))
    outside = float(np.std(smooth - quiet.day.disturbance)) * 2.0 * math.sqrt(2.0)  # peak to peak of a sine
    if outside > _TIMES_SWING * swing.peak_to_peak:
        return f"disturbances of {outside:.2g} K hide its swing of {swing.peak_to_peak:.2g} K"
    return ""


def _is_clear(quiet: FittedLoop, swing: Swing) -> bool:
    """Whether the loop hunts with its gap much as logged, whatever the gain, and is far from hunting without."""
    return (
        _swings_alike(quiet.played(quiet.backlash), swing, *_VERY_ALIKE)
        and all(quiet.played(quiet.backlash, gain).hunts for gain in (1.0 / _CLEARLY, _CLEARLY))
        and not quiet.played(0.0, _CALM).hunts
    )


def _swings_alike(
    outcome: Outcome, swing: Swing, alike: float = ALIKE, least: float = LEAST_SIZE, most: float = np.inf
) -> bool:
    size = 2.0 * outcome.amplitude / swing.peak_to_peak
    is_near = abs(np.log(outcome.period / swing.period)) < np.log(alike)
    return bool(outcome.hunts and least <= size <= most and is_near)


BUFFER = 0.01  # of the backlash inverse that is tried, fraction of stroke
WORDS = {
    "as_found": "present gains",
    "no_gap": "no gap",
    "half_gap": "half the gap",
    "half_gain": "half the gain",
    "simc": "gains of SIMC",
    "inverse": "a backlash inverse",
}
_MEANINGS = {
    "rmse": ("K", "RMS control error"),
    "amplitude": ("K", "amplitude of the swing, half of peak to peak"),
    "period": ("s", "period of the swing"),
    "travel_per_day": ("1", "strokes of the motor per day"),
    "reversals_per_day": ("1", "reversals of the stem per day"),
    "hunts": ("1", "whether the loop hunts"),
}


def simc_gains(fitted: FittedLoop, cause: str) -> tuple[float, float]:
    """kp, 1/K, and ti, s, after SIMC for the fitted plant where it is steepest; no larger kp for a loop that hunts."""
    slow, fast = max(fitted.plant.lags), min(fitted.plant.lags)
    # half of the smaller lag counts as dead time (Skogestad 2003)
    dead = fitted.plant.delay * fitted.plant.step + 0.5 * fast + 0.5 * fitted.pi.sample_time
    lag, steepest = slow + 0.5 * fast, max(abs(fitted.plant.slope(opening)) for opening in (0.0, 1.0))
    kp = lag * (1.0 - fitted.backlash) / (2.0 * steepest * dead)
    kp = kp if cause == NONE else min(kp, abs(fitted.pi.kp))
    return float(f"{math.copysign(kp, fitted.pi.kp):.2g}"), float(f"{min(lag, 8.0 * dead):.2g}")


def predictions_of(fitted: FittedLoop, cause: str) -> xr.Dataset:
    """The day of the loop in every case: numbers along ``case``, NaN where there is a ``doubt``.

    The cause is judged without the fast disturbances of the log, and a case is predicted with them: what is left of the
    swing in them may go on without the gap.  Where the two disagree, nothing is predicted.
    """
    (kp, ti), pi = simc_gains(fitted, cause), fitted.pi
    found: dict[str, Outcome | str] = {
        "as_found": what_if(fitted),
        "no_gap": what_if(fitted, backlash=0.0),
        "half_gap": what_if(fitted, backlash=0.5 * fitted.backlash),
        "half_gain": what_if(fitted, kp_factor=0.5),
        "simc": what_if(fitted, kp_factor=kp / pi.kp, ti_factor=ti / pi.ti),
        "inverse": what_if(fitted, estimate=fitted.backlash, buffer=BUFFER),
    }
    without = found["no_gap"]
    if not isinstance(without, str) and without.hunts != {BACKLASH: False, TUNING: True}.get(cause, without.hunts):
        found["no_gap"] = "the disturbances of the log hide whether the loop would hunt"
    ds = xr.Dataset(coords={"case": list(found)})
    for name, (unit, meaning) in _MEANINGS.items():
        values = [np.nan if isinstance(one, str) else float(getattr(one, name)) for one in found.values()]
        ds[name] = ("case", values, {"units": unit, "long_name": meaning})
    gains = {"half_gain": (0.5 * pi.kp, pi.ti), "simc": (kp, ti)}
    of_cases = [gains.get(case, (pi.kp, pi.ti)) for case in found]
    ds["kp"] = ("case", [abs(of_case[0]) for of_case in of_cases], {"units": "K-1", "long_name": "gain"})
    ds["ti"] = ("case", [of_case[1] for of_case in of_cases], {"units": "s", "long_name": "integral time"})
    ds["doubt"] = ("case", [one if isinstance(one, str) else "" for one in found.values()])
    return ds
