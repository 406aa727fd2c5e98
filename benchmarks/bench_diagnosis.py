"""The backlash from a trend log of 8 h at 10 s: the estimate alone, and the command in a process of its own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from bench_start import run_command
from conftest import Timed
from suite import QUICK

import fastcoil as fc
from fastcoil.measured.identify import identify_backlash

HOURS = 2 if QUICK else 8
INTERVAL = 10  # s


@pytest.fixture
def log() -> xr.Dataset:
    loop = fc.Loop.preset("lbnl").assign(backlash=0.07, noise_std=0.02, stroke_time=90.0)
    day = fc.paper_day(hours=HOURS, seed=1)
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], trace_interval=INTERVAL)
    T_set = np.asarray(day.series["T_set"], float).ravel()[::INTERVAL]
    return ds[["command", "T_measured"]].assign(T_set=("elapsed_time", T_set))


def test_backlash_from_a_trend_log(timed: Timed, log: xr.Dataset) -> None:
    series = [log[name].values.astype(float) for name in ("command", "T_measured")]

    def run() -> float:
        return identify_backlash(*series, float(INTERVAL), log["T_set"].values).backlash

    assert abs(timed(run, 20) - 0.07) <= 0.02


def test_diagnose_command(timed: Timed, log: xr.Dataset, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    table = np.column_stack([log["elapsed_time"], log["command"], log["T_measured"], log["T_set"]])
    np.savetxt(path, table, delimiter=",", header="elapsed_time [s],command [1],T_sup [degC],T_set [degC]", comments="")
    timed(lambda: run_command(sys.executable, "-m", "fastcoil", "diagnose", path), 5)
