"""The study of what backlash costs: its tables against bills in plain numpy."""

import numpy as np
import pytest
import xarray as xr

from studies.cost import cost
from studies.days import CONSTANT, HEATING

DAYS, VALVES, GAPS = 6, 24, (0.0, 0.07)
NAMES = [cost.AS_FOUND, cost.SIMC, cost.INVERSE]


@pytest.fixture(autouse=True)
def _few_resamples(monkeypatch):
    monkeypatch.setattr(cost, "RESAMPLES", 20)


def make_metrics(seed):
    """Metrics that nobody simulated: half of the valves hunt with the gap, and it makes everything dearer."""
    rng = np.random.default_rng(seed)
    dims, shape = ("day", "sample", "controller", "backlash"), (DAYS, VALVES, 3, 2)
    dearer = 1.0 + np.array([0.0, 1.0]) * rng.uniform(-0.01, 0.05, (1, VALVES, 1, 1))
    ds = xr.Dataset({name: (dims, rng.uniform(5.0, 9.0, shape) * dearer) for name in cost.KEPT_METRICS})
    hunts = (np.arange(VALVES) % 2)[:, None, None] * np.array([0.0, 1.0]) * np.ones((DAYS, 1, 3, 1))
    return ds.assign(hunts=(dims, hunts), status=(dims, np.zeros(shape, dtype=np.int8))).assign_coords(
        controller=NAMES, backlash=list(GAPS), day=range(DAYS), action="cooling"
    )


@pytest.fixture(scope="module")
def metrics_by_kind():
    return {CONSTANT: make_metrics(1), HEATING: make_metrics(2)}


def yearly_bill(ds, kind="bill"):
    """Paid per year, (sample, controller, backlash): six days, of a month of 365/12."""
    t, values = cost.TARIFF, {name: ds[name].values for name in cost.KEPT_METRICS}
    chilled = t["electricity"] / t["cop"]
    energy = values["coil_energy"].sum(axis=0) * chilled * 365 / DAYS
    demand = values["coil_peak_power"].max(axis=0) / t["cop"] * t["demand"] * 12
    warm, cold = values["reheat_energy"], values["recool_energy"]
    if kind == "evened":
        warm, cold = np.maximum(warm - cold, 0.0), np.maximum(cold - warm, 0.0)
    air = (warm.sum(axis=0) * t["heat"] + cold.sum(axis=0) * chilled) * 365 / DAYS
    return energy + demand + (0.0 if kind == "without" else air)


def test_bills_are_those_of_plain_numpy(metrics_by_kind):
    ds = metrics_by_kind[CONSTANT]
    bills = cost.bills(ds)
    for kind in ("without", "evened", "bill"):
        bill = bills[kind].transpose("sample", "controller", "backlash")
        np.testing.assert_allclose(bill, yearly_bill(ds, kind), rtol=1e-9)
    change = cost.changes_against_sound(ds)
    paid = yearly_bill(ds)
    np.testing.assert_allclose(change.bill.sel(backlash=0.07), 100 * (paid[..., 1] / paid[..., 0] - 1), rtol=1e-6)
    np.testing.assert_allclose(change.money.sel(backlash=0.07), paid[..., 1] - paid[..., 0], rtol=1e-6)
    changes = cost.changes_against_pi(ds, NAMES[0], 0.07)
    np.testing.assert_allclose(changes.bill, 100 * (paid[..., 1] / paid[:, :1, 1] - 1), rtol=1e-6)


def test_every_other_table_is_written(metrics_by_kind, read_table):
    cost.write_sums(metrics_by_kind)
    cost.write_by_backlash(metrics_by_kind)
    cost.write_remedies(metrics_by_kind)
    _, (_, *rows) = read_table("cost_sums")
    assert len(rows) == 4
    title, (_, none, gap) = read_table("cost_backlash")
    paid = yearly_bill(metrics_by_kind[CONSTANT])[:, 0]  # heating is no part of it
    assert f"pays {np.median(paid[:, 0]):,.0f} USD" in title
    assert none[2] == "0.00 % (0.00 to 0.00)"
    assert gap[3].split(" (")[0] == f"{np.median(paid[:, 1] - paid[:, 0]):+.0f}"
    _, (_, *rows) = read_table("cost_remedies")
    assert [row[1] for row in rows[:4]] == [*NAMES, "a valve without a gap"]
    assert rows[3][5].startswith(f"{np.median(100 * (paid[:, 0] / paid[:, 1] - 1)):+.2f} % (")
