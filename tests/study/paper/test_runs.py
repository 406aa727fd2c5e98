"""The simulations behind the figures: what their texts claim is what happens."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from fastcoil.loops.netcdf import load
from fastcoil.study.paper import grid
from fastcoil.study.paper import grid as runs

pytestmark = pytest.mark.kernel


def test_the_arithmetic_of_the_three_hours_is_what_happens(folder):
    literal = load(folder / "fig12.nc").sel(rule="literal")
    for hours, words, times in (
        (4.5, "= 4.5 h", literal.learn_time_reached),
        (5.5, "5.5 h until", literal.learn_time_confirmed),
    ):
        assert words in runs.arithmetic()
        np.testing.assert_array_equal(times, 3600.0 * hours)
    before = literal.estimate.sel(elapsed_time=slice(0, runs.THREE_HOURS - 1)).max("elapsed_time")
    np.testing.assert_allclose(before, 0.042)
    assert "4.2 % at most" in runs.arithmetic()


def test_switches_of_the_figure_are_those_of_the_metric(folder):
    ds = load(folder / "fig12.nc")
    counted = ds.switches.sel(block_start=slice(1800, None)).mean("block_start")
    np.testing.assert_allclose(counted.transpose(*ds.switch_frequency.dims), ds.switch_frequency)


def test_the_buffer_is_six_deviations_of_the_noise_on_the_output():
    loop = grid.tunings(quick=True)
    buffers = runs.buffers(xr.DataArray([0.0, 1.0], dims="case"), loop)
    np.testing.assert_allclose(buffers.isel(case=1), 6 * 0.05 * loop["kp"])
    assert (buffers.isel(case=0) == 1e-9).all()
