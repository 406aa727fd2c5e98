"""What an inverse is compared with in the summary of a run: plain Python finds the same."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from helpers.costly_results import PRICES, result
from helpers.results import make_result as hand_made

import fastcoil as fc
from fastcoil.study.analysis.cost import Tariff
from fastcoil.study.analysis.summary import (
    Billing,
    cost_lines,
    find_loops_without_backlash,
    summary,
)


def make_estimates(rmse, motor_travel):
    """Estimates of 0, 50, 100 and 150 % on five loops, whose errors and travels have these factors."""
    loops = np.linspace(1.0, 1.4, 5)
    metrics = {"rmse": np.outer(rmse, loops), "motor_travel": np.outer(motor_travel, loops)}
    metrics["switch_frequency"] = np.ones((4, 5))
    return hand_made(("estimate_ratio", "sample"), {"estimate_ratio": [0.0, 0.5, 1.0, 1.5]}, **metrics)


def test_days_off_count_in_no_median():
    ds = make_estimates([1.0, 0.8, 0.62, 0.6], [1.0, 1.5, 2.0, 9.0])
    off = ds.copy(deep=True)
    off["rmse"][:, :3], off["motor_travel"][:, :3] = np.nan, 0.0
    sentences = summary(off)
    assert "In 12 of 20 the loop was off all day" in sentences[2]
    assert sentences[3:] == summary(ds.isel(sample=slice(3, None)))[2:]
    days = {"rmse": [[0.2, np.nan, np.nan]] * 2, "motor_travel": [[3.0, 0.0, 0.0], [5.0, 0.0, 0.0]]}
    costs = summary(hand_made(("kp", "day"), {"kp": [0.01, 0.02]}, **days))[-1]
    assert costs == "It costs: the motor travels 3 strokes."


@pytest.mark.parametrize(
    ("stored", "coords", "called"),
    [
        ({}, {}, "plain PI"),
        ({"buffer": 1e-9, "buffer_ratio": 6.0, "noise_std": 0.0}, {}, "plain PI"),
        ({"buffer": 0.02}, {}, "PI with a buffer"),
        ({}, {"buffer": ("estimate_ratio", [0.01] * 4)}, "PI with a buffer"),
        ({"buffer_ratio": 6.0, "noise_std": 0.1}, {}, "PI with a buffer"),
        ({"buffer_ratio": 6.0, "noise_std": 0.0, "buffer_noise": "measured"}, {}, "PI with a buffer"),
    ],
)
def test_a_pi_whose_buffer_holds_reversals_back_is_not_called_plain(stored, coords, called):
    ds = make_estimates([1.0, 0.8, 0.62, 0.6], [1.0, 1.5, 2.0, 9.0]).assign_coords(coords)
    lines = summary(ds.assign_attrs(parameters=json.dumps(stored)))
    assert f"than with the {called} of the same loop" in lines[3]


def test_scenarios_off_their_set_point_for_over_half_of_the_time_are_told():
    share_off, hunts = [0.51, 1.0, 0.5, np.nan], [1.0, 0.0, 1.0, np.nan]
    lines = summary(hand_made(("sample",), rmse=np.ones(4), share_off=share_off, hunts=hunts))
    (sentence,) = [line for line in lines if "off their set-point" in line]
    assert sentence.startswith(
        "2 of 4 are more than 0.5 K off their set-point for over half of the time, 1 of them hunting"
    )


TARIFF = Tariff(**PRICES, currency="EUR")


def cost_lines_of(ds, **baseline):
    return cost_lines(ds, Billing(TARIFF, baseline))


@pytest.fixture(scope="module")
def swept():
    """Twenty valves with and without a gap: with it everything is dearer by a factor of the valve's own."""
    ds = result(365, ("backlash", [0.0, 0.05, 0.1]), ("sample", range(20)), start="2023-01-01")
    factor = 1.0 + xr.DataArray([0.0, 1.0, 3.0], dims="backlash") * xr.DataArray(
        np.linspace(0.01, 0.05, 20), dims="sample"
    )
    alike = {n: ds[n].isel(backlash=0, drop=True) * factor for n in ds.data_vars if n != "status"}
    return ds.assign({n: v.transpose(*ds[n].dims) for n, v in alike.items()})


def test_it_says_what_each_gap_costs_more_than_none(swept):
    basis, without, *gap_lines = cost_lines_of(swept)
    costs = fc.cost(swept, **PRICES, currency="EUR").yearly_cost
    assert "months of the calendar" in basis
    assert "scaled" not in basis
    base = float(costs.sel(backlash=0.0).median())
    assert without == f"A loop with no gap costs {base:,.0f} EUR a year (median)."
    for gap, line in zip((0.05, 0.1), gap_lines, strict=True):
        of_each = (costs.sel(backlash=gap) - costs.sel(backlash=0.0)).values
        low, high = np.quantile(of_each, [0.05, 0.95])
        assert line.startswith(f"With a gap of {100 * gap:g} %: +{np.median(of_each):.3g} EUR a year (median of")
        assert f"; 5 to 95 % of them: +{low:.3g} to +{high:.3g}; on average coil" in line
        parts = [float(x) for x in re.findall(r"(?:coil|demand|reheat|recooling) \+([\d.]*\d)", line)]
        assert sum(parts) == pytest.approx(float(of_each.mean()), rel=0.01)


def test_another_controller_may_be_the_baseline(swept):
    ds = swept.rename(backlash="controller").assign_coords(controller=["pi", "bad", "worse"])
    assert find_loops_without_backlash(ds) == {}
    assert cost_lines_of(ds)[1].startswith("A loop costs ")
    assert cost_lines_of(ds)[1].endswith("Add loops with backlash = 0 to see what of it the backlash costs.")
    _, base, *other_lines = cost_lines_of(ds, controller="worse")
    assert base.startswith("A loop with controller worse costs ")
    assert [line.split("-")[0] for line in other_lines] == ["With controller pi: ", "With controller bad: "]


def test_loops_without_backlash_are_found_in_a_sweep_and_among_cases(swept):
    assert find_loops_without_backlash(swept) == {"backlash": 0.0}
    cases = swept.rename(backlash="valve").assign_coords(
        valve=["sound", "worn", "bad"], backlash=("valve", [0.0, 0.05, 0.1])
    )
    assert find_loops_without_backlash(cases) == {"valve": "sound"}
    assert find_loops_without_backlash(cases.assign_coords(backlash=("valve", [0.0, 0.0, 0.1]))) == {}
    assert find_loops_without_backlash(swept.assign_coords(backlash=[0.01, 0.05, 0.1])) == {}
