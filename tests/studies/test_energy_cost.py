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


def drawn(seed):
    """Metrics that nobody simulated: half of the valves hunt with the gap, and it makes everything dearer."""
    draw = np.random.default_rng(seed)
    dims, shape = ("day", "sample", "controller", "backlash"), (DAYS, VALVES, 3, 2)
    dearer = 1.0 + np.array([0.0, 1.0]) * draw.uniform(-0.01, 0.05, (1, VALVES, 1, 1))
    ds = xr.Dataset({name: (dims, draw.uniform(5.0, 9.0, shape) * dearer) for name in cost.KEPT})
    hunts = (np.arange(VALVES) % 2)[:, None, None] * np.array([0.0, 1.0]) * np.ones((DAYS, 1, 3, 1))
    return ds.assign(hunts=(dims, hunts), status=(dims, np.zeros(shape, dtype=np.int8))).assign_coords(
        controller=NAMES, backlash=list(GAPS), day=range(DAYS), action="cooling"
    )


@pytest.fixture(scope="module")
def found():
    return {CONSTANT: drawn(1), HEATING: drawn(2)}


def bill(ds, how="bill"):
    """Paid per year, (sample, controller, backlash): six days, of a month of 365/12."""
    t, one = cost.TARIFF, {name: ds[name].values for name in cost.KEPT}
    chilled = t["electricity"] / t["cop"]
    energy = one["coil_energy"].sum(axis=0) * chilled * 365 / DAYS
    demand = one["coil_peak_power"].max(axis=0) / t["cop"] * t["demand"] * 12
    warm, cold = one["reheat_energy"], one["recool_energy"]
    if how == "evened":
        warm, cold = np.maximum(warm - cold, 0.0), np.maximum(cold - warm, 0.0)
    air = (warm.sum(axis=0) * t["heat"] + cold.sum(axis=0) * chilled) * 365 / DAYS
    return energy + demand + (0.0 if how == "without" else air)


def test_bills_are_those_of_plain_numpy(found):
    ds = found[CONSTANT]
    got = cost.bills(ds)
    for how in ("without", "evened", "bill"):
        np.testing.assert_allclose(got[how].transpose("sample", "controller", "backlash"), bill(ds, how), rtol=1e-9)
    change = cost.against_sound(ds)
    paid = bill(ds)
    np.testing.assert_allclose(change.bill.sel(backlash=0.07), 100 * (paid[..., 1] / paid[..., 0] - 1), rtol=1e-6)
    np.testing.assert_allclose(change.money.sel(backlash=0.07), paid[..., 1] - paid[..., 0], rtol=1e-6)
    other = cost.against_found(ds, NAMES[0], 0.07)
    np.testing.assert_allclose(other.bill, 100 * (paid[..., 1] / paid[:, :1, 1] - 1), rtol=1e-6)


def test_every_other_table_is_written(found, written):
    cost.write_sums(found)
    cost.write_by_backlash(found)
    cost.write_remedies(found)
    _, (_, *rows) = written("cost_sums")
    assert len(rows) == 4
    title, (_, none, gap) = written("cost_backlash")
    paid = bill(found[CONSTANT])[:, 0]  # heating is no part of it
    assert f"pays {np.median(paid[:, 0]):,.0f} USD" in title
    assert none[2] == "0.00 % (0.00 to 0.00)"
    assert gap[3].split(" (")[0] == f"{np.median(paid[:, 1] - paid[:, 0]):+.0f}"
    _, (_, *rows) = written("cost_remedies")
    assert [row[1] for row in rows[:4]] == [*NAMES, "a valve without a gap"]
    mended = 100 * (paid[:, 0] / paid[:, 1] - 1)
    assert rows[3][5].startswith(f"{np.median(mended):+.2f} % (")
