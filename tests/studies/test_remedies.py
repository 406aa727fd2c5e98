"""``remedies.py`` and its parts: gains, remedies that act, and tables that hold what plain Python finds."""

import math
import statistics

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import fastcoil as fc
from studies import common
from studies import days as kinds
from studies.remedies import front, remedies, runs
from studies.remedies import tables as remedies_tables
from studies.remedies.runs import by_count

SMALL_GRID = {"kp": (1.0, 3.0), "ti": (1.0, 4.0)}
DAYS = [2, 3]


@pytest.fixture
def short(monkeypatch):
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


def pairs(ds, metric, name, base):
    """(own, baseline's) of every valve and day."""
    return list(zip(*(ds[metric].sel(controller=n).values.ravel().tolist() for n in (name, base)), strict=True))


def changes(ds, name, base):
    return [a / b - 1.0 for a, b in pairs(ds, "rmse", name, base)]


@pytest.mark.kernel
def test_every_remedy_acts():
    """Behind the same gains each differs from plain PI on the valve that it is for."""
    loop = runs.population(64)
    backlash = np.asarray(loop["backlash"])
    worn = [int(k) for k in np.flatnonzero(backlash == 0.07)[:1]]
    one = runs.picked(loop, sample=worn)
    gains = xr.Dataset({"kp": 0.06, "ti": 20.0, "plant_gain": 12.0})
    ds = runs.every_remedy(one, gains, kinds.CONSTANT, [1]).isel(sample=0, day=0)
    plain = float(ds.rmse.sel(controller="pi"))
    assert int(ds.status.max()) == 0
    same = [str(n) for n in ds.controller.values if float(ds.rmse.sel(controller=n)) == plain]
    assert same == ["pi"]
    assert set(ds.controller.values) <= set(remedies_tables.LABELS)


@pytest.mark.kernel
def test_gains_are_best_on_the_search_days_and_dearer_travel_means_less_of_it(short):
    plain = runs.picked(runs.population(4), controller=0)
    simc = runs.simc_gains(plain, kinds.STEPPED)
    best = runs.tuned(plain, simc, [kinds.STEPPED], SMALL_GRID, [0.0, 5.0])
    day, found = kinds.of_kind(kinds.STEPPED, [1]), []
    for f_kp in SMALL_GRID["kp"]:
        for f_ti in SMALL_GRID["ti"]:
            ds = fc.simulate(plain.assign(kp=f_kp * simc.kp, ti=f_ti * simc.ti), day).isel(day=0)
            found.append((f_kp, f_ti, ds.rmse.values, ds.motor_travel.values))
    for k in range(4):
        for price, at in ((0.0, 0), (5.0, 1)):
            f_kp, f_ti, *_ = min(found, key=lambda x: math.log(x[2][k]) + price * math.log(max(x[3][k], 0.1)))  # noqa: B023
            of_valve = best.isel(sample=k, price=at)
            assert float(of_valve.kp / simc.kp[k]) == pytest.approx(f_kp)
            assert float(of_valve.ti / simc.ti[k]) == pytest.approx(f_ti)


@pytest.mark.kernel
def test_remedies_run_with_the_best_gains_and_with_those_of_simc(short):
    best_found, simc_found, edges = runs.run(4)
    assert list(best_found) == [kinds.STEPPED, kinds.HEATING]
    assert set(edges) == {kinds.STEPPED, kinds.HEATING}
    loop = runs.population(4)
    plain = runs.picked(loop, controller=0)
    simc = runs.simc_gains(plain, kinds.STEPPED)
    best = runs.tuned(plain, simc, [kinds.STEPPED], SMALL_GRID, [0.0]).isel(price=0)
    day = kinds.of_kind(kinds.STEPPED, DAYS)
    for gains, found, n in ((best, best_found, 4), (simc, simc_found, 2)):
        alone = plain.assign(kp=gains.kp, ti=gains.ti, estimate_ratio=0.95, buffer=0.01)
        own = plain.assign(kp=gains.kp, ti=gains.ti, estimator=by_count, buffer=0.01)
        for name, twin in (("inverse_95_buffer", alone), ("own_rule", own)):
            ours = found[kinds.STEPPED].rmse.sel(controller=name)
            theirs = fc.simulate(twin, day).rmse.isel(sample=slice(0, n))
            np.testing.assert_array_equal(ours.transpose(*theirs.dims).values, theirs.values)
    theirs = fc.simulate(plain.assign(kp=2.0 * simc.kp, ti=2.0 * simc.ti), day).rmse.isel(sample=slice(0, 2))
    ours = simc_found[kinds.STEPPED].rmse.sel(controller="faster")
    np.testing.assert_array_equal(ours.transpose(*theirs.dims).values, theirs.values)


@pytest.fixture
def table_of_two_kinds():
    """Results that nobody simulated: 3 valves, 3 days of two kinds, three remedies."""
    draw = np.random.default_rng(1)
    names = ["PI as found", "best PI", "inverse_95"]

    def of_kind():
        metrics = {name: (("controller", "sample", "day"), draw.uniform(0.5, 1.5, (3, 3, 3))) for name in runs.METRICS}
        metrics["status"] = (("controller", "sample", "day"), np.zeros((3, 3, 3)))
        return xr.Dataset(metrics, coords={"controller": names, "sample": range(3), "day": [5, 6, 7]})

    return {"stepped": of_kind(), "heating": of_kind()}


def test_the_interval_of_a_table_is_that_of_crossed_valves_and_days(table_of_two_kinds):
    ds = table_of_two_kinds["stepped"]
    own, base = (ds.rmse.sel(controller=n).values for n in ("inverse_95", "best PI"))
    share = own / base - 1.0
    variance = sum(statistics.variance(share.mean(axis=axis).tolist()) / 3 for axis in (0, 1))
    half = stats.t.ppf(0.975, 2) * math.sqrt(variance)
    mean, low, high = (100 * x for x in (share.mean(), share.mean() - half, share.mean() + half))
    assert common.change_in_words(ds, "inverse_95", "best PI") == f"{mean:+.0f} % ({low:+.0f} to {high:+.0f})"
    assert common.change_in_words(ds, "best PI", "best PI") == "0"


def test_tables_hold_what_plain_python_finds(table_of_two_kinds, written):
    of_kinds = table_of_two_kinds
    simc = {k: ds.assign_coords(controller=["best PI", "PI by SIMC", "inverse_95"]) for k, ds in of_kinds.items()}
    backlash = xr.DataArray([0.0, 0.07, 0.07], dims="sample")
    remedies_tables.write(of_kinds, simc, {"stepped": 0.02, "heating": 0.1}, backlash)
    for table, found, base in (("remedies", of_kinds, "best PI"), ("remedies_simc", simc, "PI by SIMC")):
        title, (head, *rows, (_, *size)) = written(table)
        assert "3 valves and loops, 3 days of each kind (0 of 54 days failed" in title
        assert ("2% cooling, 10% heating" in title) == (table == "remedies")
        assert head == ["remedy", "stepped", "heating", "all"]
        names = {text: name for name, text in remedies_tables.LABELS.items()}
        for row in rows:
            of_row = [changes(ds, names[row[0]], base) for ds in found.values()]
            means = [100 * statistics.mean(part) for part in (*of_row, of_row[0] + of_row[1])]
            assert [cell.split(" ")[0] for cell in row[1:]] == [
                "0" if names[row[0]] == base else f"{mean:+.0f}" for mean in means
            ]
        plain = [ds.rmse.sel(controller=base).values.ravel().tolist() for ds in found.values()]
        assert size == [f"{statistics.median(part):.3f} K" for part in (*plain, plain[0] + plain[1])]
        _, (head, *rows) = written(f"{table}_cost")
        for row in rows:
            name, cells = names[row[0]], dict(zip(head, row, strict=True))
            of_valves = {
                metric: [
                    sum(float(ds[metric].sel(controller=name)[k, d]) for ds in found.values() for d in range(3))
                    / sum(float(ds[metric].sel(controller=base)[k, d]) for ds in found.values() for d in range(3))
                    for k in range(3)
                ]
                for metric in ("rmse", "motor_travel")
            }
            assert cells["motor travel, median"] == f"× {statistics.median(of_valves['motor_travel']):.2f}"
            assert cells["over 1 % worse in"] == f"{sum(x > 1.01 for x in of_valves['rmse']) / 3:.0%}"
            hunts = [h for ds in found.values() for h in ds.hunts.sel(controller=name).values.ravel().tolist()]
            assert cells["hunting"] == f"{statistics.mean(hunts):.1%}"
        _, (head, *rows) = written(f"{table}_by_backlash")
        assert head == ["remedy", "0%", "7%"]
        assert {row[0]: row[1:] for row in rows}[base] == ["+0 %", "+0 %"]


@pytest.mark.kernel
def test_behind_the_gains_as_found_remedies_are_compared_with_them(short, written, monkeypatch):
    monkeypatch.setattr(remedies, "simc_gains", lambda loop, kind: xr.Dataset({"plant_gain": 12.0}))
    found = remedies.run_found(4)
    plain = runs.picked(runs.population(4), controller=0)
    by_hand = fc.simulate(
        plain.assign(estimate_ratio=0.95, buffer=0.0025, action="heating", kp=0.3 * xr.DataArray(plain["kp"])),
        kinds.of_kind(kinds.HEATING, DAYS),
    ).rmse
    ours = found[kinds.HEATING].rmse.sel(controller="inverse_95_small_buffer")
    np.testing.assert_array_equal(ours.transpose(*by_hand.dims).values, by_hand.values)
    remedies.write_found(found)
    _, (_, *rows) = written("remedies_found")
    assert [row[1] for row in rows].count("0") == 1
    assert [row[0] for row in rows][1:] == [remedies_tables.LABELS[name] for name in remedies.OF_FOUND[1:]]


@pytest.mark.full
@pytest.mark.kernel
def test_the_command_writes_every_table_and_the_figure(short, written, tmp_path, monkeypatch):
    monkeypatch.setattr(front, "groups", lambda: [[kinds.STEPPED], [kinds.HEATING]])
    monkeypatch.setattr(runs, "groups", lambda: [[kinds.STEPPED], [kinds.HEATING]])
    remedies.main(2)
    names = ["remedies", "remedies_simc", "remedies_tuned", "remedies_choice", "remedies_found", "remedies_valves"]
    assert all(len(written(name)[1]) > 3 for name in names)
    assert (tmp_path / "studies" / "remedies" / "remedies.png").stat().st_size > 20_000
