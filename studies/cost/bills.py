"""What valves pay, and their medians with intervals over other valves and other days."""

from __future__ import annotations

import warnings

import numpy as np
import xarray as xr

import fastcoil as fc

TARIFF = {"electricity": 0.13, "demand": 15.0, "heat": 0.05, "cop": 4.0, "currency": "USD"}
"""Round numbers near those of commercial customers in the United States; see ``docs/cost.md``."""
HEAT, PEAK, AIR, WITHOUT, EVENED, BILL, MONEY = "heat", "peak", "air", "without", "evened", "bill", "money"
RESAMPLES, AT_ONCE = 200, 20
HOURS = 7.5
"""Counted hours of a day."""


def bills(ds: xr.Dataset) -> xr.Dataset:
    """Per valve and year: heat of the coil (kWh), highest 15 min (kW), heat between air and set-point (kWh), money.

    without: what is paid if air off its set-point costs nothing.  evened: if rooms even it out over a day, so that only
    the day's mean has to be made up for.  Of several kinds of days along ``kind`` the mean.
    """
    net = ds.reheat_energy - ds.recool_energy
    evened = ds.assign(reheat_energy=net.clip(min=0.0), recool_energy=(-net).clip(min=0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # days of a kind have no dates
        c, of_evened = fc.cost(ds, **TARIFF), fc.cost(evened, **TARIFF)
    found = xr.Dataset(
        {
            HEAT: c.yearly_coil_energy,
            PEAK: ds.coil_peak_power.max("day"),
            AIR: c.yearly_reheat_energy + c.yearly_recool_energy,
            WITHOUT: c.yearly_coil_cost + c.yearly_demand_cost,
            EVENED: of_evened.yearly_cost,
            BILL: c.yearly_cost,
        }
    ).reset_coords(drop=True)
    return found.mean("kind") if "kind" in found.dims else found


def changes(bill: xr.Dataset, base: xr.Dataset) -> xr.Dataset:
    """Changes against the base, of the same valves.

    heat, peak, without, evened, bill: per cent of the base; air: per cent of the heat of its coil; money: of a year.
    """
    more = bill - base
    shares = [HEAT, PEAK, WITHOUT, EVENED, BILL]
    return (100.0 * more[shares] / base[shares]).assign({AIR: 100.0 * more[AIR] / base[HEAT], MONEY: more[BILL]})


def against_sound(ds: xr.Dataset) -> xr.Dataset:
    """Changes with each gap against the same valve and controller without one: (sample, controller, backlash)."""
    bill = bills(ds)
    return changes(bill, bill.sel(backlash=0.0, drop=True))


def against_found(ds: xr.Dataset, plain: str, backlash: float) -> xr.Dataset:
    """Changes with each controller against plain PI as found, of valves with this gap: (sample, controller)."""
    bill = bills(ds.sel(backlash=backlash, drop=True))
    return changes(bill, bill.sel(controller=plain, drop=True))


def spread(ds: xr.Dataset, measured, among: xr.DataArray | None = None, *more: object) -> xr.Dataset:
    """Median over valves with its interval, and what 5 and 95 % of the valves stay below, along ``statistic``.

    measured: makes changes per valve from metrics by day.  among: the valves that count.  The interval comes from
    valves and days drawn anew.
    """
    ds = ds if among is None else ds.isel(sample=np.flatnonzero(among.values))
    whole, draw = measured(ds, *more), np.random.default_rng(16499)
    n_days, n = ds.sizes["day"], ds.sizes["sample"]
    medians = []
    for _ in range(RESAMPLES // AT_ONCE):
        days = xr.DataArray(draw.integers(n_days, size=(AT_ONCE, n_days)), dims=("resample", "day"))
        other = measured(ds.drop_vars("day", errors="ignore").isel(day=days), *more)
        for k in range(AT_ONCE):
            medians.append(other.isel(resample=k, sample=draw.integers(n, size=n)).median("sample"))
    low, high = (xr.concat(medians, "resample").quantile(q, "resample", skipna=True) for q in (0.025, 0.975))
    parts = [whole.median("sample"), low, high, *(whole.quantile(q, "sample", skipna=True) for q in (0.05, 0.95))]
    names = xr.DataArray(["median", "low", "high", "q05", "q95"], dims="statistic", name="statistic")
    return xr.concat([part.drop_vars("quantile", errors="ignore") for part in parts], names, coords="minimal")


def written(of: xr.DataArray, digits: int = 1, unit: str = " %") -> str:
    """A median with its interval, from a cell of ``spread``."""
    value, low, high = (float(of.sel(statistic=s)) for s in ("median", "low", "high"))
    return f"{_signed(value, digits)}{unit} ({_signed(low, digits)} to {_signed(high, digits)})"


def between(of: xr.DataArray, digits: int = 1) -> str:
    """What 5 and 95 % of the valves stay below."""
    return " to ".join(_signed(float(of.sel(statistic=s)), digits) for s in ("q05", "q95"))


def _signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text
