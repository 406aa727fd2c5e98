"""A lane's bits depend on nothing but the lane: not on its neighbours, their number, order, or the shard."""

import math
import os

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops import plan as plans
from fastcoil.model.engine.emulator import DAY_COLUMNS, C, Day
from fastcoil.model.engine.lanes import TraceRequest, blocks, parameter_matrix, run_block, run_sets
from fastcoil.model.engine.metrics import schedule
from fastcoil.model.engine.rows import LANES, PARAMETER_ROWS
from fastcoil.model.metric_table import METRICS, STATUS_NON_FINITE, STATUS_OK, STATUS_OUT_OF_RANGE
from fastcoil.model.parameter_table import PARAMETERS

pytestmark = pytest.mark.kernel

N = 130
FULL = bool(os.environ.get("FASTCOIL_FULL"))
TRACES = TraceRequest(("T_sup", "T_measured", "command", "mode", "wet_volumes"), 7)


@pytest.fixture(scope="module")
def day():
    """20 minutes with recorded noise, an air flow that changes every minute, and an hour off within."""
    boundary = fc.paper_day(hours=1 / 3, seed=2)
    series = {name: boundary.series[name][0].copy() for name in DAY_COLUMNS}
    seconds = np.arange(boundary.n_steps)
    series["noise"] = 0.02 * np.sin(seconds / 11.0)
    series["enabled"] = np.where((seconds > 800) & (seconds < 857), 0.0, 1.0)
    series["m_a"] = series["m_a"][seconds // 60 * 60]
    series["T_set"] = np.where(seconds < 500, 14.0, 16.0)
    flags = schedule(series["T_set"], series["enabled"], 100)
    table = np.stack([series[name] for name in DAY_COLUMNS], axis=1)
    return Day(np.ascontiguousarray(table), np.empty(0), flags, 3, (17, 1))


def defaults(n):
    columns = {p.name: np.full(n, math.nan if p.default is None else p.default) for p in PARAMETERS.values()}
    return columns | {"replicate": np.zeros(n)}


@pytest.fixture(scope="module")
def mixed():
    """130 loops that differ in all that a loop may differ in."""
    rng = np.random.default_rng(5)
    columns = defaults(N)
    columns["backlash"] = rng.uniform(0.0, 0.15, N)
    columns["backlash_estimate"] = rng.choice([0.0, 0.04, 0.07, 0.1], N)
    columns["estimate_ratio"] = rng.choice([math.nan, 0.5, 1.0], N)
    columns["kp"] = rng.uniform(0.01, 0.05, N)
    columns["noise_std"] = rng.choice([0.0, 0.0, 0.05], N)
    columns["sample_time"] = rng.choice([1.0, 5.0, 12.0, 30.0], N)
    columns["stroke_time"] = rng.choice([0.0, 0.0, 90.0], N)
    columns["sensor_time_constant"] = rng.choice([0.0, 30.0], N)
    columns["sensor_resolution"] = rng.choice([0.0, 0.1], N)
    columns["command_resolution"] = rng.choice([0.0, 0.01], N)
    columns["buffer"] = rng.choice([0.0, 1e-9, 0.01], N)
    columns["learning_step"] = rng.choice([0.0, 0.007], N)
    columns["learning_interval"] = rng.choice([600.0, 660.0], N)
    columns["replicate"] = rng.integers(0, 3, N).astype(float)
    columns["action"] = rng.choice(["cooling", "cooling", "heating"], N)
    columns["n_volumes"] = rng.choice([5.0, 8.0], N)
    columns["air_march"] = rng.choice(["lagged", "quasistatic"], N)
    columns["beta3"] = rng.choice([0.38, 0.40], N)
    columns["rangeability"] = rng.choice([math.nan, 40.0], N)
    columns["authority"], columns["m_full"] = np.full(N, 0.4), np.full(N, 1.7)
    columns["learning_early_trip"] = rng.choice([0.0, 1.0], N)
    columns["learning_ratio"] = rng.choice([0.5, 2.0], N)
    columns["learning_growth"] = rng.choice([1.0, 2.0], N)
    columns["neutral_zone"] = rng.choice([0.0, 0.0, 0.01], N)
    columns["slip_jump"] = rng.choice([0.0, 0.0, 0.4], N) * columns["backlash"]
    columns["leakage"] = rng.choice([math.nan, 0.0, 0.02], N)
    columns["estimator"] = np.where(columns["learning_step"] > 0.0, "learner", "none")
    others = rng.choice(["", "", "hagglund", "gradient"], N)
    columns["estimator"] = np.where(others == "", columns["estimator"], others)
    columns["plant_gain"] = rng.choice([15.0, 25.0], N)
    columns["hagglund_least_half_periods"] = np.full(N, 5.0)
    columns["gradient_gain"] = np.full(N, 5e-3)
    columns["gradient_pause"] = np.full(N, 60.0)
    columns["estimate_share"] = rng.choice([0.0, 0.8, 1.0], N)
    columns["wear_rate"] = rng.choice([0.0, 0.0, 1e-3], N)
    columns["substeps"] = rng.choice([1.0, 1.0, 3.0], N)
    return columns


EVERY_SECOND = {"control_period": 1, "estimating_period": 1}


def part(columns, index):
    return {name: values[index] for name, values in columns.items()}


def run(columns, day, change=lambda block: block):
    """Metrics, status and traces of every lane, in the order of the columns, as one array per lane."""
    found = [np.empty(0)] * columns["kp"].size
    for lanes, block in blocks(parameter_matrix(columns)):
        metrics, status, traces = run_block(change(block), day, TRACES)
        for j, lane in enumerate(lanes):
            found[lane] = np.concatenate([[status[j]], metrics[:, j], *(traces[name][:, j] for name in TRACES.names)])
    return found


@pytest.fixture(scope="module")
def alone(mixed, day):
    """Every lane in a block of its own."""
    return [run(part(mixed, [k]), day)[0] for k in range(N)]


def assert_same_bits(found, expected):
    for k, (lane, same) in enumerate(zip(found, expected, strict=True)):
        assert lane.tobytes() == same.tobytes(), f"lane {k}"


def test_lanes_are_all_well_and_differ(alone):
    assert all(lane[0] == STATUS_OK for lane in alone)
    assert len({lane.tobytes() for lane in alone}) > 0.9 * N


def test_a_neighbour_that_freezes_changes_nothing(mixed, day, alone):
    """Near freezing the kernel takes another path through saturation, for the whole block."""
    frosty = {**mixed, "T_initial": np.where(np.arange(N) % 2 == 0, mixed["T_initial"], 0.0)}
    found = run(frosty, day)
    assert_same_bits(found[::2], alone[::2])
    assert not any(one.tobytes() == other.tobytes() for one, other in zip(found[1::2], alone[1::2], strict=True))


def test_lanes_in_frost(mixed, day):
    cold = day.series.copy()
    cold[:, C.T_a_in] = np.linspace(6.0, -12.0, cold.shape[0])
    cold[:, C.W_a_in] = 0.003
    cold = day._replace(series=cold)
    assert_same_bits(run(mixed, cold), [run(part(mixed, [k]), cold)[0] for k in range(N)])


def test_number_of_lanes(mixed, day, alone):
    for n in range(1, N + 1) if FULL else (1, 2, 7, 63, 64, 65, 66, 127, 128, 129):
        assert_same_bits(run(part(mixed, np.arange(n)), day), alone[:n])


@pytest.mark.parametrize("seed", range(3))
def test_order_of_lanes(mixed, day, alone, seed):
    order = np.random.default_rng(seed).permutation(N)
    assert_same_bits(run(part(mixed, order), day), [alone[k] for k in order])


def alike(columns):
    """The same loops, but for what keeps lanes out of one block."""
    n = columns["kp"].size
    return columns | {
        "n_volumes": np.full(n, 8.0),
        "air_march": np.full(n, "lagged"),
        "substeps": np.full(n, 1.0),
        "estimator": np.full(n, "learner"),
    }


@pytest.mark.parametrize(
    "flags",
    [
        {"has_noise": True}, {"shares_air_side": False}, {"leaks": True}, {"samples_together": False},
        {"samples_together": False, "control_period": 1}, {"estimating_period": 1},
        {"has_noise": True, "shares_air_side": False, "samples_together": False} | EVERY_SECOND,
    ],
)  # fmt: skip
def test_what_a_block_skips_changes_no_bits(mixed, day, flags):
    plain = alike(mixed) | {
        name: defaults(N)[name] for name in ("noise_std", "sample_time", "beta3", "learning_step", "leakage")
    }
    plain["estimator"] = np.full(N, "none")
    noisy = plain | {"noise_std": np.full(N, 0.05), "learning_step": mixed["learning_step"]}
    noisy["estimator"] = mixed["estimator"]
    adaptive = noisy | {"estimator": np.full(N, "gradient"), "sample_time": mixed["sample_time"]}
    passive = adaptive | {"estimator": np.full(N, "hagglund")}
    for columns in (plain, noisy, adaptive, passive):
        cautious = run(columns, day, lambda block: block._replace(common=block.common._replace(**flags)))
        assert_same_bits(cautious, run(columns, day))


@pytest.mark.parametrize("name", ["beta1", "beta3", "C_w", "C_c", "cp_a", "m_max", "T_initial"])
def test_a_lane_gone_nan_is_flagged_and_leaves_its_neighbours_alone(mixed, day, name):
    columns = part(alike(mixed), np.arange(LANES))
    columns["rangeability"] = np.full(LANES, math.nan)
    healthy = run(columns, day)
    sick = 13
    columns[name] = columns[name].copy()
    columns[name][sick] = math.nan
    found = run(columns, day)
    assert found[sick][0] == STATUS_NON_FINITE
    assert np.all(np.isnan(found[sick][1:]))
    assert_same_bits(found[:sick] + found[sick + 1 :], healthy[:sick] + healthy[sick + 1 :])


def test_an_unstable_lane_goes_out_of_range_or_non_finite_alone(mixed, day):
    columns = part(alike(mixed), np.arange(LANES))
    healthy = run(columns, day)
    columns["C_c"] = columns["C_c"].copy()
    columns["C_c"][[6, 4]] = [0.5, 0.1]
    found = run(columns, day)
    assert found[6][0] == STATUS_OUT_OF_RANGE
    assert found[4][0] == STATUS_NON_FINITE
    assert np.all(np.isnan(found[6][1:]))
    others = [k for k in range(LANES) if k not in (6, 4)]
    assert_same_bits([found[k] for k in others], [healthy[k] for k in others])


@pytest.mark.parametrize(
    ("T_initial", "status"), [(-49.0, STATUS_OK), (-51.5, STATUS_OUT_OF_RANGE), (151.5, STATUS_OUT_OF_RANGE)]
)
def test_out_of_range_is_below_minus_50_or_above_150(mixed, day, T_initial, status):
    columns = part(mixed, [0]) | {"T_initial": np.array([T_initial])}
    assert run(columns, day)[0][0] == status


def test_blocks_never_mix_volumes_or_air_march_and_hold_every_lane_once(mixed):
    cut = blocks(parameter_matrix(mixed))
    assert sorted(np.concatenate([lanes for lanes, _ in cut]).tolist()) == list(range(N))
    for lanes, block in cut:
        assert np.all(mixed["n_volumes"][lanes] == block.common.n_volumes)
        assert np.all((mixed["air_march"][lanes] == "lagged") == block.common.lagged_air)
        assert block.rows.shape[1] == LANES


def test_many_sets_on_one_record_come_back_in_their_order(mixed):
    """Sets of both kinds, in several blocks: every set finds its own numbers, whatever was padded."""
    matrix = parameter_matrix(mixed)
    kp, beta3 = PARAMETER_ROWS.index("kp"), PARAMETER_ROWS.index("beta3")
    gains, both = run_sets(matrix, lambda block, _: [block.rows[kp], block.rows[[kp, beta3]]])
    np.testing.assert_array_equal(gains, mixed["kp"])
    np.testing.assert_array_equal(both, matrix[[kp, beta3]])


# Through simulate


@pytest.fixture(scope="module")
def sweep():
    return fc.Loop(
        backlash=np.linspace(0.0, 0.15, 16),
        estimate_ratio=[0.0, 0.6, 1.2],
        kp=("tuning", [0.01, 0.03, 0.05]),
        sample_time=("tuning", [30, 5, 12]),
        noise_std=("tuning", [0.0, 0.05, 0.0]),
    )


@pytest.fixture(scope="module")
def days():
    return fc.paper_day(hours=0.25, seed=[4, 1])


def swept(sweep, days, **options):
    return fc.simulate(sweep, days, traces=["T_sup"], trace_interval=60, warm_up=100, replicates=2, **options)


def test_number_of_threads(sweep, days):
    assert swept(sweep, days, n_jobs=1).content_sha256 == swept(sweep, days, n_jobs=2).content_sha256


@pytest.mark.parametrize("lane_steps", [1.0, 2e5, 1e12])
def test_size_of_shards(sweep, days, lane_steps, monkeypatch):
    expected = swept(sweep, days, n_jobs=1).content_sha256
    monkeypatch.setattr(plans, "_LANE_STEPS_PER_SHARD", lane_steps)
    monkeypatch.setattr(plans, "_SHARDS_PER_WORKER", 0.5)
    assert swept(sweep, days, n_jobs=1).content_sha256 == expected


@pytest.mark.parametrize("n_jobs", [1, 2, 3])
def test_a_shard_may_span_days_and_changes_no_bits(sweep, days, n_jobs, monkeypatch):
    expected = swept(sweep, days, n_jobs=1).content_sha256
    monkeypatch.setattr(plans, "_LANE_STEPS_PER_SHARD", 1e12)
    monkeypatch.setattr(plans, "_SHARDS_PER_WORKER", 0.5 / n_jobs)
    monkeypatch.setattr(plans, "LANES", 40)  # other edges: 288 scenarios a day
    plan = plans.plan_simulation(sweep, days, warm_up=100, replicates=2)
    days_of = [np.unique(plan.layout.columns(shard.index)["day"]) for shard in plans.shards_of(plan, n_jobs)]
    assert any(days.size == 2 for days in days_of)
    assert swept(sweep, days, n_jobs=n_jobs).content_sha256 == expected


def test_a_scenario_of_a_sweep_is_the_scenario_alone(sweep, days):
    ds = swept(sweep, days)
    one = ds.isel(backlash=9, estimate_ratio=1, tuning=1, day=1, replicate=0)
    own_day = fc.paper_day(hours=0.25, seed=[1])
    options = {"traces": ["T_sup"], "trace_interval": 60, "warm_up": 100}
    alone = fc.simulate(fc.Loop.from_dataset(one), own_day, **options).isel(day=0)
    for name in [*METRICS, "T_sup"]:
        np.testing.assert_array_equal(one[name].values, alone[name].values, err_msg=name)
