"""What is refused before anything runs: parameters that clash, unstable coils; warned of: days that do not suit.

Stability is that of the explicit scheme of Eq (3) at dt = 1 s / substeps.  Every temperature stays a weighted mean of
its neighbours, and nothing overshoots, exactly if γ ≤ 1 and λ ≤ 1 in every control volume (γ: Courant number of the
water, λ: rate of the metal).
"""

import warnings
from collections.abc import Iterator

import numpy as np
import xarray as xr

from fastcoil.base.arguments import raise_problems
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.presets import COOLING_PRESETS
from fastcoil.loops.scenarios import Layout
from fastcoil.model import moist_air
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.plant import stability_numbers
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.parameter_table import ESTIMATOR_GROUPS, PARAMETERS, STAND_INS
from fastcoil.model.valve_test import LARGEST_RATE_RATIO

SET_POINT_TOLERANCE_K = 1.0
"""Set-points that lie closer together than this count as one, K: a record of a constant one drifts and has steps."""
_CAP_PARAMETERS = {"learner": "learning_cap", "gradient": "gradient_cap"}
"""The parameter that limits the estimate of an estimator."""


def check_clashes(loop: Loop, T_set: Array, least_scale: float = 1.0) -> None:
    """Refuse values that only clash together; ``T_set``: all set-points, °C; ``least_scale``: of the backlash."""
    unused_rules = [rule for rule in loop.rules.values() if rule.name not in used_choices(loop, rule.kind)]
    problems = [
        *_size_clashes(loop, least_scale),
        *_unread_by_estimators(loop).values(),
        *(
            f"{rule.name}, which no scenario has, alone reads {' and '.join(rule.own)}: give {rule.kind} = "
            f"{rule.name!r}, or leave them out"
            for rule in unused_rules
        ),
        *missing_parameters(loop),
        *controller_clashes(loop, T_set),
    ]
    raise_problems(problems)


def missing_parameters(loop: Loop) -> list[str]:
    """Parameters that an estimator or a rule reads and that the loop does not give, a sentence each."""
    used = used_choices(loop, "estimator")
    problems = [
        f"estimator = {estimator.name!r} without {name}: give the {PARAMETERS[name].text} "
        f"({PARAMETERS[name].unit}, {PARAMETERS[name].bounds})"
        for estimator in ESTIMATORS
        if estimator is not None and estimator.name in used
        for name in estimator.Parameters._fields
        if name not in STAND_INS and PARAMETERS[name].default is None and loop[name] is None
    ]
    return problems + [
        f"{rule.name} reads {name}, which the loop does not give: give {name}"
        for rule in loop.rules.values()
        for name in rule.reads
        if loop[name] is None
    ]


def controller_clashes(loop: Loop, T_set: Array) -> list[str]:
    """Clashes within the controller, a sentence each.  T_set: all its set-points, °C."""
    problems = [*_unread_by_controller(loop).values(), *_buffer_clashes(loop), *_test_clashes(loop)]
    dead_band, set_point_range = (
        float(np.max(np.asarray(loop["error_dead_band"]))),
        float(np.max(T_set) - np.min(T_set)),
    )
    if SET_POINT_TOLERANCE_K <= set_point_range <= dead_band:
        effect = f"set-points within {set_point_range:g} K would not move the valve"
        problems.append(f"error_dead_band = {dead_band:g} K: {effect}, give less")
    return problems


def unread_values(loop: Loop) -> dict[str, str]:
    """Parameters that differ from their defaults and that no scenario reads, with the sentences that refuse them."""
    return _unread_by_estimators(loop) | _unread_by_controller(loop)


def _parameter_arrays(loop: Loop, *names: str) -> list[xr.DataArray]:
    """The values of parameters, which then broadcast against each other by their dims."""
    return [xr.DataArray(loop[name]) for name in names]


def _size_clashes(loop: Loop, least_scale: float) -> Iterator[str]:
    """An estimate of 1 or above its cap, a learner without a step or reference, a jump of the stem above its gap."""
    if loop["estimate_ratio"] is None:
        (estimate,) = _parameter_arrays(loop, "backlash_estimate")
    else:
        ratio, backlash = _parameter_arrays(loop, "estimate_ratio", "backlash")
        estimate = ratio * backlash
    largest = float(estimate.max())
    if largest >= 1.0:
        yield f"estimate_ratio × backlash reaches {largest:g}: an estimate must stay below 1, lower one of them"
    used = used_choices(loop, "estimator")
    step, error_ratio, reference = _parameter_arrays(
        loop, "learning_step", "learning_error_ratio", "learning_reference"
    )
    learns = (step > 0.0) if loop["estimator"] is None else xr.DataArray(loop["estimator"]) == "learner"
    for name, cap_name in _CAP_PARAMETERS.items():
        has_estimator = learns if name == "learner" else xr.DataArray(loop["estimator"]) == name
        if name in used and (has_estimator & (estimate > xr.DataArray(loop[cap_name]))).any():
            yield f"backlash_estimate up to {largest:g}: it cannot start above {cap_name}, lower it or raise {cap_name}"
    if "learner" in used and (learns & (step == 0.0)).any():
        yield "estimator = 'learner' with learning_step = 0: give the step by which it changes its estimate"
    if (error_ratio > 0.0).any() and ((error_ratio > 0.0) & (reference == 0.0)).any():
        yield "learning_error_ratio without learning_reference: give the number of intervals of which it is the mean"
    jump, backlash = _parameter_arrays(loop, "slip_jump", "backlash")
    smallest_scale = min(least_scale, 1.0)
    if (jump > 0.0).any() and (excess := float((jump - smallest_scale * backlash).where(jump > 0.0, 0.0).max())) > 0.0:
        scaled = "" if smallest_scale == 1.0 else f", which backlash_scale makes {smallest_scale:g} times as large"
        yield f"slip_jump is up to {excess:g} above the backlash{scaled}: lower slip_jump or raise backlash"


def _unread_by_estimators(loop: Loop) -> dict[str, str]:
    used = {"learner"} if loop["estimator"] is None else used_choices(loop, "estimator")
    unread = {
        p.name: f"{p.name} belongs to the estimator {p.group}, which no scenario has: give estimator = {p.group!r}, or "
        f"leave {p.name} out"
        for p in PARAMETERS.values()
        if p.group in ESTIMATOR_GROUPS and p.group not in used and _is_changed(loop, p.name)
    }
    if _is_changed(loop, "estimate_share") and used <= {"none"}:
        unread["estimate_share"] = "estimate_share without an estimator: give estimator, or leave estimate_share out"
    return unread


def _unread_by_controller(loop: Loop) -> dict[str, str]:
    ratio, noise, swing, law = _parameter_arrays(loop, "buffer_ratio", "buffer_noise", "buffer_swing", "compensation")
    is_rate_changed = xr.DataArray(_is_changed(loop, "smooth_rate"))
    readers = {  # where a value is given, where it is read, and what reads it
        "buffer_noise": (noise == "measured", ratio > 0.0, "buffer_noise = 'measured' without buffer_ratio"),
        "buffer_swing": (swing > 0.0, ratio > 0.0, "buffer_swing without buffer_ratio"),
        "smooth_rate": (is_rate_changed, law == "smooth", "smooth_rate without compensation = 'smooth'"),
    }
    return {
        name: f"{text}: give {'that word' if name == 'smooth_rate' else 'buffer_ratio'}, or leave {name} out"
        for name, (is_given, is_read, text) in readers.items()
        if is_given.any() and not (is_given & is_read).any()
    }


def _buffer_clashes(loop: Loop) -> list[str]:
    ratio, swing, noise_source, kp, noise = _parameter_arrays(
        loop, "buffer_ratio", "buffer_swing", "buffer_noise", "kp", "noise_std"
    )
    if not (ratio > 0.0).any() and not (swing > 0.0).any():
        return []
    is_measured, gain = noise_source == "measured", loop["plant_gain"]
    problems = []
    if (is_measured & (ratio > 0.0) & (swing == 0.0)).any():  # a loop that rings looks like noise
        problems = ["buffer_noise = 'measured' without buffer_swing: give buffer_swing and plant_gain, which limit it"]
    if gain is None and (swing > 0.0).any():
        problems.append("buffer_swing without plant_gain: give plant_gain, by which the swing limits the buffer")
    if problems:
        return problems
    # measured noise has no upper bound: the swing alone limits the buffer
    buffer = (ratio * abs(kp) * noise.where(~is_measured, np.inf)).where(ratio > 0.0, 0.0)
    if gain is not None:
        buffer_limit = swing / xr.DataArray(gain)
        buffer = buffer.where((swing == 0.0) | (buffer < buffer_limit), buffer_limit)
        if (is_measured & (buffer >= 1.0)).any():
            largest = float(buffer_limit.where(is_measured).max())
            return [f"buffer_swing / plant_gain reaches {largest:g}: a buffer must stay below 1, lower buffer_swing"]
    largest = float(buffer.max())
    text = f"buffer_ratio × kp × noise_std reaches {largest:g}: a buffer must stay below 1, lower one"
    return [text] if largest >= 1.0 else []


def _test_clashes(loop: Loop) -> Iterator[str]:
    """A valve test that never starts, with another law, or with ramps that the motor cannot follow."""
    if loop["test_start"] is None:
        changed_names = [p.name for p in PARAMETERS.values() if p.group == "test" and _is_changed(loop, p.name)]
        if changed_names:
            yield f"{' and '.join(changed_names)} without test_start: give the time at which the valve test starts"
        return
    if used_choices(loop, "law") != {"pi"}:
        yield "test_start with a law of your own: a valve test hands back to the PI, leave one out"
    rate, stroke_time = _parameter_arrays(loop, "test_rate", "stroke_time")
    if (LARGEST_RATE_RATIO * rate * stroke_time >= 1.0).any():
        yield (
            f"test_rate = {float(rate.max()):g} 1/s: ramps take up to {LARGEST_RATE_RATIO:g} times that, and a motor of "
            f"{float(stroke_time.max()):g} s for its stroke is slower, give a lower rate"
        )


def check_test_times(loop: Loop, seconds: int, *, closed: bool) -> None:
    """Refuse a valve test that ends after ``seconds``, or in an open loop; warn of one that starts after them."""
    if loop["test_start"] is None:
        return
    if not closed:
        raise InputError("test_start with a command: a valve test commands the valve itself, leave one out")
    starts, minutes = _parameter_arrays(loop, "test_start", "test_minutes")
    is_late = starts >= seconds
    if is_late.any():
        warnings.warn(
            f"test_start = {float(starts.max()):g} s: the simulation ends at {seconds:,} s, there is no test",
            stacklevel=5,
        )
    ends = (starts + 60.0 * minutes).where(~is_late, 0.0)
    if (ends > seconds).any():
        times_text = f"the valve test would end at {float(ends.max()):,g} s, the simulation ends at {seconds:,} s"
        raise InputError(f"{times_text}: start it earlier, or give a longer day")


def _is_changed(loop: Loop, name: str) -> bool:
    """Whether some scenario has another value than the default."""
    value = loop[name]
    return value is not None and bool(np.any(np.asarray(value) != PARAMETERS[name].default))


HOT_WATER_EXCESS_K = (
    35.0  # water that much warmer than the air, K, changes it at least twice as much per stroke as chilled water does
)
MIST_RELATIVE_HUMIDITY = 1.05  # relative humidity up to which air may be mist, or readings may be rounded
IDLE_MARGIN_K = 10.0  # air that is always so much beyond its set-point, K, leaves a loop nothing to do


def warn_mismatch(loop: Loop, boundary: Boundary, *, closed: bool = True) -> None:
    """Warn where loop and days do not suit each other.  closed: the controller is on, its action and gains count."""
    for mismatch in _mismatches(loop, boundary) if closed else ():
        warnings.warn(mismatch, stacklevel=5)
    pressure = float(np.max(np.asarray(loop["pressure"])))
    humidity_per_pressure, sample = boundary.dampest
    if humidity_per_pressure * pressure > MIST_RELATIVE_HUMIDITY:
        warnings.warn(
            f"{sample} is a relative humidity of {humidity_per_pressure * pressure:.0%} at {pressure:.6g} Pa: check the units of both, "
            "or give the loop the pressure of the place",
            stacklevel=5,
        )


def warn_saturated(loop: Loop, ds: xr.Dataset) -> None:
    """Warn of an own estimator whose estimate ends at its limit, as one in per cent does."""
    rule_names = [name for name, rule in loop.rules.items() if rule.kind == "estimator"]
    n_saturated = int((ds["estimate_final"] == 1.0).sum()) if rule_names and "estimate_final" in ds else 0
    if n_saturated:
        warnings.warn(
            f"{' or '.join(rule_names)}: the estimate is at its limit of 1 at the end of {n_saturated} of "
            f"{ds['estimate_final'].size} runs: it is a fraction of the stroke, divide per cent by 100",
            stacklevel=4,
        )


def _mismatches(loop: Loop, boundary: Boundary) -> Iterator[str]:
    """Mismatches of loop and days, a sentence each."""
    actions = np.unique(np.asarray(loop["action"]))
    has_negative_gain = bool(np.any(np.asarray(loop["kp"]) < 0.0))
    if has_negative_gain or used_choices(loop, "law") != {"pi"}:  # the meaning of the action is then unknown
        return
    for action, opposite_action, verb, sign in (
        ("heating", "cooling", "warm", 1.0),
        ("cooling", "heating", "cool", -1.0),
    ):
        if action not in actions:
            continue
        # the least and the most, in the direction of the action
        ends = (sorted(sign * end for end in boundary.extremes[name]) for name in ("T_w_in", "T_a_in", "T_set"))
        (_, water), (least_air, air), (T_set, highest_set_point) = ends
        if water < least_air:
            yield (
                f"action = {action!r}, but the water, {sign * water:.3g} degC at best, cannot {verb} air of "
                f"{sign * least_air:.3g} degC: give action = {opposite_action!r}, or days of {action}"
            )
        elif max(water, air) < T_set:
            yield (
                f"T_set is {sign * T_set:.3g} degC at best: water and air of {sign * max(water, air):.3g} degC cannot "
                f"{verb} the air that far, change T_set or the water"
            )
        elif least_air - highest_set_point > IDLE_MARGIN_K:
            yield (
                f"nothing to {verb}: T_set is {sign * highest_set_point:.3g} degC where the air is {sign * least_air:.3g} degC, and "
                "never closer, give T_set in degC, or exchange T_set and T_a_in"
            )
        elif action == "heating" and water - least_air > HOT_WATER_EXCESS_K:
            kp, ti = (loop.constants.get(name) for name in ("kp", "ti"))
            cooling_presets = [
                name for name in COOLING_PRESETS if (kp, ti) == (Loop.preset(name)["kp"], Loop.preset(name)["ti"])
            ]
            for name in cooling_presets[:1]:
                yield (
                    f"action = 'heating' with kp = {kp:g} 1/K and ti = {ti:g} s, those of the cooling coil {name}: "
                    "with hot water they may ring, or be slow; begin with the preset heating or heating_45, or give "
                    "other gains"
                )


_SCENARIOS_PER_CHUNK = 65536
_N_AIR_FLOWS = 17  # air flows tried between the least and the largest of the boundary: λ need not rise with the flow


def check_stability(layout: Layout) -> None:
    """Refuse the whole study if one scenario breaks γ ≤ 1 or λ ≤ 1.

    Flows are the largest that can occur: water at full opening, air over the boundary's series.  The wet λ takes
    dh_s/dT at the largest entering dew point, unless the coil cannot get wet.
    """
    coil = _coil_and_valve_layout(layout)
    numbers = _stability_numbers(coil)
    largest_numbers = numbers.max(axis=0)
    if n_unstable := int(np.count_nonzero(~(largest_numbers <= 1.0))):
        worst = int(np.nanargmax(largest_numbers))
        raise InputError(_instability_sentence(layout, coil, n_unstable, worst, *numbers[:, worst].tolist()))


def is_stable(loop: Loop, boundary: Boundary) -> xr.DataArray:
    """Whether γ ≤ 1 and λ ≤ 1, over the dims of ``loop``: as ``check_stability``, without refusing."""
    layout = Layout(loop, boundary)
    flags = (_stability_numbers(layout).max(axis=0) <= 1.0).reshape(tuple(loop.sizes.values()))
    return xr.DataArray(flags, dims=tuple(loop.sizes), coords=layout.coordinates())


def _stability_numbers(layout: Layout) -> np.ndarray:
    """γ and λ of every scenario, (2, n)."""
    numbers, extremes = [], layout.boundary.extremes
    air_flows = np.linspace(*extremes["m_a"], _N_AIR_FLOWS)
    for start in range(0, layout.size, _SCENARIOS_PER_CHUNK):
        columns = layout.columns(np.arange(start, min(start + _SCENARIOS_PER_CHUNK, layout.size)))
        coldest = min(extremes["T_w_in"][0], extremes["T_a_in"][0], columns["T_initial"].min())
        slope = wet_slope(extremes["W_a_in"][1], coldest, float(columns["pressure"].min()))
        numbers.append(stability_numbers(parameter_matrix(columns), air_flows, slope))
    return np.concatenate(numbers, axis=1)


def _coil_and_valve_layout(layout: Layout) -> Layout:
    """The study with only the parameters swept that stability depends on."""
    # whatever a closed valve leaks, fully open it delivers the same
    names = [p.name for p in PARAMETERS.values() if p.group in ("coil", "valve") and p.name != "leakage"]
    values = {n: v for n, v in layout.loop.items() if n in names}
    axes = {d for v in values.values() if isinstance(v, xr.DataArray) for d in v.dims}
    values |= {n: v for n, v in layout.loop.swept.items() if n in axes}
    if "rangeability" in values:
        values = {n: v for n, v in values.items() if n not in ("m_max", "valve_a", "valve_b", "valve_c")}
    return Layout(Loop(**values), layout.boundary)


def wet_slope(W: float, coldest: float, pressure: float) -> float:
    """dh_s/dT at the dew point of the dampest air, 0 of a coil that cannot get wet."""
    dew_point = float(moist_air.wetting_point(W, pressure))
    return 0.0 if coldest >= dew_point else float(moist_air.saturation_enthalpy_slope(dew_point, pressure))


def _instability_sentence(layout: Layout, coil: Layout, n_unstable: int, worst: int, gamma: float, lam: float) -> str:
    """worst: flat index of the least stable scenario, of γ and λ."""
    columns = coil.columns(np.array([worst]))
    n_volumes, substeps = int(columns["n_volumes"][0]), int(columns["substeps"][0])
    violations = [f"γ = m_w cp_w dt/C_w = {gamma:.3g}"] if gamma > 1.0 else []
    violations += [f"λ = dt (G_a + G_w)/C_c = {lam:.3g}"] if lam > 1.0 else []
    stable_substeps = np.ceil(max(gamma, lam) * substeps * (1 - 1e-12))
    cures = [f"substeps = {stable_substeps:.0f} is stable"] if stable_substeps <= PARAMETERS["substeps"].upper else []
    cures.append("give fewer n_volumes or larger " + " and ".join(["C_w"] * (gamma > 1.0) + ["C_c"] * (lam > 1.0)))
    place = ", ".join(filter(None, [coil.describe(worst), f"n_volumes={n_volumes}"]))
    dt = "1 s" if substeps == 1 else f"1/{substeps} s"
    n_scenarios = n_unstable * (layout.size // coil.size)
    return (
        f"unstable at dt = {dt}: {n_scenarios:,} of {layout.size:,} scenarios have γ or λ above 1; "
        f"worst: {' and '.join(violations)} at {place}; cure: {', or '.join(cures)}"
    )
