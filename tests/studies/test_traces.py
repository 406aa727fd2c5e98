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
    growth = np.where(time >= traces.BEGIN, 1e-9 * np.exp((time.values - traces.BEGIN) / 300.0), 0.0)
    one = xr.DataArray(np.zeros((2, time.size)), {"elapsed_time": time}, ("sample", "elapsed_time"))
    other = one + xr.DataArray([1.0, 0.0], dims="sample") * xr.DataArray(growth, dims="elapsed_time")
    for limit in (1e-6, 1e-3):
        found = traces.first_apart(one, other, limit)
        expected = math.ceil(300.0 * math.log(limit / 1e-9) / 60.0)
        assert found.values.tolist() == [expected, math.inf]
    n, share, *times = traces.row_of_times(one.isel(sample=[1]), other.isel(sample=[1]))
    assert (n, share.split(" (")[0], set(times)) == ("1", "0 %", {"—"})


@pytest.mark.kernel
def test_a_pair_differs_by_the_nudge_alone_and_only_after_the_start():
    one, other = traces.pair(fc.Loop(kp=0.002, ti=300.0), fc.constant_day(hours=2))
    apart = abs(one.T_sup - other.T_sup)
    assert float(apart.sel(elapsed_time=slice(0, traces.BEGIN)).max()) == 0.0
    assert 1e-11 < float(apart.max()) < 2e-9


@pytest.fixture
def made_up():
    """A result of plain PI and one remedy for 5 valves on 4 days."""
    dice = np.random.default_rng(5)
    dims, labels = ("controller", "sample", "day"), {"controller": [others.PI, others.OVERESTIMATE]}
    rmse, travel = dice.uniform(0.05, 0.5, (2, 5, 4)), dice.uniform(0.0, 30.0, (2, 5, 4))
    hunts = (dice.random((2, 5, 4)) < 0.4).astype(float)
    return xr.Dataset({"rmse": (dims, rmse), "motor_travel": (dims, travel), "hunts": (dims, hunts)}, labels)


def test_prices_are_geometric_means_against_plain_pi(made_up):
    middle, low, high = others.changed(made_up, others.OVERESTIMATE, "rmse")
    pairs = zip(made_up.rmse.values[1].ravel(), made_up.rmse.values[0].ravel(), strict=True)
    assert middle == pytest.approx(statistics.geometric_mean(a / b for a, b in pairs))
    assert low < middle < high
    assert others.cells(made_up, others.PI)[:2] == ["+0 % (+0 to +0)", "× 1.00 (1.00 to 1.00)"]
    hunting = made_up.hunts.values[1].mean()
    assert others.cells(made_up, others.OVERESTIMATE)[2].startswith(f"{100 * hunting:.0f} %")


@pytest.mark.kernel
def test_both_populations_are_the_same_valves_with_other_gains(monkeypatch, written):
    monkeypatch.setattr(kinds, "HOURS", 1)
    monkeypatch.setattr(others, "DAYS", range(2))
    monkeypatch.setattr(others, "groups", lambda: [["stepped", "constant"], ["heating"]])
    found = others.ran(3)
    assert set(found) == {others.SIMC, others.DRAWN}
    for kind in ("stepped", "heating"):
        simc, drawn = found[others.SIMC][kind], found[others.DRAWN][kind]
        assert list(simc.controller.values) == list(others.SHOWN)
        assert not np.allclose(simc.rmse, drawn.rmse)
    ds = fc.simulate(others.valves(3, heating=False), fc.constant_day(hours=1))
    np.testing.assert_allclose(ds.estimate_final.sel(controller=others.OVERESTIMATE).squeeze(), 1.2 * ds.backlash)
    monkeypatch.setattr(others, "ran", lambda size: found)
    others.main(3)
    assert len(written("remedies_others")[1]) == 1 + 2 * 3 * len(others.SHOWN)
