"""What size of backlash, kicks, motor, sensor and controller do to a loop that may hunt.

The metric ``hunts`` requires a swing of 0.1 K.  Here a loop cycles where its swing lasts, however small: it does not
shrink from the third quarter of the day to the last.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import concat_along, mean_of, pool_days, share_of, write_table
from studies.days import HEATING
from studies.hunting.loops import OPERATING_KINDS, SERIES_NAMES, adapt_to_kind, conditions, loop_properties, valves

BACKLASH_SIZES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
TRACE_INTERVAL = 20  # seconds between samples of the temperature
HOURS = 8  # hours of a day
LASTING_RATIO = 0.8  # swing in the last quarter of the day over that of the quarter before, which a decay stays below
LEAST_SWING = 1e-3  # K: a smaller swing is none; and none of a loop with backlash lies below 2 % of backlash × gain
INDEX_BANDS = ((0.0, 0.6), (0.6, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 1.0), (1.0, 1.2), (1.2, np.inf))


def measure_cycles(T: xr.DataArray, least: xr.DataArray) -> xr.Dataset:
    """Measure whether the swing of a temperature lasts, its size, peak to peak, K, and its period, s."""
    n = T.sizes["elapsed_time"] // 4
    quarter_before, last_quarter = (T.isel(elapsed_time=slice(k * n, (k + 1) * n)) for k in (2, 3))
    sizes = [part.max("elapsed_time") - part.min("elapsed_time") for part in (quarter_before, last_quarter)]
    e = last_quarter - last_quarter.mean("elapsed_time")
    upcrossings = ((e.values[..., :-1] < 0.0) & (e.values[..., 1:] >= 0.0)).sum(-1)
    dims = tuple(d for d in e.dims if d != "elapsed_time")
    periods = xr.DataArray(
        np.where(upcrossings > 1, n * TRACE_INTERVAL / np.maximum(upcrossings, 1), np.nan), dims=dims
    )
    is_lasting = (
        (sizes[1] >= LASTING_RATIO * sizes[0]) & (sizes[1] > np.maximum(least, LEAST_SWING)) & (periods.notnull())
    )
    return xr.Dataset({"cycles": is_lasting, "swing": sizes[1], "period": periods})


def run_backlash(seed: int, size: int, days: int) -> xr.Dataset:
    """Run the same loops with every size of backlash: (sample, backlash, day)."""
    parts = {}
    for kind in OPERATING_KINDS:
        loop = adapt_to_kind(valves(seed, size), kind).assign(backlash=list(BACKLASH_SIZES))
        day = conditions(kind, seed + 1, days, HOURS)
        plant = loop_properties(loop, day)
        ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=TRACE_INTERVAL)
        T = ds.T_sup.transpose("sample", "backlash", "day", "elapsed_time").drop_vars("day")
        cycles = measure_cycles(T, 0.02 * T.backlash * plant.K)
        parts[kind] = xr.merge([plant, cycles, ds.hunts], compat="override", join="override").reset_coords(drop=True)
    return pool_days(parts, data_vars="all")


def fit_power(values: xr.DataArray, among: xr.DataArray) -> tuple[float, float, float]:
    """Fit the power of the backlash with which ``values`` grow: mean over loops, with its interval."""
    part = values.sel(backlash=values.backlash > 0.0).where(among)
    x = np.log(part.backlash)
    x = x - x.mean()
    powers = (x * np.log(part)).sum("backlash", skipna=False) / float((x**2).sum())
    middle, half = mean_of(powers)
    return middle, middle - half, middle + half


def format_quantiles(values: xr.DataArray, template: str = "{:.2g}") -> str:
    """Format median, 10 and 90 % of the loops."""
    low, middle, high = (template.format(float(values.quantile(q))) for q in (0.1, 0.5, 0.9))
    return f"{middle} ({low} to {high})"


def write_backlash(ds: xr.Dataset, limit: float) -> None:
    """Write whether, how much and how fast, by backlash; limit: of the hunting index."""
    is_valid = ds.reachable.astype(bool).all("backlash") & ds.hunts.notnull().all("backlash")
    at_one_percent, without_gap = ds.sel(backlash=0.01), ds.sel(backlash=0.0)
    is_gap_cycle = (ds.cycles | (ds.backlash == 0.0)).all("backlash") & ~without_gap.cycles & is_valid
    is_warned = is_valid & (without_gap.hunting_index > limit) & ~without_gap.cycles
    table = []
    for size in BACKLASH_SIZES:
        at_size = ds.sel(backlash=size)
        differs = (at_size.cycles != at_one_percent.cycles) & is_valid
        row = [f"{size:.0%}", str(share_of(at_size.cycles, is_valid)), str(share_of(at_size.hunts > 0, is_valid))]
        row += [
            "0" if size == 0.01 else share_of(differs & direction, is_valid).to_text(1)
            for direction in (at_size.cycles, ~at_size.cycles)
        ]
        if size:
            swing_per_gap = (at_size.swing / (size * at_size.K)).where(is_gap_cycle)
            row += [f"{format_quantiles(at_size.swing.where(is_gap_cycle))} K", format_quantiles(swing_per_gap)]
            row += [format_quantiles((at_size.period / at_one_percent.period).where(is_gap_cycle))]
        table.append(row if size else [*row, "—", "—", "—"])
    swing_power, period_power = fit_power(ds.swing, is_gap_cycle), fit_power(ds.period, is_gap_cycle)
    write_table(
        "hunting/hunting_backlash",
        f"Hunting by size of backlash: {ds.sizes['sample']} loops × {ds.sizes['day']} conditions, each with every "
        f"backlash; {int(is_valid.sum()):,} can hold their set-point.  Of those that cycle with every gap, but not "
        "without "
        f"({int(is_gap_cycle.sum()):,}), the swing grows with the backlash to the power {swing_power[0]:.2f} "
        f"({swing_power[1]:.2f} to "
        f"{swing_power[2]:.2f}), the period to the power {period_power[0]:.2f} ({period_power[1]:.2f} to "
        f"{period_power[2]:.2f}); medians, "
        "10 and 90 %.  "
        f"Of those that are calm without a gap and have a hunting index above {limit:g} ({int(is_warned.sum()):,}) "
        f"{share_of(at_one_percent.cycles, is_warned)} cycle with one of 1 %",
        [
            "backlash X",
            "cycle",
            "hunt, over 0.1 K",
            "cycle, but not at 1 %",
            "do not, but at 1 %",
            "swing, peak to peak",
            "swing / (X K)",
            "period / that at 1 %",
        ],
        table,
    )


def write_bands(ds: xr.Dataset) -> None:
    """Write what becomes of a loop by its hunting index, at the sizes of backlash."""
    hunting_index = ds.hunting_index.sel(backlash=0.07, drop=True)
    is_valid = ds.reachable.astype(bool).all("backlash")
    table = []
    for low, high in INDEX_BANDS:
        inside = is_valid & (hunting_index >= low) & (hunting_index < high)
        if not bool(inside.any()):
            continue
        worn = ds.sel(backlash=0.07)
        shares = [share_of(ds.cycles.sel(backlash=x), inside).to_text(0) for x in (0.0, 0.01, 0.03, 0.07, 0.15)]
        swing_per_gap = worn.swing / (0.07 * worn.K)
        is_calm = not bool((inside & worn.cycles).any())
        table.append(
            [f"{low:g} to {high:g}", f"{int(inside.sum()):,}", *shares,
             "—" if is_calm else format_quantiles(swing_per_gap.where(inside & worn.cycles)),
             "—" if is_calm else format_quantiles((worn.period / (worn["T"] + worn.theta)).where(inside & worn.cycles))]
        )  # fmt: skip
    write_table(
        "hunting/hunting_bands",
        f"How loops behave, by their hunting index at 7 % backlash: {ds.sizes['sample']} loops × {ds.sizes['day']} "
        "conditions",
        [
            "hunting index",
            "loops",
            *(f"cycle at X = {x:.0%}" for x in (0.0, 0.01, 0.03, 0.07, 0.15)),
            "swing / (X K) at 7 %",
            "period / (T + θ) at 7 %",
        ],
        table,
    )


RAMP_HOURS, HOLD_HOURS, KICK_HOURS, AFTER_HOURS = 6, 2, 1, 6
"""Hours: the set-point comes slowly from the temperature of the air, stands still, is elsewhere, and back."""
KICK_SIZES = (0.0, 0.1, 0.3, 1.0, 3.0)  # of the set-point, K
START_BANDS = ((0.0, 0.8), (0.8, 0.9), (0.9, 1.0), (1.0, 1.2), (1.2, 2.0), (2.0, np.inf))


def make_kicked_days(kind: str, seed: int, days: int) -> tuple[fc.Boundary, fc.Boundary]:
    """Days with each kick, (condition × kick), and the conditions themselves.

    The set-point comes from the temperature of the entering air, with the valve closed, to that of the condition, so
    the valve moves one way only.  The kick asks for more load for a while.
    """
    still_days = conditions(kind, seed, days, 1)
    t = np.arange(3600 * (RAMP_HOURS + HOLD_HOURS + KICK_HOURS + AFTER_HOURS)) / 3600
    ramp_share, is_kicked = (
        np.clip(t / RAMP_HOURS, 0.0, 1.0),
        (t >= RAMP_HOURS + HOLD_HOURS) & (t < RAMP_HOURS + HOLD_HOURS + KICK_HOURS),
    )
    by_kick = {name: np.repeat(still_days.series[name][:, 0], len(KICK_SIZES))[:, None] for name in SERIES_NAMES}
    start, end = by_kick["T_a_in"], by_kick["T_set"]
    kicks = np.tile(KICK_SIZES, days)[:, None] * (1.0 if kind == HEATING else -1.0)
    series = {name: values * np.ones(t.size) for name, values in by_kick.items()}
    return fc.Boundary(**{**series, "T_set": start + (end - start) * ramp_share + kicks * is_kicked}), still_days


def run_start(seed: int, size: int, days: int) -> xr.Dataset:
    """Run the kicks: whether each loop cycles in the end, (sample, day, kick); only valves with backlash."""
    parts = {}
    for kind in OPERATING_KINDS:
        loop = adapt_to_kind(valves(seed, size), kind)
        kicked_days, still_days = make_kicked_days(kind, seed + 1, days)
        ds = fc.simulate(loop, kicked_days, traces=["T_sup"], trace_interval=TRACE_INTERVAL)
        T = ds.T_sup.transpose("sample", "day", "elapsed_time").drop_vars("day")
        shape = (T.sizes["sample"], days, len(KICK_SIZES), T.sizes["elapsed_time"])
        folded = xr.DataArray(T.values.reshape(shape), dims=("sample", "day", "kick", "elapsed_time"))
        plant = loop_properties(loop, still_days)
        last_hours = folded.isel(elapsed_time=slice(-4 * (3600 * (AFTER_HOURS - 1) // TRACE_INTERVAL // 2), None))
        X = xr.DataArray(loop["backlash"], dims="sample").reset_coords(drop=True)
        cycles = measure_cycles(last_hours, 0.02 * X * plant.K.drop_vars("day")).assign(backlash=X)
        parts[kind] = xr.merge([plant.drop_vars("day"), cycles]).assign_coords(kick=list(KICK_SIZES), day=range(days))
    return pool_days(parts, data_vars="all")


def write_start(ds: xr.Dataset) -> None:
    """Write the share that cycles by hunting index and kick."""
    is_valid, table = ds.reachable.astype(bool) & (ds.backlash > 0.0), []
    for low, high in START_BANDS:
        in_band = is_valid & (ds.hunting_index >= low) & (ds.hunting_index < high)
        if not bool(in_band.any()):
            continue
        cells = [str(share_of(ds.cycles.sel(kick=kick, drop=True), in_band)) for kick in KICK_SIZES]
        table.append([f"{low:g} to {high:g}", f"{int(in_band.sum()):,}", *cells])
    any_kick = ds.cycles.any("kick") & is_valid
    share_without_kick = str(share_of(ds.cycles.sel(kick=0.0, drop=True), any_kick))
    write_table(
        "hunting/hunting_start",
        f"Does a cycle need a disturbance to start?  The loop reaches its set-point over {RAMP_HOURS} h without "
        "reversing "
        "the valve and rests; the set-point is then moved for one hour (the kick).  Share of loops that cycle at the "
        f"end of {AFTER_HOURS} more hours; of those that cycle after any kick {share_without_kick} do without one",
        ["hunting index", "loops", *(f"kick {kick:g} K" if kick else "no kick" for kick in KICK_SIZES)],
        table,
    )


BASE_PARAMETERS = {
    "sensor_time_constant": 30.0,
    "stroke_time": 90.0,
    "sample_time": 10.0,
    "backlash": 0.05,
    "noise_std": 0.0,
}
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
PARTS_HOURS = 6
WARM_UP_SECONDS = 2 * 3600


def run_parts(seed: int, size: int, days: int) -> xr.Dataset:
    """Largest calm kp, simulated and foreseen: (change, sample, day)."""
    ti = np.exp(np.random.default_rng([seed, 3]).uniform(*np.log(TI), size))
    loop = valves(seed, size).assign(kp=1.0, ti=("sample", ti), **BASE_PARAMETERS)
    parts = {}
    for kind in OPERATING_KINDS:
        day = conditions(kind, seed + 1, days, PARTS_HOURS)
        by_change = {}
        for name, change in CHANGES.items():
            parameters = {n: v * xr.DataArray(loop["ti"]) if n == "ti" else v for n, v in change.items()}
            changed_loop = adapt_to_kind(loop.assign(**parameters), kind)
            plant = loop_properties(changed_loop, day)
            scale = xr.DataArray(changed_loop["kp"])
            hunts = fc.simulate(
                changed_loop.assign(kp=scale * xr.DataArray(KP, dims="kp_tried")), day, warm_up=WARM_UP_SECONDS
            ).hunts
            hunts = hunts.reset_coords(drop=True) > 0
            simulated = xr.where(hunts.any("kp_tried"), scale * KP[0] * _first_hunting_kp(hunts), np.nan)
            is_valid = plant.reachable.astype(bool) & ~hunts.isel(kp_tried=0, drop=True)
            by_change[name] = xr.Dataset(
                {"simulated": simulated, "foreseen": scale / plant.hunting_index, "ok": is_valid}
            )
        parts[kind] = concat_along("change", by_change)
    return pool_days(parts, data_vars="all")


def _first_hunting_kp(hunts: xr.DataArray) -> xr.DataArray:
    """First kp that hunts over the lowest kp tried."""
    return xr.DataArray(KP / KP[0], dims="kp_tried").isel(kp_tried=hunts.argmax("kp_tried"))


def format_mean_change(values: xr.DataArray, among: xr.DataArray) -> str:
    """Mean change of the logarithm with its interval over valves and conditions, as a percentage."""
    logarithms = np.log(values).where(among)
    middle, half = mean_of(logarithms)
    value, low, high = (100.0 * np.expm1(x) for x in (middle, middle - half, middle + half))
    return f"{value:+.0f} % ({low:+.0f} to {high:+.0f})"


def write_parts(ds: xr.Dataset) -> None:
    """Write the change of the largest calm kp with each part."""
    base, table = ds.isel(change=0, drop=True), []
    for name in list(CHANGES)[1:]:
        change_ds = ds.sel(change=name, drop=True)
        simulated, predicted = change_ds.simulated / base.simulated, change_ds.foreseen / base.foreseen
        is_valid = change_ds.ok & base.ok & simulated.notnull()
        ratio = (simulated / predicted).where(is_valid)
        table.append([name, f"{int(is_valid.sum()):,}", format_mean_change(simulated, is_valid),
                      format_mean_change(predicted, is_valid),
                      f"{float(ratio.quantile(0.1)):.2f} to {float(ratio.quantile(0.9)):.2f}"])  # fmt: skip
    write_table(
        "hunting/hunting_parts",
        f"Change of the lowest kp at which a loop hunts, against {list(CHANGES)[0].removeprefix('as it is: ')}: "
        f"{ds.sizes['sample']} loops × {ds.sizes['day']} conditions, geometric mean (95 % over valves and conditions)",
        ["change", "loops", "simulated", "predicted from the hunting index", "simulated over predicted, 10 to 90 %"],
        table,
    )
