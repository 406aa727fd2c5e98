"""A log hour by hour, without a model: a state for every hour, faults that last, and the headline of a diagnosis.

Valve and swings are judged by the rules for an air handler, as in one with a single coil.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.air_handler.faults import LEAST_EFFECT_K, find_open_unmet, works_while_shut
from fastcoil.measured.air_handler.hunting import blame_swing
from fastcoil.measured.air_handler.series import MET_ERROR_K, SHUT, WIDE_OPEN, AirHandlerSeries
from fastcoil.measured.clock import describe_times
from fastcoil.measured.grid import Grid, forward_fill, running_mean
from fastcoil.measured.measures import COARSE_INTERVAL_S, LEAST_REGULARITY, is_settled, measure_swing
from fastcoil.measured.part import true_runs
from fastcoil.measured.swings import FEWEST_SAMPLES, LEAST_SWING_K, describe_period, detrend, find_swings

STATES = ("off", "start-up", "not responding", "open, not met", "shut, not met", "swinging", "wide open", "shut",
          "off set-point", "holding", "in control")  # fmt: skip
"""States of an hour; the first that applies wins."""
LEAST_HOURLY_SWING_K = 1.0  # peak to peak, of an hour that swings: loads and mixing make up to ± 0.5 K
_AT_END_S = 600.0  # time at an end of the stroke after which a valve is saturated
_AS_WARM_K = 0.5  # between supply and entering air, up to which they are as warm as each other
_LEAST_FAULT_SHARE = 0.15  # share of the hours of operation from which a fault is reported

HOURLY_VARIABLES: Mapping[str, tuple[str, str]] = {
    "enabled": ("1", "share of the hour in which the plant was on"),
    "in_control": ("1", f"share of the hour with the plant on, calm, and T_sup within {MET_ERROR_K:g} K of T_set"),
    "saturated": ("1", "share of the hour with the valve wide open or shut for more than 10 min"),
    "not_responding": ("1", "share of the hour in which T_sup does not answer the valve"),
    "command": ("1", "mean command, fraction of stroke"),
    "error": ("K", "mean of T_sup minus T_set"),
    "error_rms": ("K", "RMS of T_sup minus T_set"),
    "from_air": ("K", "mean of T_sup minus T_a_in"),
    "swing": ("K", "swing of the supply temperature, peak to peak"),
    "period": ("s", "median period of the swing; missing where the log does not resolve it"),
    "regularity": ("1", "regularity of the swing after Thornhill: regular above 1; 0 where it hardly comes back"),
}
"""Unit and meaning of each number of an hour."""


def hourly_summary(grid: Grid, start: np.datetime64 | None = None) -> xr.Dataset:
    """Summarise every hour of a log that has samples; ``start``: time of its first sample, if it has a clock.

    Returns a Dataset along ``hour``, since the first sample (each further log of a list starts a new hour): the
    variables of ``HOURLY_VARIABLES``; ``state``, one of ``STATES``; ``log_limits``, what the log of that hour cannot
    show, or blank.
    """
    cools = _coil_sign(grid)
    coil = "heating" if cools < 0.0 else "cooling"
    values = {**grid.values, f"{coil}_command": grid.values["command"]}
    unit = AirHandlerSeries("", grid._replace(values=values), start)
    samples, own_swings = _judge_samples(unit, coil, is_sign_known=cools != 0.0)
    hours = samples.groupby(level=0)
    table, command, error = hours.mean(), hours["command"], hours["error"]
    table.update(hours[["swing", "period", "regularity"]].median())
    table["error_rms"], table["saturated"] = np.sqrt(table["error_rms"]), table["open"] + table["shut"]
    spread, changes = command.max() - command.min(), hours[["command", "T_sup"]].cov().xs("command", level=1)
    fall = -cools * changes["T_sup"] / changes["command"]  # as the valve opens, K per stroke
    is_off_set_point = (error.min() > MET_ERROR_K) | (error.max() < -MET_ERROR_K)
    table.loc[is_off_set_point & (spread > 0.2) & (fall < 2.0), "not_responding"] = 1.0
    is_off = (table["enabled"] < 0.5) | (table["known"] < 0.5 * table["enabled"])
    applies = [
        is_off, table["starting"] >= 0.5, table["not_responding"] >= 0.5, table["unmet"] >= 0.5,
        (table["shut"] >= 0.5) & (cools * table["error"] > MET_ERROR_K),
        (table["swinging"] >= 0.5) & (table["saturated"] < 0.8),
        (table["open"] >= 0.5) & (table["error_rms"] <= 1.5 * MET_ERROR_K), table["shut"] >= 0.5,
        (table["error"].abs() > MET_ERROR_K) | (table["error_rms"] > 1.5 * MET_ERROR_K),
        (command.count() >= FEWEST_SAMPLES) & (spread < 0.005),
    ]  # fmt: skip
    state = np.select(applies, STATES[:-1], STATES[-1]).astype(object)
    limits = table.apply(_list_limits, axis=1, interval=grid.interval, has_error=bool(table["error"].notna().any()))
    table.loc[is_off, [name for name in HOURLY_VARIABLES if name != "enabled"]] = np.nan
    ds = xr.Dataset(coords={"hour": ("hour", table.index, {"units": "h", "long_name": "hours since the first sample"})})
    for name, (unit_name, meaning) in HOURLY_VARIABLES.items():
        ds[name] = ("hour", table[name], {"units": unit_name, "long_name": meaning})
    ds["state"] = ("hour", state, {"long_name": "what the hour was like"})
    limits = np.where(is_off, "", limits).astype(object)
    ds["log_limits"] = ("hour", limits, {"long_name": "what the log of the hour cannot show"})
    n_days = len(grid.day_slices())
    swing_times = describe_times(unit.spans(own_swings), unit.start, n_days) if own_swings.any() else ""
    return ds.assign_attrs(interval=grid.interval, cools=cools, swing_times=swing_times)


def _coil_sign(grid: Grid) -> float:
    """Return 1 for a cooling coil, whose command rises while the error is positive, -1 for heating, 0 if unknown."""
    command = forward_fill(grid.values["command"])
    error = np.where(grid.on, grid.values["T_sup"] - grid.values.get("T_set", np.nan), np.nan)
    moves = np.diff(command)
    correlation = np.nansum(moves * (error[1:] + error[:-1]))
    at_ends = [np.nansum(error[command >= WIDE_OPEN]), -np.nansum(error[command <= SHUT])]
    evidence = [correlation, *at_ends] if np.count_nonzero(moves) >= 10 else [*at_ends, correlation]
    return next((float(np.sign(value)) for value in evidence if value != 0.0), 0.0)


def _judge_samples(unit: AirHandlerSeries, coil: str, *, is_sign_known: bool) -> tuple[pd.DataFrame, Mask]:
    """Return what an hour averages, with the number of the hour as index, and where the valve makes a swing, (n,).

    The time of a start counts only in hours that have no other.
    """
    T, T_set, interval = unit.T_sup, unit.T_set(coil), unit.interval
    error, no_set_point = np.where(unit.on, T - T_set, np.nan), not np.isfinite(T_set).any()
    is_starting, hour = _find_starts(unit, error), _number_hours(unit.grid)
    is_calm = unit.on & ~is_starting & (is_settled(T_set, unit.on, interval) | no_set_point)
    deviation = detrend(T if no_set_point else error, is_calm, interval)
    variance = running_mean(deviation**2, is_calm, max(round(3600.0 / interval), 8))
    swing = np.where(is_calm, 2.0 * np.sqrt(2.0 * variance), np.nan)  # of a sine
    period, regularity = np.full((2, T.size), np.nan)
    does_swing, is_own = np.zeros((2, T.size), dtype=bool)
    # on a set-point that moves a swing has to be larger
    for least, good in ((LEAST_HOURLY_SWING_K, is_calm), (LEAST_SWING_K, unit.on)):
        for window in find_swings(T, good, interval, least, fewest_samples=0.0):
            if culprit := blame_swing(unit, window):
                margin = round(0.25 * window.period / interval)  # from its level to its first turn
                part = slice(max(window.first - margin, 0), window.end + margin)
                does_swing[part], swing[part] = True, window.peak_to_peak
                is_own[window.first : window.end] |= culprit == coil and least == LEAST_SWING_K
                if window.period >= FEWEST_SAMPLES * interval:
                    rhythm = measure_swing(deviation[part], is_calm[part], interval)
                    period[part] = window.period
                    regularity[part] = rhythm.regularity * rhythm.is_periodic if rhythm.periods else np.nan
    is_unmet, is_still = find_open_unmet(unit, coil)
    shares = {
        "open": unit.rests(coil, wide_open=True, after=_AT_END_S), "shut": unit.rests(coil, after=_AT_END_S),
        "not_responding": (is_still | works_while_shut(unit, coil)) & is_sign_known,
        "unmet": is_unmet & np.isfinite(error),
    }  # fmt: skip
    numbers = {"command": unit.command(coil), "T_sup": T, "error": error, "error_rms": error**2,
               "from_air": T - unit.T_entering[0]}  # fmt: skip
    is_used = unit.on & ~is_starting
    is_used |= unit.on & ~np.isin(hour, hour[is_used])
    samples = {name: mask & is_used for name, mask in shares.items()}
    samples |= {name: np.where(is_used, series, np.nan) for name, series in numbers.items()}
    samples |= {
        "enabled": unit.grid.on, "known": unit.on, "starting": is_starting, "missing": np.isnan(T),
        "in_control": (np.abs(error) <= MET_ERROR_K) & ~does_swing, "swinging": does_swing, "swing": swing,
        "period": period, "regularity": regularity,
    }  # fmt: skip
    return pd.DataFrame(samples, index=hour), is_own


def _number_hours(grid: Grid) -> Index:
    """Return the number of the hour of each sample, (n,); each further log starts a new one."""
    hour, first_hour = np.zeros(grid.on.size, dtype=np.int64), 0
    for first, end in zip(grid.starts, (*grid.starts[1:], grid.on.size), strict=True):
        hour[first:end] = first_hour + ((grid.time[first:end] - grid.time[first] + 1e-6) // 3600.0)
        first_hour = int(hour[first:end].max()) + 1
    return hour


def _find_starts(unit: AirHandlerSeries, error: Array) -> Mask:
    """Find where the plant starts, (n,): after half an hour off, until T_sup meets T_set, an hour at most."""
    is_starting, time = np.zeros(unit.on.size, dtype=bool), unit.grid.time
    for first, last in true_runs(unit.on):
        begin = max(row for row in unit.grid.starts if row <= first)  # of this log
        last_on = max(np.flatnonzero(unit.grid.on[begin:first]) + begin, default=begin)
        if time[first] - time[last_on] >= 1800.0:
            end = min(last, first + round(3600.0 / unit.interval))
            met_at = np.flatnonzero(np.abs(error[first:end]) <= MET_ERROR_K)
            is_starting[first : first + int(met_at[0]) if met_at.size else end] = True
    return is_starting


def _list_limits(hour: pd.Series, interval: float, has_error: bool) -> str:
    """List what the log of an hour cannot show."""
    limits = {
        f"{100 * hour['missing']:.0f} % of T_sup is missing": hour["missing"] > 0.1,
        f"no swing faster than {FEWEST_SAMPLES * interval / 60:.0f} min": interval > COARSE_INTERVAL_S,
        "no error: T_set is not logged": not has_error,
        "no small swing: the set-point changes too often": np.isnan(hour["swing"]) and hour["starting"] < 0.5,
    }
    return "; ".join(limit for limit, holds in limits.items() if holds)


def write_headline(triage: xr.Dataset) -> str:
    """Write the most important finding of a log, and what to log again if that decides, in two sentences at most."""
    operation = triage.isel(hour=triage["state"].values != "off")
    n_hours, state, interval = operation["hour"].size, operation["state"].values, float(operation.attrs["interval"])
    if not n_hours:
        return "The plant is off throughout the log: log it in operation, or check the column enabled."
    findings, shut_hours = write_warnings(triage)[:2], operation.isel(hour=state == "shut")
    is_calm = np.isin(state, ("in control", "holding", "wide open"))
    if not findings and np.isnan(operation["error"]).all():
        findings = [f"{n_hours} h: no fault found; without T_set the control error is unknown"]
    elif not findings:
        rms = float(operation["error_rms"][is_calm].median())
        finding = f"{is_calm.sum()} of {n_hours} h in control, error typically {rms:.2g} K (RMS)"
        findings = [finding] * bool(is_calm.any())
        n_shut = shut_hours["hour"].size
        findings += [f"{n_shut} of {n_hours} h shut with no call for cooling or heating"] * bool(n_shut)
    is_often_shut = shut_hours["hour"].size > _LEAST_FAULT_SHARE * n_hours
    leak_error = float(abs(shut_hours["error"]).median()) if is_often_shut else 0.0
    fastest = f"{FEWEST_SAMPLES * interval / 60:.0f} min"
    advice = [f"every 10 s for a day: every {interval:.0f} s shows no gap and no swing faster than {fastest}"]
    advice *= bool(interval > COARSE_INTERVAL_S)
    if leak_error > 5.0 and np.isnan(shut_hours["from_air"]).all():  # K
        error_text = f"{leak_error:.2g} K off its set-point"
        advice += [f"T_a_in to see whether the valve leaks: with the valve shut, T_sup is {error_text}"]
    headline = "; ".join(findings) or f"{n_hours} h, too few to judge"
    return f"{headline}." + f" Log {'; log '.join(advice)}." * bool(advice)


def write_warnings(triage: xr.Dataset) -> list[str]:
    """Write a sentence on each fault that lasts for a share of the hours of operation, the worst first."""
    state, n_hours = triage["state"].values, int(np.sum(triage["state"].values != "off"))
    is_at_end, is_open = triage["saturated"].values >= 0.5, triage["command"].values > 0.5
    is_silent = state == "not responding"
    is_fault = {"open, not met": (state == "open, not met") | (is_silent & is_at_end & is_open)}
    is_fault |= {"shut": is_silent & is_at_end & ~is_open, "not responding": is_silent & ~is_at_end}
    is_fault |= {fault: state == fault for fault in ("shut, not met", "swinging", "off set-point")}
    # a set-point that moves makes hours off it as well
    least = {"off set-point": 0.3}
    # a fault counts against the hours in which it can show: days without a call do not hide it
    n_shut = int(np.sum((state == "shut") | is_fault["shut"]))
    n_called = n_hours - n_shut
    counted = {"shut": (n_shut, "in which it was shut"), "off set-point": (n_hours, "")}
    warnings = []
    for fault, mask in is_fault.items():
        n_counted, where = counted.get(fault, (n_called, "in which it was called"))
        if mask.sum() > least.get(fault, _LEAST_FAULT_SHARE) * n_counted:
            which = f" {where}" if where and n_counted < n_hours else ""
            description = _describe_fault(fault, triage.isel(hour=mask))
            warnings.append(f"{mask.sum()} of {n_counted} h{which}: {description}")
    return warnings


def _describe_fault(fault: str, hours: xr.Dataset) -> str:
    """Describe a fault by the medians of the ``hours`` in which it occurs."""
    names = ("error", "error_rms", "from_air", "command", "swing", "period", "regularity")
    error, rms, air, command, swing, period, regularity = (float(hours[name].median()) for name in names)
    error_text = f"{abs(error):.2g} K {'above' if error > 0.0 else 'below'} the set-point"
    air_text = f"{abs(air):.2g} K {'above' if air > 0.0 else 'below'} the entering air"
    effect, largest = -hours.attrs["cools"] * air, float(hours["swing"].max())
    is_small = effect < LEAST_EFFECT_K
    coil_text = "no water or a valve stuck shut" if is_small else "no water, a stuck valve or too small a coil"
    beside = f", {air_text}" if abs(air) > _AS_WARM_K else ", as warm as the entering air"
    coil_text = f"{'' if np.isnan(air) else beside}: {coil_text}"
    coil_text += f", or something else {'heats' if air > 0.0 else 'cools'} the air" * (effect < -LEAST_EFFECT_K)
    period_text = f"about every {describe_period(period)}"
    period_text += " or faster" * (hours.attrs["interval"] > COARSE_INTERVAL_S)
    period_text += ", unevenly" * (regularity < LEAST_REGULARITY)
    largest_text = f", up to ± {largest / 2:.2g} K," * (largest > 1.5 * swing)
    rhythm = period_text if np.isfinite(period) else "too fast for this log to show the period"
    times_text = f", {hours.attrs['swing_times']}" if hours.attrs["swing_times"] else ""
    manual = f"command at {100 * command:.0f} %: a slow loop, or one in manual"
    return {
        "open, not met": f"the valve is wide open and T_sup stays {error_text}{coil_text}",
        "shut": f"the valve is shut and T_sup stays {air_text}: it leaks or is stuck open, or a sensor is wrong",
        "not responding":
            f"the command moves and T_sup stays {error_text}: a stuck valve, a loose linkage or no water",
        "shut, not met":
            f"the command keeps the valve shut while T_sup is {error_text}: look for an interlock or wind-up",
        "off set-point": f"T_sup is {rms:.2g} K (RMS) off, {manual}",
        "swinging": f"T_sup swings ± {swing / 2:.2g} K{largest_text} {rhythm}{times_text}",
    }[fault]  # fmt: skip
