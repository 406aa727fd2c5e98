"""What energy costs, against bills that plain Python writes day by day."""

import calendar
import datetime

import numpy as np
import pytest
import xarray as xr
from helpers.costly_results import PRICES, result
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.study.analysis.paired import summarise_median


def bill_by_month(ds, prices, at, heating=False, electric=False):
    """Month → (coil, demand, reheat, recool, kW) of one loop, day by day."""
    months, series = {}, {name: ds[name].isel(at).values.tolist() for name in ds.data_vars}
    for d in range(ds.sizes["day"]):
        date = datetime.datetime.fromisoformat(str(ds.start.values[d])[:19])
        months.setdefault((date.year, date.month), []).append(d)
    bills = {}
    for (year, month), days in months.items():
        of_month = {name: [values[d] for d in days] for name, values in series.items()}
        share = len(days) / calendar.monthrange(year, month)[1]
        if heating:
            coil, peak = sum(of_month["coil_energy"]) * prices["heat"], max(of_month["coil_peak_power"]) * electric
        else:
            coil = sum(of_month["coil_energy"]) * prices["electricity"] / prices["cop"]
            peak = max(of_month["coil_peak_power"]) / prices["cop"]
        reheat = sum(of_month["reheat_energy"]) * prices["heat"]
        recool = sum(of_month["recool_energy"]) * prices["electricity"] / prices["cop"]
        bills[year, month] = coil, peak * prices["demand"] * share, reheat, recool, peak
    return bills


def test_a_coil_that_works_the_wrong_way_is_told():
    ds = result(31, ("backlash", [0.0, 0.1]), start="2023-01-01")
    ds["coil_energy"] = ds["coil_energy"] * (1.0 - 2.0 * (ds["backlash"] > 0.0))
    with pytest.warns(UserWarning, match="coil energy of the year is negative in 1 of 2 loops"):
        fc.cost(ds, **PRICES)


PARTS = ("coil_cost", "demand_cost", "reheat_cost", "recool_cost", "demand")


@pytest.mark.parametrize(
    ("start", "n", "coil"),
    [
        ("2023-01-01", 365, "cooling"),
        ("2024-01-01", 366, "cooling"),
        ("2023-11-20T08:00", 75, "gas"),
        ("2024-02-10T20:00", 40, "electric"),
    ],
)
def test_it_is_the_bill_of_the_months_of_the_calendar(start, n, coil):
    heating, electric = coil != "cooling", coil == "electric"
    ds = result(n, ("backlash", [0.0, 0.1]), start=start, action="heating" if heating else "cooling")
    costs = fc.cost(ds, **PRICES, electric_heat=electric)
    for k in range(2):
        expected = bill_by_month(ds, PRICES, {"backlash": k}, heating, electric)
        loop_costs = costs.isel(backlash=k)
        assert [str(m)[:7] for m in loop_costs.month.values] == [f"{y}-{m:02}" for y, m in expected]
        for p, part in enumerate(PARTS):
            np.testing.assert_allclose(loop_costs[part], [of[p] for of in expected.values()], rtol=1e-12)
        np.testing.assert_allclose(loop_costs.cost, [sum(of[:4]) for of in expected.values()], rtol=1e-12)
        if start.endswith("-01-01"):
            assert float(loop_costs.yearly_cost) == pytest.approx(sum(sum(of[:4]) for of in expected.values()))
        assert float(loop_costs.yearly_demand) == max(of[4] for of in expected.values())
    assert costs.cost.attrs["units"] == "USD"


def test_a_part_of_a_year_is_scaled_to_twelve_months():
    ds = result(31 + 14, start="2023-01-01")
    flat = ds.assign({name: xr.full_like(ds[name], 2.0) for name in ds.data_vars if name != "status"})
    costs = fc.cost(flat, **PRICES)
    assert costs.month_share.values.tolist() == [1.0, 0.5]
    # the same every day: a year costs twelve months of demand, and energy by the share of the months
    assert float(costs.yearly_demand_cost) == pytest.approx(12 * 12.0 * 2.0 / 4.0)
    assert float(costs.yearly_reheat_cost) == pytest.approx(45 * 2.0 * 0.05 * 12 / 1.5)
    assert float(costs.yearly_motor_travel) == pytest.approx(45 * 2.0 * 12 / 1.5)


def test_without_dates_thirty_days_are_a_month_and_it_says_so():
    ds = result(70, ("sample", [0, 1]))
    with pytest.warns(UserWarning, match="no dates: 30 days are taken for a month"):
        costs = fc.cost(ds, **PRICES)
    assert costs.n_days.values.tolist() == [30, 30, 10]
    peak = [float(ds.coil_peak_power.isel(sample=1, day=slice(30 * k, 30 * k + 30)).max()) for k in range(3)]
    np.testing.assert_allclose(costs.demand.isel(sample=1), np.divide(peak, 4.0))
    assert float(costs.month_share.sum()) / 12 == pytest.approx(70 / 365)
    first_day = ds.isel(day=0, drop=True)
    with pytest.warns(UserWarning, match="no dates"):
        single = fc.cost(first_day, **PRICES)
    assert float(single.yearly_reheat_energy[1]) == pytest.approx(365 * float(first_day.reheat_energy[1]))


def test_where_a_day_failed_its_month_and_the_year_have_no_cost():
    ds = result(60, ("sample", [0, 1]), start="2023-01-01")
    ds.status[40, 1] = 1
    ds.coil_peak_power[10, 0] = np.nan  # nothing ran for 15 min: no peak, no failure
    costs = fc.cost(ds, **PRICES)
    assert costs.status.values.tolist() == [0, 1]
    no_cost = costs.cost.transpose("sample", "month").isnull()
    assert no_cost.values.tolist() == [[False, False, False], [False, True, False]]
    assert costs.yearly_cost.isnull().values.tolist() == [False, True]


def test_each_loop_pays_for_its_own_action():
    ds = result(31, ("sample", [0, 1]), start="2023-01-01", action=None, other=1)
    ds = ds.assign_coords(action=("sample", ["cooling", "heating"])).drop_vars("other")
    costs, gas = fc.cost(ds, **PRICES), bill_by_month(ds, PRICES, {"sample": 1}, heating=True)[2023, 1]
    np.testing.assert_allclose([float(costs[p][0, 1]) for p in PARTS], gas)
    assert float(costs.demand_cost[0, 0]) > 0.0 == float(costs.demand_cost[0, 1])


def test_costs_can_be_compared_like_metrics():
    ds = result(365, ("controller", ["pi", "other"]), ("sample", range(40)), start="2023-01-01")
    costs = fc.cost(ds, **PRICES)
    comparison = fc.compare(costs, baseline={"controller": "pi"}, over="sample", metrics=["yearly_cost", "cost"])
    difference = costs.yearly_cost[1] - costs.yearly_cost[0]
    assert float(comparison.yearly_cost.sel(controller="other", statistic="mean")) == pytest.approx(
        float(difference.mean())
    )
    assert comparison.cost.sizes["month"] == 12
    assert (comparison.month == costs.month).all()
    every = fc.compare(costs, baseline={"controller": "pi"}, over="sample")
    assert {"yearly_demand", "coil_cost", "motor_travel"} <= set(every)


def test_the_interval_of_a_median_holds_the_true_one_as_often_as_it_says():
    draw = np.random.default_rng(5)
    hits = 0
    for _ in range(60):
        of_valve = draw.exponential(size=40)[:, None] + 0.1 * draw.normal(size=(40, 4))
        median = summarise_median(xr.DataArray(of_valve, dims=("sample", "replicate")))
        hits += median.low <= 0.6982 <= median.high  # median of the sum, from 10 million draws
    assert 51 <= hits < 60
    assert median.q05 <= median.low <= median.median <= median.high <= median.q95
    alone = summarise_median(xr.DataArray([[1.0, 2.0, np.nan]], dims=("sample", "x")))
    assert (alone.median, np.isnan(alone.low)) == (1.5, True)


@pytest.mark.parametrize(
    ("change", "prices", "field", "code"),
    [
        (None, {"heat": None}, "heat", "type"),
        (None, {"electricity": -0.1}, "electricity", "value"),
        (None, {"demand": "12"}, "demand", "type"),
        (None, {"cop": 0.0}, "cop", "value"),
        (None, {"currency": " "}, "currency", "value"),
        (None, {"electric_heat": 1}, "electric_heat", "type"),
        (lambda ds: ds.drop_vars(["reheat_energy", "recool_energy"]), {}, "ds", "missing"),
        (lambda ds: ds.assign_coords(start=("day", [1, 2, 3])), {}, "start", "time"),
        (lambda ds: ds.assign(status=ds.status.max("day")), {}, "ds", "shape"),
        (lambda ds: ds.expand_dims(month=["a", "b"]), {}, "month", "name"),
        (lambda ds: ds.assign_attrs(parameters="{}"), {}, "action", "missing"),
        (lambda ds: ds.assign_coords(action="Heating"), {}, "action", "missing"),
        (lambda ds: ds.assign(coil_energy=ds.coil_energy.assign_attrs(units="J")), {}, "ds.coil_energy", "unit"),
        (lambda ds: ds.isel(day=[]), {}, "day", "shape"),
    ],
)
def test_a_price_that_cannot_be_and_a_result_that_cannot_be_billed_are_refused(change, prices, field, code):
    ds = result(3) if change is None else change(result(3))
    assert_refused(field, code, fc.cost, ds, **(PRICES | prices))


def test_joined_days_with_one_start_all_count_as_consecutive_ones():
    days = result(2, ("backlash", [0.0, 0.1]), start="2023-01-31")
    joined = days.drop_vars(["day", "start"]).assign_coords(start=days["start"].values[0])
    costs = fc.cost(joined, **PRICES)
    assert (costs["n_days"].values.tolist(), costs["month"].dt.month.values.tolist()) == ([1, 1], [1, 2])
    np.testing.assert_allclose(costs["coil_energy"].sum("month"), joined["coil_energy"].sum("day"))


@pytest.mark.parametrize(("code", "days"), [("duplicate", [0, 1, 1]), ("shape", [])])
def test_days_that_stand_twice_or_nowhere_are_refused(code, days):
    ds = result(2, ("backlash", [0.0, 0.1]), start="2023-01-01").isel(day=days)
    assert_refused("day", code, fc.cost, ds, **PRICES)
