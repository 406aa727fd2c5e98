"""What to do about a loop, with numbers: the cures, tried by simulation, and the one source of every advice.

``cures_of`` proposes, ``try_cures`` simulates, ``advise`` chooses and says it; a diagnosis and a tuning give it options
of their own.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.text import kelvin, number, per_cent
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.design.prediction import Prediction, cycles_at, shortest_ti, simc_gains
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop, words_used
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import HUNTING_SWING, OFF, SETTLING_TIME, STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS, Scalar

UNSURE = (0.7, 1.0)  # margins between which theory does not decide
SAFE = 0.7  # margin that a cure has to reach
AS_IS, LOWER_KP, LONGER_TI, SIMC, SIMULATED, PI, NO_INVERSE, ACTION, DEAD_BAND, INVERSE, BOTH, REPAIRED = (
    "as_it_is", "lower_kp", "longer_ti", "simc", "simulated_gains", "pi", "no_inverse", "action", "dead_band",
    "inverse", "simc_and_inverse", "repaired_valve",
)  # fmt: skip
GAINS = (LOWER_KP, LONGER_TI, SIMC, SIMULATED)  # cures that change kp and ti alone
INVERSE_SHARE, BUFFER_RATIO, BUFFER_SWING = 0.95, 6.0, 0.1
"""Of an inverse with a buffer that goes with the noise; K of the last: what docs/findings/remedies.md recommends."""
LEAST_GAIN = 0.2  # smallest plant gain that the buffer may reckon with, K per stroke: the buffer has to stay below 1
DEAD_BAND_WIDTHS = (0.1, 0.5)  # least and most, K; as wide as the swing is high in between
_QUIET_DEAD_BAND = 0.25  # K, where nothing hunts
_FACTORS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4)  # of the kp that is tried where no gains of theory stop the hunting
_TIMES = (1.0, 2.0, 4.0, 8.0)  # of the ti that is tried with each


class Cure(NamedTuple):
    """What may be changed.  words: as a technician says it.  changes: parameter → value."""

    name: str
    words: str
    changes: Mapping[str, Scalar]


def _gains(name: str, kp: float, ti: float, words: str = "") -> Cure:
    return Cure(name, f"{words}kp {kp:g} 1/K, ti {ti:g} s", {"kp": kp, "ti": ti})


def cures_of(loop: Loop, prediction: Prediction, *, has_theory: bool) -> list[Cure]:
    """What to try on a loop, as it is first; ``prediction``: of it, or of the nearest for which theory holds."""
    kp, ti, backlash = (float(loop[name]) for name in ("kp", "ti", "backlash"))  # type: ignore[arg-type]
    turned = prediction.loop["action"] != loop["action"]
    found = [Cure(AS_IS, "as it is", {})]
    if prediction.margin > SAFE:
        found.append(_gains(LOWER_KP, _rounded(kp * SAFE / prediction.margin, down=True), ti))
        longer = shortest_ti(prediction, SAFE)
        if math.isfinite(longer):
            found.append(_gains(LONGER_TI, kp, _rounded(longer, down=False)))
    simc = simc_gains(prediction)
    if simc is not None:
        tuned = {"kp": _rounded(simc[0]), "ti": _rounded(simc[1])}
        margin = float(cycles_at(prediction.loop.assign(**tuned), prediction.plants, prediction.reached).margin.max())
        if SAFE < margin <= HUNTS_ABOVE:  # the lower kp would be advised next
            tuned["kp"] = _rounded(tuned["kp"] * SAFE / margin, down=True)
        found.append(_gains(SIMC, **tuned, words="SIMC: "))
    gains = found[-1].changes if simc is not None else {}
    other_law, plain = loop["law"] != "pi", without_inverse(loop)
    if gains and (other_law or plain):
        words, changes = ("the PI in place of this law", {"law": "pi"}) if other_law else ("no inverse", plain)
        found.append(Cure(PI, found[-1].words.replace("SIMC:", f"{words},"), {**changes, **gains}))
    if plain:
        found.append(Cure(NO_INVERSE, "no inverse", plain))
    band = _QUIET_DEAD_BAND
    if has_theory and prediction.hunting.size:  # as wide as the swing is high, to 0.05 K
        height = float(np.nanmax(prediction.cycles.amplitude[prediction.reached]))
        band = float(np.clip(math.ceil(round(height / 0.05, 6)) * 0.05, *DEAD_BAND_WIDTHS).round(2))
    if float(loop["error_dead_band"]) < band:  # type: ignore[arg-type]
        found.append(Cure(DEAD_BAND, f"error dead band of {band:g} K", {"error_dead_band": band}))
    if backlash > 0.0:
        if prediction.worst >= 0:
            gain = max(abs(float(prediction.plants.gain[prediction.worst])), LEAST_GAIN)
            inverse: dict[str, Scalar] = {
                **plain,
                "backlash_estimate": INVERSE_SHARE * backlash,
                "compensation": "inverse",
                "buffer_ratio": BUFFER_RATIO,
                "buffer_noise": "measured",
                "buffer_swing": BUFFER_SWING,
                "plant_gain": gain,
            }
            sizes = f"{per_cent(INVERSE_SHARE * backlash)}, buffer by noise up to {per_cent(BUFFER_SWING / gain)}"
            if not other_law:
                found.append(Cure(INVERSE, f"inverse of {sizes}", inverse))
            if gains:
                law = {"law": "pi"} if other_law else {}
                words = f"{'the PI' if other_law else 'SIMC'} and inverse of {sizes}"
                found.append(Cure(BOTH, words, {**gains, **inverse, **law}))
        # no gap, and whatever assumed one is off; a stem cannot stick without a gap in this model
        without = {"backlash": 0.0, "backlash_estimate": 0.0, "slip_jump": 0.0}
        found.append(Cure(REPAIRED, "valve repaired: no backlash", without))
    if turned:  # nothing works the wrong way round
        action = str(prediction.loop["action"])
        words, right = f"action = {action}", {"action": action}
        rest = [Cure(one.name, f"{words}, {one.words}", {**one.changes, **right}) for one in found[1:]]
        found = [found[0], Cure(ACTION, words, right), *rest]
    return found


def without_inverse(loop: Loop) -> dict[str, Scalar]:
    """What turns a compensation off; empty where there is none."""
    on = {"backlash_estimate": loop["backlash_estimate"], "learning_step": loop["learning_step"]}
    off: dict[str, Any] = {name: 0.0 for name, value in on.items() if value}
    if words_used(loop, "estimator") != {"none"}:
        off["estimator"] = "none"
    return off | {name: PARAMETERS[name].default for name in unread_values(loop.assign(**off))}


def _rounded(value: float, *, down: bool | None = None) -> float:
    """A number that somebody types into a controller: two digits, on the safe side if that is said."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    digits = value / scale
    whole = round(digits) if down is None else math.floor(digits + 1e-9) if down else math.ceil(digits - 1e-9)
    return float(f"{whole * scale:.6g}")


def with_cures(loop: Loop, cures: Sequence[Cure]) -> Loop:
    """The loop as a sweep along ``cure``."""
    changed = {}
    for name in dict.fromkeys(name for cure in cures for name in cure.changes):
        own = loop[name] if loop[name] is not None else PARAMETERS[name].default
        given = next(cure.changes[name] for cure in cures if name in cure.changes)
        changed[name] = ("cure", [cure.changes.get(name, given if own is None else own) for cure in cures])
    return loop.assign(**changed)


class Trial(NamedTuple):
    """A day on which cures are tried, and what theory knows of the loop, if it does."""

    loop: Loop
    boundary: Boundary
    points: PointsOfDay
    prediction: Prediction | None
    warm_up: int
    seed: int


_POINTS = 43200  # most samples of a trace: one every 2 s of a day
SEEN = 0.01  # temperature difference that counts, K
PLAIN = 1.5  # so many times as large a swing shows that a loop hunts here and not there
AS_PREDICTED = 0.7  # simulated over predicted swing from which the one counts as the other
TOO_LARGE, FEW_TURNS, BY_JUMPS = 1.02, 2.0, 1.0 / 3.0
"""A motor chatters with so large an estimate relative to the gap (an estimator finds it to a few thousandths), more
turns in 10 min than that, and so large a share of its travel in the jumps at the turns."""


def try_cures(trial: Trial, cures: Sequence[Cure]) -> xr.Dataset:
    """Simulate and predict every cure: metrics, the trace T_sup, the margin, and whether it hunts, over ``cure``.

    ``hunting`` is 1 where the day hunts after the metric ``hunts``, or for a part of it (see ``_hunts_in_part``).
    ``chatters`` is 1 where the motor turns again and again since the estimate is larger than the gap.
    ``swings`` is K at each operating point.
    """
    swept, boundary = with_cures(trial.loop, cures), trial.boundary
    ds = simulate(
        swept, boundary, traces=["T_sup"], trace_interval=max(2, -(-boundary.n_steps // _POINTS)),
        warm_up=trial.warm_up, seed=trial.seed, n_jobs=1, progress=False,
    )  # fmt: skip
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    ds = ds if "cure" in ds.dims else ds.expand_dims("cure")
    swings = swings_at(trial.points, boundary, ds)
    margin, hunting = np.full(len(cures), math.nan), ds["hunts"].values > 0.0
    if trial.prediction is not None:
        reached = trial.prediction.reached
        cycles = cycles_at(swept, trial.prediction.plants, reached)
        margin = cycles.margin.max(axis=1)
        parts = zip(swings[:, reached], cycles.hunts > 0.0, cycles.amplitude, strict=True)
        hunting |= [_hunts_in_part(*part) for part in parts]
    too_large = ds["estimate_settled"] > TOO_LARGE * ds["backlash_final"]
    jumps = ds["switch_frequency"] * (boundary.n_steps - trial.warm_up) / 600.0 * ds["estimate_settled"]
    chatters = too_large & (ds["switch_frequency"] > FEW_TURNS) & (jumps > BY_JUMPS * ds["motor_travel"])
    return ds.assign_coords(cure=[cure.name for cure in cures]).assign(
        words=("cure", [cure.words for cure in cures]),
        margin=("cure", margin, {"long_name": "largest describing-function margin, predicted"}),
        hunting=("cure", hunting.astype(float), {"long_name": "whether it hunts, at least for a part of the day"}),
        chatters=("cure", chatters.values.astype(float), {"long_name": "whether the motor chatters"}),
        swings=(("cure", "point"), swings, {"long_name": "simulated, peak to peak", "units": "K"}),
    )


def swings_at(points: PointsOfDay, boundary: Boundary, now: xr.Dataset) -> Array:
    """Simulated swing at each operating point, K, (…, n_points): max - min of T_sup in settled seconds; NaN without."""
    T_set = boundary.series["T_set"][0]
    seconds = np.arange(T_set.size)
    changed = np.maximum.accumulate(np.where(np.diff(T_set, prepend=T_set[0]) != 0.0, seconds, -SETTLING_TIME))
    settled = np.where(seconds - changed >= SETTLING_TIME, points.of_second, -1)
    of_second, T_sup = settled[now["elapsed_time"].values.astype(int)], now["T_sup"].values
    seen = [T_sup[..., of_second == k] for k in range(points.size)]
    return np.stack([np.ptp(T, axis=-1) if T.size else np.full(T.shape[:-1], np.nan) for T in seen], axis=-1)


def _hunts_in_part(swings: Array, predicted: Mask, amplitudes: Array) -> bool:
    """Whether a loop hunts although the metric does not count it, since it does at times only, or not regularly enough.

    At the operating points at which it is predicted to hunt, the simulated swings are, in the median, ``PLAIN`` times
    those elsewhere; or they are of the size predicted, ``AS_PREDICTED``, and above ``OFF``.
    """
    there, rest = _median(swings[predicted]), _median(swings[~predicted])
    expected = 2.0 * _median(amplitudes[predicted])
    return there > max(PLAIN * rest, HUNTING_SWING) or there > max(AS_PREDICTED * expected, OFF)


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan


def with_simulated_gains(trial: Trial, cures: list[Cure]) -> list[Cure]:
    """The cures, second the best kp and ti around those of SIMC that do not hunt, nor with the next larger kp."""
    own = {name: trial.loop[name] for name in ("kp", "ti")}
    start: Mapping[str, Any] = next((cure.changes for cure in cures if cure.name == SIMC), own)
    pairs = [[(start["kp"] * factor, start["ti"] * time) for factor in _FACTORS] for time in _TIMES]
    grid = [_gains(SIMULATED, _rounded(kp), _rounded(ti), "found by simulation: ") for row in pairs for kp, ti in row]
    ds = try_cures(trial, grid)
    shape = len(_TIMES), len(_FACTORS)
    calm = ((ds["hunting"] == 0.0) & (ds["status"] == STATUS_OK)).values.reshape(shape)
    calm[:, :-1] &= calm[:, 1:]
    calm[:, -1] = False
    error = np.where(calm, ds["rmse"].values.reshape(shape), np.inf).ravel()
    k = int(np.argmin(error))
    return [cures[0], grid[k], *cures[1:]] if math.isfinite(error[k]) else cures


class Option(NamedTuple):
    """What a loop does as it is, or with a change.  error: RMS, K; margin: of the describing function."""

    name: str
    words: str
    error: float
    travel: float
    hunts: bool
    margin: float = math.nan
    chatters: bool = False


class Advice(NamedTuple):
    """Which option to take, 0 for none, and the sentences that say so."""

    best: int
    text: str


WORSE, BETTER = 1.05, 0.95  # RMSE relative to now from which an option counts as worse, and up to which as better
_RANKS = {INVERSE: 1, BOTH: 1, DEAD_BAND: 3, REPAIRED: 4}
"""Settings of the PI come first, then what asks for the size of the gap, then (2) what is calm although its margin is
too large or its motor chatters; a dead band hides the swing, a repair is no setting."""


def advise(options: Sequence[Option], *, holds: bool = True, error: str = "RMSE", least: float = 0.0) -> Advice:
    """Choose an option and say so.

    Where the loop hunts or its motor chatters, the first rank with an option that does not, and its least error; where
    it does not, only what takes 5 % off the error.

    options: the loop as it is first.  holds: whether the loop holds its set-point as it is.  error: its name.  least:
    error that counts, K.
    """
    now = options[0]

    def rank(k: int) -> tuple[int, float]:
        of_name, one = _RANKS.get(options[k].name, 0), options[k]
        return (max(of_name, 2) if one.chatters or one.margin > HUNTS_ABOVE else of_name), one.error

    def effect(k: int, words: str = "") -> str:
        moved = f", motor travel × {number(options[k].travel / now.travel)}" if now.travel > 0.0 else ""
        doubt = f"  This day stays calm, but a margin of {options[k].margin:.2g} is above {HUNTS_ABOVE:g}."
        said = f"{words or options[k].words}: {error} {100 * (options[k].error / now.error - 1.0):+.0f} %{moved}."
        return said + doubt * (options[k].margin > HUNTS_ABOVE and rank(k)[0] == 2 and not options[k].hunts)

    trouble = "hunting" if now.hunts else "chatter" if now.chatters else ""

    def calm(one: Option) -> bool:
        return not one.hunts and (now.hunts or not one.chatters)

    able = [k for k, one in enumerate(options) if k and math.isfinite(one.error) and calm(one)]
    better = [k for k in able if options[k].error < BETTER * now.error]
    with_gap = [k for k in able if options[k].name in (INVERSE, BOTH)]
    known = "If the backlash is known to 5 %: "

    def then(best: int) -> str:
        k = min((k for k in with_gap if options[k].error < BETTER * options[best].error), key=rank, default=0)
        return f"  {known}{effect(k)}" if k and rank(best)[0] == 0 else ""

    if not trouble:
        if holds and now.error < least:
            return Advice(0, f"Leave it: its error is below {kelvin(least)}.")
        settings = [k for k in better if options[k].name not in (DEAD_BAND, REPAIRED)]
        best = min(settings, key=rank, default=0)
        if best:
            start = "Do this: " if not holds else known if best in with_gap else "If the error matters: "
            return Advice(best, f"{start}{effect(best)}{then(best)}")
        if not holds:
            return Advice(0, "None of these changes makes the loop hold its set-point.")
        words = {DEAD_BAND: "an error dead band would", REPAIRED: "a repaired valve would"}
        other = min(better, key=rank, default=0)
        ends = f"; {effect(other, words[options[other].name])}" if other else "."
        ends = " and stays calm" * any(one.error < BETTER * now.error and not calm(one) for one in options) + ends
        what = "gains" if options[other].name == DEAD_BAND else "settings"
        return Advice(0, f"Leave it: none of these {what} reduces the error by 5 %{ends}")
    best = min(able, key=rank, default=0)
    if not best:
        nearest = min(range(len(options)), key=lambda k: np.nan_to_num(options[k].error, nan=np.inf))
        ends = f"; least error: {effect(nearest)}" if nearest else "."
        return Advice(0, f"None of these stops the {trouble}{ends}")
    text = f"Do this: {effect(best)}{then(best)}"
    if options[best].name == DEAD_BAND:
        text += "  It only hides the swing: the margin, and any error within the band, remain."
    if options[best].name == REPAIRED:
        text += f"  None of these settings stops the {trouble}."
    return Advice(best, text)


def verdict(now: Option, then: Option) -> str:
    """What an option does, in a few words."""
    if not math.isfinite(then.error):
        return "failed"
    error = then.error / now.error if now.error else math.nan
    if not now.hunts:
        return "makes it hunt" if then.hunts else _compared(error)
    if then.hunts:
        return {"worse": "still hunts, and worse", "better": "still hunts, but less"}.get(
            _compared(error), "still hunts"
        )
    return "cures it, at a larger error" if error > WORSE else "cures it"


def _compared(error: float) -> str:
    return "worse" if error > WORSE else "better" if error < BETTER else "no gain"


LOST = 0.5  # share of the time off the set-point from which a loop does not hold it


def find_cures(trial: Trial, prediction: Prediction) -> tuple[xr.Dataset, Advice]:
    """``try_cures`` with ``verdict``, also gains that only simulation finds where no others help; and what to do."""
    cures = cures_of(trial.loop, prediction, has_theory=trial.prediction is not None)
    ds = try_cures(trial, cures)
    if ds["hunting"][0] and not (ds["hunting"] == 0.0)[np.isin(ds["cure"], GAINS)].any():
        ds = try_cures(trial, with_simulated_gains(trial, cures))
    tried = ds.assign(error=ds["rmse"].where(ds["status"] == STATUS_OK), hunts=ds["hunting"] > 0.0)
    names = ("cure", "words", "error", "motor_travel", "hunts", "margin", "chatters")
    options = [Option(*row) for row in zip(*(tried[name].values.tolist() for name in names), strict=True)]
    ds = ds.assign(verdict=("cure", [verdict(options[0], option) for option in options]))
    return ds, advise(options, holds=not ds["share_off"][0] > LOST, least=SEEN)
