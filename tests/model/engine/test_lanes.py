"""The bits of a lane depend on the lane only: not on its neighbours, their number, their order, or the shard."""

import math
import os

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops import plan as plans
from fastcoil.model.engine.emulator import DAY_COLUMN, DAY_COLUMNS, Day
from fastcoil.model.engine.lanes import TraceRequest, cut_into_blocks, parameter_matrix, run_block, run_sets
from fastcoil.model.engine.metrics import make_schedule
from fastcoil.model.engine.rows import LANES, PARAMETER_ROWS
from fastcoil.model.metric_table import METRICS, STATUS_NON_FINITE, STATUS_OK, STATUS_OUT_OF_RANGE
from fastcoil.model.parameter_table import PARAMETERS

pytestmark = pytest.mark.kernel

N_LOOPS = 130
IS_FULL_RUN = bool(os.environ.get("FASTCOIL_FULL"))
TRACES = TraceRequest(("T_sup", "T_measured", "command", "mode", "wet_volumes"), 7)


@pytest.fixture(scope="module")
def day():
    """20 minutes with recorded noise, an air flow that changes every minute, and a minute off."""
    boundary = fc.paper_day(hours=1 / 3, seed=2)
    series = {name: boundary.series[name][0].copy() for name in DAY_COLUMNS}
    seconds = np.arange(boundary.n_steps)
    series["noise"] = 0.02 * np.sin(seconds / 11.0)
    series["enabled"] = np.where((seconds > 800) & (seconds < 857), 0.0, 1.0)
    series["m_a"] = series["m_a"][seconds // 60 * 60]
    series["T_set"] = np.where(seconds < 500, 14.0, 16.0)
    flags = make_schedule(series["T_set"], series["enabled"], 100)
    table = np.stack([series[name] for name in DAY_COLUMNS], axis=1)
    return Day(np.ascontiguousarray(table), np.empty(0), flags, 3, (17, 1))


def default_columns(n):
    columns = {p.name: np.full(n, math.nan if p.default is None else p.default) for p in PARAMETERS.values()}
    return columns | {"replicate": np.zeros(n)}


CHOICES = {
    "backlash_estimate": [0.0, 0.04, 0.07, 0.1], "estimate_ratio": [math.nan, 0.5, 1.0], "noise_std": [0.0, 0.0, 0.05],
    "sample_time": [1.0, 5.0, 12.0, 30.0], "stroke_time": [0.0, 0.0, 90.0], "sensor_time_constant": [0.0, 30.0],
    "sensor_resolution": [0.0, 0.1], "command_resolution": [0.0, 0.01], "buffer": [0.0, 1e-9, 0.01],
    "learning_step": [0.0, 0.007], "learning_interval": [600.0, 660.0], "learning_early_trip": [0.0, 1.0],
    "learning_ratio": [0.5, 2.0], "learning_growth": [1.0, 2.0], "action": ["cooling", "cooling", "heating"],
    "n_volumes": [5.0, 8.0], "air_march": ["lagged", "quasistatic"], "substeps": [1.0, 1.0, 3.0],
    "beta3": [0.38, 0.40], "rangeability": [math.nan, 40.0], "authority": [0.4], "m_full": [1.7],
    "neutral_zone": [0.0, 0.0, 0.01], "slip_jump": [0.0, 0.0, 0.4], "leakage": [math.nan, 0.0, 0.02],
    "wear_rate": [0.0, 0.0, 1e-3], "estimator": ["", "", "hagglund", "gradient"], "estimate_share": [0.0, 0.8, 1.0],
    "plant_gain": [15.0, 25.0], "hagglund_least_half_periods": [5.0], "gradient_gain": [5e-3],
    "gradient_pause": [60.0],
}  # fmt: skip
"""Values of which each loop gets one; slip_jump as a share of its backlash."""


@pytest.fixture(scope="module")
def mixed_columns():
    """130 loops that differ in every way in which loops may differ."""
    rng = np.random.default_rng(5)
    columns = default_columns(N_LOOPS)
    columns["backlash"], columns["kp"] = rng.uniform(0.0, 0.15, N_LOOPS), rng.uniform(0.01, 0.05, N_LOOPS)
    columns |= {name: rng.choice(values, N_LOOPS) for name, values in CHOICES.items()}
    columns["replicate"] = rng.integers(0, 3, N_LOOPS).astype(float)
    columns["slip_jump"] *= columns["backlash"]
    learner = np.where(columns["learning_step"] > 0.0, "learner", "none")
    columns["estimator"] = np.where(columns["estimator"] == "", learner, columns["estimator"])
    return columns


EVERY_SECOND = {"control_period": 1, "estimating_period": 1}


def select_lanes(columns, index, names=None):
    return {name: columns[name][index] for name in (columns if names is None else names)}


def run_lanes(columns, day, change=lambda block: block):
    """Metrics, status and traces of every lane, in the order of the columns, as one array per lane."""
    lane_values = [np.empty(0)] * columns["kp"].size
    for lanes, block in cut_into_blocks(parameter_matrix(columns)):
        metrics, status, traces = run_block(change(block), day, TRACES)
        for j, lane in enumerate(lanes):
            parts = ([status[j]], metrics[:, j], *(traces[name][:, j] for name in TRACES.names))
            lane_values[lane] = np.concatenate(parts)
    return lane_values


@pytest.fixture(scope="module")
def lanes_alone(mixed_columns, day):
    """Every lane alone in a block."""
    return [run_lanes(select_lanes(mixed_columns, [k]), day)[0] for k in range(N_LOOPS)]


def assert_same_bits(lanes, expected):
    for k, (lane, expected_lane) in enumerate(zip(lanes, expected, strict=True)):
        assert lane.tobytes() == expected_lane.tobytes(), f"lane {k}"


def test_lanes_are_all_well_and_differ(lanes_alone):
    assert all(lane[0] == STATUS_OK for lane in lanes_alone)
    assert len({lane.tobytes() for lane in lanes_alone}) > 0.9 * N_LOOPS


def test_a_neighbour_that_freezes_changes_nothing(mixed_columns, day, lanes_alone):
    """Near freezing the kernel takes another path through saturation, for the whole block."""
    frosty = {**mixed_columns, "T_initial": np.where(np.arange(N_LOOPS) % 2 == 0, mixed_columns["T_initial"], 0.0)}
    lanes = run_lanes(frosty, day)
    assert_same_bits(lanes[::2], lanes_alone[::2])
    pairs = zip(lanes[1::2], lanes_alone[1::2], strict=True)
    assert not any(frozen.tobytes() == lane.tobytes() for frozen, lane in pairs)


def test_lanes_in_frost(mixed_columns, day):
    cold = day.series.copy()
    cold[:, DAY_COLUMN.T_a_in] = np.linspace(6.0, -12.0, cold.shape[0])
    cold[:, DAY_COLUMN.W_a_in] = 0.003
    cold = day._replace(series=cold)
    alone = [run_lanes(select_lanes(mixed_columns, [k]), cold)[0] for k in range(N_LOOPS)]
    assert_same_bits(run_lanes(mixed_columns, cold), alone)


def test_number_of_lanes(mixed_columns, day, lanes_alone):
    for n in range(1, N_LOOPS + 1) if IS_FULL_RUN else (1, 2, 7, 63, 64, 65, 66, 127, 128, 129):
        assert_same_bits(run_lanes(select_lanes(mixed_columns, np.arange(n)), day), lanes_alone[:n])


@pytest.mark.parametrize("seed", range(3))
def test_order_of_lanes(mixed_columns, day, lanes_alone, seed):
    order = np.random.default_rng(seed).permutation(N_LOOPS)
    assert_same_bits(run_lanes(select_lanes(mixed_columns, order), day), [lanes_alone[k] for k in order])


def with_same_block_keys(columns):
    """The same loops with one value of all that a block shares."""
    keys = {"n_volumes": 8.0, "air_march": "lagged", "substeps": 1.0, "estimator": "learner"}
    return columns | {name: np.full(columns["kp"].size, value) for name, value in keys.items()}


@pytest.mark.parametrize(
    "flags",
    [
        {"has_noise": True}, {"shares_air_side": False}, {"leaks": True}, {"samples_together": False},
        {"samples_together": False, "control_period": 1}, {"estimating_period": 1},
        {"has_noise": True, "shares_air_side": False, "samples_together": False} | EVERY_SECOND,
    ],
)  # fmt: skip
def test_what_a_block_skips_changes_no_bits(mixed_columns, day, flags):
    uniform = ("noise_std", "sample_time", "beta3", "learning_step", "leakage")
    plain = with_same_block_keys(mixed_columns) | select_lanes(default_columns(N_LOOPS), slice(None), uniform)
    plain["estimator"] = np.full(N_LOOPS, "none")
    noisy = plain | select_lanes(mixed_columns, slice(None), ("learning_step", "estimator"))
    noisy["noise_std"] = np.full(N_LOOPS, 0.05)
    adaptive = noisy | {"estimator": np.full(N_LOOPS, "gradient"), "sample_time": mixed_columns["sample_time"]}
    passive = adaptive | {"estimator": np.full(N_LOOPS, "hagglund")}
    for columns in (plain, noisy, adaptive, passive):
        cautious = run_lanes(columns, day, lambda block: block._replace(config=block.config._replace(**flags)))
        assert_same_bits(cautious, run_lanes(columns, day))


@pytest.mark.parametrize("name", ["beta1", "beta3", "C_w", "C_c", "cp_a", "m_max", "T_initial"])
def test_a_lane_gone_nan_is_flagged_and_leaves_its_neighbours_alone(mixed_columns, day, name):
    columns = select_lanes(with_same_block_keys(mixed_columns), np.arange(LANES))
    columns["rangeability"] = np.full(LANES, math.nan)
    healthy = run_lanes(columns, day)
    columns[name] = columns[name].copy()
    columns[name][13] = math.nan
    lanes = run_lanes(columns, day)
    assert lanes[13][0] == STATUS_NON_FINITE
    assert np.all(np.isnan(lanes[13][1:]))
    assert_same_bits(lanes[:13] + lanes[14:], healthy[:13] + healthy[14:])


def test_an_unstable_lane_goes_out_of_range_or_non_finite_alone(mixed_columns, day):
    columns = select_lanes(with_same_block_keys(mixed_columns), np.arange(LANES))
    healthy = run_lanes(columns, day)
    columns["C_c"] = columns["C_c"].copy()
    columns["C_c"][[6, 4]] = [0.5, 0.1]
    lanes = run_lanes(columns, day)
    assert lanes[6][0] == STATUS_OUT_OF_RANGE
    assert lanes[4][0] == STATUS_NON_FINITE
    assert np.all(np.isnan(lanes[6][1:]))
    stable_lanes = [k for k in range(LANES) if k not in (6, 4)]
    assert_same_bits([lanes[k] for k in stable_lanes], [healthy[k] for k in stable_lanes])


@pytest.mark.parametrize(
    ("T_initial", "status"), [(-49.0, STATUS_OK), (-51.5, STATUS_OUT_OF_RANGE), (151.5, STATUS_OUT_OF_RANGE)]
)
def test_out_of_range_is_below_minus_50_or_above_150(mixed_columns, day, T_initial, status):
    columns = select_lanes(mixed_columns, [0]) | {"T_initial": np.array([T_initial])}
    assert run_lanes(columns, day)[0][0] == status


def test_blocks_never_mix_volumes_or_air_march_and_hold_every_lane_once(mixed_columns):
    lanes_and_blocks = cut_into_blocks(parameter_matrix(mixed_columns))
    assert sorted(np.concatenate([lanes for lanes, _ in lanes_and_blocks]).tolist()) == list(range(N_LOOPS))
    for lanes, block in lanes_and_blocks:
        assert np.all(mixed_columns["n_volumes"][lanes] == block.config.n_volumes)
        assert np.all((mixed_columns["air_march"][lanes] == "lagged") == block.config.lagged_air)
        assert block.rows.shape[1] == LANES


def test_many_sets_on_one_record_come_back_in_their_order(mixed_columns):
    """Sets of both kinds, in several padded blocks."""
    matrix = parameter_matrix(mixed_columns)
    kp, beta3 = PARAMETER_ROWS.index("kp"), PARAMETER_ROWS.index("beta3")
    gains, both = run_sets(matrix, lambda block, _: [block.rows[kp], block.rows[[kp, beta3]]])
    np.testing.assert_array_equal(gains, mixed_columns["kp"])
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


def simulate_sweep(sweep, days, **options):
    return fc.simulate(sweep, days, traces=["T_sup"], trace_interval=60, warm_up=100, replicates=2, **options)


def test_number_of_threads(sweep, days):
    assert simulate_sweep(sweep, days, n_jobs=1).content_sha256 == simulate_sweep(sweep, days, n_jobs=2).content_sha256


@pytest.mark.parametrize("lane_steps", [1.0, 2e5, 1e12])
def test_size_of_shards(sweep, days, lane_steps, monkeypatch):
    expected = simulate_sweep(sweep, days, n_jobs=1).content_sha256
    monkeypatch.setattr(plans, "_LANE_STEPS_PER_SHARD", lane_steps)
    monkeypatch.setattr(plans, "_SHARDS_PER_WORKER", 0.5)
    assert simulate_sweep(sweep, days, n_jobs=1).content_sha256 == expected


@pytest.mark.parametrize("n_jobs", [1, 2, 3])
def test_a_shard_may_span_days_and_changes_no_bits(sweep, days, n_jobs, monkeypatch):
    expected = simulate_sweep(sweep, days, n_jobs=1).content_sha256
    monkeypatch.setattr(plans, "_LANE_STEPS_PER_SHARD", 1e12)
    monkeypatch.setattr(plans, "_SHARDS_PER_WORKER", 0.5 / n_jobs)
    monkeypatch.setattr(plans, "LANES", 40)  # other edges: 288 scenarios a day
    plan = plans.plan_simulation(sweep, days, warm_up=100, replicates=2)
    days_of = [np.unique(plan.layout.columns(shard.index)["day"]) for shard in plans.cut_into_shards(plan, n_jobs)]
    assert any(days.size == 2 for days in days_of)
    assert simulate_sweep(sweep, days, n_jobs=n_jobs).content_sha256 == expected


def test_a_scenario_of_a_sweep_is_the_scenario_alone(sweep, days):
    ds = simulate_sweep(sweep, days)
    scenario = ds.isel(backlash=9, estimate_ratio=1, tuning=1, day=1, replicate=0)
    its_day = fc.paper_day(hours=0.25, seed=[1])
    options = {"traces": ["T_sup"], "trace_interval": 60, "warm_up": 100}
    alone = fc.simulate(fc.Loop.from_dataset(scenario), its_day, **options).isel(day=0)
    for name in [*METRICS, "T_sup"]:
        np.testing.assert_array_equal(scenario[name].values, alone[name].values, err_msg=name)
