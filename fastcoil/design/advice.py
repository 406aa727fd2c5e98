"""What to do about a loop, with numbers: the cures, tried by simulation, and the one source of every advice.

``propose_cures`` proposes, ``try_cures`` simulates, ``advise`` chooses and says it; a diagnosis and a tuning give it options
of their own.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.text import format_kelvin, format_percent, format_two_digits
from fastcoil.design.limit_cycle import HUNTING_MARGIN
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.design.prediction import Prediction, predict_cycles_at, shortest_ti, simc_gains
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import HUNTING_SWING_K, OFF_SET_POINT_ERROR_K, SETTLING_TIME_S, STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS, Scalar

UNSURE_MARGINS = (0.7, 1.0)  # margins between which theory does not decide
SAFE_MARGIN = 0.7  # hunting index that a cure has to reach
AS_IS, LOWER_KP, LONGER_TI, SIMC, SIMULATED_GAINS, PLAIN_PI, NO_INVERSE, TURNED_ACTION, DEAD_BAND, INVERSE, SIMC_AND_INVERSE, REPAIRED_VALVE = (
    "as_it_is", "lower_kp", "longer_ti", "simc", "simulated_gains", "pi", "no_inverse", "action", "dead_band",
    "inverse", "simc_and_inverse", "repaired_valve",
)  # fmt: skip
GAIN_CURES = (LOWER_KP, LONGER_TI, SIMC, SIMULATED_GAINS)  # cures that change kp and ti alone
INVERSE_ESTIMATE_SHARE, BUFFER_RATIO, BUFFER_SWING = 0.95, 6.0, 0.1
"""Of an inverse with a buffer that goes with the noise; K of the last: what docs/findings/remedies.md recommends."""
LEAST_PLANT_GAIN = (
    0.2  # smallest plant gain that the buffer may reckon with, K per stroke: the buffer has to stay below 1
)
DEAD_BAND_WIDTHS = (0.1, 0.5)  # least and most, K; as wide as the swing is high in between
_DEAD_BAND_WITHOUT_HUNTING = 0.25  # K, where nothing hunts
_KP_FACTORS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4)  # of the kp that is tried where no gains of theory stop the hunting
_TI_FACTORS = (1.0, 2.0, 4.0, 8.0)  # of the ti that is tried with each


class Cure(NamedTuple):
    """What may be changed.  words: as a technician says it.  changes: parameter → value."""

    name: str
    words: str
    changes: Mapping[str, Scalar]


def _gains_cure(name: str, kp: float, ti: float, words: str = "") -> Cure:
    return Cure(name, f"{words}kp {kp:g} 1/K, ti {ti:g} s", {"kp": kp, "ti": ti})


def propose_cures(loop: Loop, prediction: Prediction, *, has_theory: bool) -> list[Cure]:
    """What to try on a loop, as it is first; ``prediction``: of it, or of the nearest for which theory holds."""
    kp, ti, backlash = (float(loop[name]) for name in ("kp", "ti", "backlash"))  # type: ignore[arg-type]
    acts_backwards = prediction.loop["action"] != loop["action"]
    cures = [Cure(AS_IS, "as it is", {})]
    if prediction.hunting_index > SAFE_MARGIN:
        cures.append(
            _gains_cure(LOWER_KP, _round_setting(kp * SAFE_MARGIN / prediction.hunting_index, round_down=True), ti)
        )
        safe_ti = shortest_ti(prediction, SAFE_MARGIN)
        if math.isfinite(safe_ti):
            cures.append(_gains_cure(LONGER_TI, kp, _round_setting(safe_ti, round_down=False)))
    simc = simc_gains(prediction)
    if simc is not None:
        simc_changes = {"kp": _round_setting(simc[0]), "ti": _round_setting(simc[1])}
        hunting_index = float(
            predict_cycles_at(
                prediction.loop.assign(**simc_changes), prediction.plants, prediction.reached
            ).hunting_index.max()
        )
        if SAFE_MARGIN < hunting_index <= HUNTING_MARGIN:  # the lower kp would be advised next
            simc_changes["kp"] = _round_setting(simc_changes["kp"] * SAFE_MARGIN / hunting_index, round_down=True)
        cures.append(_gains_cure(SIMC, **simc_changes, words="SIMC: "))
    gain_changes = cures[-1].changes if simc is not None else {}
    has_other_law, plain_changes = loop["law"] != "pi", inverse_off_changes(loop)
    if gain_changes and (has_other_law or plain_changes):
        words, changes = (
            ("the PI in place of this law", {"law": "pi"}) if has_other_law else ("no inverse", plain_changes)
        )
        cures.append(Cure(PLAIN_PI, cures[-1].words.replace("SIMC:", f"{words},"), {**changes, **gain_changes}))
    if plain_changes:
        cures.append(Cure(NO_INVERSE, "no inverse", plain_changes))
    band_width = _DEAD_BAND_WITHOUT_HUNTING
    if has_theory and prediction.hunting.size:  # as wide as the swing is high, to 0.05 K
        height = float(np.nanmax(prediction.cycles.amplitude[prediction.reached]))
        band_width = float(np.clip(math.ceil(round(height / 0.05, 6)) * 0.05, *DEAD_BAND_WIDTHS).round(2))
    if float(loop["error_dead_band"]) < band_width:  # type: ignore[arg-type]
        cures.append(Cure(DEAD_BAND, f"error dead band of {band_width:g} K", {"error_dead_band": band_width}))
    if backlash > 0.0:
        if prediction.worst_point >= 0:
            gain = max(abs(float(prediction.plants.gain[prediction.worst_point])), LEAST_PLANT_GAIN)
            inverse_changes: dict[str, Scalar] = {
                **plain_changes,
                "backlash_estimate": INVERSE_ESTIMATE_SHARE * backlash,
                "compensation": "inverse",
                "buffer_ratio": BUFFER_RATIO,
                "buffer_noise": "measured",
                "buffer_swing": BUFFER_SWING,
                "plant_gain": gain,
            }
            sizes_text = f"{format_percent(INVERSE_ESTIMATE_SHARE * backlash)}, buffer by noise up to {format_percent(BUFFER_SWING / gain)}"
            if not has_other_law:
                cures.append(Cure(INVERSE, f"inverse of {sizes_text}", inverse_changes))
            if gain_changes:
                law_change = {"law": "pi"} if has_other_law else {}
                words = f"{'the PI' if has_other_law else 'SIMC'} and inverse of {sizes_text}"
                cures.append(Cure(SIMC_AND_INVERSE, words, {**gain_changes, **inverse_changes, **law_change}))
        # no gap, and whatever assumed one is off; a stem cannot stick without a gap in this model
        repair_changes = {"backlash": 0.0, "backlash_estimate": 0.0, "slip_jump": 0.0}
        cures.append(Cure(REPAIRED_VALVE, "valve repaired: no backlash", repair_changes))
    if acts_backwards:  # nothing works the wrong way round
        action = str(prediction.loop["action"])
        words, action_change = f"action = {action}", {"action": action}
        turned_cures = [
            Cure(cure.name, f"{words}, {cure.words}", {**cure.changes, **action_change}) for cure in cures[1:]
        ]
        cures = [cures[0], Cure(TURNED_ACTION, words, action_change), *turned_cures]
    return cures


def inverse_off_changes(loop: Loop) -> dict[str, Scalar]:
    """What turns a compensation off; empty where there is none."""
    active_values = {"backlash_estimate": loop["backlash_estimate"], "learning_step": loop["learning_step"]}
    changes: dict[str, Any] = {name: 0.0 for name, value in active_values.items() if value}
    if used_choices(loop, "estimator") != {"none"}:
        changes["estimator"] = "none"
    return changes | {name: PARAMETERS[name].default for name in unread_values(loop.assign(**changes))}


def _round_setting(value: float, *, round_down: bool | None = None) -> float:
    """A number that somebody types into a controller: two digits, on the safe side if that is said."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    digits = value / scale
    rounded = (
        round(digits) if round_down is None else math.floor(digits + 1e-9) if round_down else math.ceil(digits - 1e-9)
    )
    return float(f"{rounded * scale:.6g}")


def sweep_cures(loop: Loop, cures: Sequence[Cure]) -> Loop:
    """The loop as a sweep along ``cure``."""
    swept_values = {}
    for name in dict.fromkeys(name for cure in cures for name in cure.changes):
        current_value = loop[name] if loop[name] is not None else PARAMETERS[name].default
        fallback = next(cure.changes[name] for cure in cures if name in cure.changes)
        swept_values[name] = (
            "cure",
            [cure.changes.get(name, fallback if current_value is None else current_value) for cure in cures],
        )
    return loop.assign(**swept_values)


class Trial(NamedTuple):
    """A day on which cures are tried, and what theory knows of the loop, if it does."""

    loop: Loop
    boundary: Boundary
    points: PointsOfDay
    prediction: Prediction | None
    warm_up: int
    seed: int


_MOST_SAMPLES = 43200  # most samples of a trace: one every 2 s of a day
NOTICEABLE_DIFFERENCE = 0.01  # temperature difference that counts, K
CLEAR_SWING_RATIO = 1.5  # so many times as large a swing shows that a loop hunts here and not there
PREDICTED_SWING_RATIO = 0.7  # simulated over predicted swing from which the one counts as the other
TOO_LARGE_ESTIMATE_RATIO, MOST_CALM_TURNS, CHATTER_JUMP_SHARE = 1.02, 2.0, 1.0 / 3.0
"""A motor chatters with so large an estimate relative to the gap (an estimator finds it to a few thousandths), more
turns in 10 min than that, and so large a share of its travel in the jumps at the turns."""


def try_cures(trial: Trial, cures: Sequence[Cure]) -> xr.Dataset:
    """Simulate and predict every cure: metrics, the trace T_sup, the hunting index, and whether it hunts, over ``cure``.

    ``hunting`` is 1 where the day hunts after the metric ``hunts``, or for a part of it (see ``_is_hunting_in_part``).
    ``chatters`` is 1 where the motor turns again and again since the estimate is larger than the gap.
    ``swings`` is K at each operating point.
    """
    swept, boundary = sweep_cures(trial.loop, cures), trial.boundary
    ds = simulate(
        swept, boundary, traces=["T_sup"], trace_interval=max(2, -(-boundary.n_steps // _MOST_SAMPLES)),
        warm_up=trial.warm_up, seed=trial.seed, n_jobs=1, progress=False,
    )  # fmt: skip
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    ds = ds if "cure" in ds.dims else ds.expand_dims("cure")
    swings = simulated_swings(trial.points, boundary, ds)
    hunting_index, hunting = np.full(len(cures), math.nan), ds["hunts"].values > 0.0
    if trial.prediction is not None:
        reached = trial.prediction.reached
        cycles = predict_cycles_at(swept, trial.prediction.plants, reached)
        hunting_index = cycles.hunting_index.max(axis=1)
        points_of_cures = zip(swings[:, reached], cycles.hunts > 0.0, cycles.amplitude, strict=True)
        hunting |= [_is_hunting_in_part(*part) for part in points_of_cures]
    too_large = ds["estimate_settled"] > TOO_LARGE_ESTIMATE_RATIO * ds["backlash_final"]
    jump_travel = ds["switch_frequency"] * (boundary.n_steps - trial.warm_up) / 600.0 * ds["estimate_settled"]
    chatters = (
        too_large & (ds["switch_frequency"] > MOST_CALM_TURNS) & (jump_travel > CHATTER_JUMP_SHARE * ds["motor_travel"])
    )
    return ds.assign_coords(cure=[cure.name for cure in cures]).assign(
        words=("cure", [cure.words for cure in cures]),
        hunting_index=("cure", hunting_index, {"long_name": "largest describing-function hunting index, predicted"}),
        hunting=("cure", hunting.astype(float), {"long_name": "whether it hunts, at least for a part of the day"}),
        chatters=("cure", chatters.values.astype(float), {"long_name": "whether the motor chatters"}),
        swings=(("cure", "point"), swings, {"long_name": "simulated, peak to peak", "units": "K"}),
    )


def simulated_swings(points: PointsOfDay, boundary: Boundary, simulated: xr.Dataset) -> Array:
    """Simulated swing at each operating point, K, (…, n_points): max - min of T_sup in settled seconds; NaN without."""
    T_set = boundary.series["T_set"][0]
    seconds = np.arange(T_set.size)
    last_change = np.maximum.accumulate(np.where(np.diff(T_set, prepend=T_set[0]) != 0.0, seconds, -SETTLING_TIME_S))
    settled_point = np.where(seconds - last_change >= SETTLING_TIME_S, points.point_of_second, -1)
    point_of_second, T_sup = settled_point[simulated["elapsed_time"].values.astype(int)], simulated["T_sup"].values
    point_temperatures = [T_sup[..., point_of_second == k] for k in range(points.size)]
    return np.stack(
        [np.ptp(T, axis=-1) if T.size else np.full(T.shape[:-1], np.nan) for T in point_temperatures], axis=-1
    )


def _is_hunting_in_part(swings: Array, is_predicted: Mask, amplitudes: Array) -> bool:
    """Whether a loop hunts although the metric does not count it, since it does at times only, or not regularly enough.

    At the operating points at which it is predicted to hunt, the simulated swings are, in the median, ``PLAIN`` times
    those elsewhere; or they are of the size predicted, ``PREDICTED_SWING_RATIO``, and above ``OFF``.
    """
    predicted_swing, other_swing = _finite_median(swings[is_predicted]), _finite_median(swings[~is_predicted])
    expected_swing = 2.0 * _finite_median(amplitudes[is_predicted])
    return predicted_swing > max(CLEAR_SWING_RATIO * other_swing, HUNTING_SWING_K) or predicted_swing > max(
        PREDICTED_SWING_RATIO * expected_swing, OFF_SET_POINT_ERROR_K
    )


def _finite_median(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan


def with_simulated_gains(trial: Trial, cures: list[Cure]) -> list[Cure]:
    """The cures, second the best kp and ti around those of SIMC that do not hunt, nor with the next larger kp."""
    current_gains = {name: trial.loop[name] for name in ("kp", "ti")}
    start: Mapping[str, Any] = next((cure.changes for cure in cures if cure.name == SIMC), current_gains)
    pairs = [
        [(start["kp"] * kp_factor, start["ti"] * ti_factor) for kp_factor in _KP_FACTORS] for ti_factor in _TI_FACTORS
    ]
    grid = [
        _gains_cure(SIMULATED_GAINS, _round_setting(kp), _round_setting(ti), "found by simulation: ")
        for row in pairs
        for kp, ti in row
    ]
    ds = try_cures(trial, grid)
    shape = len(_TI_FACTORS), len(_KP_FACTORS)
    is_calm = ((ds["hunting"] == 0.0) & (ds["status"] == STATUS_OK)).values.reshape(shape)
    is_calm[:, :-1] &= is_calm[:, 1:]
    is_calm[:, -1] = False
    error = np.where(is_calm, ds["rmse"].values.reshape(shape), np.inf).ravel()
    k = int(np.argmin(error))
    return [cures[0], grid[k], *cures[1:]] if math.isfinite(error[k]) else cures


class Option(NamedTuple):
    """What a loop does as it is, or with a change.  error: RMS, K; hunting index: of the describing function."""

    name: str
    words: str
    error: float
    travel: float
    hunts: bool
    hunting_index: float = math.nan
    chatters: bool = False


class Advice(NamedTuple):
    """Which option to take, 0 for none, and the sentences that say so."""

    best: int
    text: str


WORSE_ERROR_RATIO, BETTER_ERROR_RATIO = (
    1.05,
    0.95,
)  # RMSE relative to now from which an option counts as worse, and up to which as better
_CURE_RANKS = {INVERSE: 1, SIMC_AND_INVERSE: 1, DEAD_BAND: 3, REPAIRED_VALVE: 4}
"""Settings of the PI come first, then what asks for the size of the gap, then (2) what is calm although its hunting index is
too large or its motor chatters; a dead band hides the swing, a repair is no setting."""


def advise(
    options: Sequence[Option], *, holds_set_point: bool = True, error_name: str = "RMSE", least_error: float = 0.0
) -> Advice:
    """Choose an option and say so.

    Where the loop hunts or its motor chatters, the first rank with an option that does not, and its least error; where
    it does not, only what takes 5 % off the error.

    options: the loop as it is first.  holds: whether the loop holds its set-point as it is.  error: its name.  least:
    error that counts, K.
    """
    current = options[0]

    def rank(k: int) -> tuple[int, float]:
        cure_rank, option = _CURE_RANKS.get(options[k].name, 0), options[k]
        return (
            max(cure_rank, 2) if option.chatters or option.hunting_index > HUNTING_MARGIN else cure_rank
        ), option.error

    def describe_option(k: int, words: str = "") -> str:
        travel_text = (
            f", motor travel × {format_two_digits(options[k].travel / current.travel)}" if current.travel > 0.0 else ""
        )
        margin_warning = (
            f"  This day stays calm, but a hunting index of {options[k].hunting_index:.2g} is above {HUNTING_MARGIN:g}."
        )
        sentence = f"{words or options[k].words}: {error_name} {100 * (options[k].error / current.error - 1.0):+.0f} %{travel_text}."
        return sentence + margin_warning * (
            options[k].hunting_index > HUNTING_MARGIN and rank(k)[0] == 2 and not options[k].hunts
        )

    trouble = "hunting" if current.hunts else "chatter" if current.chatters else ""

    def is_calm(option: Option) -> bool:
        return not option.hunts and (current.hunts or not option.chatters)

    calm_options = [k for k, option in enumerate(options) if k and math.isfinite(option.error) and is_calm(option)]
    better = [k for k in calm_options if options[k].error < BETTER_ERROR_RATIO * current.error]
    inverse_options = [k for k in calm_options if options[k].name in (INVERSE, SIMC_AND_INVERSE)]
    if_known = "If the backlash is known to 5 %: "

    def describe_inverse(best: int) -> str:
        k = min(
            (k for k in inverse_options if options[k].error < BETTER_ERROR_RATIO * options[best].error),
            key=rank,
            default=0,
        )
        return f"  {if_known}{describe_option(k)}" if k and rank(best)[0] == 0 else ""

    if not trouble:
        if holds_set_point and current.error < least_error:
            return Advice(0, f"Leave it: its error is below {format_kelvin(least_error)}.")
        settings = [k for k in better if options[k].name not in (DEAD_BAND, REPAIRED_VALVE)]
        best = min(settings, key=rank, default=0)
        if best:
            start = (
                "Do this: "
                if not holds_set_point
                else if_known
                if best in inverse_options
                else "If the error matters: "
            )
            return Advice(best, f"{start}{describe_option(best)}{describe_inverse(best)}")
        if not holds_set_point:
            return Advice(0, "None of these changes makes the loop hold its set-point.")
        words = {DEAD_BAND: "an error dead band would", REPAIRED_VALVE: "a repaired valve would"}
        alternative = min(better, key=rank, default=0)
        ends = f"; {describe_option(alternative, words[options[alternative].name])}" if alternative else "."
        ends = (
            " and stays calm"
            * any(option.error < BETTER_ERROR_RATIO * current.error and not is_calm(option) for option in options)
            + ends
        )
        what = "gains" if options[alternative].name == DEAD_BAND else "settings"
        return Advice(0, f"Leave it: none of these {what} reduces the error by 5 %{ends}")
    best = min(calm_options, key=rank, default=0)
    if not best:
        least_wrong = min(range(len(options)), key=lambda k: np.nan_to_num(options[k].error, nan=np.inf))
        ends = f"; least error: {describe_option(least_wrong)}" if least_wrong else "."
        return Advice(0, f"None of these stops the {trouble}{ends}")
    text = f"Do this: {describe_option(best)}{describe_inverse(best)}"
    if options[best].name == DEAD_BAND:
        text += "  It only hides the swing: the hunting index, and any error within the band, remain."
    if options[best].name == REPAIRED_VALVE:
        text += f"  None of these settings stops the {trouble}."
    return Advice(best, text)


def verdict(current: Option, changed: Option) -> str:
    """What an option does, in a few words."""
    if not math.isfinite(changed.error):
        return "failed"
    error_ratio = changed.error / current.error if current.error else math.nan
    if not current.hunts:
        return "makes it hunt" if changed.hunts else _compare_errors(error_ratio)
    if changed.hunts:
        return {"worse": "still hunts, and worse", "better": "still hunts, but less"}.get(
            _compare_errors(error_ratio), "still hunts"
        )
    return "cures it, at a larger error" if error_ratio > WORSE_ERROR_RATIO else "cures it"


def _compare_errors(error_ratio: float) -> str:
    return "worse" if error_ratio > WORSE_ERROR_RATIO else "better" if error_ratio < BETTER_ERROR_RATIO else "no gain"


LOST_SHARE = 0.5  # share of the time off the set-point from which a loop does not hold it


def find_cures(trial: Trial, prediction: Prediction) -> tuple[xr.Dataset, Advice]:
    """``try_cures`` with ``verdict``, also gains that only simulation finds where no others help; and what to do."""
    cures = propose_cures(trial.loop, prediction, has_theory=trial.prediction is not None)
    ds = try_cures(trial, cures)
    if ds["hunting"][0] and not (ds["hunting"] == 0.0)[np.isin(ds["cure"], GAIN_CURES)].any():
        ds = try_cures(trial, with_simulated_gains(trial, cures))
    results = ds.assign(error=ds["rmse"].where(ds["status"] == STATUS_OK), hunts=ds["hunting"] > 0.0)
    names = ("cure", "words", "error", "motor_travel", "hunts", "hunting_index", "chatters")
    options = [Option(*row) for row in zip(*(results[name].values.tolist() for name in names), strict=True)]
    ds = ds.assign(verdict=("cure", [verdict(options[0], option) for option in options]))
    return ds, advise(options, holds_set_point=not ds["share_off"][0] > LOST_SHARE, least_error=NOTICEABLE_DIFFERENCE)
