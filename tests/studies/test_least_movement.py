"""The study of how far a set-point must move: its ways to move, its bound, and its tables."""

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies.least_movement import least_movement as least


def test_set_points_move_as_said():
    set_points = {name: move(1.2, np.random.default_rng(4)) for name, move in least.MOVES.items()}
    assert {series.shape for series in set_points.values()} == {(28800,)}
    assert np.ptp(set_points["still"]) == 0.0
    jumps = np.diff(set_points["steps"])
    assert np.flatnonzero(jumps).tolist() == [1800 * k - 1 for k in range(1, 16)]
    assert abs(jumps[jumps != 0.0]) == pytest.approx(1.2)
    assert abs(np.diff(set_points["ramps of 15 min"])).max() == pytest.approx(1.2 / 900)
    assert set_points["ramps of 15 min"][3599] == pytest.approx(set_points["steps"][3599])
    assert np.ptp(set_points["outdoor reset"]) == pytest.approx(3.0)


def test_trim_and_respond_goes_up_by_a_tenth_and_down_by_fifths_up_to_six_tenths():
    for seed in range(5):
        T_set = least.trim_and_respond(0.0, np.random.default_rng(seed))
        moves = np.round(np.diff(T_set[::120]), 9)
        assert set(moves) <= {0.1, -0.1, -0.3, -0.5, 0.0}
        assert {0.1, -0.1} <= set(moves)
        assert (np.diff(T_set)[np.arange(28799) % 120 != 119] == 0.0).all()


def make_readings() -> xr.Dataset:
    """Six loops whose readings are known: (sample, day)."""
    one_day = ("sample", "day")
    gap = np.array([0.0, 0.02, 0.05, 0.05, 0.1, 0.1])
    columns = {
        "found": gap + [0.03, 0.0, 0.02, 0.0, 0.0, 0.0], "claimed": np.array([1.0, 0, 1, 1, 1, 0]), "low": 0.9 * gap,
        "high": 1.1 * gap, "online": gap, "bound": np.where(gap > 0.0, np.maximum(0.2 * gap, 0.01) / 3.92, np.nan),
        "rmse": np.full(6, 0.1), "turns": np.array([9.0, 0, 9, 9, 9, 9]),
    }  # fmt: skip
    known = {"true": gap, "about": gap, "noise": np.zeros(6), "step": 10.0 * gap, "K": np.full(6, 20.0)}
    ds = xr.Dataset({name: (one_day, values[:, np.newaxis]) for name, values in columns.items()})
    return ds.assign({name: ("sample", values) for name, values in known.items()})


def test_the_tables_count_wrong_claims_and_good_valves(read_table, monkeypatch):
    monkeypatch.setattr(least, "run_move", lambda *_: make_readings())
    monkeypatch.setattr(least, "draw", lambda _: None)
    monkeypatch.setattr(least, "write_short_logs", lambda _: None)
    least.main(6)
    head, *rows = read_table("least_movement")[1]
    cells = dict(zip(head, next(row for row in rows if row[:2] == ["steps", "0.5 to 1"]), strict=True))
    assert [cells["loops"], cells["wrong claims"], cells["claimed"][:4]] == ["5", "1 of 3", "60 %"]
    assert cells["hours to certify, by the bound, median"] == f"{8 * 0.5**2:.2g}"
    head, *rows = read_table("least_movement_ways")[1]
    assert {row[head.index("good valves accused")] for row in rows} == {"1 of 1"}
    head, *rows = read_table("least_movement_turns")[1]
    assert [row[head.index("loops")] for row in rows if row[0] in ("0", "6 to 11")] == ["6", "24"]


def test_the_bound_by_day_has_the_constant_and_power_of_its_law():
    """A bound of 60 mK / (K √reversals)."""
    ds = make_readings()
    turns = ds.turns + np.arange(6.0)[:, np.newaxis]
    row = list(
        least.rows_by_day({way: ds.assign(turns=turns, bound=0.06 / (ds.K * turns**0.5)) for way in least.MOVES})
    )[-1]
    assert [row[0], row[2], row[3]] == ["all", "60 · 60 · 60", "-0.50"]


@pytest.mark.kernel
def test_a_loop_is_read_as_the_whole_population_is(monkeypatch):
    """Its day, values and seed put together by hand."""
    monkeypatch.setattr(least, "Parallel", lambda n_jobs: lambda jobs: [call(*args) for call, args, _ in jobs])
    ds = least.run_move("still", 702, 2)
    values = {name: float(column[1]) for name, column in least.draw_loops(702, 2).values.items()}
    series = least.make_days(least.CONSTANT, [70201]).series
    entering = {name: series[name][0] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **values)
    assert float(ds.rmse[1, 1]) == pytest.approx(
        float(fc.simulate(loop, fc.Boundary(**entering, T_set=np.full(28800, 14.0)), seed=702001).rmse), rel=1e-12
    )
    assert np.isnan(ds.rmse.values[1, 0])
    assert abs(float(ds.true[1]) / float(ds.about[1]) - 1.0) <= 0.1
    assert 0.0 < float(ds.bound[1, 1]) < 0.5
