"""Faults of the valves, coils and sensors of an air handler that last: what its coils do against their commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from fastcoil.base.arrays import Mask
from fastcoil.measured.air_handler.finding import Finding, make_finding
from fastcoil.measured.air_handler.mismatch import find_mismatch
from fastcoil.measured.grid import forward_fill
from fastcoil.measured.part import true_runs

from fastcoil.measured.air_handler.series import (  # isort: skip
    EFFECT_AFTER_LOW_FLOW_S, MET_ERROR_K, SHUT, SIGNS, WIDE_OPEN, AirHandlerSeries,
)  # fmt: skip

_VALVE_KINDS = ("leak", "stuck_open", "stuck_shut")
_LEAST_HOURS = 1.0  # of a day, of a fault that counts on it
LEAST_EFFECT_K = 3.0  # of a coil whose valve is shut: sensors of mixed air are off by up to 2.3 K
_LEAST_EFFECT_LOW_FLOW_K = 6.0  # the same at a low air flow, at which ducts warm and cool the air
_LEAST_EFFECT_BETWEEN_K = 4.0  # the same beyond outdoor and return air, where the entering air is not logged
_LEAST_EFFECT_OVER_OFFSET_K = 2.0  # the same beyond the offset that the log shows
_NO_EFFECT_K = 1.5  # of a coil wide open, up to which it does nothing: fan heat, sensors
_STUCK_OPEN_SHARE = 0.7  # of the effect when open, from which a valve that is commanded shut is stuck open
_STILL_UNMET_K = 2.0  # the same, of a valve without any effect
_OPEN_COMMAND = 0.05  # from which a valve counts as open
_FIGHT_S = 900.0
_OFF_HOURS = 4.0  # of a day, of a controller that leaves its set-point
_OFF_K = 2.0
_STILL_S = 4 * 3600.0  # for which a sensor shows one number
_STILL_NEIGHBOUR_K = 2.0  # range of another temperature meanwhile
_SENSORS = {"T_sup": "supply air", "T_mixed": "entering air"}
_LATER_EFFECT_K = 3.0  # on the same day, of a valve that lacked water for a time
_ALWAYS_DAYS = 3
_ALWAYS_SHARE = 0.9  # of the time with all valves shut, in which a sensor that is off shows it
_OUTSIDE_K = 3.0  # of mixed air beyond return and outdoor air
_OUTSIDE_HOURS = 3.0  # of a day


def find_faults(unit: AirHandlerSeries) -> list[Finding]:
    """Find what lasts for an hour of a day or more."""
    still = {name: _still_mask(unit, name) for name in _SENSORS}
    findings = [_describe_still(unit, name, mask) for name, mask in still.items() if mask.any()]
    unit = unit.without({name: mask for name, mask in still.items() if mask.any()})
    works = {coil: works_while_shut(unit, coil) for coil in unit.coils}
    passing = {coil: unit.on_days_of(mask & unit.is_entering_plausible, _LEAST_HOURS) for coil, mask in works.items()}
    findings += _find_mixed_air_off(unit, works)
    for coil in unit.coils:
        findings += _describe_passing(unit, coil, passing[coil])
    findings += _find_fights(unit)
    for coil in unit.coils:
        # what another valve does wrong keeps this one from its set-point
        others = np.any([mask for other, mask in passing.items() if other != coil] or [np.zeros_like(unit.on)], axis=0)
        excused = np.isin(unit.day, np.unique(unit.day[others])) if others.any() else np.zeros_like(unit.on)
        findings += _find_unmet(unit, coil, excused)
    if any(finding.kind in _VALVE_KINDS for finding in findings) and (mismatch := find_mismatch(unit)):
        findings = [mismatch, *(finding for finding in findings if finding.kind not in _VALVE_KINDS)]
    return [*findings, *_find_unoccupied(unit)]


def _coils_alike(unit: AirHandlerSeries, coil: str) -> list[str]:
    """Return the coils that change the air the way this one does."""
    return [other for other in unit.coils if SIGNS[other] == SIGNS[coil]]


def _opposing(unit: AirHandlerSeries, coil: str, least: float) -> Mask:
    """Whether a coil that changes the air the other way is commanded open by more than ``least``."""
    others = [unit.command(other) > least for other in unit.coils if SIGNS[other] != SIGNS[coil]]
    return np.any(others, axis=0) if others else np.zeros_like(unit.on)


def works_while_shut(unit: AirHandlerSeries, coil: str) -> Mask:
    """Whether a coil works though its valve, and any other that does the same, has been commanded shut."""
    coils, effect, offset = _coils_alike(unit, coil), unit.effect(coil), unit.offset(coil)
    is_shut = np.all([unit.rests(other) for other in coils], axis=0)
    has_rested = np.all([unit.rests(other, after=EFFECT_AFTER_LOW_FLOW_S) for other in coils], axis=0)
    limit = np.full(effect.size, LEAST_EFFECT_K if unit.is_entering_measured else _LEAST_EFFECT_BETWEEN_K)
    if unit.is_entering_measured and np.isfinite(offset):
        limit[:] = np.clip(offset + _LEAST_EFFECT_OVER_OFFSET_K, _LEAST_EFFECT_OVER_OFFSET_K, LEAST_EFFECT_K)
    limit[unit.has_low_flow] = _LEAST_EFFECT_LOW_FLOW_K
    with np.errstate(invalid="ignore"):
        return np.asarray(is_shut & (has_rested | ~unit.has_low_flow) & (effect > limit))


def find_open_unmet(unit: AirHandlerSeries, coil: str) -> tuple[Mask, Mask]:
    """Find where a valve has been wide open and T_sup does not meet its set-point, and where the coil has no effect."""
    shortfall, effect, offset = unit.shortfall(coil), unit.effect(coil), unit.offset(coil)
    no_effect = _NO_EFFECT_K + (np.clip(offset, -1.0, 1.0) if np.isfinite(offset) else 0.0)
    with np.errstate(invalid="ignore"):
        # a controller without a set-point in the log is wide open because the air lacks something
        is_unmet = unit.rests(coil, wide_open=True) & ((shortfall > MET_ERROR_K) | np.isnan(shortfall))
        # air that the coil should cool and that leaves much warmer is another coil's work
        is_still = is_unmet & (effect < no_effect) & (effect > -LEAST_EFFECT_K) & ~(shortfall < _STILL_UNMET_K)
    return is_unmet, np.asarray(is_still)


def _describe_passing(unit: AirHandlerSeries, coil: str, mask: Mask) -> Iterator[Finding]:
    if not mask.any():
        return
    coils = _coils_alike(unit, coil)
    if coil != coils[0]:
        return  # the other one's finding names both
    component = f"{' or '.join(coils)} valve"
    effect, open_effect = float(np.median(unit.effect(coil)[mask])), np.nan
    is_open = unit.on & (unit.command(coil) >= 0.8)
    if unit.hours(is_open) >= 0.5:
        open_effect = float(np.nanmedian(unit.effect(coil)[is_open]))
    kind = "stuck_open" if effect >= _STUCK_OPEN_SHARE * open_effect else "leak"
    change = "warmer" if SIGNS[coil] > 0.0 else "colder"
    shut_hours = unit.hours(unit.rests(coil))
    against = next((o for o in unit.coils if SIGNS[o] != SIGNS[coil] and np.median(unit.command(o)[mask]) > 0.2), "")
    beside = f", while the {against} valve works against it" if against else ""
    text = f"commanded shut, and the air leaves {effect:.2g} K {change} than it enters{beside}, for "
    text += f"{unit.hours(mask):.1f} of the {shut_hours:.1f} h in which it was shut, {{when}}"
    action = (
        "compare the mixed air sensor with a hand-held one, then close the isolating valve: if the effect ends, the "
    )
    action += "valve passes: check its stroke and linkage, and repair valve or actuator"
    yield make_finding(unit, component, kind, mask, effect, text, action)


def _find_fights(unit: AirHandlerSeries) -> Iterator[Finding]:
    """Find heating and cooling commanded at the same time."""
    commanded = {sign: np.zeros_like(unit.on) for sign in (-1.0, 1.0)}
    for coil in unit.coils:
        commanded[SIGNS[coil]] |= unit.command(coil) > _OPEN_COMMAND
    both = unit.on & commanded[-1.0] & commanded[1.0]
    lasting = np.zeros_like(both)
    for first, last in true_runs(both):
        lasting[first:last] = (last - first) * unit.interval >= _FIGHT_S
    mask = unit.on_days_of(lasting, _LEAST_HOURS)
    if mask.any():
        openings = [float(np.median(unit.command(coil)[mask])) for coil in unit.coils]
        levels = ", ".join(f"{coil} {100 * x:.0f} %" for coil, x in zip(unit.coils, openings, strict=True))
        size = float(np.median(np.abs(unit.T_sup - unit.T_entering[0])[mask]))
        text = f"heating and cooling are commanded at once ({levels}), for {unit.hours(mask):.1f} h, {{when}}"
        action = "unless it dehumidifies, set the cooling set-point 2 K or more above that for heating"
        yield make_finding(unit, "controller", "fight", mask, size if np.isfinite(size) else 0.0, text, action)


def _find_unmet(unit: AirHandlerSeries, coil: str, excused: Mask) -> Iterator[Finding]:
    """Find a valve that is wide open without effect, or with too little, and a loop that leaves its set-point."""
    sign, command, effect = SIGNS[coil], unit.command(coil), unit.effect(coil)
    shortfall = unit.shortfall(coil)
    called = unit.on & (command > SHUT)
    is_unmet, is_still = (m & ~excused & ~_opposing(unit, coil, _OPEN_COMMAND) for m in find_open_unmet(unit, coil))
    is_weak = is_unmet & ~is_still & np.isfinite(shortfall)
    with np.errstate(invalid="ignore"):
        is_left = called & (command < WIDE_OPEN) & (np.abs(shortfall) > _OFF_K) & ~excused
    still_days = unit.on_days_of(is_still, _LEAST_HOURS)
    # a valve that works on the same day lacked water
    works = unit.on_days_of(called & (effect > _LATER_EFFECT_K), 0.5)
    dry_days = still_days & np.isin(unit.day, np.unique(unit.day[works]))
    still_days &= ~dry_days
    weak_days = unit.on_days_of(is_weak & ~np.isin(unit.day, np.unique(unit.day[still_days])), _LEAST_HOURS)
    left_days = unit.on_days_of(is_left, _OFF_HOURS)
    left_days &= left_days.any() and float(np.ptp(command[left_days])) < 0.3
    water, side = ("chilled", "above") if sign < 0.0 else ("hot", "below")
    cases = [
        (f"{water} water", "not_met", dry_days,
         f"the {coil} valve is wide open without effect, and works at other times of the same day",
         f"look when {water} water is available, and start it earlier"),
        (f"{coil} valve", "stuck_shut", still_days, "{state}: the air leaves {change} than it enters",
         f"check that {water} water arrives; if it does, valve or actuator is stuck shut, or the strainer is full"),
        (f"{coil} coil", "not_met", weak_days, "{state}: {seen}",
         "check the temperature and flow of the water, the stroke of the valve, then the size of the coil"),
        ("controller", "not_met", left_days,
         f"the {coil} command stays near {{level:.0f}} % while T_sup is {{miss:.2g}} K off the set-point",
         "look for a controller in manual, an interlock, or a very long integral time"),
    ]  # fmt: skip
    for component, kind, days, text, action in cases:
        if days.any():
            miss, change, level = (float(np.nanmedian(x[days])) for x in (np.abs(shortfall), effect, 100.0 * command))
            state = "wide open" + f", and T_sup stays {miss:.2g} K {side} the set-point" * bool(np.isfinite(miss))
            is_known = np.isfinite(change)
            seen = f"the coil changes the air by {change:.2g} K" if is_known else "the entering air is not logged"
            word = f"{abs(change):.2g} K {'warmer' if sign * change >= 0.0 else 'colder'}"
            shown = text.format(state=state, change=word, seen=seen, level=level, miss=miss)
            shown += f"; for {unit.hours(days):.1f} of the {unit.hours(called):.1f} h in which it was called, {{when}}"
            yield make_finding(unit, component, kind, days, np.nan_to_num(miss), shown, action)


def _still_mask(unit: AirHandlerSeries, name: str) -> Mask:
    """Whether a sensor shows one number for hours while another temperature moves."""
    T, mask = unit.get(name), np.zeros_like(unit.on)
    others = [unit.get(other) for other in ("T_sup", "T_mixed", "T_return") if other != name]
    for first, last in true_runs(np.concatenate([[False], np.diff(forward_fill(T)) == 0.0]) & unit.on):
        if (last - first) * unit.interval >= _STILL_S:
            ranges = [float(np.ptp(part)) for o in others if (part := o[first:last][np.isfinite(o[first:last])]).size]
            mask[first:last] = max(ranges, default=0.0) >= _STILL_NEIGHBOUR_K
    return mask


def _describe_still(unit: AirHandlerSeries, name: str, mask: Mask) -> Finding:
    value, hours = float(np.median(unit.get(name)[mask])), unit.hours(mask)
    text = f"the sensor shows {value:.4g} °C while others move, for {hours:.1f} h, {{when}}"
    action = "check the sensor and its wiring; what rests on it is not judged meanwhile"
    return make_finding(unit, _SENSORS[name], "sensor_stuck", mask, 0.0, text, action)


def _find_mixed_air_off(unit: AirHandlerSeries, works: Mapping[str, Mask]) -> Iterator[Finding]:
    """Find mixed air outside the range of what it is mixed from, or far from supply air that is in that range."""
    T, (low, high) = unit.get("T_mixed"), unit.outdoor_and_return
    excess = np.maximum(T - high, low - T)
    with np.errstate(invalid="ignore"):
        mask = unit.on_days_of(unit.on & ~unit.has_low_flow & (excess > _OUTSIDE_K), _OUTSIDE_HOURS)
    text = "mixed air is {size:.2g} K outside the range of return and outdoor air, for {hours:.1f} h, {{when}}"
    if not mask.any():
        off = np.any([*works.values()], axis=0) & ~unit.is_entering_plausible
        # a leak comes and goes with the water, a sensor is off all the time
        n_days, at_rest = np.unique(unit.day[off]).size, off[unit.all_rest]
        is_always = n_days >= _ALWAYS_DAYS and at_rest.size > 0 and float(at_rest.mean()) >= _ALWAYS_SHARE
        mask, excess = unit.on_days_of(off & is_always, _LEAST_HOURS), np.abs(unit.T_sup - T)
        text = (
            "with the valves shut the sensor is {size:.2g} K off the supply air, which return and outdoor air explain, "
        )
        text += "for {hours:.1f} h, {{when}}"
    if mask.any():
        size = float(np.nanmedian(excess[mask]))
        action = "compare the sensors with a hand-held one, with the fan running; if they agree, a valve leaks"
        text = text.format(size=size, hours=unit.hours(mask))
        yield make_finding(unit, "entering air", "sensor_offset", mask, size, text, action)


def _find_unoccupied(unit: AirHandlerSeries) -> Iterator[Finding]:
    """Find a plant that runs while nobody is there, with a valve open."""
    occupied = unit.get("occupied")
    is_open = np.any([unit.command(coil) > _OPEN_COMMAND for coil in unit.coils], axis=0)
    is_empty = occupied == 0.0
    mask = unit.on_days_of(unit.on & is_empty & is_open, 2.0)
    if mask.any():
        hours = unit.hours(mask)
        text = f"the plant heats or cools in {hours:.1f} of {unit.hours(is_empty):.0f} unoccupied hours, {{when}}"
        action = "unless rooms need it, switch the plant off or widen its set-points when nobody is there"
        yield make_finding(unit, "fan", "unoccupied", mask, hours, text, action, symbol="h")
