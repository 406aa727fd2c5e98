"""Both bounds of the buffer against simulation.

Lower: the turns that noise adds, and the buffer behind which they end.  Upper: the buffer's own cycle, alone and on
days as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from studies.buffer.rule import (
    ALLOWED_TURNS_PER_HOUR,
    LOWER_SCALE,
    UPPER_SCALE,
    cycle_frequency,
    mean_noise_range,
    noise_factor,
    phase_margin,
    predict_cycle,
    swing_per_buffer,
)
from studies.buffer.runs import ALLOWED_SWING, BUFFER_MULTIPLES, ESTIMATE_SHARES, SWINGS, Runs, Valves
from studies.common import pool_days, share_of, write_table
from studies.days import CONSTANT

BLOCKS_PER_HOUR = 6.0  # ``switch_frequency`` counts in 10 min
NEAR_FACTOR = 1.3  # factor within which a bound or a swing counts as predicted
SAMPLE_TIMES = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0)  # sample times of the table of factors, s
TURNS_PER_HOUR = (3.0, 10.0, 30.0)  # false turns per hour that the formula is tried for


def format_quantiles(values: Any) -> str:
    """Format the 5 %, 50 % and 95 % quantiles, without NaN."""
    numbers = np.asarray(values, dtype=float)
    return " … ".join(f"{q:.2f}" for q in np.quantile(numbers[~np.isnan(numbers)], [0.05, 0.5, 0.95], method="nearest"))


def added_turns_per_hour(ds: xr.Dataset) -> xr.DataArray:
    """Turns per hour that the noise adds, (size, sample, day)."""
    turns = BLOCKS_PER_HOUR * ds.switch_frequency
    return (turns.isel(noisy=1) - turns.isel(noisy=0)).transpose("size", "sample", "day")


def measured_lower_ratio(ds: xr.Dataset, allowed_per_hour: float = ALLOWED_TURNS_PER_HOUR) -> xr.DataArray:
    """Buffer where the added turns fall below those allowed per hour, over the lower bound; (sample, day).

    Between sizes by the logarithm of the turns; 0 where they are below without any buffer, inf where they are above
    behind the largest.
    """
    added_turns = added_turns_per_hour(ds).values
    is_above = added_turns > allowed_per_hour
    last_above = len(BUFFER_MULTIPLES) - 1 - is_above[::-1].argmax(0)
    index = np.minimum(last_above, len(BUFFER_MULTIPLES) - 2)
    y = np.log(np.maximum(added_turns, 0.1))
    y0, y1 = (np.take_along_axis(y, k[None], 0)[0] for k in (index, index + 1))
    sizes = np.array(BUFFER_MULTIPLES)
    ratio = sizes[index] + (y0 - np.log(allowed_per_hour)) / np.where(y0 > y1, y0 - y1, 1.0) * (
        sizes[index + 1] - sizes[index]
    )
    ratio = np.where(is_above.any(0), np.where(is_above[-1], np.inf, ratio), 0.0)
    return xr.DataArray(ratio, dims=("sample", "day"), coords={"day": ds.day})


def lower_bound_row(name: str, ds: xr.Dataset, among: Any = True) -> list[str]:
    """A row of the lower bound; what turns seldom enough without any buffer does not count."""
    ratio, added_turns = measured_lower_ratio(ds), added_turns_per_hour(ds)
    turns_without_noise = BLOCKS_PER_HOUR * ds.switch_frequency.isel(noisy=0).transpose("size", "sample", "day")
    travel = ds.motor_travel.isel(noisy=1).transpose("size", "sample", "day")
    among = xr.full_like(ratio, True, dtype=bool) & among
    needs_buffer = (ratio > 0.0) & among
    is_near = abs(np.log(ratio.where(needs_buffer))) <= np.log(NEAR_FACTOR)

    def select_size(part: xr.DataArray, size: float) -> xr.DataArray:
        return part.isel(size=BUFFER_MULTIPLES.index(size)).where(needs_buffer)

    return [
        name,
        f"{float(needs_buffer.where(among).mean()):.0%}",
        format_quantiles(ratio.where(needs_buffer)),
        str(share_of(is_near, needs_buffer)),
        ", ".join(f"{float(select_size(added_turns, size).median()):.0f}" for size in (0.0, 0.5, 1.0, 2.0)),
        f"{float(select_size(turns_without_noise, 1.0).median()):.0f}",
        str(share_of(select_size(added_turns, 1.0) > 2.0 * ALLOWED_TURNS_PER_HOUR, needs_buffer)),
        ", ".join(
            f"× {float((select_size(travel, size) / select_size(travel, 2.0)).median()):.1f}"
            for size in (0.0, 0.5, 1.0)
        ),
    ]


def per_valve_and_day(runs: Runs, valve_quantity: Callable[[Valves], Any]) -> xr.DataArray:
    """Repeat a quantity of the valves for each day they ran on: (sample, day)."""
    parts = [xr.DataArray(valve_quantity(runs.valves_on(kind)), dims="sample").expand_dims(day=ds.sizes["day"])
             for kind, ds in runs.lower.items()]  # fmt: skip
    return xr.concat(parts, "day").transpose("sample", "day")


def has_no_fitting_buffer(valves: Valves) -> Any:
    """Return where the lower bound lies above the upper one."""
    return valves.lower_bound > valves.upper_bound(ALLOWED_SWING)


def write_lower_bound(runs: Runs) -> None:
    """Write the lower bound by kind of days and by loop."""
    table = [lower_bound_row(kind, ds) for kind, ds in runs.lower.items()]
    pooled_days = pool_days(runs.lower)
    loop_gain, sample_time = (
        per_valve_and_day(runs, lambda v: v.kp * v.plant.gain),
        per_valve_and_day(runs, lambda v: v.sample_time),
    )
    has_no_fit = per_valve_and_day(runs, has_no_fitting_buffer)
    groups: dict[str, Any] = {
        "all": True,
        "no backlash": per_valve_and_day(runs, lambda v: v.backlash) == 0.0,
        "kp K above 1": loop_gain > 1.0,
        "some buffer fits": ~has_no_fit,
        "none fits": has_no_fit,
        **{f"sampled every {t:g} s": sample_time == t for t in np.unique(sample_time)},
    }
    table += [lower_bound_row(name, pooled_days, among) for name, among in groups.items() if np.any(among)]
    write_table(
        "buffer/buffer_lower",
        f"The lower bound, {ALLOWED_TURNS_PER_HOUR:g} false reversals per hour allowed: "
        f"{pooled_days.sizes['sample']} fresh valves "
        f"and loops, {pooled_days.sizes['day'] // len(runs.lower)} days of each kind, inverse of 95 %",
        [
            "days or loops",
            "need a buffer",
            "measured / formula (5 %, median, 95 %)",
            f"within a factor of {NEAR_FACTOR:g}",
            "false reversals per hour at 0, ½, 1, 2 × the bound, median",
            "reversals per hour without noise",
            f"over {2 * ALLOWED_TURNS_PER_HOUR:g} at the bound",
            "travel at 0, ½, 1 ×, over that at 2 ×",
        ],
        table,
    )


def write_allowed_turns(runs: Runs) -> None:
    """Write the lower bound for other numbers of turns, from the same runs."""
    pooled_days, table = pool_days(runs.lower), []
    sample_time, has_fit = (
        per_valve_and_day(runs, lambda v: v.sample_time),
        ~per_valve_and_day(runs, has_no_fitting_buffer),
    )
    for allowed_per_hour in TURNS_PER_HOUR:
        factor = noise_factor(sample_time, allowed_per_hour)
        ratio = (
            measured_lower_ratio(pooled_days, allowed_per_hour) * noise_factor(sample_time) / factor.where(factor > 0.0)
        )
        is_counted = (ratio > 0.0) & has_fit
        is_near = abs(np.log(ratio.where(is_counted))) <= np.log(NEAR_FACTOR)
        table.append(
            [
                f"{allowed_per_hour:g}",
                f"{float(is_counted.where(has_fit).mean()):.0%}",
                format_quantiles(ratio.where(is_counted)),
                str(share_of(is_near, is_counted)),
                str(share_of(ratio > NEAR_FACTOR, is_counted)),
            ]
        )
    write_table(
        "buffer/buffer_allowed",
        "The lower bound for other numbers of false reversals, where some buffer fits: "
        f"{pooled_days.sizes['sample']} fresh valves and loops, {pooled_days.sizes['day'] // len(runs.lower)} days of "
        "each kind",
        ["false reversals per hour", "need a buffer", "measured / formula (5 %, median, 95 %)",
         f"within a factor of {NEAR_FACTOR:g}", f"over {NEAR_FACTOR:g} × the formula"],
        table,
    )  # fmt: skip


def lower_scales(runs: Runs) -> Any:
    """Measured bound over that of white noise, (n_valves, n_days), NaN where no buffer is needed."""
    ratio = measured_lower_ratio(pool_days(runs.lower)).values
    return LOWER_SCALE * np.where(ratio > 0.0, ratio, np.nan)


def write_noise() -> None:
    """Write the lower bound over kp σ by sample time and allowed false turns, beside what a trend shows."""
    rows: list[list[str]] = []
    for n in (1.0, *TURNS_PER_HOUR):
        rows.append([f"{n:g}", *(f"{LOWER_SCALE * float(noise_factor(t, n)):.1f}" for t in SAMPLE_TIMES)])
    ranges = [mean_noise_range(3600.0 / (ALLOWED_TURNS_PER_HOUR * t)) for t in SAMPLE_TIMES]
    rows.append([f"(range in {60.0 / ALLOWED_TURNS_PER_HOUR:g} min, over σ)", *(f"{x:.1f}" for x in ranges)])
    write_table(
        "buffer/buffer_noise",
        "The lower bound over kp σ by sample time, and the mean peak-to-peak noise between two false reversals at "
        f"{ALLOWED_TURNS_PER_HOUR:g} per hour",
        ["false reversals per hour", *(f"{t:g} s" for t in SAMPLE_TIMES)],
        rows,
    )


MISSED_PLAY_WEIGHT = 0.5  # share of the play that is left which takes off the buffer; the formula is better by it
VISIBLE_SWING = 0.25  # swing over K b from which a cycle counts as seen


class CycleComparison(NamedTuple):
    """Predicted and simulated cycles on days on which nothing changes; (swing, sample)."""

    predicted: xr.DataArray
    seen: xr.DataArray
    swing: xr.DataArray
    swing_over_gain: xr.DataArray
    swing_over_theory: xr.DataArray
    period: xr.DataArray


def missed_play(valves: Valves, share_index: int) -> Any:
    """Width of the play in u that an estimate short of the backlash leaves: (X - x̂) / (1 - x̂)."""
    estimate = ESTIMATE_SHARES[share_index] * valves.backlash
    return (valves.backlash - estimate) / (1.0 - estimate)


def compare_cycles(valves: Valves, ds: xr.Dataset, share_index: int, deduction: Any = 0.0) -> CycleComparison:
    """Compare swing and period with their formulas; deduction: what the formula takes off the buffer, (n_valves,).

    A cycle that is seen where nothing is left of the buffer has no formula: NaN.
    """
    ds = ds.isel(share=share_index).transpose("swing", "sample")
    width = np.array([valves.upper_bound(swing) for swing in SWINGS[1:]])
    seen = ds.hunting_swing / width > VISIBLE_SWING * valves.plant.gain
    per_width = ds.hunting_swing / np.where(width > deduction, width - deduction, np.nan)
    plant_and_gains = (valves.plant, valves.kp, valves.ti)
    return CycleComparison(
        xr.DataArray(phase_margin(*plant_and_gains) < 0.5 * np.pi, dims="sample")
        & (ds.hunting_swing == ds.hunting_swing),
        seen,
        (per_width / swing_per_buffer(*plant_and_gains)).where(seen),
        (per_width / valves.plant.gain).where(seen),
        (per_width / predict_cycle(*plant_and_gains).swing).where(seen),
        (ds.hunting_period * cycle_frequency(*plant_and_gains) / (2.0 * np.pi)).where(seen),
    )


def cycle_row(name: str, comparison: CycleComparison) -> list[str]:
    """A row of the buffer's cycle."""
    is_near = abs(np.log(comparison.swing)) <= np.log(NEAR_FACTOR)
    return [
        name,
        str(share_of((comparison.seen & ~comparison.predicted).rename(swing="day"))),
        f"{float(comparison.predicted.mean()):.0%}, {float((comparison.seen & comparison.predicted).mean()):.0%}",
        format_quantiles(comparison.swing),
        str(share_of(is_near.rename(swing="day"), comparison.seen.rename(swing="day"))),
        format_quantiles(comparison.swing_over_gain),
        format_quantiles(comparison.swing_over_theory),
        format_quantiles(comparison.period),
    ]


def write_cycles(runs: Runs) -> None:
    """Write the buffer's own cycle beside formula and theory."""
    table = []
    for is_heating, ds in runs.still.items():
        for share_index, size in reversed(list(enumerate(ESTIMATE_SHARES))):
            name = f"{'heating' if is_heating else 'cooling'}, inverse of {100 * size:g} %"
            table.append(cycle_row(name, compare_cycles(runs.valves[is_heating], ds, share_index)))
        valves, mode = runs.valves[is_heating], "heating" if is_heating else "cooling"
        corrected = compare_cycles(valves, ds, 0, MISSED_PLAY_WEIGHT * missed_play(valves, 0))
        table.append(cycle_row(f"{mode}, {100 * ESTIMATE_SHARES[0]:g} %, b less half of what is missed", corrected))
        is_good = valves.backlash == 0.0
        if is_good.any():
            good_valve_cells = CycleComparison(*(part.isel(sample=is_good) for part in compare_cycles(valves, ds, 0)))
            table.append(cycle_row(f"{mode}, no backlash", good_valve_cells))
    write_table(
        "buffer/buffer_cycle",
        f"The buffer's own cycle where nothing else moves the loop: {len(runs.valves[False].kp)} fresh valves and "
        f"loops, buffers for swings of {', '.join(f'{s:g}' for s in SWINGS[1:])} K",
        ["loop", "seen, not predicted", "predicted, predicted and seen", "swing / formula (5 %, median, 95 %)",
         f"within a factor of {NEAR_FACTOR:g}", "swing / (K b)", "swing / describing function", "period / formula"],
        table,
    )  # fmt: skip


def upper_bound_row(name: str, ds: xr.Dataset, among: Any = None) -> list[str]:
    """A row of the upper bound, from days of one kind or one estimate."""
    part = (ds if among is None else ds.isel(sample=among)).transpose("swing", "sample", "day")
    error = part.rmse_settled.mean("day")
    rise = 100.0 * (error / error.isel(swing=0) - 1.0)
    excess = np.sqrt((error**2 - error.isel(swing=0) ** 2).clip(0.0)) / xr.DataArray(
        [np.nan, *SWINGS[1:]], dims="swing"
    )
    cells = []
    for k in range(1, len(SWINGS)):
        rise_at_swing, hunting = rise.isel(swing=k), float(part.hunts.isel(swing=k).mean())
        cells.append(
            f"{float(rise_at_swing.median()):+.0f} %, {float(rise_at_swing.quantile(0.95)):+.0f} %, {hunting:.0%}"
        )
    error_text = f"{float(error.isel(swing=0).median()):.3f}"
    return [name, error_text, *cells, format_quantiles(excess.isel(swing=SWINGS.index(0.2)))]


def write_upper_bound(runs: Runs) -> None:
    """Write what buffers for these swings cost on ordinary days."""
    table = []
    for kind, ds in runs.upper.items():
        table += [
            upper_bound_row(f"{kind}, inverse of {100 * size:g} %", ds.isel(share=share_index))
            for share_index, size in enumerate(ESTIMATE_SHARES)
        ]
    kind, exact_index = CONSTANT, len(ESTIMATE_SHARES) - 1
    valves = runs.valves_on(kind)
    is_predicted = phase_margin(valves.plant, valves.kp, valves.ti) < 0.5 * np.pi
    for among, label in ((is_predicted, "a cycle predicted"), (~is_predicted, "none predicted")):
        if among.any():
            table.append(
                upper_bound_row(f"{kind}, inverse of 100 %, {label}", runs.upper[kind].isel(share=exact_index), among)
            )
    write_table(
        "buffer/buffer_upper",
        "The upper bound: settled RMSE with the buffer that allows the given swing in K, relative to no buffer (median "
        f"and 95th percentile of the valves), and hunting; no noise, {len(valves.kp)} fresh valves and loops",
        ["days", "RMSE without buffer, K", *(f"{swing:g} K" for swing in SWINGS[1:]),
         "√(RMSE² - RMSE₀²) / swing at 0.2 K (5 %, median, 95 %)"],
        table,
    )  # fmt: skip


def upper_scales(runs: Runs) -> Any:
    """Swing over its formula without its factor, exact inverse, (n_valves, n); NaN where there is no cycle."""
    ratios = [
        compare_cycles(runs.valves[is_heating], ds, len(ESTIMATE_SHARES) - 1).swing.values
        for is_heating, ds in runs.still.items()
    ]
    return UPPER_SCALE * np.concatenate(ratios).T
