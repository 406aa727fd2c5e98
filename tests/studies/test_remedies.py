"""``remedies.py``: gains that are the best by plain Python, and its tables."""

import math

import pytest

import fastcoil as fc
from studies import days as kinds
from studies.remedies import front, remedies, runs

SMALL_GRID = {"kp": (1.0, 3.0), "ti": (1.0, 4.0)}
DAYS = [2, 3]


@pytest.fixture
def short_days(monkeypatch):
    """Short days, few gains, two kinds of days."""
    monkeypatch.setattr(kinds, "HOURS", 2)
    monkeypatch.setattr(runs, "GRID", SMALL_GRID)
    monkeypatch.setattr(front, "OWN_GRID", SMALL_GRID)
    monkeypatch.setattr(runs, "SEARCH_DAYS", [1])
    monkeypatch.setattr(runs, "FRESH_DAYS", DAYS)
    monkeypatch.setattr(remedies, "FRESH_DAYS", DAYS)
    monkeypatch.setattr(front, "DAYS", DAYS)
    monkeypatch.setattr(runs, "SIMC_VALVES", 2)
    for module in (runs, remedies):
        monkeypatch.setattr(module, "kinds", lambda: (kinds.STEPPED, kinds.HEATING))


@pytest.mark.kernel
def test_gains_are_best_on_the_search_days_and_dearer_travel_means_less_of_it(short_days):
    plain = runs.select_loop(runs.population(4), controller=0)
    simc = runs.simc_gains(plain, kinds.STEPPED)
    best = runs.tune_gains(plain, simc, [kinds.STEPPED], SMALL_GRID, [0.0, 5.0])
    day, results = kinds.make_days(kinds.STEPPED, [1]), []
    for f_kp in SMALL_GRID["kp"]:
        for f_ti in SMALL_GRID["ti"]:
            ds = fc.simulate(plain.assign(kp=f_kp * simc.kp, ti=f_ti * simc.ti), day).isel(day=0)
            results.append((f_kp, f_ti, ds.rmse.values, ds.motor_travel.values))
    for k in range(4):
        for price, at in ((0.0, 0), (5.0, 1)):
            f_kp, f_ti, *_ = min(results, key=lambda x: math.log(x[2][k]) + price * math.log(max(x[3][k], 0.1)))  # noqa: B023
            of_valve = best.isel(sample=k, price=at)
            assert float(of_valve.kp / simc.kp[k]) == pytest.approx(f_kp)
            assert float(of_valve.ti / simc.ti[k]) == pytest.approx(f_ti)


@pytest.mark.full
@pytest.mark.kernel
def test_the_command_writes_every_table_and_the_figure(short_days, read_table, tmp_path, monkeypatch):
    monkeypatch.setattr(front, "kind_groups", lambda: [[kinds.STEPPED], [kinds.HEATING]])
    monkeypatch.setattr(runs, "kind_groups", lambda: [[kinds.STEPPED], [kinds.HEATING]])
    remedies.main(2)
    names = ["remedies", "remedies_simc", "remedies_tuned", "remedies_choice", "remedies_found", "remedies_valves"]
    assert all(len(read_table(name)[1]) > 3 for name in names)
    assert (tmp_path / "studies" / "remedies" / "remedies.png").stat().st_size > 20_000
