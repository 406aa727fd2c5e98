"""A coil's log with gaps, nights and still water: where the model starts again and what is compared."""

import numpy as np
import pytest
import xarray as xr
from helpers.simulated_logs import COIL_SERIES, assert_covered, build_coil_problem, coil_log, join_logs, shift_log

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.measured.fit_coil import build_record, drop_idle_samples
from fastcoil.measured.part import fitting_mask

pytestmark = pytest.mark.kernel


def make_night(log, hours=1.0):
    """Between two days: no flow, and sensors at room temperature."""
    n = int(hours * 3600)
    off = log.isel(elapsed_time=np.zeros(n, dtype=int)).copy(deep=True)
    for name, value in (("m_w", 0.0), ("m_a", 0.004), ("T_sup", 24.0), ("T_w_out", 23.0)):
        off[name] = xr.full_like(off[name], value).assign_attrs(log[name].attrs)
    return off.assign_coords(elapsed_time=("elapsed_time", np.arange(n) + 1.0, {"units": "s"}))


@pytest.fixture(scope="module")
def two_days():
    return coil_log(hours=1, seed=41), coil_log(hours=1, seed=42)


@pytest.fixture(scope="module")
def broken(two_days):
    first, second = two_days
    return fc.fit_coil(join_logs(first, shift_log(second, 7200.0)), split=1.0)


def test_after_a_gap_the_model_starts_again_with_a_warm_up(broken):
    assert_covered(broken)
    assert broken.rmse["fit"] == pytest.approx(0.05, rel=0.05)
    assert any("1 gap in time (first: 3601 s between rows 3599 and 3600)" in note for note in broken.notes)
    assert any("2 unbroken pieces, each starting at 20 degC, the first 1800 s of each" in note for note in broken.notes)
    assert broken.residuals["part"].values.tolist() == (["unused"] * 1800 + ["fit"] * 1800) * 2


def test_every_piece_starts_as_the_whole_record_does(two_days):
    """For the same day twice, with a gap between, the model gives the same twice, to the bit."""
    first, _ = two_days
    log = read_checked_log(join_logs(first, shift_log(first, 7200.0)), COIL_SERIES)
    record = build_record(log, fc.Loop(), (), np.ones(log.time.size, dtype=bool))
    assert len(record.pieces) == 2
    rng = np.random.default_rng(43)
    sets = np.log([[8.8], [10.0], [0.35], [1.0], [0.35], [1.0], [0.4], [1.0]]) + rng.uniform(0.0, 0.2, (8, 3))
    for values in record.run(sets).values():
        assert np.isfinite(values).all()
        np.testing.assert_array_equal(values[:3600], values[3600:])


def test_nights_without_air_are_left_out_and_counted(two_days):
    """What remains is the log of both days, so that the fit is the one of that log."""
    first, second = two_days
    with_night = join_logs(first, shift_log(make_night(first), 3599.0), shift_log(second, 7200.0))
    log = drop_idle_samples(read_checked_log(with_night, COIL_SERIES))
    assert "3,600 samples in 1 spell left out, no air flows (first in row 3600)" in log.notes[-1]
    days = read_checked_log(join_logs(first, shift_log(second, 7200.0)), COIL_SERIES)
    np.testing.assert_array_equal(log.batch, days.batch)
    for name, values in days.values.items():
        np.testing.assert_array_equal(log.values[name], values)


def test_leaving_water_that_stands_still_is_not_compared(two_days):
    log = two_days[0].copy(deep=True)
    log["m_w"][2600:3200] = 0.0
    log["T_w_out"][2600:3200] = 60.0
    problem = build_coil_problem(log, 1800.0)
    np.testing.assert_array_equal(np.flatnonzero(~problem.compared["T_w_out"][1800:]), np.arange(800, 1400))
    assert problem.compared["T_sup"][1800:].all()
    assert "600 samples of T_w_out not compared: no water flows" in problem.notes


def test_four_pieces_or_more_are_held_back_whole():
    pieces = [shift_log(coil_log(hours=h, seed=30 + i), 20000.0 * i) for i, h in enumerate((1.0, 1.5, 0.7, 0.15, 0.8))]
    problem = build_coil_problem(join_logs(*pieces), 600.0, share=None)
    batch, compared = problem.data.batch, problem.compared["T_sup"]
    assert set(batch[compared & problem.fitting]) == {0, 1, 2}
    assert set(batch[compared & ~problem.fitting]) == {4}
    assert not fitting_mask(problem.data, 0.99)[batch == 4].any()  # the last piece is never fitted
    assert any("5 unbroken pieces" in note and "(1 shorter than that)" in note for note in problem.notes)
