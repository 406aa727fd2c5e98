"""Each claim of the paper is judged rightly: on made-up results, where it holds and where it does not."""

import numpy as np
import pytest
import xarray as xr

from studies.paper import grid
from studies.paper.claims import CLAIMS, IDENTITIES

HOUR_SECONDS = 3600.0


def result_by_case(metric, **values):
    """A result of one tuning and day: a metric by case."""
    data = np.array(list(values.values()))[:, None, None]
    return xr.Dataset(
        {metric: (("case", "tuning", "day"), data)}, coords={"case": list(values), "tuning": ["made up"], "day": [1]}
    )


def result_by_ratio(metric, *values):
    """The metric for all estimates in turn."""
    return result_by_case(metric, **dict(zip(map(grid.case_label, grid.RATIOS), values, strict=False)))


def learned_result(case, first_down, confirmed, step=0.007):
    ds = result_by_case("estimate_first_down", **{case: first_down})
    ds["learn_time_confirmed"] = ds.estimate_first_down * 0 + confirmed
    return ds.assign_coords(learning_step=("case", [step]))


def noisy_result(literal, noise):
    return xr.concat(
        [learned_result("literal", literal, 5.5 * HOUR_SECONDS), learned_result("noise", noise, 5.5 * HOUR_SECONDS)],
        "case",
    )


def buffered_result(switches, rmse):
    """Switches of the inverse with noise and buffer, where there are 5 without noise, and its error; the PI's is 1."""
    names = ("95 %", "95 %, noise, buffer", "plain PI, noise")
    values_by_metric = {"switch_frequency": (5.0, switches, 3.0), "rmse_settled": (0.1, rmse, 1.0)}
    return xr.merge(
        result_by_case(metric, **dict(zip(names, values, strict=True))) for metric, values in values_by_metric.items()
    )


def result_pair(metric, fixed_case, varied_case, value, holds, fails):
    """A result with a value in one case and that in the other with which the claim holds, and one with which not."""
    return tuple(
        result_by_case(metric, **{fixed_case: value, varied_case: varied_value}) for varied_value in (holds, fails)
    )


def error_pair(better, worse):
    """A case that is 2 % lower than the other, and one that is half a per cent lower."""
    return result_pair("rmse", worse, better, 0.100, 0.098, 0.0995)


def hunting_result(without, with_it):
    return result_by_case("hunts", **{"no backlash": without, "plain PI": with_it}).isel(day=0, drop=True)


FLAT = (6.0, 6.1, 6.2, 6.3, 6.4, 6.5, 6.6)
FALLING = (1.0, 0.9, 0.8, 0.6, 0.4, 0.2, 0.1, 0.05)
GOOD_AND_WORN = ("no backlash", "plain PI")
MADE_UP_RESULTS = {
    "hunts": (hunting_result(False, True), hunting_result(True, True)),
    "fluctuates": result_pair("rmse_settled", *GOOD_AND_WORN, 0.1, 0.21, 0.19),
    "sixty": tuple(result_by_ratio("rmse_settled", 1.0, 0, 0, 0, at_sixty, 0, 0, 0, 0.1) for at_sixty in (0.5, 1.1)),
    "ninety-five": tuple(
        result_by_case("rmse_settled", **{"no backlash": 0.1, "plain PI": 1.1, "95 %": error}) for error in (0.19, 0.21)
    ),
    "unity": result_pair("rmse_settled", "no backlash", "100 %", 0.100, 0.104, 0.106),
    "flat": (result_by_ratio("switch_frequency", *FLAT), result_by_ratio("switch_frequency", *FLAT[:-1], 9.5)),
    "jump": result_pair("switch_frequency", "10 %", "110 %", 6.0, 13.0, 11.0),
    "falls": (result_by_ratio("rmse", *FALLING, 0.04), result_by_ratio("rmse", *FALLING[:4], 0.7, *FALLING[5:], 0.04)),
    "rises": result_pair("rmse", "100 %", "120 %", 0.100, 0.102, 0.1005),
    "rises, settled": result_pair("rmse_settled", "100 %", "120 %", 0.100, 0.102, 0.1005),
    "best": (
        result_by_ratio("rmse", *FALLING, 0.06, 0.2, 0.3, 0.4),
        result_by_ratio("rmse", *FALLING, 0.06, 0.04, 0.3, 0.4),
    ),
    "finds": (
        learned_result("literal", 0.077, 5.5 * HOUR_SECONDS),
        learned_result("literal", 0.056, 5.5 * HOUR_SECONDS),
    ),
    "three hours, every 15 min": (
        learned_result("every 15 min", 0.07, 2.9 * HOUR_SECONDS),
        learned_result("every 15 min", 0.035, 1.0 * HOUR_SECONDS),
    ),
    "three hours, twice the step": tuple(
        learned_result("twice the step", 0.07, hours * HOUR_SECONDS) for hours in (3.0, 3.01)
    ),
    "three hours, growing steps": (
        learned_result("growing steps", 0.07, 2.9 * HOUR_SECONDS),
        learned_result("growing steps", np.nan, np.nan),
    ),
    "any start": tuple(
        xr.concat([learned_result("a", 0.07, 1.0), learned_result("b", 0.056, 1.0, step)], "case")
        for step in (0.014, 0.007)
    ),
    "volumes": tuple(xr.Dataset({"largest": ("tuning", [n])}) for n in (8, 9)),
    "heat": result_pair("coil_energy", *GOOD_AND_WORN, 100.0, 101.5, 99.0),
    "peak": result_pair("coil_peak_power", *GOOD_AND_WORN, 100.0, 101.5, 100.5),
    "noise": result_pair("switch_frequency", "95 %", "95 %, noise", 5.0, 11.0, 9.0),
    "buffer": (buffered_result(7.0, 0.2), buffered_result(8.0, 0.2)),
    "noise, learner": (noisy_result(0.07, 0.028), noisy_result(0.07, 0.077)),
    "buffer, learner": (
        learned_result("noise, buffer", 0.07, 5.5 * HOUR_SECONDS),
        learned_result("noise, buffer", np.nan, np.nan),
    ),
    "against dead band": error_pair("95 %", "dead band"),
    "against best PI": error_pair("95 %", "best PI"),
    "best PI alone": error_pair("best PI", "95 %"),
    "best PI with inverse": error_pair("best PI, 95 %", "best PI"),
    "best against best": error_pair("best inverse", "best PI"),
    "best against best, noise": error_pair("best inverse, noise, buffer", "best PI, noise"),
}
"""For each claim a result on which it holds, and one on which it does not."""


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda c: c.name)
def test_a_claim_holds_where_it_should_and_not_where_it_should_not(claim):
    holds, fails = (claim.holds(ds) for ds in MADE_UP_RESULTS[claim.name])
    assert bool(holds.all())
    assert not bool(fails.any())
    assert "case" not in holds.dims


def test_a_claim_that_is_false_whatever_the_loop_gets_no_share():
    """Nine steps of half an hour each are no three hours, on any tuning."""
    assert set(MADE_UP_RESULTS) == {claim.name for claim in CLAIMS}
    ((_, words, verdict, why),) = IDENTITIES
    assert words not in {claim.words for claim in CLAIMS}
    assert "contradicts" in verdict
    assert "9 × 0.5 h = 4.5 h" in why


@pytest.mark.parametrize("claim", [c for c in CLAIMS if c.evidence in ("days", "learning")], ids=lambda c: c.name)
def test_a_failed_scenario_holds_nothing(claim):
    failed = MADE_UP_RESULTS[claim.name][0]
    assert not claim.holds(failed.assign({n: v * np.nan for n, v in failed.data_vars.items()})).any()
