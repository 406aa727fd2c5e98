"""Why a loop swings (the gap of its valve, its tuning, or a disturbance), and what would change it."""

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.design.advice import INVERSE_SHARE
from fastcoil.measured import thresholds
from fastcoil.measured.fitted_loop import FittedLoop, Outcome, what_if, why_unusable
from fastcoil.measured.grid import running_mean
from fastcoil.measured.measures import SMOOTHINGS_PER_PERIOD, Measures, Swing

CAUSE_NONE = "none"
CAUSE_BACKLASH = "backlash"
CAUSE_TUNING = "tuning"
CAUSE_DISTURBANCE = "disturbance"
CAUSE_UNKNOWN = "unknown"
GAIN_DECIDES = "a 10 % change of the loop gain decides whether the loop would hunt alone, "
GAIN_DECIDES += "and the log does not show the gain that accurately"


class Cause(NamedTuple):
    """The cause, one of the names above, and why, a sentence."""

    name: str
    because: str


class PriorEvidence(NamedTuple):
    """What is known of a swing besides the fitted model of the loop."""

    is_identified: bool  # whether log or test resolves the backlash; if neither does, the model has to be clear
    is_measured: bool = False  # whether it was a test, to which the plant was fitted as well
    is_own_swing: bool = False  # whether the swing is known to be the loop's own


def stops_on_hold(measures: Measures, held_swing: float, held_for: float) -> bool:
    """Whether only ``held_swing`` K are left of a swing with the command held for ``held_for`` s: the loop makes it."""
    swing = measures.swing
    is_gone = held_swing <= thresholds.LARGEST_REMAINING_SHARE * swing.peak_to_peak
    return is_gone and held_for >= thresholds.LEAST_HOLD_PERIODS * swing.period


def judge_cause(measures: Measures, fitted: FittedLoop | str, evidence: PriorEvidence) -> Cause:
    """Judge why a loop swings.

    The fitted loop is simulated on the day of the log without fast disturbances, with its gap and without.  What still
    swings is a limit cycle of the loop.  Noise is removed as well unless a test has measured the gap: a log may count
    more as noise.

    fitted: the model of the loop, or why there is none; it need not reproduce the log exactly.
    """
    swing, command_swing, why_blind = measures.swing, measures.command_swing, measures.why_blind
    if not swing.is_regular:
        return Cause(CAUSE_UNKNOWN, why_blind) if why_blind else Cause(CAUSE_NONE, "there is no regular swing")
    if measures.is_own == 0.0:
        return Cause(CAUSE_DISTURBANCE, "the logged air and water explain it")
    is_measured = evidence.is_measured
    if command_swing > (thresholds.LARGEST_MEASURED_GAP_SWING if is_measured else thresholds.LARGEST_GAP_SWING):
        swings = f"the command swings over {100 * command_swing:.0f} % of the stroke"
        return Cause(CAUSE_TUNING, f"{swings}, more than a gap can cause")
    if isinstance(fitted, str):
        return Cause(CAUSE_UNKNOWN, f"the loop could not be modelled: {fitted}")
    if sentence := why_unusable(fitted):
        return Cause(CAUSE_UNKNOWN, sentence)
    return _judge_by_model(fitted, measures, evidence)


def revise_after_hold(cause: Cause, measures: Measures, held_swing: float, held_for: float) -> Cause:
    """Revise the cause where a test held the command for ``held_for`` s; ``held_swing``: of the temperature, K."""
    swing = measures.swing
    if not np.isfinite(held_swing):
        return cause
    if not swing.is_regular:
        explanation = f"the temperature moved by {held_swing:.2g} K while the command was held"
        return Cause(CAUSE_DISTURBANCE, explanation) if held_swing > thresholds.LARGEST_CALM_DRIFT_K else cause
    remainder = f"{100 * held_swing / swing.peak_to_peak:.0f} % of the swing remained while the command was held"
    if held_swing > max(thresholds.LARGEST_REMAINING_SHARE * swing.peak_to_peak, thresholds.LARGEST_CALM_DRIFT_K):
        return Cause(CAUSE_DISTURBANCE, remainder)
    if cause.name == CAUSE_DISTURBANCE and stops_on_hold(measures, held_swing, held_for):
        return Cause(CAUSE_TUNING, f"only {remainder}, and the gap does not explain it")
    return cause


def _judge_by_model(fitted: FittedLoop, measures: Measures, evidence: PriorEvidence) -> Cause:
    """Judge whether the fitted loop swings as logged without disturbances, with its gap and without."""
    swing, gains = measures.swing, thresholds.GAIN_FACTORS
    undisturbed = undisturbed_loop(fitted, swing, noise=evidence.is_measured)
    # number of gains with which the undisturbed loop swings as logged
    n_with_gap = sum(_matches_log(undisturbed.replay_with(fitted.backlash, gain), swing) for gain in gains)
    n_without_gap = sum(_matches_log(undisturbed.replay_with(0.0, gain), swing) for gain in gains)
    if n_without_gap >= thresholds.LEAST_AGREEING_GAINS:
        because = "would hunt even with a perfect valve"
        if fitted.doubt and not evidence.is_measured:
            return Cause(CAUSE_UNKNOWN, f"the fitted loop {because}, but it does not reproduce the log")
        return Cause(CAUSE_TUNING, f"the loop {because}")
    if n_with_gap >= thresholds.LEAST_AGREEING_GAINS and n_without_gap == 0:
        return _judge_gap(fitted, undisturbed, measures, evidence)
    if n_with_gap == 0 and not undisturbed.replay_with(fitted.backlash, thresholds.DISTURBANCE_GAIN_FACTOR).hunts:
        because = "the loop would not hunt alone: look for a swing from outside, in the water or the entering air"
        return Cause(CAUSE_DISTURBANCE, because)
    return Cause(CAUSE_UNKNOWN, GAIN_DECIDES)


def undisturbed_loop(fitted: FittedLoop, swing: Swing, *, noise: bool = False) -> FittedLoop:
    """Return the loop on its day without disturbances as fast as the swing, and without noise unless ``noise``."""
    day, step = fitted.day, fitted.plant.step
    slow_disturbance = _smooth(day.disturbance, max(3, round(2.0 * swing.period / step)))
    # a set-point that is off for ten minutes starts a cycle that needs a start
    kick = np.where(np.arange(day.T_set.size) * step >= 600.0, 0.0, max(swing.peak_to_peak, 1.0))
    noise_read = day.noise if noise else np.zeros_like(day.noise)
    return fitted._replace(day=day._replace(disturbance=slow_disturbance, noise=noise_read, T_set=day.T_set + kick))


def _smooth(series: Array, width: int) -> Array:
    return running_mean(series, np.ones(series.size, dtype=bool), width)


def _judge_gap(fitted: FittedLoop, undisturbed: FittedLoop, measures: Measures, evidence: PriorEvidence) -> Cause:
    """Judge whether the gap is the cause, for a fitted loop that hunts with it and not without."""
    if explanation := _why_not_gap_alone(fitted, undisturbed, measures, evidence):
        return Cause(CAUSE_UNKNOWN, f"the loop would hunt with its gap and not without, but {explanation}")
    if evidence.is_identified or evidence.is_own_swing:
        return Cause(CAUSE_BACKLASH, "the loop would not hunt without it")
    explanation = f"it would hunt with a gap of {100 * fitted.backlash:.2g} % and not without"
    if _is_gap_clear(undisturbed, measures.swing):
        return Cause(CAUSE_BACKLASH, f"{explanation}; the size is not identified")
    return Cause(CAUSE_UNKNOWN, f"{explanation}, but the gap is not identified")


def _why_not_gap_alone(fitted: FittedLoop, undisturbed: FittedLoop, measures: Measures, evidence: PriorEvidence) -> str:
    """Return why the gap alone does not explain the swing, though the loop hunts only with it; empty if it does."""
    swing, plant = measures.swing, fitted.plant
    if measures.command_swing > thresholds.LARGEST_SWING_PER_GAP * fitted.backlash and not evidence.is_measured:
        return f"the command swings by {measures.command_swing / fitted.backlash:.0f} times the gap"
    if evidence.is_own_swing:
        return ""
    is_explained = plant.explained >= thresholds.WELL_EXPLAINED_SHARE
    if not is_explained and 2.0 * undisturbed.replay_with(undisturbed.backlash).amplitude < swing.peak_to_peak:
        return "by less than the log shows: something outside the loop seems to add to the swing"
    smooth = _smooth(fitted.day.disturbance, max(1, round(swing.period / SMOOTHINGS_PER_PERIOD / plant.step)))
    fast_disturbance = smooth - undisturbed.day.disturbance
    disturbance_swing = float(np.std(fast_disturbance)) * 2.0 * math.sqrt(2.0)  # peak to peak of a sine
    if disturbance_swing > thresholds.LARGEST_DISTURBANCE_PER_SWING * swing.peak_to_peak:
        return f"disturbances of {disturbance_swing:.2g} K hide its swing of {swing.peak_to_peak:.2g} K"
    return ""


def _is_gap_clear(undisturbed: FittedLoop, swing: Swing) -> bool:
    """Whether the loop hunts as logged with its gap, whatever the gain, and is far from hunting without a gap."""
    gains = (1.0 / thresholds.CLEAR_GAIN_FACTOR, thresholds.CLEAR_GAIN_FACTOR)
    outcome = undisturbed.replay_with(undisturbed.backlash)
    return (
        _matches_log(outcome, swing, thresholds.CLEAR_PERIOD_RATIO, thresholds.CLEAR_SWING_RATIOS)
        and all(undisturbed.replay_with(undisturbed.backlash, gain).hunts for gain in gains)
        and not undisturbed.replay_with(0.0, thresholds.CALM_GAIN_FACTOR).hunts
    )


def _matches_log(
    outcome: Outcome, swing: Swing, largest_period_ratio: float = thresholds.LARGEST_PERIOD_RATIO,
    swing_ratios: tuple[float, float] = (thresholds.LEAST_SWING_RATIO, np.inf),
) -> bool:  # fmt: skip
    """Whether a simulated loop hunts as logged; swing_ratios: least and most of its swing over the logged one."""
    low, high = swing_ratios
    is_period_near = abs(np.log(outcome.period / swing.period)) < np.log(largest_period_ratio)
    return bool(outcome.hunts and low <= 2.0 * outcome.amplitude / swing.peak_to_peak <= high and is_period_near)


CASE_LABELS = {
    "as_found": "present gains", "no_gap": "no gap", "half_gap": "half the gap", "half_gain": "half the gain",
    "simc": "gains of SIMC", "inverse": "a backlash inverse",
}  # fmt: skip
_PREDICTED_VARIABLES = {
    "rmse": ("K", "RMS control error"),
    "amplitude": ("K", "amplitude of the swing, half of peak to peak"),
    "period": ("s", "period of the swing"),
    "travel_per_day": ("1", "strokes of the motor per day"),
    "reversals_per_day": ("1", "reversals of the stem per day"),
    "hunts": ("1", "whether the loop hunts"),
}


def simc_gains(fitted: FittedLoop, cause: str) -> tuple[float, float]:
    """Return the gains kp, 1/K, and ti, s, of the tuning rule SIMC for the fitted plant where it is steepest.

    kp is no larger than that of a loop that hunts.
    """
    slow, fast = max(fitted.plant.lags), min(fitted.plant.lags)
    # half of the smaller lag counts as dead time (Skogestad 2003)
    dead_time = fitted.plant.delay * fitted.plant.step + 0.5 * fast + 0.5 * fitted.pi.sample_time
    lag, steepest = slow + 0.5 * fast, max(abs(fitted.plant.slope(opening)) for opening in (0.0, 1.0))
    kp = lag * (1.0 - fitted.backlash) / (2.0 * steepest * dead_time)
    kp = kp if cause == CAUSE_NONE else min(kp, abs(fitted.pi.kp))
    return float(f"{math.copysign(kp, fitted.pi.kp):.2g}"), float(f"{min(lag, 8.0 * dead_time):.2g}")


def predict_cases(fitted: FittedLoop, cause: Cause) -> xr.Dataset:
    """Predict the loop's day with each change of ``CASE_LABELS``: a Dataset along ``case``, NaN where in ``doubt``.

    The cause is judged without fast disturbances, and a day is predicted with them: the swing that is left in them may
    go on without the gap.  Where the two disagree, nothing is predicted.
    """
    (kp, ti), pi = simc_gains(fitted, cause.name), fitted.pi
    outcomes: dict[str, Outcome | str] = {
        "as_found": what_if(fitted),
        "no_gap": GAIN_DECIDES if cause.because == GAIN_DECIDES else what_if(fitted, backlash=0.0),
        "half_gap": what_if(fitted, backlash=0.5 * fitted.backlash),
        "half_gain": what_if(fitted, kp_factor=0.5),
        "simc": what_if(fitted, kp_factor=kp / pi.kp, ti_factor=ti / pi.ti),
        "inverse": what_if(fitted, estimate=INVERSE_SHARE * fitted.backlash, buffer=0.01),
    }
    no_gap, hunts_without_gap = outcomes["no_gap"], {CAUSE_BACKLASH: False, CAUSE_TUNING: True}
    if not isinstance(no_gap, str) and no_gap.hunts != hunts_without_gap.get(cause.name, no_gap.hunts):
        outcomes["no_gap"] = "the disturbances of the log hide whether the loop would hunt"
    ds = xr.Dataset(coords={"case": list(outcomes)})
    for name, (unit, meaning) in _PREDICTED_VARIABLES.items():
        values = [np.nan if isinstance(o, str) else float(getattr(o, name)) for o in outcomes.values()]
        ds[name] = ("case", values, {"units": unit, "long_name": meaning})
    gains = {"half_gain": (0.5 * pi.kp, pi.ti), "simc": (kp, ti)}
    case_kp, case_ti = zip(*(gains.get(case, (pi.kp, pi.ti)) for case in outcomes), strict=True)
    ds["kp"] = ("case", np.abs(case_kp), {"units": "K-1", "long_name": "gain"})
    ds["ti"] = ("case", list(case_ti), {"units": "s", "long_name": "integral time"})
    ds["doubt"] = ("case", [outcome if isinstance(outcome, str) else "" for outcome in outcomes.values()])
    return ds
