"""``numerics/traces.py`` and ``remedies/others.py``: what they count is what plain Python counts."""

import math
import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import days as kinds
from studies.numerics import traces
from studies.remedies import others


def test_two_traces_come_apart_where_their_difference_first_exceeds_the_limit():
    time = xr.DataArray(np.arange(0, 7200, 60.0), dims="elapsed_time", name="elapsed_time")
    growth = np.where(time >= traces.BEGIN_SECOND, 1e-9 * np.exp((time.values - traces.BEGIN_SECOND) / 300.0), 0.0)
    trace = xr.DataArray(np.zeros((2, time.size)), {"elapsed_time": time}, ("sample", "elapsed_time"))
    nudged_trace = trace + xr.DataArray([1.0, 0.0], dims="sample") * xr.DataArray(growth, dims="elapsed_time")
    for limit in (1e-6, 1e-3):
        expected = math.ceil(300.0 * math.log(limit / 1e-9) / 60.0)
        assert traces.minutes_until_apart(trace, nudged_trace, limit).values.tolist() == [expected, math.inf]
    n, share, *times = traces.times_row(trace.isel(sample=[1]), nudged_trace.isel(sample=[1]))
    assert (n, share.split(" (")[0], set(times)) == ("1", "0 %", {"—"})


@pytest.mark.kernel
def test_a_pair_differs_by_the_nudge_alone_and_only_after_the_start():
    base, nudged = traces.simulate_pair(fc.Loop(kp=0.002, ti=300.0), fc.constant_day(hours=2))
    difference = abs(base.T_sup - nudged.T_sup)
    assert float(difference.sel(elapsed_time=slice(0, traces.BEGIN_SECOND)).max()) == 0.0
    assert 1e-11 < float(difference.max()) < 2e-9


@pytest.fixture
def made_up_result():
    """A result of plain PI and one remedy for 5 valves on 4 days."""
    rng = np.random.default_rng(5)
    dims, labels = ("controller", "sample", "day"), {"controller": [others.PI, others.OVERESTIMATE]}
    rmse, travel = rng.uniform(0.05, 0.5, (2, 5, 4)), rng.uniform(0.0, 30.0, (2, 5, 4))
    hunts = (rng.random((2, 5, 4)) < 0.4).astype(float)
    return xr.Dataset({"rmse": (dims, rmse), "motor_travel": (dims, travel), "hunts": (dims, hunts)}, labels)


def test_prices_are_geometric_means_against_plain_pi(made_up_result):
    middle, low, high = others.geometric_mean_ratio(made_up_result, others.OVERESTIMATE, "rmse")
    pairs = zip(made_up_result.rmse.values[1].ravel(), made_up_result.rmse.values[0].ravel(), strict=True)
    assert middle == pytest.approx(statistics.geometric_mean(a / b for a, b in pairs))
    assert low < middle < high
    assert others.remedy_cells(made_up_result, others.PI)[:2] == ["+0 % (+0 to +0)", "× 1.00 (1.00 to 1.00)"]
    hunting = made_up_result.hunts.values[1].mean()
    assert others.remedy_cells(made_up_result, others.OVERESTIMATE)[2].startswith(f"{100 * hunting:.0f} %")


@pytest.mark.full
@pytest.mark.kernel
def test_both_populations_are_the_same_valves_with_other_gains(monkeypatch, read_table):
    monkeypatch.setattr(kinds, "HOURS", 1)
    monkeypatch.setattr(others, "DAYS", range(2))
    monkeypatch.setattr(others, "kind_groups", lambda: [["stepped", "constant"], ["heating"]])
    by_gains = others.run_populations(3)
    assert set(by_gains) == {others.SIMC, others.AS_FOUND}
    for kind in ("stepped", "heating"):
        simc, as_found = by_gains[others.SIMC][kind], by_gains[others.AS_FOUND][kind]
        assert list(simc.controller.values) == list(others.SHOWN_REMEDIES)
        assert not np.allclose(simc.rmse, as_found.rmse)
    ds = fc.simulate(others.valves(3, heating=False), fc.constant_day(hours=1))
    np.testing.assert_allclose(ds.estimate_final.sel(controller=others.OVERESTIMATE).squeeze(), 1.2 * ds.backlash)
    monkeypatch.setattr(others, "run_populations", lambda size: by_gains)
    others.main(3)
    assert len(read_table("remedies_others")[1]) == 1 + 2 * 3 * len(others.SHOWN_REMEDIES)
