"""Refusals before anything runs (parameters that clash, unstable coils), and warnings of days that do not suit.

The explicit scheme of Eq (3) at dt = 1 s / substeps keeps every temperature a weighted mean of its neighbours exactly
if γ ≤ 1 (Courant number of the water) and λ ≤ 1 (rate of the metal) in every control volume.
"""

import warnings
from collections.abc import Iterator

import numpy as np
import xarray as xr

from fastcoil.base.arguments import raise_problems
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, Problem
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.presets import COOLING_PRESETS, PRESETS
from fastcoil.loops.scenarios import Layout
from fastcoil.model import moist_air
from fastcoil.model.engine.coil import stability_numbers
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.parameter_table import ESTIMATOR_GROUPS, PARAMETERS, STAND_INS
from fastcoil.model.valve_test import LARGEST_RATE_RATIO

_CAP_PARAMETERS = {"learner": "learning_cap", "gradient": "gradient_cap"}  # which limit the estimate


def check_clashes(loop: Loop, T_set: Array, least_scale: float = 1.0) -> None:
    """Refuse values that clash with each other; ``T_set``: all set-points, °C; ``least_scale``: of the backlash."""
    problems = [*_size_clashes(loop, least_scale), *_unread_by_estimators(loop).values(), *_plant_clashes(loop)]
    for rule in loop.rules.values():
        if rule.name not in used_choices(loop, rule.kind):
            sentence = f"{rule.name}, which no scenario has, alone reads {' and '.join(rule.own)}"
            cure = f"give {rule.kind} = {rule.name!r}, or leave them out"
            problems.append(Problem(f"{sentence}: {cure}", next(iter(rule.own)), "conflict"))
    raise_problems([*problems, *missing_parameters(loop), *controller_clashes(loop, T_set)])


def missing_parameters(loop: Loop) -> list[Problem]:
    """Return a problem for each parameter that an estimator or a rule reads and that the loop does not give."""
    used = used_choices(loop, "estimator")
    problems = []
    for estimator in filter(None, ESTIMATORS):
        for name in estimator.Parameters._fields if estimator.name in used else ():
            if name not in STAND_INS and PARAMETERS[name].default is None and loop[name] is None:
                cure = f"give the {PARAMETERS[name].text} ({PARAMETERS[name].unit}, {PARAMETERS[name].bounds})"
                problems.append(Problem(f"estimator = {estimator.name!r} without {name}: {cure}", name, "missing"))
    return problems + [
        Problem(f"{rule.name} reads {name}, which the loop does not give: give {name}", name, "missing")
        for rule in loop.rules.values()
        for name in rule.reads
        if loop[name] is None
    ]


def controller_clashes(loop: Loop, T_set: Array) -> list[Problem]:
    """Return a problem for each clash within the controller.  T_set: all its set-points, °C."""
    problems = [*_unread_by_controller(loop).values(), *_buffer_clashes(loop), *_test_clashes(loop)]
    dead_band = float(np.max(np.asarray(loop["error_dead_band"])))
    # set-points within 1 K count as one: a record of a constant one drifts and has steps
    if 1.0 <= (set_point_range := float(np.max(T_set) - np.min(T_set))) <= dead_band:
        effect = f"set-points within {set_point_range:g} K would not move the valve, give less"
        problems.append(Problem(f"error_dead_band = {dead_band:g} K: {effect}", "error_dead_band", "conflict"))
    return problems


def unread_values(loop: Loop) -> dict[str, Problem]:
    """Return the parameters that differ from their defaults and that no scenario reads, with the problems."""
    return _unread_by_estimators(loop) | _unread_by_controller(loop)


def _parameter_arrays(loop: Loop, *names: str) -> list[xr.DataArray]:
    """Return the values of parameters as arrays that broadcast against each other by their dims."""
    return [xr.DataArray(loop[name]) for name in names]


def _size_clashes(loop: Loop, least_scale: float) -> Iterator[Problem]:
    """Refuse an estimate of 1 or above its cap, a learner without step or reference, a jump above the backlash."""
    if loop["estimate_ratio"] is None:
        (estimate,) = _parameter_arrays(loop, "backlash_estimate")
    else:
        ratio, backlash = _parameter_arrays(loop, "estimate_ratio", "backlash")
        estimate = ratio * backlash
    largest = float(estimate.max())
    if largest >= 1.0:
        sentence = f"estimate_ratio × backlash reaches {largest:g}: an estimate must stay below 1, lower one of them"
        yield Problem(sentence, "estimate_ratio", "value")
    used = used_choices(loop, "estimator")
    names = ("learning_step", "learning_error_ratio", "learning_reference")
    step, error_ratio, reference = _parameter_arrays(loop, *names)
    learns = (step > 0.0) if loop["estimator"] is None else xr.DataArray(loop["estimator"]) == "learner"
    for name, cap_name in _CAP_PARAMETERS.items():
        has_estimator = learns if name == "learner" else xr.DataArray(loop["estimator"]) == name
        if name in used and (has_estimator & (estimate > xr.DataArray(loop[cap_name]))).any():
            cure = f"it cannot start above {cap_name}, lower it or raise {cap_name}"
            yield Problem(f"backlash_estimate up to {largest:g}: {cure}", "backlash_estimate", "conflict")
    if "learner" in used and (learns & (step == 0.0)).any():
        sentence = "estimator = 'learner' with learning_step = 0: give the step by which it changes its estimate"
        yield Problem(sentence, "learning_step", "missing")
    if ((error_ratio > 0.0) & (reference == 0.0)).any():
        cure = "give the number of intervals of which it is the mean"
        yield Problem(f"learning_error_ratio without learning_reference: {cure}", "learning_reference", "missing")
    jump, backlash = _parameter_arrays(loop, "slip_jump", "backlash")
    smallest_scale = min(least_scale, 1.0)
    if (jump > 0.0).any() and (excess := float((jump - smallest_scale * backlash).where(jump > 0.0, 0.0).max())) > 0.0:
        scaled = "" if smallest_scale == 1.0 else f", which backlash_scale makes {smallest_scale:g} times as large"
        sentence = f"slip_jump is up to {excess:g} above the backlash{scaled}: lower slip_jump or raise backlash"
        yield Problem(sentence, "slip_jump", "conflict")


def _plant_clashes(loop: Loop) -> Iterator[Problem]:
    """Refuse a controlled room that is none, and what valve, actuator or plant of a scenario do not have."""
    controlled, capacity, ua = _parameter_arrays(loop, "controlled", "room_capacity", "room_ua")
    controls_room = bool((controlled == "T_room").any())
    if loop["room_capacity"] is None and (controls_room or (ua > 0.0).any()):
        name = "controlled = 'T_room'" if controls_room else "room_ua"
        sentence = f"{name} without a room: give room_capacity, its heat capacity in kJ/K"
        yield Problem(sentence, "room_capacity", "missing")
    if controls_room and loop["test_start"] is not None:
        sentence = "test_start with controlled = 'T_room': a valve test watches the supply air, leave one out"
        yield Problem(sentence, "test_start", "unsupported")
    if _is_changed(loop, "dead_time") and used_choices(loop, "plant") == {"coil"}:
        yield Problem("dead_time belongs to a plant of one's own: give plant, or leave it out", "dead_time", "conflict")
    curve, band, stroke, zone = _parameter_arrays(loop, "curve", "positioner_band", "stroke_time", "neutral_zone")
    if (curve == "linear").any() and loop["rangeability"] is not None:
        sentence = "curve = 'linear' with rangeability, which is of an equal-percentage valve: leave one out"
        yield Problem(sentence, "curve", "conflict")
    if ((band > 0.0) & (stroke == 0.0)).any():
        sentence = "positioner_band without stroke_time: give the time of a full stroke, a positioner stops the motor"
        yield Problem(sentence, "stroke_time", "missing")
    if ((band > 0.0) & (zone > 0.0)).any():
        sentence = "neutral_zone with positioner_band, which is the zone of a positioner: leave one out"
        yield Problem(sentence, "neutral_zone", "conflict")


def _unread_by_estimators(loop: Loop) -> dict[str, Problem]:
    used = {"learner"} if loop["estimator"] is None else used_choices(loop, "estimator")
    unread = {}
    for p in PARAMETERS.values():
        if p.group in ESTIMATOR_GROUPS and p.group not in used and _is_changed(loop, p.name):
            sentence = f"{p.name} belongs to the estimator {p.group}, which no scenario has"
            cure = f"give estimator = {p.group!r}, or leave {p.name} out"
            unread[p.name] = Problem(f"{sentence}: {cure}", p.name, "conflict")
    if _is_changed(loop, "estimate_share") and used <= {"none"}:
        sentence = "estimate_share without an estimator: give estimator, or leave estimate_share out"
        unread["estimate_share"] = Problem(sentence, "estimate_share", "conflict")
    return unread


def _unread_by_controller(loop: Loop) -> dict[str, Problem]:
    ratio, noise, swing, law = _parameter_arrays(loop, "buffer_ratio", "buffer_noise", "buffer_swing", "compensation")
    is_rate_changed = xr.DataArray(_is_changed(loop, "smooth_rate"))
    readers = (  # a parameter, where it is given, where it is read, text, what to give
        ("buffer_noise", noise == "measured", ratio > 0.0, " = 'measured' without buffer_ratio", "buffer_ratio"),
        ("buffer_swing", swing > 0.0, ratio > 0.0, " without buffer_ratio", "buffer_ratio"),
        ("smooth_rate", is_rate_changed, law == "smooth", " without compensation = 'smooth'", "that word"),
    )
    return {
        name: Problem(f"{name}{text}: give {cure}, or leave {name} out", name, "conflict")
        for name, is_given, is_read, text, cure in readers
        if is_given.any() and not (is_given & is_read).any()
    }


def _buffer_clashes(loop: Loop) -> list[Problem]:
    names = ("buffer_ratio", "buffer_swing", "buffer_noise", "kp", "noise_std")
    ratio, swing, noise_source, kp, noise = _parameter_arrays(loop, *names)
    if not (ratio > 0.0).any() and not (swing > 0.0).any():
        return []
    is_measured, gain = noise_source == "measured", loop["plant_gain"]
    problems = []
    if (is_measured & (ratio > 0.0) & (swing == 0.0)).any():  # a loop that rings looks like noise
        sentence = "buffer_noise = 'measured' without buffer_swing: give buffer_swing and plant_gain, which limit it"
        problems.append(Problem(sentence, "buffer_swing", "missing"))
    if gain is None and (swing > 0.0).any():
        sentence = "buffer_swing without plant_gain: give plant_gain, by which the swing limits the buffer"
        problems.append(Problem(sentence, "plant_gain", "missing"))
    if problems:
        return problems
    # measured noise has no upper bound: the swing alone limits the buffer
    buffer = (ratio * abs(kp) * noise.where(~is_measured, np.inf)).where(ratio > 0.0, 0.0)
    if gain is not None:
        buffer_limit = swing / xr.DataArray(gain)
        buffer = buffer.where((swing == 0.0) | (buffer < buffer_limit), buffer_limit)
        if (is_measured & (buffer >= 1.0)).any():
            largest = float(buffer_limit.where(is_measured).max())
            sentence = f"buffer_swing / plant_gain reaches {largest:g}: a buffer must stay below 1, lower buffer_swing"
            return [Problem(sentence, "buffer_swing", "value")]
    largest = float(buffer.max())
    sentence = f"buffer_ratio × kp × noise_std reaches {largest:g}: a buffer must stay below 1, lower one"
    return [Problem(sentence, "buffer_ratio", "value")] if largest >= 1.0 else []


def _test_clashes(loop: Loop) -> Iterator[Problem]:
    """Refuse a valve test that never starts, with another law, or with ramps that the motor cannot follow."""
    if loop["test_start"] is None:
        changed_names = [p.name for p in PARAMETERS.values() if p.group == "test" and _is_changed(loop, p.name)]
        if changed_names:
            sentence = f"{' and '.join(changed_names)} without test_start"
            yield Problem(f"{sentence}: give the time at which the valve test starts", "test_start", "missing")
        return
    if used_choices(loop, "law") != {"pi"}:
        sentence = "test_start with a user-defined law: a valve test hands back to the PI, leave one out"
        yield Problem(sentence, "test_start", "unsupported")
    rate, stroke_time = _parameter_arrays(loop, "test_rate", "stroke_time")
    if (LARGEST_RATE_RATIO * rate * stroke_time >= 1.0).any():
        sentence = f"test_rate = {float(rate.max()):g} 1/s: ramps take up to {LARGEST_RATE_RATIO:g} times that"
        cure = f"a motor of {float(stroke_time.max()):g} s for its stroke is slower, give a lower rate"
        yield Problem(f"{sentence}, and {cure}", "test_rate", "conflict")


def check_test_times(loop: Loop, seconds: int, *, closed: bool) -> None:
    """Refuse a valve test that ends after ``seconds``, or in an open loop; warn of one that starts after them."""
    if loop["test_start"] is None:
        return
    if not closed:
        sentence = "test_start with a command: a valve test commands the valve itself, leave one out"
        raise InputError(sentence, "command", "conflict")
    starts, minutes = _parameter_arrays(loop, "test_start", "test_minutes")
    is_late = starts >= seconds
    if is_late.any():
        sentence = f"test_start = {float(starts.max()):g} s: the simulation ends at {seconds:,} s, there is no test"
        warnings.warn(sentence, stacklevel=5)
    ends = (starts + 60.0 * minutes).where(~is_late, 0.0)
    if (ends > seconds).any():
        sentence = f"the valve test would end at {float(ends.max()):,g} s, the simulation ends at {seconds:,} s"
        raise InputError(f"{sentence}: start it earlier, or give a longer day", "test_start", "value")


def _is_changed(loop: Loop, name: str) -> bool:
    """Whether some scenario has another value than the default."""
    value = loop[name]
    return value is not None and bool(np.any(np.asarray(value) != PARAMETERS[name].default))


def warn_mismatch(loop: Loop, boundary: Boundary, *, closed: bool = True) -> None:
    """Warn of loops and days that do not suit each other.  closed: the controller is on, its action and gains count."""
    for mismatch in _mismatches(loop, boundary) if closed else ():
        warnings.warn(mismatch, stacklevel=5)
    band, stroke, backlash = _parameter_arrays(loop, "positioner_band", "stroke_time", "backlash")
    least = (0.5 / (stroke.where(stroke > 0.0) * (1.0 - backlash))).where(band > 0.0)
    if (band < least).any():
        text = f"positioner_band reaches down to {float(band.where(band < least).min()):g}"
        cure = f"the motor may run to and fro, give {float(least.max()):.2g} or more"
        warnings.warn(f"{text}, less than half of what the motor moves the stem in a second: {cure}", stacklevel=5)
    pressure = float(np.max(np.asarray(loop["pressure"])))
    humidity_per_pressure, sample = boundary.dampest
    humidity = humidity_per_pressure * pressure
    if humidity > 1.05:  # up to there air may be mist, or readings may be rounded
        cure = "check the units of both, or give the loop the pressure of the place"
        warnings.warn(f"{sample} is a relative humidity of {humidity:.0%} at {pressure:.6g} Pa: {cure}", stacklevel=5)


def warn_saturated(loop: Loop, ds: xr.Dataset) -> None:
    """Warn of a user's estimator whose estimate ends at its limit, such as an estimate in per cent."""
    rule_names = [name for name, rule in loop.rules.items() if rule.kind == "estimator"]
    n_saturated = int((ds["estimate_final"] == 1.0).sum()) if rule_names and "estimate_final" in ds else 0
    if n_saturated:
        place = f"at its limit of 1 at the end of {n_saturated} of {ds['estimate_final'].size} runs"
        cure = "it is a fraction of the stroke, divide per cent by 100"
        warnings.warn(f"{' or '.join(rule_names)}: the estimate is {place}: {cure}", stacklevel=4)


def _mismatches(loop: Loop, boundary: Boundary) -> Iterator[str]:
    """Return a sentence for each mismatch of loop and days."""
    actions = np.unique(np.asarray(loop["action"]))
    has_negative_gain = bool(np.any(np.asarray(loop["kp"]) < 0.0))
    # the meaning of the action is unknown, or what the water can do
    if has_negative_gain or used_choices(loop, "law") != {"pi"} or used_choices(loop, "plant") != {"coil"}:
        return
    kinds = (("heating", "cooling", "warm", 1.0), ("cooling", "heating", "cool", -1.0))
    for action, opposite_action, verb, sign in (kind for kind in kinds if kind[0] in actions):
        # the least and the most, in the direction of the action
        ends = (sorted(sign * end for end in boundary.extremes[name]) for name in ("T_w_in", "T_a_in", "T_set"))
        (_, water), (least_air, air), (T_set, highest_set_point) = ends
        if water < least_air:
            suiting = (preset for preset in PRESETS.values() if preset.heats == (action == "heating"))
            best = min(suiting, key=lambda p: p.has_room != ("T_room" in used_choices(loop, "controlled")))
            yield (
                f"action = {action!r}, but the water, {sign * water:.3g} degC at best, cannot {verb} air of "
                f"{sign * least_air:.3g} degC: give action = {opposite_action!r}, or days such as {best.day_text}"
            )
        elif max(water, air) < T_set:
            yield (
                f"T_set is {sign * T_set:.3g} degC at best: water and air of {sign * max(water, air):.3g} degC cannot "
                f"{verb} the air that far, change T_set or the water"
            )
        elif least_air - highest_set_point > 10.0:  # K, at all times: the loop has nothing to do
            yield (
                f"nothing to {verb}: T_set is {sign * highest_set_point:.3g} degC where the air is "
                f"{sign * least_air:.3g} degC, and never closer, give T_set in degC, or exchange T_set and T_a_in"
            )
        elif action == "heating" and water - least_air > 35.0:
            # K, from where water changes the air at least twice as much per stroke as chilled water does
            kp, ti = (loop.constants.get(name) for name in ("kp", "ti"))
            for name in [n for n in COOLING_PRESETS if (kp, ti) == (Loop.preset(n)["kp"], Loop.preset(n)["ti"])][:1]:
                yield (
                    f"action = 'heating' with kp = {kp:g} 1/K and ti = {ti:g} s, those of the cooling coil {name}: "
                    "with hot water they may ring, or be slow; begin with the preset heating or heating_45, or give "
                    "other gains"
                )


_SCENARIOS_PER_CHUNK = 65536  # whose parameters are in memory


def check_stability(layout: Layout) -> None:
    """Refuse the whole study if one scenario violates γ ≤ 1 or λ ≤ 1 at the largest flows of water and air."""
    _check_room_stability(layout)
    plants = used_choices(layout.loop, "plant")
    if "coil" not in plants:
        return
    coil = _coil_and_valve_layout(layout) if plants == {"coil"} else layout
    numbers = _stability_numbers(coil)
    largest_numbers = numbers.max(axis=0)
    if n_unstable := int(np.count_nonzero(~(largest_numbers <= 1.0))):
        worst = int(np.nanargmax(largest_numbers))
        gamma, lam = numbers[:, worst].tolist()
        columns = coil.columns(np.array([worst]))
        substeps = int(columns["substeps"][0])
        violations = [f"γ = m_w cp_w dt/C_w = {gamma:.3g}"] if gamma > 1.0 else []
        violations += [f"λ = dt (G_a + G_w)/C_c = {lam:.3g}"] if lam > 1.0 else []
        stable = np.ceil(max(gamma, lam) * substeps * (1 - 1e-12))
        cures = [f"substeps = {stable:.0f} is stable"] if stable <= PARAMETERS["substeps"].upper else []
        cures.append("give fewer n_volumes or larger " + " and ".join(["C_w"] * (gamma > 1.0) + ["C_c"] * (lam > 1.0)))
        place = ", ".join(filter(None, [coil.describe(worst), f"n_volumes={int(columns['n_volumes'][0])}"]))
        sentence = (
            f"unstable at dt = {'1 s' if substeps == 1 else f'1/{substeps} s'}: "
            f"{n_unstable * (layout.size // coil.size):,} of {layout.size:,} scenarios have γ or λ above 1; "
            f"worst: {' and '.join(violations)} at {place}; cure: {', or '.join(cures)}"
        )
        raise InputError(sentence, "C_w" if gamma > 1.0 else "C_c", "value")


def _check_room_stability(layout: Layout) -> None:
    """Refuse a room that a second of air takes beyond the temperature of that air."""
    if layout.loop["room_capacity"] is None:
        return
    capacity, ua, cp_a = _parameter_arrays(layout.loop, "room_capacity", "room_ua", "cp_a")
    least = layout.boundary.extremes["m_a"][1] * cp_a + ua
    if (capacity < least).any():
        sentence = f"room_capacity = {float(capacity.min()):g} kJ/K is unstable at a step of 1 s"
        raise InputError(f"{sentence}: give at least {float(least.max()):.4g} kJ/K", "room_capacity", "value")


def is_stable(loop: Loop, boundary: Boundary) -> xr.DataArray:
    """Return whether γ ≤ 1 and λ ≤ 1, over the dims of ``loop``: as ``check_stability``, without refusing."""
    layout = Layout(loop, boundary)
    flags = (_stability_numbers(layout).max(axis=0) <= 1.0).reshape(tuple(loop.sizes.values()))
    return xr.DataArray(flags, dims=tuple(loop.sizes), coords=layout.coordinates())


def _stability_numbers(layout: Layout) -> np.ndarray:
    """Return γ and λ of every scenario, (2, n)."""
    numbers, extremes = [], layout.boundary.extremes
    air_flows = np.linspace(*extremes["m_a"], 17)  # λ need not rise with the air flow
    for start in range(0, layout.size, _SCENARIOS_PER_CHUNK):
        columns = layout.columns(np.arange(start, min(start + _SCENARIOS_PER_CHUNK, layout.size)))
        coldest = min(extremes["T_w_in"][0], extremes["T_a_in"][0], columns["T_initial"].min())
        slope = wet_slope(extremes["W_a_in"][1], coldest, float(columns["pressure"].min()))
        is_coil = columns["plant"] == "coil"
        matrix = parameter_matrix(columns | {"plant": np.full(is_coil.size, "coil")})
        numbers.append(np.where(is_coil, stability_numbers(matrix, air_flows, slope), 0.0))
    return np.concatenate(numbers, axis=1)


def _coil_and_valve_layout(layout: Layout) -> Layout:
    """Return the study with only those parameters swept on which stability depends."""
    # whatever a closed valve leaks, fully open it delivers the same
    names = [p.name for p in PARAMETERS.values() if p.group in ("coil", "valve") and p.name != "leakage"]
    values = {n: v for n, v in layout.loop.items() if n in names}
    axes = {d for v in values.values() if isinstance(v, xr.DataArray) for d in v.dims}
    values |= {n: v for n, v in layout.loop.swept.items() if n in axes}
    if "rangeability" in values:
        values = {n: v for n, v in values.items() if n not in STAND_INS["rangeability"]}
    return Layout(Loop(**values), layout.boundary)


def wet_slope(W: float, coldest: float, pressure: float) -> float:
    """Return dh_s/dT at the dew point of the dampest air, 0 for a coil that cannot get wet."""
    dew_point = float(moist_air.wetting_point(W, pressure))
    return 0.0 if coldest >= dew_point else float(moist_air.saturation_enthalpy_slope(dew_point, pressure))
