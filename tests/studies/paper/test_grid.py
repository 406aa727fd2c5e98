"""The grid of tunings: its size, its presets, its long days; the same for any number of threads."""

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.loops.netcdf import load
from fastcoil.loops.presets import COOLING
from studies.paper import grid

pytestmark = pytest.mark.kernel


def test_the_grid_has_at_least_500_tunings_and_the_presets_by_name():
    loop = grid.tunings()
    assert loop.sizes["tuning"] >= 500
    assert grid.named(loop["kp"]["tuning"]) == list(COOLING)
    lbnl = loop["stroke_time"].sel(tuning="lbnl")
    assert float(lbnl) == fc.Loop.preset("lbnl")["stroke_time"]
    for start, step in grid.STARTS_AND_STEPS:
        updates = np.ceil((grid.BACKLASH - start) / step) + 2
        assert updates * grid.INTERVAL < grid.LONG_HOURS * 3600


STEPPED = {"stepped": grid.stepped}
TWO_KINDS = STEPPED | {"constant": grid.constant}


def few(*names):
    """The tunings of these presets."""
    values = {n: grid.tunings(quick=True)[n].sel(tuning=list(names)) for n in (*grid.GAINS, *grid.PLANT)}
    return fc.Loop(**values)


def test_tunings_differ_in_nothing_but_their_gains_and_what_the_gains_are_for():
    varied = {n for preset in COOLING.values() for n in preset.values}
    assert varied == {*grid.GAINS, *grid.PLANT}


def test_a_kind_of_day_with_large_errors_counts_no_more_than_one_with_small_ones():
    error = xr.DataArray([[[[1.0], [1.2], [np.nan]]], [[[0.2], [0.1], [0.05]]]], dims=("kind", "day", "kp", "ti"))
    cost = grid.relative_cost(error).values.ravel()
    np.testing.assert_allclose(cost, [(1.0 + 4.0) / 2, (1.2 + 2.0) / 2, np.inf])


def test_days_of_a_kind_are_those_of_a_simulation_of_their_own(monkeypatch):
    monkeypatch.setattr(grid, "DAYS", (7, 8))
    loop = few("lbnl")
    best = {"best PI": loop.assign(kp=0.1, ti=100.0), "best inverse": loop.assign(kp=0.05, ti=50.0)}
    ds = grid.on_days(loop, best, TWO_KINDS).isel(tuning=0)
    lbnl = fc.Loop.preset("lbnl").assign(backlash=0.07)
    wanted = {
        "95 %": lbnl.assign(estimate_ratio=0.95),
        "dead band": lbnl.assign(error_dead_band=grid.DEAD_BAND),
        "best PI, noise": lbnl.assign(kp=0.1, ti=100.0, noise_std=grid.NOISE),
        "best PI, 95 %": lbnl.assign(kp=0.1, ti=100.0, estimate_ratio=0.95),
        "best inverse, noise, buffer": lbnl.assign(
            kp=0.05, ti=50.0, noise_std=grid.NOISE, estimate_ratio=0.95, buffer=grid.BUFFER_SIGMAS * grid.NOISE * 0.05
        ),
    }
    for name, one in wanted.items():
        for kind, make in TWO_KINDS.items():
            alone = fc.simulate(one, make(8, [7, 8]), seed=grid.SEED)
            for metric in ("rmse", "motor_travel", "switch_frequency"):
                np.testing.assert_array_equal(ds[metric].sel(case=name, kind=kind), alone[metric], err_msg=name)


def test_all_kinds_keep_their_units_and_their_hash():
    ds = grid.on_every_kind(few("lbnl"), TWO_KINDS, 1, (7,))
    assert (ds.rmse.dims[0], ds.rmse.attrs["units"]) == ("kind", "K")
    assert ds.attrs["content_sha256"] == grid.rehashed(ds).attrs["content_sha256"]


SEEDS = (5, 6)


def test_days_of_all_kinds_share_air_flow_water_and_the_seeds_of_the_noise():
    days = [make(1, SEEDS) for make in grid.KINDS.values()]
    for other in days[1:]:
        assert other.day.tolist() == days[0].day.tolist() == list(SEEDS)
        for name in ("m_a", "T_w_in", "sensor_noise"):
            if name in other.series:
                np.testing.assert_array_equal(other.series[name], days[0].series[name])


def test_the_first_kind_is_the_paper_s_and_only_there_the_set_point_steps():
    assert next(iter(grid.KINDS)) == "stepped"
    paper = fc.paper_day(hours=2, seed=SEEDS)
    for name, make in grid.KINDS.items():
        day = make(2, SEEDS)
        if name == "stepped":
            assert all(np.array_equal(day.series[n], paper.series[n]) for n in paper.series)
        else:
            assert (day.series["T_set"] == grid.T_SET).all()


def test_a_design_day_is_milder_than_the_extreme_and_differs_by_seed():
    one, other = grid.design(8, SEEDS).series["T_a_in"]
    extreme = fc.design_day(hours=8, outdoor_fraction=max(grid.OUTDOOR_FRACTIONS)).series["T_a_in"][0]
    assert not np.allclose(one, other)
    for air in (one, other):
        assert (air < extreme).all()
        assert (air > grid.T_SET + 5).all()
    given = fc.design_day(hours=8, T_design=grid.EXTREME[0], T_wet_bulb=grid.EXTREME[1])
    for name in ("T_a_in", "W_a_in"):
        np.testing.assert_array_equal(given.series[name], fc.design_day(hours=8).series[name])


def test_switches_of_the_figure_are_those_of_the_metric(folder):
    ds = load(folder / "fig12.nc")
    counted = ds.switches.sel(block_start=slice(1800, None)).mean("block_start")
    np.testing.assert_allclose(counted.transpose(*ds.switch_frequency.dims), ds.switch_frequency)


def test_the_buffer_is_six_deviations_of_the_noise_on_the_output():
    loop = grid.tunings(quick=True)
    buffers = grid.buffers(loop, ["95 %", "95 %, noise, buffer"])
    np.testing.assert_allclose(buffers.isel(case=1), 6 * 0.05 * loop["kp"])
    assert (buffers.isel(case=0) == 1e-9).all()
