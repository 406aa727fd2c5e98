"""Each claim of the paper is judged rightly: on made-up results, where it holds and where it does not."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from fastcoil.study.paper import grid
from fastcoil.study.paper.claims import CLAIMS, IDENTITIES

H = 3600.0


def by_case(metric, **values):
    """A result of one tuning and day: a metric by case."""
    names = [name.replace("_", " ").replace("pct", " %") for name in values]
    data = np.array(list(values.values()))[:, None, None]
    return xr.Dataset(
        {metric: (("case", "tuning", "day"), data)}, coords={"case": names, "tuning": ["made up"], "day": [1]}
    )


def ratios(metric, *values):
    """The metric for all estimates in turn."""
    ds = by_case(metric, **{f"c{k}": v for k, v in enumerate(values)})
    return ds.assign_coords(case=[grid.case(r) for r in grid.RATIOS[: len(values)]])


def learned(case, first_down, confirmed, step=0.007):
    ds = by_case("estimate_first_down", a=first_down).assign_coords(case=[case])
    ds["learn_time_confirmed"] = ds.estimate_first_down * 0 + confirmed
    return ds.assign_coords(learning_step=("case", [step]))


def noisy(literal, noise):
    return xr.concat([learned("literal", literal, 5.5 * H), learned("noise", noise, 5.5 * H)], "case")


def buffered(switches, rmse):
    """Switches of the inverse with noise and buffer, where there are 5 without noise, and its error; the PI's is 1."""
    names = ["95 %", "95 %, noise, buffer", "plain PI, noise"]
    ds = by_case("switch_frequency", a=5.0, b=switches, c=3.0).assign_coords(case=names)
    return ds.merge(by_case("rmse_settled", a=0.1, b=rmse, c=1.0).assign_coords(case=names))


def two_errors(better, worse):
    """A case that is 2 % lower than the other, and one that is half a per cent lower."""
    return tuple(by_case("rmse", a=x, b=0.100).assign_coords(case=[better, worse]) for x in (0.098, 0.0995))


def hunting(without, with_it):
    return by_case("hunts", no_backlash=without, plain_PI=with_it).isel(day=0, drop=True)


def largest(n):
    return xr.Dataset({"largest": ("tuning", [n])})


def renamed(ds, **names):
    return ds.assign_coords(case=[names.get(str(c), str(c)) for c in ds.case.values])


FLAT = (6.0, 6.1, 6.2, 6.3, 6.4, 6.5, 6.6)
FALLING = (1.0, 0.9, 0.8, 0.6, 0.4, 0.2, 0.1, 0.05)
NOISE_CASES = {"a": "95 %", "b": "95 %, noise"}
MADE_UP = {
    "hunts": (hunting(False, True), hunting(True, True)),
    "fluctuates": (
        by_case("rmse_settled", no_backlash=0.1, plain_PI=0.21), by_case("rmse_settled", no_backlash=0.1, plain_PI=0.19)
    ),
    "sixty": (
        ratios("rmse_settled", 1.0, 0, 0, 0, 0.5, 0, 0, 0, 0.1), ratios("rmse_settled", 1.0, 0, 0, 0, 1.1, 0, 0, 0, 0.1)
    ),
    "ninety-five": (
        by_case("rmse_settled", no_backlash=0.1, plain_PI=1.1, **{"95pct": 0.19}),
        by_case("rmse_settled", no_backlash=0.1, plain_PI=1.1, **{"95pct": 0.21}),
    ),
    "unity": (
        by_case("rmse_settled", no_backlash=0.100, **{"100pct": 0.104}),
        by_case("rmse_settled", no_backlash=0.100, **{"100pct": 0.106}),
    ),
    "flat": (ratios("switch_frequency", *FLAT), ratios("switch_frequency", *FLAT[:-1], 9.5)),
    "jump": (
        by_case("switch_frequency", **{"10pct": 6.0, "110pct": 13.0}),
        by_case("switch_frequency", **{"10pct": 6.0, "110pct": 11.0}),
    ),
    "falls": (ratios("rmse", *FALLING, 0.04), ratios("rmse", *FALLING[:4], 0.7, *FALLING[5:], 0.04)),
    "rises": (
        by_case("rmse", **{"100pct": 0.100, "120pct": 0.102}), by_case("rmse", **{"100pct": 0.100, "120pct": 0.1005})
    ),
    "rises, settled": (
        by_case("rmse_settled", **{"100pct": 0.100, "120pct": 0.102}),
        by_case("rmse_settled", **{"100pct": 0.100, "120pct": 0.1005}),
    ),
    "best": (ratios("rmse", *FALLING, 0.06, 0.2, 0.3, 0.4), ratios("rmse", *FALLING, 0.06, 0.04, 0.3, 0.4)),
    "finds": (learned("literal", 0.077, 5.5 * H), learned("literal", 0.056, 5.5 * H)),
    "three hours, every 15 min": (learned("every 15 min", 0.07, 2.9 * H), learned("every 15 min", 0.035, 1.0 * H)),
    "three hours, twice the step": (
        learned("twice the step", 0.07, 3.0 * H), learned("twice the step", 0.07, 3.01 * H)
    ),
    "three hours, growing steps": (learned("growing steps", 0.07, 2.9 * H), learned("growing steps", np.nan, np.nan)),
    "any start": (
        xr.concat([learned("a", 0.07, 1.0), learned("b", 0.056, 1.0, 0.014)], "case"),
        xr.concat([learned("a", 0.07, 1.0), learned("b", 0.056, 1.0, 0.007)], "case"),
    ),
    "volumes": (largest(8), largest(9)),
    "heat": (
        by_case("coil_energy", no_backlash=100.0, plain_PI=101.5),
        by_case("coil_energy", no_backlash=100.0, plain_PI=99.0),
    ),
    "peak": (
        by_case("coil_peak_power", no_backlash=100.0, plain_PI=101.5),
        by_case("coil_peak_power", no_backlash=100.0, plain_PI=100.5),
    ),
    "noise": (
        renamed(by_case("switch_frequency", a=5.0, b=11.0), **NOISE_CASES),
        renamed(by_case("switch_frequency", a=5.0, b=9.0), **NOISE_CASES),
    ),
    "buffer": (buffered(7.0, 0.2), buffered(8.0, 0.2)),
    "noise, learner": (noisy(0.07, 0.028), noisy(0.07, 0.077)),
    "buffer, learner": (learned("noise, buffer", 0.07, 5.5 * H), learned("noise, buffer", np.nan, np.nan)),
    "against dead band": two_errors("95 %", "dead band"),
    "against best PI": two_errors("95 %", "best PI"),
    "best PI alone": two_errors("best PI", "95 %"),
    "best PI with inverse": two_errors("best PI, 95 %", "best PI"),
    "best against best": two_errors("best inverse", "best PI"),
    "best against best, noise": two_errors("best inverse, noise, buffer", "best PI, noise"),
}  # fmt: skip
"""For each claim a result on which it holds, and one on which it does not."""


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda c: c.name)
def test_a_claim_holds_where_it_should_and_not_where_it_should_not(claim):
    holds, not_so = (claim.holds(ds) for ds in MADE_UP[claim.name])
    assert bool(holds.all())
    assert not bool(not_so.any())
    assert "case" not in holds.dims


def test_a_buffer_must_help_control_too_and_noise_breaks_only_what_works():
    claims = {claim.name: claim.holds for claim in CLAIMS}
    assert not claims["buffer"](buffered(5.0, 1.2)).any()
    assert not claims["noise, learner"](noisy(0.028, 0.028)).any()


def test_a_claim_that_is_false_whatever_the_loop_gets_no_share():
    """Nine steps of half an hour each are no three hours, on any tuning."""
    assert set(MADE_UP) == {claim.name for claim in CLAIMS}
    ((_, words, verdict, why),) = IDENTITIES
    assert words not in {claim.words for claim in CLAIMS}
    assert "contradicts" in verdict
    assert "9 × 0.5 h = 4.5 h" in why


@pytest.mark.parametrize("claim", [c for c in CLAIMS if c.evidence in ("days", "learning")], ids=lambda c: c.name)
def test_a_failed_scenario_holds_nothing(claim):
    failed = MADE_UP[claim.name][0]
    assert not claim.holds(failed.assign({n: v * np.nan for n, v in failed.data_vars.items()})).any()
