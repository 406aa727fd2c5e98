"""Advice on a loop, with numbers: cures, tried by simulation, and the one source of every advice."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.text import format_kelvin, format_percent, format_two_digits
from fastcoil.design.limit_cycle import HUNTING_INDEX_LIMIT
from fastcoil.design.prediction import Prediction, predict_cycles_at, shortest_ti, simc_gains
from fastcoil.design.swing_verdict import judge_by_twins
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS, Scalar

# Thresholds; tests/design/test_advice.py checks them on 500 random loops.  Of the inverse: docs/findings/remedies.md
UNSURE_HUNTING_INDEX = (0.7, 1.0)  # between these theory does not decide
SAFE_HUNTING_INDEX = 0.7  # that the gains of a cure have to reach
NOTICEABLE = 0.01  # difference of temperature that counts, K
OVERESTIMATE_RATIO = 1.02  # estimate over gap from which a motor may chatter; estimators are right to a few thousandths
CALM_TURNS = 2.0  # of the motor in 10 min that are no chatter
CHATTER_SHARE = 1.0 / 3.0  # of the travel in the jumps at the turns from which a motor chatters
WORSE = 1.05  # RMSE over that now above which an option is worse
BETTER = 0.95  # and below which it is better
LOST_SHARE = 0.5  # of the time off the set-point from which a loop does not hold it
INVERSE_SHARE = 0.95  # estimate of the inverse over the gap
BUFFER_SWING = 0.1  # K, see the parameter ``buffer_swing``

NOISE_SWINGS_IT = "noise still swings it"  # a verdict
AS_IS = "as_it_is"
LOWER_KP = "lower_kp"
LONGER_TI = "longer_ti"
SIMC = "simc"
SIMULATED_GAINS = "simulated_gains"
DEAD_BAND = "dead_band"
NO_INVERSE = "no_inverse"
INVERSE = "inverse"
SIMC_AND_INVERSE = "simc_and_inverse"
REPAIRED_VALVE = "repaired_valve"
GAIN_CURES = (LOWER_KP, LONGER_TI, SIMC, SIMULATED_GAINS)  # cures that change kp and ti alone


class Cure(NamedTuple):
    """A change of a loop.  words: as a technician says it.  changes: parameter → value."""

    name: str
    words: str
    changes: Mapping[str, Scalar]


def _gains_cure(name: str, kp: float, ti: float, words: str = "") -> Cure:
    return Cure(name, f"{words}kp {kp:g} 1/K, ti {ti:g} s", {"kp": kp, "ti": ti})


def propose_cures(loop: Loop, prediction: Prediction, *, has_theory: bool) -> list[Cure]:
    """List changes to try on a loop, as it is first; prediction: of it, or of the nearest for which theory holds."""
    kp, ti, backlash = (float(loop[name]) for name in ("kp", "ti", "backlash"))  # type: ignore[arg-type]
    acts_backwards = prediction.loop["action"] != loop["action"]
    cures = [Cure(AS_IS, "as it is", {})]
    if prediction.hunting_index > SAFE_HUNTING_INDEX:
        safe_kp = kp * SAFE_HUNTING_INDEX / prediction.hunting_index
        cures.append(_gains_cure(LOWER_KP, _round_setting(safe_kp, round_down=True), ti))
        safe_ti = shortest_ti(prediction, SAFE_HUNTING_INDEX)
        if math.isfinite(safe_ti):
            cures.append(_gains_cure(LONGER_TI, kp, _round_setting(safe_ti, round_down=False)))
    simc = simc_gains(prediction)
    if simc is not None:
        simc_kp, simc_ti = _round_setting(simc[0]), _round_setting(simc[1])
        tuned = prediction.loop.assign(kp=simc_kp, ti=simc_ti)
        index = float(predict_cycles_at(tuned, prediction.plants, prediction.reachable_points).hunting_index.max())
        if SAFE_HUNTING_INDEX < index <= HUNTING_INDEX_LIMIT:  # the lower kp would be advised next
            simc_kp = _round_setting(simc_kp * SAFE_HUNTING_INDEX / index, round_down=True)
        cures.append(_gains_cure(SIMC, simc_kp, simc_ti, "SIMC: "))
    gain_changes = cures[-1].changes if simc is not None else {}
    law_change, no_inverse = {"law": "pi"} if loop["law"] != "pi" else {}, inverse_off_changes(loop)
    if gain_changes and (law_change or no_inverse):
        words, changes = ("the PI in place of this law", law_change) if law_change else ("no inverse", no_inverse)
        cures.append(Cure("pi", cures[-1].words.replace("SIMC:", f"{words},"), {**changes, **gain_changes}))
    if no_inverse:
        cures.append(Cure(NO_INVERSE, "no inverse", no_inverse))
    band_width = 0.25  # K, where nothing hunts
    if has_theory and prediction.hunting_points.size:  # as wide as the swing is high to 0.05 K, from 0.1 to 0.5 K
        height = float(np.nanmax(prediction.cycles.amplitude[prediction.reachable_points]))
        band_width = float(np.clip(math.ceil(round(height / 0.05, 6)) * 0.05, 0.1, 0.5).round(2))
    if float(loop["error_dead_band"]) < band_width:  # type: ignore[arg-type]
        cures.append(Cure(DEAD_BAND, f"error dead band of {band_width:g} K", {"error_dead_band": band_width}))
    if backlash > 0.0:
        if prediction.worst_point >= 0:
            # K per stroke; with a smaller gain the buffer would exceed 1
            gain = max(abs(float(prediction.plants.gain[prediction.worst_point])), 0.2)
            inverse_changes: dict[str, Scalar] = {**no_inverse, "backlash_estimate": INVERSE_SHARE * backlash}
            inverse_changes |= {"compensation": "inverse", "buffer_ratio": 6.0, "buffer_noise": "measured"}
            inverse_changes |= {"buffer_swing": BUFFER_SWING, "plant_gain": gain}
            size, buffer = format_percent(INVERSE_SHARE * backlash), format_percent(BUFFER_SWING / gain)
            words = f"inverse of {size}, buffer by noise up to {buffer}"
            if not law_change:
                cures.append(Cure(INVERSE, words, inverse_changes))
            if gain_changes:
                words = f"{'the PI' if law_change else 'SIMC'} and {words}"
                cures.append(Cure(SIMC_AND_INVERSE, words, {**gain_changes, **inverse_changes, **law_change}))
        # no gap, and whatever assumed one is off; a stem cannot stick without a gap in this model
        repair_changes = {"backlash": 0.0, "backlash_estimate": 0.0, "slip_jump": 0.0}
        cures.append(Cure(REPAIRED_VALVE, "valve repaired: no backlash", repair_changes))
    if acts_backwards:  # nothing works the wrong way round
        action = str(prediction.loop["action"])
        words, turned = f"action = {action}", {"action": action}
        others = [Cure(cure.name, f"{words}, {cure.words}", {**cure.changes, **turned}) for cure in cures[1:]]
        cures = [cures[0], Cure("action", words, turned), *others]
    return cures


def inverse_off_changes(loop: Loop) -> dict[str, Scalar]:
    """Changes that turn the compensation off; empty if there is none."""
    changes: dict[str, Any] = {name: 0.0 for name in ("backlash_estimate", "learning_step") if loop[name]}
    if used_choices(loop, "estimator") != {"none"}:
        changes["estimator"] = "none"
    return changes | {name: PARAMETERS[name].default for name in unread_values(loop.assign(**changes))}


def _round_setting(value: float, *, round_down: bool | None = None) -> float:
    """Round a setting to two digits, to the nearest one, down or up."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    digits = value / scale
    down, up = math.floor(digits + 1e-9), math.ceil(digits - 1e-9)
    return float(f"{(round(digits) if round_down is None else down if round_down else up) * scale:.6g}")


def sweep_cures(loop: Loop, cures: Sequence[Cure]) -> Loop:
    """Return the loop as a sweep along ``cure``."""
    swept = {}
    for name in dict.fromkeys(name for cure in cures for name in cure.changes):
        value = loop[name] if loop[name] is not None else PARAMETERS[name].default
        if value is None:
            value = next(cure.changes[name] for cure in cures if name in cure.changes)
        swept[name] = ("cure", [cure.changes.get(name, value) for cure in cures])
    return loop.assign(**swept)


class Trial(NamedTuple):
    """A loop and the day on which cures are tried; prediction: None where theory does not hold."""

    loop: Loop
    boundary: Boundary
    prediction: Prediction | None
    warm_up: int
    seed: int


def try_cures(trial: Trial, cures: Sequence[Cure]) -> xr.Dataset:
    """Simulate and predict every cure: metrics, controlled temperature, hunting index, ``hunts``, over ``cure``.

    ``hunts`` and ``swing_alone``: see ``judge_by_twins``.
    ``chatters`` is 1 where the motor keeps turning because the estimate is larger than the gap.
    """
    swept, boundary = sweep_cures(trial.loop, cures), trial.boundary
    interval = max(2, -(-boundary.n_steps // 43200))
    options: dict[str, Any] = {"warm_up": trial.warm_up, "seed": trial.seed, "n_jobs": 1}
    ds = simulate(swept, boundary, traces=[swept["controlled"]], trace_interval=interval, progress=False, **options)
    ds = judge_by_twins(ds, swept, boundary, **options)
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    ds = ds if "cure" in ds.dims else ds.expand_dims("cure")
    hunting_index = np.full(len(cures), math.nan)
    if trial.prediction is not None:
        reachable = trial.prediction.reachable_points
        hunting_index = predict_cycles_at(swept, trial.prediction.plants, reachable).hunting_index.max(axis=1)
    jump_travel = ds["switch_frequency"] * (boundary.n_steps - trial.warm_up) / 600.0 * ds["estimate_settled"]
    chatters = ds["estimate_settled"] > OVERESTIMATE_RATIO * ds["backlash_final"]
    chatters &= (ds["switch_frequency"] > CALM_TURNS) & (jump_travel > CHATTER_SHARE * ds["motor_travel"])
    index_attrs = {"long_name": "largest hunting index of the describing function, predicted"}
    return ds.assign_coords(cure=[cure.name for cure in cures]).assign(
        words=("cure", [cure.words for cure in cures]),
        hunting_index=("cure", hunting_index, index_attrs),
        chatters=("cure", chatters.values.astype(float), {"long_name": "whether the motor chatters"}),
    )


def with_simulated_gains(trial: Trial, cures: list[Cure]) -> list[Cure]:
    """Insert after the loop as it is the best kp and ti around SIMC's that do not hunt, nor with the next larger kp."""
    current = {name: trial.loop[name] for name in ("kp", "ti")}
    start: Mapping[str, Any] = next((cure.changes for cure in cures if cure.name == SIMC), current)
    kps = [_round_setting(start["kp"] * factor) for factor in (0.25, 0.35, 0.5, 0.7, 1.0, 1.4)]
    tis = [_round_setting(start["ti"] * factor) for factor in (1.0, 2.0, 4.0, 8.0)]
    grid = [_gains_cure(SIMULATED_GAINS, kp, ti, "found by simulation: ") for ti in tis for kp in kps]
    ds, shape = try_cures(trial, grid), (len(tis), len(kps))
    is_calm = ((ds["hunts"] == 0.0) & (ds["status"] == STATUS_OK)).values.reshape(shape)
    is_calm[:, :-1] &= is_calm[:, 1:]
    is_calm[:, -1] = False
    error = np.where(is_calm, ds["rmse"].values.reshape(shape), np.inf).ravel()
    k = int(np.argmin(error))
    return [cures[0], grid[k], *cures[1:]] if math.isfinite(error[k]) else cures


class Option(NamedTuple):
    """Results of a loop as it is, or with a change.  error: RMS, K; travel: of the motor, strokes."""

    name: str
    words: str
    error: float
    travel: float
    hunts: bool
    hunting_index: float = math.nan
    chatters: bool = False
    swing: float = math.nan  # of T_sup, K


class Advice(NamedTuple):
    """Index of the option to take, 0 for none, and the sentences that say so."""

    best: int
    text: str


_CURE_RANKS = {INVERSE: 1, SIMC_AND_INVERSE: 1, DEAD_BAND: 3, REPAIRED_VALVE: 4}
"""Settings of the PI come first, then what needs the size of the gap, then (2) what is calm although its hunting index
is too large or its motor chatters; a dead band hides the swing, a repair is no setting."""


def advise(
    options: Sequence[Option], *, holds_set_point: bool = True, error_name: str = "RMSE", least_error: float = 0.0,
    format_error: Callable[[float], str] = format_kelvin,
) -> Advice:  # fmt: skip
    """Choose an option, and say so in a sentence.

    Where the loop, first of the options, hunts or its motor chatters: that of the first rank that does not, with the
    least error.  Where it does not: one that takes 5 % off the error.  least_error: that counts, K.
    """
    current = options[0]

    def rank(k: int) -> tuple[int, float]:
        option, by_name = options[k], _CURE_RANKS.get(options[k].name, 0)
        is_doubtful = option.chatters or option.hunting_index > HUNTING_INDEX_LIMIT
        return max(by_name, 2) if is_doubtful else by_name, option.error

    def describe(k: int, words: str = "") -> str:
        option = options[k]
        text = f"{words or option.words}: {error_name} {format_error(option.error)}"
        text += f" ({100 * (option.error / current.error - 1.0):+.0f} %)"
        if current.travel > 0.0:
            text += f", motor travel × {format_two_digits(round(option.travel / current.travel, 3))}"
        if option.hunting_index > HUNTING_INDEX_LIMIT and rank(k)[0] == 2 and not option.hunts:
            index = f"a hunting index of {option.hunting_index:.2g} is above {HUNTING_INDEX_LIMIT:g}"
            text += f".  This day stays calm, but {index}"
        return f"{text}."

    trouble = "hunting" if current.hunts else "chatter" if current.chatters else ""

    def is_calm(option: Option) -> bool:
        return not option.hunts and (current.hunts or not option.chatters)

    calm = [k for k, option in enumerate(options) if k and math.isfinite(option.error) and is_calm(option)]
    better = [k for k in calm if options[k].error < BETTER * current.error]
    inverses = [k for k in calm if options[k].name in (INVERSE, SIMC_AND_INVERSE)]
    if_known = "If the backlash is known to 5 %: "

    def describe_inverse(best: int) -> str:
        k = min((k for k in inverses if options[k].error < BETTER * options[best].error), key=rank, default=0)
        return f"  {if_known}{describe(k)}" if k and rank(best)[0] == 0 else ""

    if not trouble:
        if holds_set_point and current.error < least_error:
            return Advice(0, f"Leave it: its error is below {format_kelvin(least_error)}.")
        settings = [k for k in better if options[k].name not in (DEAD_BAND, REPAIRED_VALVE)]
        best = min(settings, key=rank, default=0)
        if best:
            start = if_known if best in inverses else "If the error matters: "
            start = start if holds_set_point else "Do this: "
            return Advice(best, f"{start}{describe(best)}{describe_inverse(best)}")
        if not holds_set_point:
            return Advice(0, "None of these changes makes the loop hold its set-point.")
        words = {DEAD_BAND: "an error dead band would", REPAIRED_VALVE: "a repaired valve would"}
        alternative = min(better, key=rank, default=0)
        ends = f"; {describe(alternative, words[options[alternative].name])}" if alternative else "."
        if any(option.error < BETTER * current.error and not is_calm(option) for option in options):
            ends = f" and stays calm{ends}"
        what = "gains" if options[alternative].name == DEAD_BAND else "settings"
        return Advice(0, f"Leave it: none of these {what} reduces the error by 5 %{ends}")
    best = min(calm, key=rank, default=0)
    if not best:
        least_wrong = min(range(len(options)), key=lambda k: np.nan_to_num(options[k].error, nan=np.inf))
        ends = f"; least error: {describe(least_wrong)}" if least_wrong else "."
        return Advice(0, f"None of these stops the {trouble}{ends}")
    text = f"Do this: {describe(best)}{describe_inverse(best)}"
    if options[best].name == DEAD_BAND:
        text += "  It only hides the swing: the hunting index, and any error within the band, remain."
    if options[best].name == REPAIRED_VALVE:
        text += f"  None of these settings stops the {trouble}."
    return Advice(best, text)


def verdict(current: Option, changed: Option, *, has_noise: bool = False) -> str:
    """Effect of an option compared with the loop as it is, in a few words; of one that should rest, noise is named."""
    if not math.isfinite(changed.error):
        return "failed"
    ratio = changed.error / current.error if current.error else math.nan
    is_worse, is_better = ratio > WORSE, ratio < BETTER
    if current.hunts and changed.hunts:
        start = NOISE_SWINGS_IT if has_noise and changed.hunting_index < UNSURE_HUNTING_INDEX[0] else "still hunts"
        ratio = changed.swing / current.swing if current.swing else math.nan
        size = ", but less" if ratio < BETTER else ", and more" if ratio > WORSE else ""
        return f"{start}{size}{', at a larger error' * is_worse}"
    if current.hunts:
        return "cures it, at a larger error" if is_worse else "cures it"
    if changed.hunts:
        return "makes it hunt"
    return "worse" if is_worse else "better" if is_better else "no gain"


def find_cures(trial: Trial, prediction: Prediction) -> tuple[xr.Dataset, Advice, str]:
    """Try cures, with a ``verdict`` each, also gains from a grid of simulations if no others help; and advise."""
    cures = propose_cures(trial.loop, prediction, has_theory=trial.prediction is not None)
    ds = try_cures(trial, cures)
    if ds["hunts"][0] > 0.0 and not (ds["hunts"] == 0.0)[np.isin(ds["cure"], GAIN_CURES)].any():
        cures = with_simulated_gains(trial, cures)
        ds = try_cures(trial, cures)
    results = ds.assign(error=ds["rmse"].where(ds["status"] == STATUS_OK), hunts=ds["hunts"] > 0.0)
    names = ("cure", "words", "error", "motor_travel", "hunts", "hunting_index", "chatters", "hunting_swing")
    options = [Option(*row) for row in zip(*(results[name].values.tolist() for name in names), strict=True)]
    has_noise = float(trial.loop["noise_std"]) > 0.0  # type: ignore[arg-type]
    ds = ds.assign(verdict=("cure", [verdict(options[0], option, has_noise=has_noise) for option in options]))
    advice = advise(options, holds_set_point=not ds["share_off"][0] > LOST_SHARE, least_error=NOTICEABLE)
    decisive = list(dict.fromkeys([0, advice.best]))
    hunts = [options[k].hunts for k in decisive]
    return ds, advice, contradiction_by_converged_march(trial, [cures[k] for k in decisive], hunts)


def contradiction_by_converged_march(trial: Trial, cures: Sequence[Cure], hunts_as_printed: Sequence[bool]) -> str:
    """Say with which cures the converged march contradicts the printed one on hunting; empty with none."""
    loop = trial.loop.assign(converged=True)
    if loop["air_march"] == trial.loop["air_march"]:
        return ""
    hunts = try_cures(trial._replace(loop=loop, prediction=None), cures)["hunts"].values > 0.0
    clauses = [
        f"{cure.words}, it {'hunts' if converged else 'does not hunt'}"
        for cure, converged, as_printed in zip(cures, hunts, hunts_as_printed, strict=True)
        if converged != as_printed
    ]
    return f"The converged march says otherwise: {'; '.join(clauses)}.  Set converged = true." * bool(clauses)
