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
    LOWER_SCALE,
    PER_HOUR,
    UPPER_SCALE,
    cycle,
    frequency,
    mean_range,
    noise_factor,
    phase,
    swing_per_buffer,
)
from studies.buffer.runs import ALLOWED, SHARES, SIZES, SWINGS, Runs, Valves
from studies.common import pooled, share_of, write_table
from studies.days import CONSTANT

BLOCKS_PER_HOUR = 6.0
"""``switch_frequency`` counts in 10 min."""
NEAR = 1.3
"""Factor within which a bound or a swing counts as predicted."""
TIMES = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
"""Sample times of the table of factors, s."""
TURNS = (3.0, 10.0, 30.0)
"""False turns per hour that the formula is tried for."""


def across(values: Any) -> str:
    """5 %, median and 95 % of what is finite or censored."""
    finite = np.asarray(values, dtype=float)
    return " … ".join(f"{q:.2f}" for q in np.quantile(finite[~np.isnan(finite)], [0.05, 0.5, 0.95], method="nearest"))


def per_hour(ds: xr.Dataset) -> xr.DataArray:
    """Turns per hour that the noise adds, (size, sample, day)."""
    turns = BLOCKS_PER_HOUR * ds.switch_frequency
    return (turns.isel(noisy=1) - turns.isel(noisy=0)).transpose("size", "sample", "day")


def measured_lower(ds: xr.Dataset, allowed: float = PER_HOUR) -> xr.DataArray:
    """Buffer where the added turns fall below those allowed per hour, over the bound for ``PER_HOUR``; (sample, day).

    Between sizes by the logarithm of the turns; 0 where they are below without any buffer, inf where they are above
    behind the largest.
    """
    added = per_hour(ds).values
    above = added > allowed
    last = len(SIZES) - 1 - above[::-1].argmax(0)
    at = np.minimum(last, len(SIZES) - 2)
    y = np.log(np.maximum(added, 0.1))
    y0, y1 = (np.take_along_axis(y, k[None], 0)[0] for k in (at, at + 1))
    sizes = np.array(SIZES)
    ratio = sizes[at] + (y0 - np.log(allowed)) / np.where(y0 > y1, y0 - y1, 1.0) * (sizes[at + 1] - sizes[at])
    ratio = np.where(above.any(0), np.where(above[-1], np.inf, ratio), 0.0)
    return xr.DataArray(ratio, dims=("sample", "day"), coords={"day": ds.day})


def lower_row(name: str, ds: xr.Dataset, among: Any = True) -> list[str]:
    """A row of the lower bound; what turns seldom enough without any buffer does not count."""
    ratio, added = measured_lower(ds), per_hour(ds)
    quiet = BLOCKS_PER_HOUR * ds.switch_frequency.isel(noisy=0).transpose("size", "sample", "day")
    travel = ds.motor_travel.isel(noisy=1).transpose("size", "sample", "day")
    among = xr.full_like(ratio, True, dtype=bool) & among
    needs = (ratio > 0.0) & among
    near = abs(np.log(ratio.where(needs))) <= np.log(NEAR)

    def at(part: xr.DataArray, size: float) -> xr.DataArray:
        return part.isel(size=SIZES.index(size)).where(needs)

    return [
        name,
        f"{float(needs.where(among).mean()):.0%}",
        across(ratio.where(needs)),
        str(share_of(near, needs)),
        ", ".join(f"{float(at(added, size).median()):.0f}" for size in (0.0, 0.5, 1.0, 2.0)),
        f"{float(at(quiet, 1.0).median()):.0f}",
        str(share_of(at(added, 1.0) > 2.0 * PER_HOUR, needs)),
        ", ".join(f"× {float((at(travel, size) / at(travel, 2.0)).median()):.1f}" for size in (0.0, 0.5, 1.0)),
    ]


def each(runs: Runs, value: Callable[[Valves], Any]) -> xr.DataArray:
    """Something of the valves that ran on each day; (sample, day)."""
    parts = [xr.DataArray(value(runs.of(kind)), dims="sample").expand_dims(day=ds.sizes["day"])
             for kind, ds in runs.lower.items()]  # fmt: skip
    return xr.concat(parts, "day").transpose("sample", "day")


def no_buffer_fits(valves: Valves) -> Any:
    """Where the lower bound lies above the upper one."""
    return valves.lower > valves.upper(ALLOWED)


def write_lower(runs: Runs) -> None:
    """The lower bound by kind of days and by loop."""
    table = [lower_row(kind, ds) for kind, ds in runs.lower.items()]
    everything = pooled(runs.lower)
    loop_gain, sample_time = each(runs, lambda v: v.kp * v.plant.gain), each(runs, lambda v: v.sample_time)
    crossed = each(runs, no_buffer_fits)
    groups: dict[str, Any] = {
        "all": True,
        "no backlash": each(runs, lambda v: v.backlash) == 0.0,
        "kp K above 1": loop_gain > 1.0,
        "some buffer fits": ~crossed,
        "none fits": crossed,
        **{f"sampled every {t:g} s": sample_time == t for t in np.unique(sample_time)},
    }
    table += [lower_row(name, everything, among) for name, among in groups.items() if np.any(among)]
    write_table(
        "buffer/buffer_lower",
        f"The lower bound, {PER_HOUR:g} false reversals per hour allowed: {everything.sizes['sample']} fresh valves "
        f"and loops, {everything.sizes['day'] // len(runs.lower)} days of each kind, inverse of 95 %",
        ["days or loops", "need a buffer", "measured / formula (5 %, median, 95 %)", f"within a factor of {NEAR:g}",
         "false reversals per hour at 0, ½, 1, 2 × the bound, median", "reversals per hour without noise",
         f"over {2 * PER_HOUR:g} at the bound",
         "travel at 0, ½, 1 ×, over that at 2 ×"],
        table,
    )  # fmt: skip


def write_allowed(runs: Runs) -> None:
    """The lower bound for other numbers of turns, from the same runs."""
    everything, table = pooled(runs.lower), []
    sample_time, fits = each(runs, lambda v: v.sample_time), ~each(runs, no_buffer_fits)
    for allowed in TURNS:
        factor = noise_factor(sample_time, allowed)
        ratio = measured_lower(everything, allowed) * noise_factor(sample_time) / factor.where(factor > 0.0)
        counts = (ratio > 0.0) & fits
        near = abs(np.log(ratio.where(counts))) <= np.log(NEAR)
        table.append(
            [
                f"{allowed:g}",
                f"{float(counts.where(fits).mean()):.0%}",
                across(ratio.where(counts)),
                str(share_of(near, counts)),
                str(share_of(ratio > NEAR, counts)),
            ]
        )
    write_table(
        "buffer/buffer_allowed",
        "The lower bound for other numbers of false reversals, where some buffer fits: "
        f"{everything.sizes['sample']} fresh valves and loops, {everything.sizes['day'] // len(runs.lower)} days of "
        "each kind",
        ["false reversals per hour", "need a buffer", "measured / formula (5 %, median, 95 %)",
         f"within a factor of {NEAR:g}", f"over {NEAR:g} × the formula"],
        table,
    )  # fmt: skip


def lower_scales(runs: Runs) -> Any:
    """Measured bound over that of white noise, (n_valves, n_days), NaN where no buffer is needed."""
    ratio = measured_lower(pooled(runs.lower)).values
    return LOWER_SCALE * np.where(ratio > 0.0, ratio, np.nan)


def write_noise() -> None:
    """The lower bound over kp σ by sample time and false turns allowed, beside what a trend shows."""
    rows: list[list[str]] = []
    for n in (1.0, *TURNS):
        rows.append([f"{n:g}", *(f"{LOWER_SCALE * float(noise_factor(t, n)):.1f}" for t in TIMES)])
    shown = [mean_range(3600.0 / (PER_HOUR * t)) for t in TIMES]
    rows.append([f"(range in {60.0 / PER_HOUR:g} min, over σ)", *(f"{x:.1f}" for x in shown)])
    write_table(
        "buffer/buffer_noise",
        "The lower bound over kp σ by sample time, and the mean peak-to-peak noise between two false reversals at "
        f"{PER_HOUR:g} per hour",
        ["false reversals per hour", *(f"{t:g} s" for t in TIMES)],
        rows,
    )


HALF_MISSED = 0.5
"""Share of the play that is left which takes off the buffer; the formula is better by it."""
SEEN = 0.25
"""Swing over K b from which a cycle counts as seen."""


class Cycles(NamedTuple):
    """Of the days on which nothing changes: what is predicted, and what is seen; (swing, sample)."""

    predicted: xr.DataArray
    seen: xr.DataArray
    swing: xr.DataArray
    by_gain: xr.DataArray
    by_theory: xr.DataArray
    period: xr.DataArray


def missed(valves: Valves, share: int) -> Any:
    """Width of the play in u that an estimate short of the backlash leaves: (X - x̂) / (1 - x̂)."""
    estimate = SHARES[share] * valves.backlash
    return (valves.backlash - estimate) / (1.0 - estimate)


def cycles(valves: Valves, ds: xr.Dataset, share: int, less: Any = 0.0) -> Cycles:
    """Swing and period over their formulas; less: what the formula takes off the buffer, (n_valves,).

    A cycle that is seen where nothing is left of the buffer has no formula: NaN.
    """
    ds = ds.isel(share=share).transpose("swing", "sample")
    width = np.array([valves.upper(swing) for swing in SWINGS[1:]])
    seen = ds.hunting_swing / width > SEEN * valves.plant.gain
    per_width = ds.hunting_swing / np.where(width > less, width - less, np.nan)
    given = (valves.plant, valves.kp, valves.ti)
    return Cycles(
        xr.DataArray(phase(*given) < 0.5 * np.pi, dims="sample") & (ds.hunting_swing == ds.hunting_swing),
        seen,
        (per_width / swing_per_buffer(*given)).where(seen),
        (per_width / valves.plant.gain).where(seen),
        (per_width / cycle(*given).swing).where(seen),
        (ds.hunting_period * frequency(*given) / (2.0 * np.pi)).where(seen),
    )


def cycle_row(name: str, c: Cycles) -> list[str]:
    """A row of the buffer's cycle."""
    near = abs(np.log(c.swing)) <= np.log(NEAR)
    return [
        name,
        str(share_of((c.seen & ~c.predicted).rename(swing="day"))),
        f"{float(c.predicted.mean()):.0%}, {float((c.seen & c.predicted).mean()):.0%}",
        across(c.swing),
        str(share_of(near.rename(swing="day"), c.seen.rename(swing="day"))),
        across(c.by_gain),
        across(c.by_theory),
        across(c.period),
    ]


def write_cycles(runs: Runs) -> None:
    """The buffer's own cycle against formula and theory."""
    table = []
    for heats, ds in runs.still.items():
        for share, size in reversed(list(enumerate(SHARES))):
            name = f"{'heating' if heats else 'cooling'}, inverse of {100 * size:g} %"
            table.append(cycle_row(name, cycles(runs.valves[heats], ds, share)))
        valves, mode = runs.valves[heats], "heating" if heats else "cooling"
        corrected = cycles(valves, ds, 0, HALF_MISSED * missed(valves, 0))
        table.append(cycle_row(f"{mode}, {100 * SHARES[0]:g} %, b less half of what is missed", corrected))
        good = valves.backlash == 0.0
        if good.any():
            exact = Cycles(*(part.isel(sample=good) for part in cycles(valves, ds, 0)))
            table.append(cycle_row(f"{mode}, no backlash", exact))
    write_table(
        "buffer/buffer_cycle",
        f"The buffer's own cycle where nothing else moves the loop: {len(runs.valves[False].kp)} fresh valves and "
        f"loops, buffers for swings of {', '.join(f'{s:g}' for s in SWINGS[1:])} K",
        ["loop", "seen, not predicted", "predicted, predicted and seen", "swing / formula (5 %, median, 95 %)",
         f"within a factor of {NEAR:g}", "swing / (K b)", "swing / describing function", "period / formula"],
        table,
    )  # fmt: skip


def upper_row(name: str, ds: xr.Dataset, among: Any = None) -> list[str]:
    """A row of the upper bound, from days of one kind or one estimate."""
    d = (ds if among is None else ds.isel(sample=among)).transpose("swing", "sample", "day")
    error = d.rmse_settled.mean("day")
    rise = 100.0 * (error / error.isel(swing=0) - 1.0)
    excess = np.sqrt((error**2 - error.isel(swing=0) ** 2).clip(0.0)) / xr.DataArray(
        [np.nan, *SWINGS[1:]], dims="swing"
    )
    cells = []
    for k in range(1, len(SWINGS)):
        at, hunting = rise.isel(swing=k), float(d.hunts.isel(swing=k).mean())
        cells.append(f"{float(at.median()):+.0f} %, {float(at.quantile(0.95)):+.0f} %, {hunting:.0%}")
    settled = f"{float(error.isel(swing=0).median()):.3f}"
    return [name, settled, *cells, across(excess.isel(swing=SWINGS.index(0.2)))]


def write_upper(runs: Runs) -> None:
    """What buffers for these swings cost on days as they are."""
    table = []
    for kind, ds in runs.upper.items():
        table += [
            upper_row(f"{kind}, inverse of {100 * size:g} %", ds.isel(share=share)) for share, size in enumerate(SHARES)
        ]
    kind, exact = CONSTANT, len(SHARES) - 1
    valves = runs.of(kind)
    predicted = phase(valves.plant, valves.kp, valves.ti) < 0.5 * np.pi
    for which, words in ((predicted, "a cycle predicted"), (~predicted, "none predicted")):
        if which.any():
            table.append(upper_row(f"{kind}, inverse of 100 %, {words}", runs.upper[kind].isel(share=exact), which))
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
    found = [cycles(runs.valves[heats], ds, len(SHARES) - 1).swing.values for heats, ds in runs.still.items()]
    return UPPER_SCALE * np.concatenate(found).T
