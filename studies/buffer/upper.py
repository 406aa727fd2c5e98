"""The upper bound of ``buffer.py`` against simulation: the buffer's own cycle, alone and on days as they are."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.study.analysis.paired import share_of
from studies.buffer.lower import NEAR, across
from studies.buffer.rule import UPPER_SCALE, cycle, frequency, phase, swing_per_buffer
from studies.buffer.run import SHARES, SWINGS, Runs, Valves
from studies.common import write_table
from studies.days import CONSTANT

HALF_MISSED = 0.5
"""Share of the play that is left which takes off the buffer; the formula is better by it."""
SEEN = 0.25
"""Swing over K b from which a cycle counts as seen."""


class Cycles(NamedTuple):
    """Of the days on which nothing changes: what is foretold, and what is seen; (swing, sample)."""

    foretold: xr.DataArray
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
        str(share_of((c.seen & ~c.foretold).rename(swing="day"))),
        f"{float(c.foretold.mean()):.0%}, {float((c.seen & c.foretold).mean()):.0%}",
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
        ["loop", "seen, not foretold", "foretold, foretold and seen", "swing / formula (5 %, median, 95 %)",
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
    foretold = phase(valves.plant, valves.kp, valves.ti) < 0.5 * np.pi
    for which, words in ((foretold, "a cycle foretold"), (~foretold, "none foretold")):
        if which.any():
            table.append(upper_row(f"{kind}, inverse of 100 %, {words}", runs.upper[kind].isel(share=exact), which))
    write_table(
        "buffer/buffer_upper",
        "The upper bound: settled RMSE behind buffers for a swing of so many K, against no buffer (median of the "
        f"valves, 95 % of them), and hunting; no noise, {len(valves.kp)} fresh valves and loops",
        ["days", "RMSE without buffer, K", *(f"{swing:g} K" for swing in SWINGS[1:]),
         "√(RMSE² - RMSE₀²) / swing at 0.2 K (5 %, median, 95 %)"],
        table,
    )  # fmt: skip


def upper_scales(runs: Runs) -> Any:
    """Swing over its formula without its factor, exact inverse, (n_valves, n); NaN where there is no cycle."""
    found = [cycles(runs.valves[heats], ds, len(SHARES) - 1).swing.values for heats, ds in runs.still.items()]
    return UPPER_SCALE * np.concatenate(found).T
