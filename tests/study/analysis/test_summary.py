"""What an inverse is compared with in the summary of a run: plain Python finds the same."""

import json
import re
import statistics

import numpy as np
import pytest
import xarray as xr
from helpers.costly_results import PRICES, result
from helpers.results import make_result as hand_made

import fastcoil as fc
from fastcoil.study.analysis.cost import Tariff
from fastcoil.study.analysis.summary import (
    Billing,
    best_plain_pi,
    cost_lines,
    find_loops_without_backlash,
    keep_comparable,
    summary,
)

TUNINGS = {"slow": (0.01, 60.0), "quick": (0.05, 30.0)}


def make_plain_pis(**rmse):
    """Errors of plain PIs over two backlashes, by tuning."""
    coords = {n: ("tuning", [TUNINGS[name][k] for name in rmse]) for k, n in enumerate(("kp", "ti"))}
    plain_pis = xr.Dataset({"rmse": (("tuning", "backlash"), list(rmse.values()))}, {"backlash": [0.02, 0.1], **coords})
    return plain_pis.assign_coords(tuning=list(rmse))


@pytest.mark.parametrize(("slow", "best"), [([0.11, 0.40], 0), ([0.13, 0.45], 1), ([np.nan, np.nan], 1)])
def test_the_best_plain_pi_is_lowest_over_everything_relative_to_the_best_of_each_plant(slow, best):
    """With 1.10 and 1.00 against 1.00 and 1.25 the first is best."""
    assert best_plain_pi(make_plain_pis(slow=slow, quick=[0.10, 0.50])) == {"tuning": best}


def test_gains_that_come_with_a_plant_of_their_own_are_no_choice():
    plain = make_plain_pis(slow=[0.11, 0.40], quick=[0.10, 0.50])
    assert best_plain_pi(plain.assign_coords(C_c=("tuning", [10.0, 30.0]))) is None
    assert best_plain_pi(plain.drop_vars(["kp", "ti"])) is None


def test_loops_with_a_dead_band_are_left_out_unless_every_one_has_one():
    plain = make_plain_pis(slow=[0.1, 0.1], quick=[0.1, 0.1]).assign_coords(error_dead_band=("tuning", [0.0, 0.2]))
    assert keep_comparable(plain).rmse.notnull().all("backlash").values.tolist() == [True, False]
    every = plain.isel(tuning=[1])
    assert keep_comparable(every).rmse.notnull().all()


STUDY = """
title = "small"
question = "does it help?"
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


def change_in_words(ratio):
    change = 100 * (ratio - 1)
    return f"{abs(change):.0f} % {'lower' if change < 0 else 'higher'}"


@pytest.mark.kernel
def test_the_answer_of_a_run_is_what_plain_python_finds(tmp_path):
    (tmp_path / "small.toml").write_text(STUDY)
    ds = fc.run_study(tmp_path / "small.toml", tmp_path / "out").load()
    heads, sentences = zip(*(line.split(": ", 1) for line in summary(ds)[-5:]), strict=True)
    assert heads == ("Asked", "Do this", "It brings", "It costs", "It fails")
    question, do, brings, costs, _ = sentences
    assert question == "does it help?"
    rmse, travel = (
        {(str(t), x, r): float(ds[m].sel(tuning=t, backlash=x, estimate_ratio=r))
         for t in ds.tuning.values for x in (0.03, 0.07, 0.1) for r in (0.0, 0.95)}
        for m in ("rmse", "motor_travel")
    )  # fmt: skip
    pairs = [(t, x) for t in ("own", "calm") for x in (0.03, 0.07, 0.1)]
    best = min(
        ("own", "calm"), key=lambda t: sum(rmse[t, x, 0] / min(rmse[s, x, 0] for s, _ in pairs) for _, x in pairs)
    )
    assert best == "calm"
    tuning, inverse, both = (
        statistics.median(rmse[at or t, x, r] / rmse[t, x, 0.0] for t, x in pairs)
        for at, r in ((best, 0.0), ("", 0.95), (best, 0.95))
    )
    assert inverse - 0.05 < both < tuning - 0.05, "the simpler of two that are alike is recommended"
    assert do == "put an inverse behind the PI with an estimate of 95 % of the backlash."
    assert brings.startswith(
        f"the RMS error is {change_in_words(inverse)} than with the plain PI of the same loop (median), and "
    )
    assert brings.endswith(f"with the tuning alone {change_in_words(tuning)}; with both {change_in_words(both)}.")
    cost = statistics.median(travel[t, x, 0.95] / travel[t, x, 0.0] for t, x in pairs)
    assert costs.startswith(f"the motor travels {cost:.3g} times as far (median), and ")


def make_estimates(rmse, motor_travel):
    """Estimates of 0, 50, 100 and 150 % on five loops, whose errors and travels have these factors."""
    loops = np.linspace(1.0, 1.4, 5)
    metrics = {"rmse": np.outer(rmse, loops), "motor_travel": np.outer(motor_travel, loops)}
    metrics["switch_frequency"] = np.ones((4, 5))
    return hand_made(("estimate_ratio", "sample"), {"estimate_ratio": [0.0, 0.5, 1.0, 1.5]}, **metrics)


def test_the_estimate_of_least_travel_with_nine_tenths_of_the_gain_is_recommended():
    sentences = summary(make_estimates([1.0, 0.8, 0.62, 0.6], [1.0, 1.5, 2.0, 9.0]))
    assert sentences[2:4] == [
        "Do this: put an inverse behind the PI with an estimate of 100 % of the backlash.",
        "It brings: the RMS error is 38 % lower than with the plain PI of the same loop (median), and lower in 100 % "
        "of the loops.",
    ]
    assert (
        "with an estimate of 150 % instead of 100 % the inverse makes the motor travel 9 times as far" in sentences[-1]
    )
    nothing = summary(make_estimates([1.0, 1.1, 1.2, 1.3], [1.0, 1.5, 2.0, 9.0]))
    assert nothing[2:] == ["Do this: leave the plain PI as it is: nothing that was tried lowers its RMS error by 1 %."]


def test_where_tuning_and_inverse_add_up_both_are_recommended_in_words():
    as_found, better = (
        make_estimates([1.0, 0.8, 0.7, 0.7], [1, 2, 3, 9]),
        make_estimates([0.8, 0.6, 0.5, 0.5], [1, 2, 3, 9]),
    )
    ds = xr.concat([as_found, better], xr.DataArray(["as_found", "kp08_ti20_s1"], dims="tuning", name="tuning"))
    do, brings, *_ = summary(ds.assign_coords(kp=("tuning", [0.03, 0.08]), ti=("tuning", [8.0, 20.0])))[2:]
    assert do == (
        "Do this: tune the PI to proportional gain Kp = 0.08 1/K, integral time Ti = 20 s; then put an inverse behind "
        "the PI with an estimate of 100 % of the backlash."
    )
    assert "with the tuning alone 10 % lower; with the inverse alone" in brings


def test_days_off_count_in_no_median():
    ds = make_estimates([1.0, 0.8, 0.62, 0.6], [1.0, 1.5, 2.0, 9.0])
    off = ds.copy(deep=True)
    off["rmse"][:, :3], off["motor_travel"][:, :3] = np.nan, 0.0
    sentences = summary(off)
    assert "In 12 of 20 the loop was off all day" in sentences[2]
    assert sentences[3:] == summary(ds)[2:]
    days = {"rmse": [[0.2, np.nan, np.nan]] * 2, "motor_travel": [[3.0, 0.0, 0.0], [5.0, 0.0, 0.0]]}
    costs = summary(hand_made(("kp", "day"), {"kp": [0.01, 0.02]}, **days))[-1]
    assert costs == "It costs: the motor travels 3 strokes (median) instead of 3."


def test_it_says_in_which_loops_the_remedy_fails():
    better, worse = (
        make_estimates([1.0, 0.8, 0.6, 0.6], [1, 2, 3, 9]),
        make_estimates([1.0, 0.8, 1.1, 1.1], [1, 2, 3, 9]),
    )
    ds = xr.concat([better, better, worse], xr.DataArray([0.1, 0.05, 0.01], dims="backlash", name="backlash"))
    line = summary(ds)[-1]
    assert line.startswith(
        "It fails: the error is not lower in 33 % of the loops, most often at backlash = 1 % (100 %); "
    )


def test_choices_without_an_inverse_and_single_scenarios_have_an_answer():
    rmse = np.array([[0.4, 0.3], [0.2, 0.5]])
    results = hand_made(
        ("kp", "backlash"), {"kp": [0.01, 0.03], "backlash": [0.02, 0.1]}, rmse=rmse, motor_travel=10 * rmse
    )
    do, brings, costs, fails = summary(results)[2:]
    assert do == "Do this: take proportional gain Kp = 0.01 1/K."
    assert "0.35 K (median)" in brings
    named = results.rename(kp="controller").assign_coords(
        controller=["hagglund", "mine"], buffer_ratio=("controller", [0.0, 6.0]),
        estimator=("controller", ["hagglund", "identify"]),
    )  # fmt: skip
    assert summary(named)[2] == "Do this: take hagglund.", "numbers alone would not say which estimator"
    assert costs == "It costs: the motor travels 3.5 strokes (median) instead of 3.5."
    assert fails == "It fails: the error is largest at backlash = 2 %: 0.4 K (median)."
    assert summary(results.isel(kp=0))[-2:] == [
        "Found: the RMS error is 0.35 K in the median, 0.305 to 0.395 K in 5 to 95 % of the loops.",
        "It fails: the error is largest at backlash = 2 %: 0.4 K (median).",
    ]
    single = results.isel(kp=0, backlash=0).drop_vars(["kp", "backlash"])
    assert summary(single)[-2:] == ["Found: the RMS error is 0.4 K.", "It costs: the motor travels 4 strokes."]


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
