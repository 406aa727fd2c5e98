"""The backlash from a trend log of 8 h at 10 s."""

from __future__ import annotations

import numpy as np
from conftest import Timed
from suite import QUICK

import fastcoil as fc
from fastcoil.measured.identify import identify_backlash

HOURS, INTERVAL = 2 if QUICK else 8, 10


def test_backlash_from_a_trend_log(timed: Timed) -> None:
    loop = fc.Loop.preset("lbnl").assign(backlash=0.07, noise_std=0.02, stroke_time=90.0)
    day = fc.paper_day(hours=HOURS, seed=1)
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], trace_interval=INTERVAL)
    T_set = np.asarray(day.series["T_set"], float).ravel()[::INTERVAL]
    series = [ds[name].values.astype(float) for name in ("command", "T_measured")]

    def run() -> float:
        return identify_backlash(*series, float(INTERVAL), T_set).backlash

    assert abs(timed(run, 20) - 0.07) <= 0.02
