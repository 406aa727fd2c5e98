"""Plans: arguments of ``simulate`` that are refused, memory and disk, shards, parts joined into one result."""

import tracemalloc
from collections import namedtuple

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused
from hypothesis import given, settings
from hypothesis import strategies as st

import fastcoil as fc
from fastcoil.loops import plan as resources
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.scenarios import join_flat
from fastcoil.model.engine.rows import LANES

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("command", "shape", np.zeros(899)), ("command", "shape", np.zeros((3, 900))),
        ("command", "value", np.r_[np.zeros(400), 1.1, np.zeros(499)]),
        ("command", "value", np.r_[np.zeros(400), np.nan, np.zeros(499)]), ("traces", "choice", ["T_supp"]),
        ("traces", "choice", ["T_set"]), ("traces", "duplicate", ["T_sup", "T_sup"]), ("traces", "type", None),
        ("trace_interval", "value", 0), ("trace_interval", "value", 901), ("warm_up", "value", -1),
        ("seed", "value", 2**64), ("replicates", "value", 0), ("n_jobs", "value", 0),
    ],
)  # fmt: skip
def test_bad_options_are_refused(days, field, code, value):
    assert_refused(field, code, fc.simulate, fc.Loop(), days, **{"warm_up": 60} | {field: value})


def test_too_short_days_and_a_sweep_that_may_be_a_series_are_refused(days):
    assert_refused("boundary", "data", fc.simulate, fc.Loop(), days)  # shorter than the default warm-up
    loop = fc.Loop(kp=np.linspace(0.01, 0.02, 3600))  # a value for each second
    assert_refused("kp", "shape", plan_simulation, loop, fc.constant_day(hours=1))


def test_a_million_million_scenarios_are_refused_without_allocating(days, monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 2**33)
    axes = {name: np.linspace(1.0, 2.0, 1000) for name in ("kp", "ti", "beta1", "cp_a")}
    assert_refused("loop", "size", fc.simulate, fc.Loop(**axes), days, warm_up=60)


LEARNER_RANGES = {"learning_step": (0.01, 0.1), "backlash_estimate": (0.0, 0.1), "learning_cap": (0.1, 0.2)}
RATIO_RANGES = {"estimate_ratio": (0.0, 1.0), "backlash": (0.0, 0.1)}


@pytest.mark.parametrize(("n", "ranges"), [(200, LEARNER_RANGES), (3000, RATIO_RANGES)], ids=["learner", "ratio"])
def test_nor_is_anything_allocated_to_check_parameters_together(n, ranges, days, monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 10**6)
    loop = fc.Loop(**{name: np.linspace(*ends, n) for name, ends in ranges.items()})
    tracemalloc.start()
    try:
        assert_refused("loop", "size", fc.simulate, loop, days, warm_up=60)
        assert tracemalloc.get_traced_memory()[1] < 2e6
    finally:
        tracemalloc.stop()


def test_traces_count_towards_the_memory(days, monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 10**6)
    loop = fc.Loop(backlash=np.linspace(0.0, 0.1, 20))
    fc.simulate(loop, days, warm_up=60)
    assert_refused("loop", "size", fc.simulate, loop, days, warm_up=60, traces=["T_c"])


def test_the_memory_of_a_run_is_that_of_its_results_its_shards_and_its_workers(days):
    loop = fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, 4000)))
    plain = plan_simulation(loop, days, warm_up=60)
    traced = plan_simulation(loop, days, warm_up=60, traces=["T_c", "u"])
    many = fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, 400_000)))
    larger = plan_simulation(many, days, warm_up=60, traces=["T_c", "u"], traces_on_disk=True)
    for n_jobs in (1, 2, 16):
        alone, each = traced.memory_of_run(n_jobs, "threads")
        assert each < traced.memory_of_run(n_jobs, "threads", traces_kept=False)[1]
        more = larger.memory_of_run(n_jobs, "threads")  # a hundred times the traces, in shards of the same size
        assert sum(more) < alone + each + larger.metric_bytes + 6 * 64 * 2**20
        assert traced.memory_of_run(n_jobs, "loky")[1] > each + 100 * 2**20
    needed, left = traced.disk_bytes()
    assert traced.trace_bytes < left < needed < 3 * traced.trace_bytes
    assert traced.disk_bytes(traces_left=0.3)[1] < 0.5 * left
    assert traced.disk_bytes(traces_kept=False) == plain.disk_bytes()
    year = plan_simulation(fc.Loop(), fc.constant_day(hours=400))
    assert year.memory_of_run(1, "threads")[1] > 1.5 * year.boundary_bytes


DAY = {"T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": 14.0}


def two_minute_days(n_days):
    return fc.Boundary(m_a=np.full((n_days, 120), 1.0), **DAY)


@settings(max_examples=20)
@given(st.data())
def test_shards_are_whole_blocks_of_whatever_is_left_to_run(data):
    n_days, per_day = data.draw(st.integers(1, 5)), data.draw(st.integers(1, 200))
    loop = fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, per_day)))
    plan = plan_simulation(loop, two_minute_days(n_days), warm_up=60)
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    todo = np.flatnonzero(rng.random(plan.n_scenarios) < data.draw(st.sampled_from([0.02, 0.5, 1.0])))
    n_jobs = data.draw(st.integers(1, 4))
    shards = [shard.lanes for shard in resources.cut_into_shards(plan, n_jobs, todo)]
    assert np.array_equal(np.concatenate([*shards, np.array([], dtype=np.int64)]), todo)
    blocks_of_day = -(-np.bincount(todo // per_day, minlength=n_days) // LANES)
    pieces = [-(-np.bincount(shard // per_day, minlength=n_days) // LANES) for shard in shards]
    assert sum(pieces, start=np.zeros(n_days, dtype=np.int64)).tolist() == blocks_of_day.tolist()
    most, _ = plan.shard_limits(n_jobs, int(blocks_of_day.sum()))
    assert max((int(one.sum()) for one in pieces), default=0) <= most


def test_the_first_shards_are_small_and_double_so_that_results_are_soon_kept():
    loop = fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, 32 * LANES)))
    sizes = [shard.size // LANES for shard in resources.cut_into_shards(plan_simulation(loop, fc.constant_day()), 2)]
    assert sizes == [2, 2, *[4] * 7]
    sequence = plan_simulation(loop, fc.Boundary(m_a=np.full((4, 28800), 1.0), **DAY), carry_over=True)
    sizes = [shard.lanes.size // LANES for shard in resources.cut_into_shards(sequence, 1)]
    assert sizes[:3] == [1, 2, 4]
    assert sum(sizes) == 32


def test_days_in_sequence_are_shards_of_bounded_work_and_size_with_what_is_left_of_each_lane(monkeypatch):
    loop = fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, 300)))
    plan = plan_simulation(loop, two_minute_days(5), warm_up=60, carry_over=True)
    for n_jobs in (1, 2, 8):
        shards = resources.cut_into_shards(plan, n_jobs)
        assert len(shards) >= min(n_jobs, 5)
        assert sorted(k for shard in shards for k in shard.index) == list(range(1500))
        assert all(shard.lanes.size % LANES == 0 for shard in shards[:-1])
    todo = np.r_[7, 307, 1208, 1499]  # a lane from its first day to its second, two on their last
    left = [(s.lanes.tolist(), s.first_day, s.end_day) for s in resources.cut_into_shards(plan, 1, todo)]
    assert sorted(left) == [([7], 0, 2), ([8, 299], 4, 5)]
    monkeypatch.setattr(resources, "_LANE_STEPS_PER_SEQUENCE", 5 * 120 * LANES * 2.5)
    assert len(resources.cut_into_shards(plan, 1)) == 1
    monkeypatch.setattr(resources, "_MIN_SEQUENCE_BLOCKS", 1)
    assert {shard.lanes.size for shard in resources.cut_into_shards(plan, 1)} == {2 * LANES, 300 % (2 * LANES)}
    monkeypatch.setattr(resources, "_BYTES_PER_SHARD", 3 * (plan.metric_bytes + plan.trace_bytes) // plan.n_per_day)
    assert max(shard.lanes.size for shard in resources.cut_into_shards(plan, 1)) == 3


def test_a_shard_holds_no_more_than_its_share_of_bytes(days):
    traces = {"traces": ["T_w", "T_c", "T_a", "W_a", "u"], "warm_up": 60}
    plan = plan_simulation(fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, 1000))), days, **traces)
    bytes_of_one = (plan.metric_bytes + plan.trace_bytes) / plan.n_scenarios
    shards = resources.cut_into_shards(plan, 1)
    assert len(shards) > 4
    assert all(LANES <= shard.size <= 64 * 2**20 / bytes_of_one for shard in shards[:-1])


def test_results_that_do_not_fit_into_memory_are_refused(monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 2**30)
    resources.check_memory(2**30, 5)
    assert_refused("loop", "size", resources.check_memory, 2**31, 12_000)


def test_results_that_do_not_fit_on_the_disk_are_refused(tmp_path, monkeypatch):
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(resources.shutil, "disk_usage", lambda path: usage(2**30 if path == tmp_path else 0))
    resources.check_disk(2**30, tmp_path / "results" / "mine")
    assert_refused("out", "size", resources.check_disk, 2**31, tmp_path / "results" / "mine")


def test_workers_that_do_not_fit_are_refused_with_the_number_that_does(monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 700 * 2**20)
    resources.check_workers(100 * 2**20, 300 * 2**20, 2)
    for run_bytes in (100 * 2**20, 600 * 2**20):  # two workers fit, none does
        assert_refused("n_jobs", "size", resources.check_workers, run_bytes, 300 * 2**20, 8)


FORMS = {
    "the type": "np.array([1, 2]) if first else np.array([1.5, 2.5])",
    "the labels": "xr.DataArray(np.ones((2, 2)), {'bin': [0, 1] if first else [5, 6]}, ['scenario', 'bin'])",
    "the dim": "xr.DataArray(np.ones((2, 2)), dims=['scenario', 'a' if first else 'b'])",
    "the shape": "xr.DataArray(np.ones((2, 2 if first else 3)), dims=['scenario', 'bin'])",
}


def flat_part(score, start, status=0):
    score = score if isinstance(score, xr.DataArray) else ("scenario", score)
    index = np.arange(start, start + 2)
    variables = {"rmse": ("scenario", np.ones(2)), "status": ("scenario", np.full(2, status, dtype=np.int8))}
    return xr.Dataset(variables | {"score": score}, coords={"scenario": index})


@pytest.mark.parametrize("source", FORMS.values(), ids=FORMS)
def test_answers_of_another_form_for_other_scenarios_are_refused(source):
    first, second = (eval(source, {"np": np, "xr": xr, "first": first}) for first in (True, False))
    assert_refused("score", "shape", join_flat, 4, [flat_part(first, 0), flat_part(second, 2)])
    joined = join_flat(4, [flat_part(first, 0), flat_part(first, 2)])
    assert joined["score"].dtype == flat_part(first, 0)["score"].dtype
