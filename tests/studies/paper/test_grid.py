"""The grid of tunings: its size, its presets, its long days; the same for any number of threads."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops.netcdf import load
from fastcoil.loops.presets import COOLING_PRESETS
from studies.paper import grid

pytestmark = pytest.mark.kernel


def test_the_grid_has_at_least_500_tunings_and_the_presets_by_name():
    loop = grid.tunings()
    assert loop.sizes["tuning"] >= 500
    assert grid.preset_labels(loop["kp"]["tuning"]) == list(COOLING_PRESETS)
    lbnl = loop["stroke_time"].sel(tuning="lbnl")
    assert float(lbnl) == fc.Loop.preset("lbnl")["stroke_time"]
    for start, step in grid.STARTS_AND_STEPS:
        updates = np.ceil((grid.BACKLASH - start) / step) + 2
        assert updates * grid.INTERVAL < grid.LONG_HOURS * 3600


STEPPED = {"stepped": grid.stepped_days}
TWO_KINDS = STEPPED | {"constant": grid.constant_days}


def loop_of_presets(*names):
    """The tunings of these presets."""
    values = {n: grid.tunings(quick=True)[n].sel(tuning=list(names)) for n in (*grid.GAIN_NAMES, *grid.PLANT_NAMES)}
    return fc.Loop(**values)


@pytest.mark.full
def test_days_of_a_kind_are_those_of_a_simulation_of_their_own(monkeypatch):
    monkeypatch.setattr(grid, "DAYS", (7, 8))
    loop = loop_of_presets("lbnl")
    best = {"best PI": loop.assign(kp=0.1, ti=100.0), "best inverse": loop.assign(kp=0.05, ti=50.0)}
    ds = grid.simulate_days(loop, best, TWO_KINDS).isel(tuning=0)
    lbnl = fc.Loop.preset("lbnl").assign(backlash=0.07, air_march="lagged")
    loops_by_case = {
        "95 %": lbnl.assign(estimate_ratio=0.95),
        "dead band": lbnl.assign(error_dead_band=grid.DEAD_BAND),
        "best PI, noise": lbnl.assign(kp=0.1, ti=100.0, noise_std=grid.NOISE),
        "best PI, 95 %": lbnl.assign(kp=0.1, ti=100.0, estimate_ratio=0.95),
        "best inverse, noise, buffer": lbnl.assign(
            kp=0.05, ti=50.0, noise_std=grid.NOISE, estimate_ratio=0.95, buffer=grid.BUFFER_SIGMAS * grid.NOISE * 0.05
        ),
    }
    for name, case_loop in loops_by_case.items():
        for kind, make in TWO_KINDS.items():
            alone = fc.simulate(case_loop, make(8, [7, 8]), seed=grid.SEED)
            for metric in ("rmse", "motor_travel", "switch_frequency"):
                np.testing.assert_array_equal(ds[metric].sel(case=name, kind=kind), alone[metric], err_msg=name)


SEEDS = (5, 6)


def test_days_of_all_kinds_share_air_flow_water_and_the_seeds_of_the_noise():
    days = [make(1, SEEDS) for make in grid.KINDS.values()]
    for other_days in days[1:]:
        assert other_days.day.tolist() == days[0].day.tolist() == list(SEEDS)
        for name in ("m_a", "T_w_in", "sensor_noise"):
            if name in other_days.series:
                np.testing.assert_array_equal(other_days.series[name], days[0].series[name])


@pytest.mark.full
def test_switches_of_the_figure_are_those_of_the_metric(folder):
    ds = load(folder / "fig12.nc")
    mean_switches = ds.switches.sel(block_start=slice(1800, None)).mean("block_start")
    np.testing.assert_allclose(mean_switches.transpose(*ds.switch_frequency.dims), ds.switch_frequency)
