"""What an inverse is compared with in the summary of a run: plain Python finds the same."""

import re
import statistics

import numpy as np
import pytest
import xarray as xr
from helpers.costly_results import PRICES, result
from helpers.results import result as hand_made

import fastcoil as fc
from fastcoil.study.analysis import summary as baselines
from fastcoil.study.analysis.cost import Tariff
from fastcoil.study.analysis.summary import Billing, cost_lines, sound, summary

TUNINGS = {
    "slow": (0.01, 60.0, 0.0),
    "quick": (0.05, 30.0, 0.0),
    "banded": (0.05, 30.0, 0.2),
    "other": (0.05, 9.0, 0.5),
}


def errors(**rmse):
    """Errors of plain PIs over two backlashes, by tuning."""
    values = zip(*(TUNINGS[name] for name in rmse), strict=True)
    coords = {n: ("tuning", list(v)) for n, v in zip(("kp", "ti", "error_dead_band"), values, strict=True)}
    found = xr.Dataset({"rmse": (("tuning", "backlash"), list(rmse.values()))}, {"backlash": [0.02, 0.1], **coords})
    return found.assign_coords(tuning=list(rmse))


def test_the_best_plain_pi_is_lowest_over_everything_relative_to_the_best_of_each_plant():
    plain = errors(slow=[0.11, 0.40], quick=[0.10, 0.50])
    assert baselines.best_plain_pi(plain) == {"tuning": 0}, "1.10 and 1.00 against 1.00 and 1.25"
    plain = errors(slow=[0.13, 0.45], quick=[0.10, 0.50])
    assert baselines.best_plain_pi(plain) == {"tuning": 1}
    plain = errors(slow=[np.nan, np.nan], quick=[0.10, 0.50])
    assert baselines.best_plain_pi(plain) == {"tuning": 1}


def test_gains_that_come_with_a_plant_of_their_own_are_no_choice():
    plain = errors(slow=[0.11, 0.40], quick=[0.10, 0.50])
    assert baselines.tuning_dims(plain) == ["tuning"]
    assert baselines.best_plain_pi(plain.assign_coords(C_c=("tuning", [10.0, 30.0]))) is None
    assert baselines.best_plain_pi(plain.drop_vars(["kp", "ti"])) is None


def test_a_dead_band_is_compared_with_the_same_tuning_without():
    plain = errors(slow=[0.1, 0.1], quick=[0.1, 0.1], banded=[0.1, 0.1], other=[0.1, 0.1])
    assert baselines.dead_bands(plain) == [({"tuning": 2}, {"tuning": 1})]
    without = baselines.without_dead_band(plain).rmse
    assert without.notnull().all("backlash").values.tolist() == [True, True, False, False]
    swept = xr.Dataset(coords={"error_dead_band": [0.0, 0.2, 0.5]})
    assert baselines.dead_bands(swept) == [({"error_dead_band": k}, {"error_dead_band": 0}) for k in (1, 2)]
    every = plain.isel(tuning=[2, 3])
    assert baselines.without_dead_band(every).identical(every), "nothing is left out where every loop has one"


STUDY = """
title = "small"
[loop]
[sweep]
backlash = [0.0, 0.03, 0.07, 0.1]
estimate_ratio = [0.0, 0.95]
[cases.tuning]
own = { kp = 0.03, ti = 8 }
calm = { kp = 0.045, ti = 40 }
banded = { kp = 0.03, ti = 8, error_dead_band = 0.3 }
[boundary]
hours = 2
"""


def lower(ratio):
    change = 100 * (ratio - 1)
    return f"{abs(change):.0f} % {'lower' if change < 0 else 'higher'}"


@pytest.mark.kernel
def test_the_summary_of_a_run_says_what_plain_python_finds(tmp_path):
    (tmp_path / "small.toml").write_text(STUDY)
    ds = fc.run_study(tmp_path / "small.toml", tmp_path / "out").load()
    said = " ".join(summary(ds))
    rmse, travel = (
        {(str(t), x, r): float(ds[m].sel(tuning=t, backlash=x, estimate_ratio=r))
         for t in ds.tuning.values for x in (0.03, 0.07, 0.1) for r in (0.0, 0.95)}
        for m in ("rmse", "motor_travel")
    )  # fmt: skip
    sizes, tunings, median = (0.03, 0.07, 0.1), ("own", "calm"), statistics.median
    own = median(rmse[t, x, 0.95] / rmse[t, x, 0.0] for t in tunings for x in sizes)
    assert f"Lowest error at estimate ratio 0.95: RMSE is {lower(own)} against the plain PI (median)" in said
    assert re.search(
        r"Mode switches per 10 min \(median\): [\d.]+ with the plain PI, at most [\d.]+ up to estimate ratio 1, ", said
    )
    best = min(tunings, key=lambda t: sum(rmse[t, x, 0.0] / min(rmse[s, x, 0.0] for s in tunings) for x in sizes))
    alone = median(rmse[best, x, 0.0] / rmse[t, x, 0.0] for t in tunings for x in sizes)
    under = [rmse[t, x, 0.95] < rmse[best, x, 0.0] for t in tunings for x in sizes]
    assert (
        f"The best plain PI of 2 tunings ({best}): RMSE is {lower(alone)} than with the plain PI of the same loop "
        f"(median); the inverse is lower than that in {100 * sum(under) / 6:.0f} % of the loops." in said
    )
    on_top = median(rmse[best, x, 0.95] / rmse[best, x, 0.0] for x in sizes)
    cost = median(travel[best, x, 0.95] / travel[best, x, 0.0] for x in sizes)
    assert (
        f"on top of the best plain PI: RMSE is {lower(on_top)} (median), at {cost:.1f} times the motor travel" in said
    )
    band = median(rmse["banded", x, 0.0] / rmse["own", x, 0.0] for x in sizes)
    saved = median(travel["banded", x, 0.0] / travel["own", x, 0.0] for x in sizes)
    instead = median(rmse["own", x, 0.95] / rmse["banded", x, 0.0] for x in sizes)
    assert (
        f"An error dead band of 0.3 K (banded): RMSE is {lower(band)} than without it, at {saved:.2f} times the motor "
        f"travel (median); with the inverse instead it is {lower(instead)} than with the dead band." in said
    )


@pytest.mark.kernel
def test_a_study_without_a_choice_of_tunings_says_nothing_of_the_best_pi(tmp_path):
    ds = fc.simulate(fc.Loop(estimate_ratio=[0.0, 0.95]), fc.paper_day(hours=1))
    said = " ".join(summary(ds))
    assert "against the plain PI" in said
    assert "best plain PI" not in said
    assert "dead band" not in said


def test_scenarios_off_their_set_point_for_over_half_of_the_time_are_told():
    share_off, hunts = [0.51, 1.0, 0.5, np.nan], [1.0, 0.0, 1.0, np.nan]
    lines = summary(hand_made(("sample",), rmse=np.ones(4), share_off=share_off, hunts=hunts))
    (said,) = [line for line in lines if "off their set-point" in line]
    assert said.startswith(
        "2 of 4 are more than 0.5 K off their set-point for over half of the time, 1 of them hunting"
    )


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
