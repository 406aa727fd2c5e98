"""Fits from a Dataset to the result: a valve, a coil on 8 h of seconds, and a coil on days of minutes with nights."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from conftest import Timed
from suite import QUICK

import fastcoil as fc

HOURS = 1.0 if QUICK else 8.0
NOISE = {"m_w": 0.02, "T_sup": 0.05}


def log(hours: float, seed: int) -> xr.Dataset:
    """A day in which command and air flow step every few minutes, with noise on flow and temperature."""
    n, rng = int(hours * 3600), np.random.default_rng(seed)
    day = {name: values[0] for name, values in fc.paper_day(hours=hours, seed=seed).series.items()}
    day["m_a"] = day["m_a"] * np.repeat(rng.uniform(0.5, 1.1, n // 600), 600)
    command = np.repeat(rng.uniform(0.1, 0.9, n // 300), 300)
    ds = fc.simulate(fc.Loop(), fc.Boundary(**day), command=command, traces=["command", "m_w", "T_sup"], warm_up=0)
    signals = ds[["command", "m_w", "T_sup"]]
    for name, unit in (("m_a", "kg/s"), ("T_a_in", "degC"), ("W_a_in", "1"), ("T_w_in", "degC")):
        signals[name] = ("elapsed_time", day[name], {"units": unit})
    return signals


def noisy(ds: xr.Dataset, name: str) -> xr.Dataset:
    noise = np.random.default_rng(0).normal(0.0, NOISE[name], ds.sizes["elapsed_time"])
    return ds.assign({name: np.maximum(ds[name] + noise, 0.0).assign_attrs(ds[name].attrs)})


def test_valve(timed: Timed) -> None:
    ds = noisy(log(HOURS, 1), "m_w").isel(elapsed_time=slice(None, None, 10))
    timed(lambda: fc.fit_valve(ds), 5)


@pytest.mark.timeout(600)
def test_coil_on_seconds(timed: Timed) -> None:
    ds = noisy(log(HOURS, 1), "T_sup")
    timed(lambda: fc.fit_coil(ds), 3)


@pytest.mark.timeout(600)
def test_coil_on_five_days_of_minutes(timed: Timed) -> None:
    """The nights between are gaps."""
    days = [log(HOURS, seed).isel(elapsed_time=slice(None, None, 60)) for seed in range(5)]
    shifted_days = [d.assign_coords(elapsed_time=d["elapsed_time"] + 86400.0 * k) for k, d in enumerate(days)]
    ds = noisy(xr.concat(shifted_days, "elapsed_time", combine_attrs="override"), "T_sup")
    ds["elapsed_time"].attrs["units"] = "s"
    timed(lambda: fc.fit_coil(ds, holds=["m_w", "m_a"]), 1)
