"""What the backlash does: whether a loop hunts, how much, with which period, and whether somebody must start it.

The metric ``hunts`` asks for a swing of 0.1 K.  Here a loop cycles where its swing lasts, however small: it does not
shrink from the third quarter of the day to the last.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.analysis.paired import mean_of, share_of
from studies.common import write_table
from studies.hunting.loops import OPERATING, acting, conditions, joined, valves
from studies.hunting.plants import foreseen

SIZES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
SEEN, HOURS = 20, 8
"""Seconds between samples of the temperature; hours of a day."""
LASTS = 0.8
"""Swing in the last quarter of the day over that of the quarter before, which a decay stays below."""
LEAST = 1e-3
"""K: a smaller swing is none; and none of a loop with backlash lies below 2 % of backlash × gain."""
BANDS = ((0.0, 0.6), (0.6, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 1.0), (1.0, 1.2), (1.2, np.inf))


def cycling(T: xr.DataArray, least: xr.DataArray) -> xr.Dataset:
    """Whether the swing of a temperature lasts, its size, peak to peak, K, and its period, s."""
    n = T.sizes["elapsed_time"] // 4
    before, last = (T.isel(elapsed_time=slice(k * n, (k + 1) * n)) for k in (2, 3))
    sizes = [part.max("elapsed_time") - part.min("elapsed_time") for part in (before, last)]
    e = last - last.mean("elapsed_time")
    up = ((e.values[..., :-1] < 0.0) & (e.values[..., 1:] >= 0.0)).sum(-1)
    of = tuple(d for d in e.dims if d != "elapsed_time")
    times = xr.DataArray(np.where(up > 1, n * SEEN / np.maximum(up, 1), np.nan), dims=of)
    lasts = (sizes[1] >= LASTS * sizes[0]) & (sizes[1] > np.maximum(least, LEAST)) & (times.notnull())
    return xr.Dataset({"cycles": lasts, "swing": sizes[1], "period": times})


def run(seed: int, size: int, days: int) -> xr.Dataset:
    """The same loops with every size of backlash: (sample, backlash, day)."""
    parts = {}
    for kind in OPERATING:
        loop = acting(valves(seed, size), kind).assign(backlash=list(SIZES))
        day = conditions(kind, seed + 1, days, HOURS)
        plant = foreseen(loop, day)
        ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=SEEN)
        T = ds.T_sup.transpose("sample", "backlash", "day", "elapsed_time").drop_vars("day")
        found = cycling(T, 0.02 * T.backlash * plant.K)
        parts[kind] = xr.merge([plant, found, ds.hunts], compat="override", join="override").reset_coords(drop=True)
    return joined(parts)


def slopes(of: xr.DataArray, among: xr.DataArray) -> tuple[float, float, float]:
    """Power of the backlash with which something grows: mean over loops, interval over valves and conditions."""
    part = of.sel(backlash=of.backlash > 0.0).where(among)
    x = np.log(part.backlash)
    x = x - x.mean()
    each = (x * np.log(part)).sum("backlash", skipna=False) / float((x**2).sum())
    middle, half = mean_of(each)
    return middle, middle - half, middle + half


def quantiles(of: xr.DataArray, form: str = "{:.2g}") -> str:
    """Median, 10 and 90 % of the loops."""
    low, middle, high = (form.format(float(of.quantile(q))) for q in (0.1, 0.5, 0.9))
    return f"{middle} ({low} to {high})"


def write(ds: xr.Dataset, limit: float) -> None:
    """Write whether, how much and how fast, by backlash; limit: of the margin."""
    ok = ds.reachable.astype(bool).all("backlash") & ds.hunts.notnull().all("backlash")
    at_one, good = ds.sel(backlash=0.01), ds.sel(backlash=0.0)
    of_gap = (ds.cycles | (ds.backlash == 0.0)).all("backlash") & ~good.cycles & ok
    warned = ok & (good.margin > limit) & ~good.cycles
    table = []
    for size in SIZES:
        at = ds.sel(backlash=size)
        differs = (at.cycles != at_one.cycles) & ok
        row = [f"{size:.0%}", str(share_of(at.cycles, ok)), str(share_of(at.hunts > 0, ok))]
        row += ["0" if size == 0.01 else share_of(differs & way, ok).written(1) for way in (at.cycles, ~at.cycles)]
        if size:
            scaled = (at.swing / (size * at.K)).where(of_gap)
            row += [f"{quantiles(at.swing.where(of_gap))} K", quantiles(scaled)]
            row += [quantiles((at.period / at_one.period).where(of_gap))]
        table.append(row if size else [*row, "—", "—", "—"])
    grows, changes = slopes(ds.swing, of_gap), slopes(ds.period, of_gap)
    write_table(
        "hunting/hunting_backlash",
        f"The same {ds.sizes['sample']} loops × {ds.sizes['day']} conditions with every backlash; {int(ok.sum()):,} "
        f"can hold their set-point.  Of those that cycle with every gap, but not without ({int(of_gap.sum()):,}), the "
        f"swing grows with the backlash to the power {grows[0]:.2f} ({grows[1]:.2f} to {grows[2]:.2f}), the period "
        f"to the power {changes[0]:.2f} ({changes[1]:.2f} to {changes[2]:.2f}); medians, 10 and 90 %.  "
        f"Of those that are calm without a gap and have a margin above {limit:g} ({int(warned.sum()):,}) "
        f"{share_of(at_one.cycles, warned)} cycle with one of 1 %",
        ["backlash X", "cycle", "hunt, over 0.1 K", "cycle, but not at 1 %", "do not, but at 1 %",
         "swing, peak to peak", "swing / (X K)", "period / that at 1 %"],
        table,
    )  # fmt: skip


def write_bands(ds: xr.Dataset) -> None:
    """Write what becomes of a loop by its margin, at the sizes of backlash."""
    at_all = ds.margin.sel(backlash=0.07, drop=True)
    ok = ds.reachable.astype(bool).all("backlash")
    table = []
    for low, high in BANDS:
        inside = ok & (at_all >= low) & (at_all < high)
        if not bool(inside.any()):
            continue
        worn = ds.sel(backlash=0.07)
        shares = [share_of(ds.cycles.sel(backlash=x), inside).written(0) for x in (0.0, 0.01, 0.03, 0.07, 0.15)]
        scaled = worn.swing / (0.07 * worn.K)
        calm = not bool((inside & worn.cycles).any())
        table.append(
            [f"{low:g} to {high:g}", f"{int(inside.sum()):,}", *shares,
             "—" if calm else quantiles(scaled.where(inside & worn.cycles)),
             "—" if calm else quantiles((worn.period / (worn["T"] + worn.theta)).where(inside & worn.cycles))]
        )  # fmt: skip
    write_table(
        "hunting/hunting_bands",
        f"What becomes of a loop, by its margin at 7 %: {ds.sizes['sample']} loops × {ds.sizes['day']} conditions",
        ["margin", "loops", *(f"cycle at X = {x:.0%}" for x in (0.0, 0.01, 0.03, 0.07, 0.15)),
         "swing / (X K) at 7 %", "period / (T + θ) at 7 %"],
        table,
    )  # fmt: skip
