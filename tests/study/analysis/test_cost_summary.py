"""The sentences on what backlash costs a year say what the numbers are."""

from __future__ import annotations

import re

import numpy as np
import pytest
import xarray as xr
from helpers.costly_results import PRICES, result

import fastcoil as fc
from fastcoil.study.analysis.cost import Tariff
from fastcoil.study.analysis.summary import Billing, cost_lines, sound

TARIFF = Tariff(**PRICES, currency="EUR")


def lines(ds, **baseline):
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
    basis, first, detail, mechanics = lines(swept)
    costs = fc.cost(swept, **PRICES, currency="EUR").yearly_cost
    extra = (costs - costs.sel(backlash=0.0, drop=True)).median("sample")
    assert "months of the calendar" in basis
    assert "scaled" not in basis
    five, ten = (f"{float(extra[k]):.3g}" for k in (1, 2))
    assert first == (
        f"A gap of 5 % costs {five} EUR more a year than no gap, a gap of 10 % {ten} more "
        f"(medians of the same loops; no gap: {float(costs.sel(backlash=0.0).median()):,.0f} EUR a year)."
    )
    of_each = (costs[2] - costs[0]).values
    low, high = np.quantile(of_each, [0.05, 0.95])
    assert detail.startswith(f"With a gap of 10 %, 5 to 95 % of the loops: +{low:.3g} to +{high:.3g} EUR a year; ")
    parts = [float(x) for x in re.findall(r"(?:coil|demand|reheat|recooling) \+([\d.]*\d)", detail)]
    assert sum(parts) == pytest.approx(float(of_each.mean()), rel=0.01)
    travel = float((swept.motor_travel.mean("day")[2] / swept.motor_travel.mean("day")[0]).median())
    assert f"its motor travels {travel:.1f} times as far" in mechanics
    off = [100 * float(swept.share_off.mean("day")[k].median()) for k in (2, 0)]
    assert f"{off[0]:.1f} % of the time instead of {off[1]:.1f} %" in mechanics


def test_part_of_a_year_and_days_without_dates_are_told(swept):
    assert "scaled from 10 days to a year" in lines(swept.isel(day=slice(10)))[0]
    assert "no dates, so 30 days are a month" in lines(swept.drop_vars("start"))[0]


def test_another_controller_may_be_the_baseline_and_words_get_lines_of_their_own(swept):
    ds = swept.rename(backlash="controller").assign_coords(controller=["pi", "bad", "worse"])
    assert sound(ds) == {}
    assert lines(ds)[1].startswith("A loop costs ")
    assert lines(ds)[1].endswith("Add loops with backlash = 0 to see what of it the backlash costs.")
    said = lines(ds, controller="worse")[1]
    assert said.startswith("Pi costs ")
    assert re.search(r"EUR less a year than worse, bad [\d.]+ less \(", said)
    both = xr.concat([swept, swept], xr.DataArray(["one", "two"], dims="strategy", name="strategy"))
    assert [line.split(":")[0] for line in lines(both)[1::3]] == ["one", "two"]


def test_loops_without_backlash_are_found_in_a_sweep_and_among_cases(swept):
    assert sound(swept) == {"backlash": 0.0}
    cases = swept.rename(backlash="valve").assign_coords(
        valve=["sound", "worn", "bad"], backlash=("valve", [0.0, 0.05, 0.1])
    )
    assert sound(cases) == {"valve": "sound"}
    assert lines(cases)[1].startswith("Worn costs ")
    assert sound(cases.assign_coords(backlash=("valve", [0.0, 0.0, 0.1]))) == {}
    assert sound(swept.assign_coords(backlash=[0.01, 0.05, 0.1])) == {}


def test_wear_is_told_where_days_follow_one_another_and_the_gap_grew(swept):
    gap = swept.backlash + xr.DataArray(np.linspace(0.0, 0.02, 365), dims="day") * (swept.backlash > 0)
    worn = swept.assign(backlash_final=gap.broadcast_like(swept.rmse)).assign_attrs(carry_over=1)
    assert lines(worn)[-1] == (
        "From the first day to the last the gap grows from 7.50 to 9.50 % of stroke (medians); by more than 2.00 % of "
        "stroke in 5 % of the loops."
    )
    assert len(lines(worn.assign_attrs(carry_over=0))) == len(lines(swept)) == len(lines(worn)) - 1
    steady = worn.assign(backlash_final=worn.backlash_final.isel(day=0, drop=True).broadcast_like(swept.rmse))
    assert len(lines(steady)) == len(lines(swept))
    every = worn.assign(backlash_final=worn.backlash_final + 0.01 * (worn.day > 3))
    assert lines(every)[-1] == "The loops without a gap wear, too: 1.00 % in the end (median)."
