"""What an inverse is compared with in the summary of a run: plain Python finds the same."""

from __future__ import annotations

import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.study.analysis import summary as baselines
from fastcoil.study.analysis.summary import summary

TUNINGS = {
    "slow": (0.01, 60.0, 0.0),
    "quick": (0.05, 30.0, 0.0),
    "banded": (0.05, 30.0, 0.2),
    "other": (0.05, 9.0, 0.5),
}


def errors(**rmse):
    """Errors of plain PIs over two backlashes, by tuning."""
    names = list(rmse)
    kp, ti, band = zip(*(TUNINGS[name] for name in names), strict=True)
    return xr.Dataset(
        {"rmse": (("tuning", "backlash"), list(rmse.values()))},
        coords={"tuning": names, "backlash": [0.02, 0.1], "kp": ("tuning", list(kp)), "ti": ("tuning", list(ti)),
                "error_dead_band": ("tuning", list(band))},
    )  # fmt: skip


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
preset = "paper_like"
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
