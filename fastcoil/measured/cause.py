"""Why a loop swings (the gap of its valve, its tuning, or a disturbance), and what would change it."""

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.measured.fitted_loop import FittedLoop, Outcome, what_if, why_unusable
from fastcoil.measured.measures import SMOOTHINGS_PER_PERIOD, Measures, Swing, running_mean

NONE, BACKLASH, TUNING, DISTURBANCE, UNKNOWN = "none", "backlash", "tuning", "disturbance", "unknown"
LARGEST_GAP_SWING = 0.6
LARGEST_MEASURED_GAP_SWING = 0.95
"""Swing of the command that no gap makes, fraction of stroke: the loop is unstable, the ends of the valve hold it.
Where a test has measured the gap, only a swing from end to end is."""
LARGEST_PERIOD_RATIO, LEAST_SWING_RATIO = 1.6, 0.5
"""A model swings as the log does if the periods differ by less than this factor, and if its swing has at least this
share of the logged one."""
GAIN_FACTORS, _LEAST_AGREEING_GAINS = (1.0 / 1.1, 1.0, 1.1), 2
"""Factors on the gain of the model, which no log resolves exactly, and how many of these have to agree."""
DISTURBANCE_GAIN_FACTOR = 1.25
"""Factor on the gain with which a loop may not hunt either, for its swing to be called a disturbance."""
_CLEAR_GAIN_FACTOR, _CALM_GAIN_FACTOR, _CLEAR_MATCH_LIMITS = 1.2, 1.4, (1.25, 0.75, 2.0)
"""For a gap whose size the log does not resolve to be blamed: factor by which the gain may be larger or smaller and the
loop still hunts with it; factor with which it stays calm without it; by how much the periods may differ, and the least
and largest swing of the model over the logged one."""
_KICK_TIME_S, _LEAST_KICK_K = 600.0, 1.0
"""Seconds and K by which the set-point is off at first, so that a cycle that needs a start gets it."""


_LARGEST_SWING_PER_GAP, _WELL_EXPLAINED_SHARE, _LARGEST_DISTURBANCE_PER_SWING = 5.0, 0.9, 2.0
"""A gap is not blamed for a command that swings over more than so many times its size, nor for a swing that is larger
than that of the model where the command explains a smaller share of the changes of the temperature, nor on a day whose
fast disturbances are so many times as large as its swing."""


LARGEST_REMAINING_SHARE, LEAST_HOLD_PERIODS, LARGEST_CALM_DRIFT_K = 0.5, 0.75, 0.25
"""Share of a swing that remains while the command is held, above which it comes from outside; periods of the swing for
which the command has to be held for a swing that dies to be the loop's own; K that the temperature drifts on calm days
in such a hold, and that it has to move for something outside to be blamed."""


class Cause(NamedTuple):
    """The cause, one word of those above, and why, a sentence."""

    name: str
    because: str


class PriorEvidence(NamedTuple):
    """What else is known of a loop."""

    is_identified: bool  # whether log or test resolves the backlash; if neither does, the model has to be clear
    is_measured: bool = False  # whether it was a test, to which the plant was fitted as well
    is_own_swing: bool = False  # whether the swing is known to be the loop's own


def stops_on_hold(measures: Measures, held_swing: float, held_for: float) -> bool:
    """Whether a swing dies while the command is held for ``held_for`` s, and is the loop's own."""
    swing = measures.swing
    return held_swing <= LARGEST_REMAINING_SHARE * swing.peak_to_peak and held_for >= LEAST_HOLD_PERIODS * swing.period


def judge_cause(measures: Measures, fitted: FittedLoop | str, evidence: PriorEvidence) -> Cause:
    """Judge why a loop swings.

    The fitted loop is simulated on the day of the log with all fast disturbances taken away, with its gap and without.
    What still swings then is a limit cycle of the loop.  Noise is taken away as well where no test has measured the
    gap: what a log calls noise may be more.

    measures: what the log shows.  fitted: the loop as a model, or why there is none; one that does not repeat its log
    to the letter may do.
    """
    swing, command_swing = measures.swing, measures.command_swing
    if not swing.is_regular:
        return Cause(UNKNOWN, measures.why_blind) if measures.why_blind else Cause(NONE, "there is no regular swing")
    if command_swing > (LARGEST_MEASURED_GAP_SWING if evidence.is_measured else LARGEST_GAP_SWING):
        return Cause(
            TUNING, f"the command swings over {100 * command_swing:.0f} % of the stroke, more than a gap can cause"
        )
    if isinstance(fitted, str):
        return Cause(UNKNOWN, f"the loop could not be modelled: {fitted}")
    if sentence := why_unusable(fitted):
        return Cause(UNKNOWN, sentence)
    return _judge_by_model(fitted, measures, evidence)


def revise_after_hold(cause: Cause, measures: Measures, held_swing: float, held_for: float) -> Cause:
    """The cause where a test held the command for ``held_for`` s, and the temperature moved by ``held_swing`` K."""
    swing = measures.swing
    if not np.isfinite(held_swing):
        return cause
    if not swing.is_regular:
        explanation = f"the temperature moved by {held_swing:.2g} K while the command was held"
        return Cause(DISTURBANCE, explanation) if held_swing > LARGEST_CALM_DRIFT_K else cause
    explanation_of_share = (
        f"{100 * held_swing / swing.peak_to_peak:.0f} % of the swing remained while the command was held"
    )
    if held_swing > max(LARGEST_REMAINING_SHARE * swing.peak_to_peak, LARGEST_CALM_DRIFT_K):
        return Cause(DISTURBANCE, explanation_of_share)
    if cause.name == DISTURBANCE and stops_on_hold(measures, held_swing, held_for):
        return Cause(TUNING, f"only {explanation_of_share}, and the gap does not explain it")
    return cause


def _judge_by_model(fitted: FittedLoop, measures: Measures, evidence: PriorEvidence) -> Cause:
    swing = measures.swing
    quiet = undisturbed(fitted, swing, noise=evidence.is_measured)
    # with how many gains the loop swings by itself as the log does
    with_gap, without = (
        sum(_matches_log(quiet.replay_with(gap, gain), swing) for gain in GAIN_FACTORS)
        for gap in (fitted.backlash, 0.0)
    )
    if without >= _LEAST_AGREEING_GAINS:
        return Cause(TUNING, "the loop would hunt even with a perfect valve")
    if with_gap >= _LEAST_AGREEING_GAINS and without == 0:
        return _judge_gap(fitted, quiet, measures, evidence)
    if with_gap == 0 and not quiet.replay_with(fitted.backlash, DISTURBANCE_GAIN_FACTOR).hunts:
        return Cause(
            DISTURBANCE,
            "the loop would not hunt by itself: look for a swing from outside, in the water or the entering air",
        )
    return Cause(
        UNKNOWN,
        "a 10 % change of the loop gain decides whether the loop would hunt by itself, and the log does not show the "
        "gain that accurately",
    )


def undisturbed(fitted: FittedLoop, swing: Swing, *, noise: bool = False) -> FittedLoop:
    """The loop on its day without any disturbance as fast as the swing, and without noise unless it is asked for."""
    day, step = fitted.day, fitted.plant.step
    slow_disturbance = _smooth(day.disturbance, max(3, round(2.0 * swing.period / step)))
    is_started = np.arange(day.T_set.size) * step >= _KICK_TIME_S
    kick = np.where(is_started, 0.0, max(swing.peak_to_peak, _LEAST_KICK_K))
    noise_read = day.noise if noise else np.zeros_like(day.noise)
    return fitted._replace(day=day._replace(disturbance=slow_disturbance, noise=noise_read, T_set=day.T_set + kick))


def _smooth(series: Array, width: int) -> Array:
    return running_mean(series, np.ones(series.size, dtype=bool), width)


def _judge_gap(fitted: FittedLoop, quiet: FittedLoop, measures: Measures, evidence: PriorEvidence) -> Cause:
    """The cause where the model hunts with its gap and not without."""
    if explanation := _why_not_gap_alone(fitted, quiet, measures, evidence):
        return Cause(UNKNOWN, f"the loop would hunt with its gap and not without, but {explanation}")
    if evidence.is_identified or evidence.is_own_swing:
        return Cause(BACKLASH, "the loop would not hunt without it")
    explanation = f"it would hunt with a gap of {100 * fitted.backlash:.2g} % and not without"
    if _is_gap_clear(quiet, measures.swing):
        return Cause(BACKLASH, f"{explanation}; the size is not identified")
    return Cause(UNKNOWN, f"{explanation}, but the gap is not identified")


def _why_not_gap_alone(fitted: FittedLoop, quiet: FittedLoop, measures: Measures, evidence: PriorEvidence) -> str:
    """What speaks for another cause of a swing that the gap alone would make, too, or nothing."""
    swing, plant = measures.swing, fitted.plant
    if measures.command_swing > _LARGEST_SWING_PER_GAP * fitted.backlash and not evidence.is_measured:
        return f"the command swings by {measures.command_swing / fitted.backlash:.0f} times the gap"
    if evidence.is_own_swing:
        return ""
    if (
        plant.explained < _WELL_EXPLAINED_SHARE
        and 2.0 * quiet.replay_with(quiet.backlash).amplitude < swing.peak_to_peak
    ):
        return "by less than the log shows: something outside the loop seems to add to the swing"
    smooth = _smooth(fitted.day.disturbance, max(1, round(swing.period / SMOOTHINGS_PER_PERIOD / plant.step)))
    disturbance_swing = float(np.std(smooth - quiet.day.disturbance)) * 2.0 * math.sqrt(2.0)  # peak to peak of a sine
    if disturbance_swing > _LARGEST_DISTURBANCE_PER_SWING * swing.peak_to_peak:
        return f"disturbances of {disturbance_swing:.2g} K hide its swing of {swing.peak_to_peak:.2g} K"
    return ""


def _is_gap_clear(quiet: FittedLoop, swing: Swing) -> bool:
    """Whether the loop hunts with its gap much as logged, whatever the gain, and is far from hunting without."""
    return (
        _matches_log(quiet.replay_with(quiet.backlash), swing, *_CLEAR_MATCH_LIMITS)
        and all(
            quiet.replay_with(quiet.backlash, gain).hunts for gain in (1.0 / _CLEAR_GAIN_FACTOR, _CLEAR_GAIN_FACTOR)
        )
        and not quiet.replay_with(0.0, _CALM_GAIN_FACTOR).hunts
    )


def _matches_log(
    outcome: Outcome,
    swing: Swing,
    largest_period_ratio: float = LARGEST_PERIOD_RATIO,
    least_swing_ratio: float = LEAST_SWING_RATIO,
    largest_swing_ratio: float = np.inf,
) -> bool:
    swing_ratio = 2.0 * outcome.amplitude / swing.peak_to_peak
    is_period_near = abs(np.log(outcome.period / swing.period)) < np.log(largest_period_ratio)
    return bool(outcome.hunts and least_swing_ratio <= swing_ratio <= largest_swing_ratio and is_period_near)


TRIAL_BUFFER = 0.01  # of the backlash inverse that is tried, fraction of stroke
CASE_LABELS = {
    "as_found": "present gains",
    "no_gap": "no gap",
    "half_gap": "half the gap",
    "half_gain": "half the gain",
    "simc": "gains of SIMC",
    "inverse": "a backlash inverse",
}
_PREDICTED_VARIABLES = {
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
    dead_time = fitted.plant.delay * fitted.plant.step + 0.5 * fast + 0.5 * fitted.pi.sample_time
    lag, steepest = slow + 0.5 * fast, max(abs(fitted.plant.slope(opening)) for opening in (0.0, 1.0))
    kp = lag * (1.0 - fitted.backlash) / (2.0 * steepest * dead_time)
    kp = kp if cause == NONE else min(kp, abs(fitted.pi.kp))
    return float(f"{math.copysign(kp, fitted.pi.kp):.2g}"), float(f"{min(lag, 8.0 * dead_time):.2g}")


def predict_cases(fitted: FittedLoop, cause: str) -> xr.Dataset:
    """The day of the loop in every case: numbers along ``case``, NaN where there is a ``doubt``.

    The cause is judged without the fast disturbances of the log, and a case is predicted with them: what is left of the
    swing in them may go on without the gap.  Where the two disagree, nothing is predicted.
    """
    (kp, ti), pi = simc_gains(fitted, cause), fitted.pi
    outcomes: dict[str, Outcome | str] = {
        "as_found": what_if(fitted),
        "no_gap": what_if(fitted, backlash=0.0),
        "half_gap": what_if(fitted, backlash=0.5 * fitted.backlash),
        "half_gain": what_if(fitted, kp_factor=0.5),
        "simc": what_if(fitted, kp_factor=kp / pi.kp, ti_factor=ti / pi.ti),
        "inverse": what_if(fitted, estimate=fitted.backlash, buffer=TRIAL_BUFFER),
    }
    no_gap = outcomes["no_gap"]
    if not isinstance(no_gap, str) and no_gap.hunts != {BACKLASH: False, TUNING: True}.get(cause, no_gap.hunts):
        outcomes["no_gap"] = "the disturbances of the log hide whether the loop would hunt"
    ds = xr.Dataset(coords={"case": list(outcomes)})
    for name, (unit, meaning) in _PREDICTED_VARIABLES.items():
        values = [
            np.nan if isinstance(outcome, str) else float(getattr(outcome, name)) for outcome in outcomes.values()
        ]
        ds[name] = ("case", values, {"units": unit, "long_name": meaning})
    gains = {"half_gain": (0.5 * pi.kp, pi.ti), "simc": (kp, ti)}
    gains_by_case = [gains.get(case, (pi.kp, pi.ti)) for case in outcomes]
    ds["kp"] = ("case", [abs(pair[0]) for pair in gains_by_case], {"units": "K-1", "long_name": "gain"})
    ds["ti"] = ("case", [pair[1] for pair in gains_by_case], {"units": "s", "long_name": "integral time"})
    ds["doubt"] = ("case", [outcome if isinstance(outcome, str) else "" for outcome in outcomes.values()])
    return ds
