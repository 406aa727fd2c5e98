"""Days in sequence: the bits of the same series in one piece, whatever a loop remembers, and metrics that add up."""

from typing import NamedTuple

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops.plan import Shard, plan_simulation
from fastcoil.loops.simulate import run_shard
from fastcoil.model.engine.metrics import IS_COUNTED, IS_SETTLED, IS_SWING_SAMPLE
from fastcoil.model.metric_table import METRICS, TRACES

pytestmark = pytest.mark.kernel

N_DAYS = 3
N_STEPS = 2407  # s, no multiple of a sample time, of a learning interval, or of a minute
WARM_UP = 300  # s
SUMS = (
    "iae", "stem_travel", "motor_travel", "reversals", "coil_energy", "reheat_energy", "recool_energy", "water_volume",
    "condensate",
)  # fmt: skip
"""Metrics that add up over days."""


def all_series():
    """Samples of all days in one piece: the loop is off over the first midnight, and moves over the second."""
    t = np.arange(N_DAYS * N_STEPS)
    T_set = 14.0 + 1.2 * (t // 1100 % 2)
    T_set[2 * N_STEPS - 20 :] -= 2.0
    return {
        "m_a": 1.2 + 0.1 * np.sin(t / 500),
        "T_a_in": 26.0 + np.sin(t / 900),
        "W_a_in": np.full(t.size, 0.011),
        "T_w_in": 7.0 + 0.3 * np.sin(t / 300),
        "T_set": T_set,
        "enabled": np.where((t > N_STEPS - 200) & (t < N_STEPS + 300), 0.0, 1.0),
    }


DAILY_ROWS = {name: values.reshape(N_DAYS, N_STEPS) for name, values in all_series().items()}
WHOLE = fc.Boundary(**all_series(), day=5)
DAILY = fc.Boundary(**DAILY_ROWS, day=[5, 8, 2])


class Settings(NamedTuple):
    kp: float


class Memory(NamedTuple):
    total: float = 0.5
    before: float = 0.0


@fc.law(Settings, Memory)
def leaky(now, p, m):
    total = 0.999 * m.total + 0.01 * now.e + 0.001 * m.before
    return p.kp * now.e + total, Memory(total, now.e)


LBNL = fc.Loop.preset("lbnl").assign(stroke_time=900.0, noise_std=0.05, backlash=[0.03, 0.1])
LOOPS = {
    "learner": LBNL.assign(learning_step=0.025, learning_interval=700),
    "hagglund": LBNL.assign(estimator="hagglund", plant_gain=15.0, compensation="additive"),
    "gradient": LBNL.assign(estimator="gradient", plant_gain=15.0, sample_time=("backlash", [7, 11])),
    "identify": LBNL.assign(estimator="identify", plant_gain=15.0),
    "all that remembers": LBNL.assign(
        backlash_estimate=0.04, error_dead_band=0.1, neutral_zone=0.01, slip_jump=0.02, wear_rate=0.001, n_volumes=4,
        compensation=("way", ["inverse", "smooth", "additive"]), sensor_resolution=0.05, command_resolution=0.002,
        buffer_noise="measured", buffer_ratio=1.0, buffer_swing=0.3, plant_gain=15.0, air_march="quasistatic",
    ),
    "own law": LBNL.assign(law=leaky),
}  # fmt: skip


def days_end_to_end(ds, name):
    """A trace of the days, end to end; without the dim ``day`` as it is."""
    dims = [dim for dim in ("day", "elapsed_time") if dim in ds[name].dims]
    values = ds[name].transpose(..., *dims).values
    return values.reshape(*values.shape[: -len(dims)], -1)


def assert_same(whole, days, names):
    for name in names:
        np.testing.assert_array_equal(days_end_to_end(days, name), days_end_to_end(whole, name), err_msg=name)


@pytest.fixture(scope="module", params=LOOPS)
def runs(request):
    """The same in one piece and in days."""
    options = {"traces": [*TRACES], "warm_up": WARM_UP, "n_jobs": 1}
    whole = fc.simulate(LOOPS[request.param], WHOLE, **options)
    return whole, fc.simulate(LOOPS[request.param], DAILY, carry_over=True, **options)


def test_days_in_sequence_have_the_bits_of_one_piece(runs):
    whole, days = runs
    assert (whole["status"] == 0).all()
    assert_same(whole, days, TRACES)
    assert days.attrs["carry_over"] == 1
    assert "carry_over" not in whole.attrs


def test_metrics_of_days_add_up_to_those_of_one_piece_or_end_as_there(runs):
    whole, days = runs
    for name in SUMS:
        np.testing.assert_allclose(days[name].sum("day"), whole[name], rtol=1e-9, atol=1e-12, err_msg=name)
    for name in ("estimate_final", "backlash_final", "time_identified", "learn_time_reached", "learn_time_confirmed"):
        np.testing.assert_array_equal(days[name].isel(day=-1), whole[name], err_msg=name)


def test_an_open_loop_goes_on_too():
    command = 0.5 + 0.4 * np.sin(np.arange(N_DAYS * N_STEPS) / 150)
    loop = fc.Loop.preset("lbnl").assign(backlash=[0.03, 0.1])
    options = {"traces": ["T_sup", "opening", "T_c"], "warm_up": WARM_UP, "n_jobs": 1}
    whole = fc.simulate(loop, WHOLE, command=command, **options)
    days = fc.simulate(loop, DAILY, command=command.reshape(N_DAYS, -1), carry_over=True, **options)
    assert_same(whole, days, options["traces"])


@pytest.mark.filterwarnings("ignore:action")
def test_frost_is_that_of_each_day():
    frosty = fc.Boundary(**DAILY_ROWS | {"T_a_in": -10.0, "W_a_in": 0.001})
    ds = fc.simulate(fc.Loop(), frosty, carry_over=True, warm_up=WARM_UP, n_jobs=1)
    assert 0.0 < ds["freeze_time"].values[0] < N_STEPS
    assert ds["freeze_time"].values[1:].tolist() == [N_STEPS, N_STEPS]


@pytest.mark.parametrize("n_steps", [28, 250, 1204])
def test_seconds_count_and_are_settled_as_in_one_piece(n_steps):
    loop = fc.Loop()
    whole = {name: values[:2408] for name, values in all_series().items()}
    rows = {name: values.reshape(-1, n_steps) for name, values in whole.items() if values.size % n_steps == 0}
    rows = rows or {name: values[:2250].reshape(-1, n_steps) for name, values in whole.items()}
    n = next(iter(rows.values())).size
    one = plan_simulation(loop, fc.Boundary(**{k: v[:n] for k, v in whole.items()}), warm_up=5).days[0]
    some = plan_simulation(loop, fc.Boundary(**rows), warm_up=5, carry_over=True)
    seen = IS_COUNTED | IS_SETTLED | (0 if n_steps % 10 else IS_SWING_SAMPLE)
    backwards = [some.days[k] for k in reversed(range(n // n_steps))][::-1]
    flags = np.concatenate([day.schedule.flags for day in backwards])
    np.testing.assert_array_equal(flags & seen, one.schedule.flags & seen)
    assert [day.start for day in backwards] == list(range(0, n, n_steps))
    was_enabled = whole["enabled"][n_steps - 1 : n - 1 : n_steps] > 0.0
    assert [day.was_enabled for day in backwards[1:]] == was_enabled.tolist()


def test_lanes_on_the_last_days_alone_and_in_other_blocks_have_the_same_metrics():
    loop = LBNL.assign(
        backlash=("sample", np.linspace(0.01, 0.12, 67)), estimator=["learner", "none", "identify"],
        learning_step=0.01, learning_interval=700, plant_gain=15.0, n_volumes=("sample", [8, 4] * 33 + [8]),
    )  # fmt: skip
    plan = plan_simulation(loop, DAILY, warm_up=WARM_UP, carry_over=True)
    n_per_day = plan.n_per_day
    whole = run_shard(plan, Shard(np.arange(n_per_day), n_per_day, 0, N_DAYS))
    one, other = Shard(np.arange(n_per_day), n_per_day, 1, N_DAYS).halves()
    for piece in (one, other, Shard(np.arange(3, n_per_day, 50), n_per_day, 2, N_DAYS)):
        done = run_shard(plan, piece)
        for name in METRICS:
            np.testing.assert_array_equal(done[name], whole[name].values[piece.index], err_msg=name)


@fc.law(Settings, Memory)
def fails_later(now, p, m):
    return (np.nan if now.t > N_STEPS + 500.0 and now.t < N_STEPS + 600.0 else p.kp * now.e), m


def test_a_lane_that_failed_stays_failed():
    ds = fc.simulate(fc.Loop(law=[leaky, fails_later]), DAILY, carry_over=True, warm_up=WARM_UP, n_jobs=1)
    assert ds["status"].sel(law="leaky").values.tolist() == [0, 0, 0]
    assert ds["status"].sel(law="fails_later").values.tolist() == [0, 1, 1]
    assert np.isnan(ds["rmse"].sel(law="fails_later").values).tolist() == [False, True, True]


def test_the_bits_do_not_depend_on_the_threads():
    loop = LOOPS["learner"].assign(kp=("sample", np.linspace(0.01, 0.03, 140)))
    one, several = (fc.simulate(loop, DAILY, carry_over=True, warm_up=WARM_UP, n_jobs=n) for n in (1, 3))
    assert one.attrs["content_sha256"] == several.attrs["content_sha256"]
