"""``kinds.py``, ``best_pi.py``, ``remedies.py``: kinds of days, gains, and tables that hold what plain Python finds."""

from __future__ import annotations

import statistics

import best_pi
import kinds
import numpy as np
import pytest
import remedies
import xarray as xr

import fastcoil as fc

WITHOUT_WEATHER = (kinds.STEPPED, kinds.CONSTANT, kinds.DESIGN, kinds.HEATING)


@pytest.fixture
def two_hours(monkeypatch, tmp_path):
    """Short days, few gains, no figure in the repository."""
    monkeypatch.setattr(kinds, "HOURS", 2)
    monkeypatch.setattr(best_pi, "KP", np.array([0.02, 0.05]))
    monkeypatch.setattr(best_pi, "TI", np.array([40.0, 100.0]))
    monkeypatch.setattr(remedies, "SEARCH_DAYS", [1])
    monkeypatch.setattr(remedies, "FRESH_DAYS", [2, 3])
    monkeypatch.setattr(remedies, "kinds", lambda: (kinds.STEPPED, kinds.HEATING))
    monkeypatch.setattr(remedies, "HERE", tmp_path / "studies")


@pytest.mark.parametrize("kind", WITHOUT_WEATHER)
def test_days_of_a_kind_differ_and_come_again(kind):
    days, again = kinds.of_kind(kind, [5, 6]), kinds.of_kind(kind, [6])
    assert days.day.tolist() == [5, 6]
    for name in ("m_a", "T_a_in", "T_w_in"):
        assert not np.allclose(days.series[name][0], days.series[name][1])
        np.testing.assert_array_equal(days.series[name][1], again.series[name][0])
    changes = np.count_nonzero(np.diff(days.series["T_set"]))
    assert (changes > 0) == (kind == kinds.STEPPED)
    colder = days.series["T_a_in"] < days.series["T_set"]
    assert colder.all() if kind == kinds.HEATING else not colder.any()


def test_days_of_weather_come_only_with_a_file(tmp_path):
    assert kinds.WEATHER not in kinds.kinds(tmp_path / "weather.csv")
    hours = np.arange(1, 8761)
    columns = {"hour_of_year": hours, "month": 1, "day": 1, "hour": (hours - 1) % 24 + 1, "T_drybulb_C": 20 + hours % 7}
    text = [",".join([*columns, "T_dewpoint_C"])]
    text += [",".join(str(np.broadcast_to(v, hours.shape)[k]) for v in columns.values()) + ",12" for k in range(8760)]
    (tmp_path / "weather.csv").write_text("\n".join(text) + "\n")
    assert kinds.WEATHER in kinds.kinds(tmp_path / "weather.csv")
    days = kinds.of_kind(kinds.WEATHER, [1, 2], tmp_path / "weather.csv")
    assert not np.allclose(days.series["T_a_in"][0], days.series["T_a_in"][1])


@pytest.mark.parametrize(("gain", "tau", "theta"), [(20.0, 60.0, 30.0), (8.0, 200.0, 20.0)])
def test_the_model_of_a_first_order_plant_is_that_plant(monkeypatch, gain, tau, theta):
    def response(loop, kind, level):
        t = np.arange(0.0, best_pi.RESPONSE, best_pi.SEEN)
        rise = np.where(t > theta, 1.0 - np.exp(-(t - theta) / tau), 0.0)
        T = 25.0 - gain * (level + best_pi.STEP * rise)
        return xr.DataArray(T, dims="elapsed_time", coords={"elapsed_time": t})

    monkeypatch.setattr(best_pi, "_response", response)
    loop = fc.Loop(sample_time=10.0)
    model = best_pi.first_order(loop, kinds.CONSTANT)
    assert float(model.gain) == pytest.approx(gain, rel=0.01)
    assert float(model.tau) == pytest.approx(tau, rel=0.1)
    assert float(model.theta) == pytest.approx(theta + 5.0, abs=4.0)
    gains = best_pi.simc_gains(loop, kinds.CONSTANT)
    assert float(gains.kp) == pytest.approx(tau / (gain * 2 * (theta + 5.0)), rel=0.25)
    assert float(gains.ti) == pytest.approx(min(tau, 8 * (theta + 5.0)), rel=0.25)


@pytest.mark.kernel
def test_the_best_gains_have_the_lowest_error_on_the_search_days(two_hours):
    loop = fc.Loop.preset("lbnl").assign(backlash=("valve", [0.02, 0.1]))
    best = best_pi.best_gains(loop, [kinds.CONSTANT], [1])
    swept = loop.assign(kp=[0.02, 0.05], ti=[40.0, 100.0])
    ds = fc.simulate(swept, kinds.of_kind(kinds.CONSTANT, [1])).isel(day=0)
    for k in range(2):
        lowest = min(ds.rmse.isel(valve=k).values.ravel())
        assert float(ds.rmse.isel(valve=k).sel(kp=float(best.kp[k]), ti=float(best.ti[k]))) == lowest


@pytest.mark.kernel
def test_remedies_write_what_plain_python_finds(two_hours, written):
    found = remedies.main(size=8)
    title, (head, *table) = written("remedies")
    names = [str(n) for n in found[kinds.STEPPED].controller.values]
    assert names[0] == remedies.DRAWN
    assert remedies.BASELINE in names
    assert "on 8 valves and loops, 2 days of each kind" in title
    assert [row[:2] for row in table] == [[k, n] for k in (kinds.STEPPED, kinds.HEATING) for n in names]
    for row in table:
        d, base = (found[row[0]].sel(controller=n) for n in (row[1], remedies.BASELINE))
        pairs = zip(d.rmse.values.ravel(), base.rmse.values.ravel(), strict=True)
        assert row[2].split(" ")[0] == f"{100 * statistics.mean(a / b - 1 for a, b in pairs):+.0f}"
        pairs = zip(d.motor_travel.mean("day").values, base.motor_travel.mean("day").values, strict=True)
        assert row[head.index("motor travel, median")] == f"× {statistics.median(a / b for a, b in pairs if b):.2f}"
        assert row[head.index("hunting")] == f"{statistics.mean(d.hunts.values.ravel()):.1%}"
    _, (_, *by_backlash) = written("remedies_by_backlash")
    assert {row[0]: set(row[1:]) for row in by_backlash}[remedies.BASELINE] == {"+0 %"}


@pytest.mark.kernel
def test_every_remedy_runs_with_the_best_gains_of_its_valve(two_hours):
    plain = remedies.picked(remedies.population(4), controller=0)
    simc, best = remedies.tuned(plain, [kinds.STEPPED])
    assert set(np.round((best.kp / simc.kp).values, 6)) <= set(remedies.KP_FACTORS)
    found = remedies.remedies(remedies.population(4), kinds.STEPPED, simc, best)
    alone = plain.assign(kp=best.kp, ti=best.ti, estimate_ratio=0.95, buffer=0.01)
    ds = fc.simulate(alone, kinds.of_kind(kinds.STEPPED, [2, 3]))
    ours = found.rmse.sel(controller="inverse_95_buffer").transpose(*ds.rmse.dims)
    np.testing.assert_array_equal(ours.values, ds.rmse.values)
