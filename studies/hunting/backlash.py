"""What size of backlash, kicks, motor, sensor and controller do to a loop that may hunt.

The metric ``hunts`` requires a swing of 0.1 K.  Here a loop cycles where its swing lasts, however small: it does not
shrink from the third quarter of the day to the last.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import along, mean_of, pooled, share_of, write_table
from studies.days import HEATING
from studies.hunting.loops import OPERATING, SERIES, acting, conditions, foreseen, valves

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


def run_backlash(seed: int, size: int, days: int) -> xr.Dataset:
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
    return pooled(parts, data_vars="all")


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


def write_backlash(ds: xr.Dataset, limit: float) -> None:
    """Write whether, how much and how fast, by backlash; limit: of the hunting index."""
    ok = ds.reachable.astype(bool).all("backlash") & ds.hunts.notnull().all("backlash")
    at_one, good = ds.sel(backlash=0.01), ds.sel(backlash=0.0)
    of_gap = (ds.cycles | (ds.backlash == 0.0)).all("backlash") & ~good.cycles & ok
    warned = ok & (good.hunting_index > limit) & ~good.cycles
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
        f"Hunting by size of backlash: {ds.sizes['sample']} loops × {ds.sizes['day']} conditions, each with every "
        f"backlash; {int(ok.sum()):,} can hold their set-point.  Of those that cycle with every gap, but not without "
        f"({int(of_gap.sum()):,}), the swing grows with the backlash to the power {grows[0]:.2f} ({grows[1]:.2f} to "
        f"{grows[2]:.2f}), the period to the power {changes[0]:.2f} ({changes[1]:.2f} to {changes[2]:.2f}); medians, "
        "10 and 90 %.  "
        f"Of those that are calm without a gap and have a hunting index above {limit:g} ({int(warned.sum()):,}) "
        f"{share_of(at_one.cycles, warned)} cycle with one of 1 %",
        ["backlash X", "cycle", "hunt, over 0.1 K", "cycle, but not at 1 %", "do not, but at 1 %",
         "swing, peak to peak", "swing / (X K)", "period / that at 1 %"],
        table,
    )  # fmt: skip


def write_bands(ds: xr.Dataset) -> None:
    """Write what becomes of a loop by its hunting index, at the sizes of backlash."""
    at_all = ds.hunting_index.sel(backlash=0.07, drop=True)
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
        f"How loops behave, by their hunting index at 7 % backlash: {ds.sizes['sample']} loops × {ds.sizes['day']} conditions",
        ["hunting_index", "loops", *(f"cycle at X = {x:.0%}" for x in (0.0, 0.01, 0.03, 0.07, 0.15)),
         "swing / (X K) at 7 %", "period / (T + θ) at 7 %"],
        table,
    )  # fmt: skip


RAMP, HOLD, KICK, AFTER = 6, 2, 1, 6
"""Hours: the set-point comes slowly from the temperature of the air, stands still, is elsewhere, and back."""
KICKS = (0.0, 0.1, 0.3, 1.0, 3.0)
"""K"""
START_BANDS = ((0.0, 0.8), (0.8, 0.9), (0.9, 1.0), (1.0, 1.2), (1.2, 2.0), (2.0, np.inf))


def kicked(kind: str, seed: int, days: int) -> tuple[fc.Boundary, fc.Boundary]:
    """Days with each kick, (condition × kick), and the conditions themselves.

    The set-point comes from the temperature of the entering air, with the valve closed, to that of the condition, so
    the valve moves one way only.  The kick asks for more load for a while.
    """
    still = conditions(kind, seed, days, 1)
    t = np.arange(3600 * (RAMP + HOLD + KICK + AFTER)) / 3600
    come, away = np.clip(t / RAMP, 0.0, 1.0), (t >= RAMP + HOLD) & (t < RAMP + HOLD + KICK)
    of_all = {name: np.repeat(still.series[name][:, 0], len(KICKS))[:, None] for name in SERIES}
    start, end = of_all["T_a_in"], of_all["T_set"]
    more = np.tile(KICKS, days)[:, None] * (1.0 if kind == HEATING else -1.0)
    series = {name: values * np.ones(t.size) for name, values in of_all.items()}
    return fc.Boundary(**{**series, "T_set": start + (end - start) * come + more * away}), still


def run_start(seed: int, size: int, days: int) -> xr.Dataset:
    """Whether each loop cycles in the end: (sample, day, kick); valves without backlash are left out."""
    parts = {}
    for kind in OPERATING:
        loop = acting(valves(seed, size), kind)
        of_kicks, still = kicked(kind, seed + 1, days)
        ds = fc.simulate(loop, of_kicks, traces=["T_sup"], trace_interval=SEEN)
        T = ds.T_sup.transpose("sample", "day", "elapsed_time").drop_vars("day")
        shape = (T.sizes["sample"], days, len(KICKS), T.sizes["elapsed_time"])
        folded = xr.DataArray(T.values.reshape(shape), dims=("sample", "day", "kick", "elapsed_time"))
        plant = foreseen(loop, still)
        late = folded.isel(elapsed_time=slice(-4 * (3600 * (AFTER - 1) // SEEN // 2), None))
        X = xr.DataArray(loop["backlash"], dims="sample").reset_coords(drop=True)
        found = cycling(late, 0.02 * X * plant.K.drop_vars("day")).assign(backlash=X)
        parts[kind] = xr.merge([plant.drop_vars("day"), found]).assign_coords(kick=list(KICKS), day=range(days))
    return pooled(parts, data_vars="all")


def write_start(ds: xr.Dataset) -> None:
    """Write the share that cycles by hunting index and kick."""
    ok, table = ds.reachable.astype(bool) & (ds.backlash > 0.0), []
    for low, high in START_BANDS:
        inside = ok & (ds.hunting_index >= low) & (ds.hunting_index < high)
        if not bool(inside.any()):
            continue
        cells = [str(share_of(ds.cycles.sel(kick=kick, drop=True), inside)) for kick in KICKS]
        table.append([f"{low:g} to {high:g}", f"{int(inside.sum()):,}", *cells])
    any_kick = ds.cycles.any("kick") & ok
    alone = str(share_of(ds.cycles.sel(kick=0.0, drop=True), any_kick))
    write_table(
        "hunting/hunting_start",
        f"Does a cycle need a disturbance to start?  The loop reaches its set-point over {RAMP} h without reversing "
        "the valve and rests; the set-point is then moved for one hour (the kick).  Share of loops that cycle at the "
        f"end of {AFTER} more hours; of those that cycle after any kick {alone} do without one",
        ["hunting_index", "loops", *(f"kick {kick:g} K" if kick else "no kick" for kick in KICKS)],
        table,
    )


BASE = {"sensor_time_constant": 30.0, "stroke_time": 90.0, "sample_time": 10.0, "backlash": 0.05, "noise_std": 0.0}
CHANGES: dict[str, dict[str, float]] = {
    "as it is: sensor 30 s, stroke 90 s, sample 10 s, X 5 %": {},
    "sensor lag 5 s": {"sensor_time_constant": 5.0},
    "sensor lag 60 s": {"sensor_time_constant": 60.0},
    "sample time 1 s": {"sample_time": 1.0},
    "sample time 30 s": {"sample_time": 30.0},
    "sample time 60 s": {"sample_time": 60.0},
    "stroke 15 s": {"stroke_time": 15.0},
    "stroke 300 s": {"stroke_time": 300.0},
    "backlash 1 %": {"backlash": 0.01},
    "backlash 15 %": {"backlash": 0.15},
    "noise 0.05 K": {"noise_std": 0.05},
    "ti × 2": {"ti": 2.0},
    "ti × 4": {"ti": 4.0},
}
KP = np.geomspace(0.004, 0.4, 24)
TI = (6.0, 100.0)
PARTS_HOURS, WARM_UP = 6, 2 * 3600


def run_parts(seed: int, size: int, days: int) -> xr.Dataset:
    """Largest calm kp, simulated and foreseen: (change, sample, day)."""
    ti = np.exp(np.random.default_rng([seed, 3]).uniform(*np.log(TI), size))
    loop = valves(seed, size).assign(kp=1.0, ti=("sample", ti), **BASE)
    parts = {}
    for kind in OPERATING:
        day = conditions(kind, seed + 1, days, PARTS_HOURS)
        found = {}
        for name, change in CHANGES.items():
            given = {n: v * xr.DataArray(loop["ti"]) if n == "ti" else v for n, v in change.items()}
            one = acting(loop.assign(**given), kind)
            plant = foreseen(one, day)
            scale = xr.DataArray(one["kp"])
            hunts = fc.simulate(one.assign(kp=scale * xr.DataArray(KP, dims="kp_tried")), day, warm_up=WARM_UP).hunts
            hunts = hunts.reset_coords(drop=True) > 0
            simulated = xr.where(hunts.any("kp_tried"), scale * KP[0] * _first(hunts), np.nan)
            ok = plant.reachable.astype(bool) & ~hunts.isel(kp_tried=0, drop=True)
            found[name] = xr.Dataset({"simulated": simulated, "foreseen": scale / plant.hunting_index, "ok": ok})
        parts[kind] = along("change", found)
    return pooled(parts, data_vars="all")


def _first(hunts: xr.DataArray) -> xr.DataArray:
    """First kp that hunts over the lowest kp tried."""
    return xr.DataArray(KP / KP[0], dims="kp_tried").isel(kp_tried=hunts.argmax("kp_tried"))


def change_of(of: xr.DataArray, ok: xr.DataArray) -> str:
    """Mean change of the logarithm with its interval over valves and conditions, as a percentage."""
    d = np.log(of).where(ok)
    middle, half = mean_of(d)
    value, low, high = (100.0 * np.expm1(x) for x in (middle, middle - half, middle + half))
    return f"{value:+.0f} % ({low:+.0f} to {high:+.0f})"


def write_parts(ds: xr.Dataset) -> None:
    """Write the change of the largest calm kp with each part."""
    base, table = ds.isel(change=0, drop=True), []
    for name in list(CHANGES)[1:]:
        at = ds.sel(change=name, drop=True)
        simulated, predicted = at.simulated / base.simulated, at.foreseen / base.foreseen
        ok = at.ok & base.ok & simulated.notnull()
        ratio = (simulated / predicted).where(ok)
        table.append([name, f"{int(ok.sum()):,}", change_of(simulated, ok), change_of(predicted, ok),
                      f"{float(ratio.quantile(0.1)):.2f} to {float(ratio.quantile(0.9)):.2f}"])  # fmt: skip
    write_table(
        "hunting/hunting_parts",
        f"Change of the lowest kp at which a loop hunts, against {list(CHANGES)[0].removeprefix('as it is: ')}: "
        f"{ds.sizes['sample']} loops × {ds.sizes['day']} conditions, geometric mean (95 % over valves and conditions)",
        ["change", "loops", "simulated", "predicted from the hunting index", "simulated over predicted, 10 to 90 %"],
        table,
    )
