"""A validated simulation: its scenarios, the memory and disk space it takes, and the shards that it is cut into.

A shard is a set of scenarios that one worker runs.  Independent days are cut anywhere.  Where days are a sequence, a
shard is some lanes (one loop and replicate each) on all days from the first on.
"""

import json
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from fastcoil.base import arguments
from fastcoil.base.arrays import MEMMAP_MIN_BYTES
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.files import convert_os_errors, exists
from fastcoil.base.machine import available_memory, format_bytes
from fastcoil.loops.assignment import MIN_SERIES_VALUES, SERIES_HINT
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.clashes import check_clashes, check_stability, check_test_times, warn_mismatch
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import Days, Layout, read_commands
from fastcoil.model.engine.emulator import DAY_COLUMNS
from fastcoil.model.engine.lanes import TraceRequest
from fastcoil.model.engine.rows import LANES
from fastcoil.model.metric_table import METRICS, TRACES, WARM_UP_S
from fastcoil.model.numerics.noise import RNG_NAME

_CURE = "sweep fewer values, ask for fewer traces or a longer trace_interval"


def check_memory(needed_bytes: int, n_scenarios: int) -> None:
    """Refuse results that do not fit into memory."""
    available = available_memory()
    if needed_bytes > available:
        sizes = f"{format_bytes(needed_bytes)} of memory, {format_bytes(available)} are available"
        raise InputError(f"{n_scenarios:,} scenarios need {sizes}: {_CURE}", "loop", "size")


def check_workers(run_bytes: int, worker_bytes: int, n_jobs: int) -> None:
    """Refuse ``n_jobs`` workers of ``worker_bytes`` each that do not fit into memory beside ``run_bytes``."""
    available = available_memory()
    if run_bytes + n_jobs * worker_bytes > available:
        fit = (available - run_bytes) // worker_bytes
        sizes = f"{format_bytes(run_bytes + n_jobs * worker_bytes)} of memory, {format_bytes(available)} are available"
        raise InputError(f"{n_jobs} workers need {sizes}: {f'use -j {fit}' if fit >= 1 else _CURE}", "n_jobs", "size")


def check_disk(needed_bytes: int, folder: Path) -> None:
    """Refuse results that do not fit on the disk of ``folder``, which need not exist."""
    existing = next(p for p in [folder, *folder.absolute().parents] if exists(p))
    with convert_os_errors(existing, "read"):
        free = shutil.disk_usage(existing).free
    if needed_bytes > free:
        sizes = f"{format_bytes(needed_bytes)} on disk, {format_bytes(free)} are free in {existing}"
        raise InputError(f"the study needs up to {sizes}: choose another folder, or {_CURE}", "out", "size")


RUN_LIMITS: dict[str, tuple[int, int | None]] = {
    "trace_interval": (1, None), "warm_up": (0, None), "seed": (0, 2**64 - 1), "replicates": (1, 2**32),
}  # fmt: skip
"""Least and largest value of the whole numbers of a run; a boundary may limit them further."""

# chosen on two cores, see benchmarks/README.md
_LANE_STEPS_PER_SHARD = 60e6  # about 1 to 2 s of work on one core
_SHARDS_PER_WORKER = 4  # at least
_LANE_STEPS_PER_FIRST_SHARD = 4e6
_BYTES_PER_SHARD = 64 * 2**20  # results of a shard
_BYTES_IN_FLIGHT = 192 * 2**20  # results of the shards of all workers and one more
_LANE_STEPS_PER_SEQUENCE = 1e10  # about two minutes, the most that a kill costs where a shard has more than 8 blocks
_MIN_SEQUENCE_BLOCKS = 8  # of days in sequence: each shard makes its days itself, which fewer blocks do not repay
SCENARIOS_AT_ONCE = 128 * LANES  # whose parameters are in memory


@dataclass(frozen=True)
class Plan:
    """A validated simulation: everything that a shard needs, and the size of the result."""

    layout: Layout
    traces: TraceRequest
    warm_up: int
    seed: int
    command: np.ndarray | None
    days: Days = field(repr=False)

    @property
    def n_scenarios(self) -> int:
        return self.layout.size

    @property
    def n_steps(self) -> int:
        return self.layout.boundary.n_steps

    @property
    def n_volumes(self) -> int:
        """Largest number of control volumes."""
        return int(np.max(self.layout.loop["n_volumes"]))  # type: ignore[arg-type]

    @property
    def n_per_day(self) -> int:
        """Number of scenarios of a day."""
        return self.n_scenarios // len(self.days)

    @property
    def carry_over(self) -> bool:
        """Whether its days are a sequence."""
        return self.days.carry_over

    @property
    def metric_bytes(self) -> int:
        """Size of metrics and status of all scenarios."""
        return self.n_scenarios * 8 * (len(METRICS) + 1)

    @property
    def trace_bytes(self) -> int:
        """Size of the traces of all scenarios."""
        return sum(map(self._trace_bytes, self.traces.names))

    def _trace_bytes(self, name: str) -> int:
        rows = self.n_volumes if TRACES[name].per_volume else 1
        return self.n_scenarios * 8 * rows * self.traces.n_points(self.n_steps)

    @property
    def boundary_bytes(self) -> int:
        return len(self.days) * self.n_steps * 8 * len(DAY_COLUMNS)

    def memory_of_run(self, n_jobs: int, backend: str, *, traces_kept: bool = True) -> tuple[int, int]:
        """Return the memory [bytes] of a run with traces on disk: added to this process, and of each worker.

        This process: while workers run, indices of all scenarios, a shard being written, its file, and one that the
        allocator keeps; then values and labels of the results and, in the merge, the file of a shard twice with a trace
        of it and of two others, or two copies of a metric in the summary.  A worker: a shard, parameters, a block and a
        day; one trace more to reduce it; as another process, the shard twice, and its own libraries and boundary.
        """
        n, layout = self.n_scenarios, self.layout
        if self.carry_over:
            shard_size = min(self.lanes_of_sequence(n_jobs, self.n_per_day), self.n_per_day) * len(self.days)
        else:
            blocks, scenarios = self.shard_limits(n_jobs, len(self.days) * -(-self.n_per_day // LANES))
            shard_size = min(blocks * LANES, scenarios, n)
        worker_bytes = -(-(self.metric_bytes + self.trace_bytes) // n) * shard_size
        written_bytes = worker_bytes if traces_kept else self.metric_bytes // n * shard_size
        trace_bytes = max(map(self._trace_bytes, self.traces.names), default=0) // n * shard_size
        worker_bytes += trace_bytes * (not traces_kept) if backend == "threads" else worker_bytes
        worker_bytes += -(-self.trace_bytes // n) * LANES + self.n_steps * 8 * (len(DAY_COLUMNS) + 8)
        worker_bytes += 2400 * min(shard_size, SCENARIOS_AT_ONCE)  # of parameters, measured
        if backend != "threads":  # 170 MiB of a process, measured; libraries are shared
            worker_bytes += 170 * 2**20 + (0 if layout.boundary.is_streamed else 2 * self.boundary_bytes)
        merge_bytes = max(2 * written_bytes + 3 * trace_bytes * traces_kept, 16 * n)  # when there are no workers
        merge_bytes += sum(values.nbytes for values in layout.loop.swept.values()) + 2 * 8 * sum(layout.sizes.values())
        return max(8 * n + 3 * written_bytes, merge_bytes - n_jobs * worker_bytes), worker_bytes

    def disk_bytes(
        self, *, traces_kept: bool = True, metrics_left: float = 1.0, traces_left: float = 1.0
    ) -> tuple[int, int]:
        """Return the disk space [bytes] while a study is merged, and afterwards; shares that compression leaves."""
        traces = [self._trace_bytes(name) // (8 if name == "mode" else 1) for name in self.traces.names if traces_kept]
        left_bytes = int(self.n_scenarios * 8 * len(METRICS) * metrics_left + sum(traces) * traces_left)
        left_bytes += sum(values.nbytes for values in self.layout.loop.swept.values())
        joined_bytes = max([0, *traces]) + self.metric_bytes * (8 * self.n_scenarios >= MEMMAP_MIN_BYTES)
        return self.metric_bytes + sum(traces) + joined_bytes + left_bytes, left_bytes

    def shard_limits(self, n_jobs: int, n_blocks: int) -> tuple[int, int]:
        """Return the most blocks and the most scenarios of a shard of a run of ``n_blocks``."""
        by_work = _LANE_STEPS_PER_SHARD / (self.n_steps * LANES)
        by_workers = n_blocks / (n_jobs * _SHARDS_PER_WORKER)
        shard_bytes = min(_BYTES_PER_SHARD, _BYTES_IN_FLIGHT // (n_jobs + 1))
        by_size = shard_bytes * self.n_scenarios // (self.metric_bytes + self.trace_bytes)
        return max(1, round(min(by_work, by_workers))), max(LANES, by_size)

    def lanes_of_sequence(self, n_jobs: int, n_lanes: int) -> int:
        """Return the most lanes of a shard of a run of ``n_lanes`` on days in sequence."""
        n_blocks, n_groups = -(-n_lanes // LANES), 1
        if n_jobs > 1:  # groups of four blocks, up to four for each worker, so that none is idle for long
            n_groups = max(n_jobs, min(n_blocks // 4, n_jobs * 4))
        by_work = max(_MIN_SEQUENCE_BLOCKS, int(_LANE_STEPS_PER_SEQUENCE / (self.n_steps * len(self.days) * LANES)))
        shard_bytes = min(_BYTES_PER_SHARD, _BYTES_IN_FLIGHT // (n_jobs + 1))
        by_size = shard_bytes * self.n_per_day // (self.metric_bytes + self.trace_bytes)
        return max(1, min(LANES * min(-(-n_blocks // n_groups), by_work), by_size))


def plan_simulation(
    loop: Loop, boundary: Boundary, *, command: Any = None, traces: Sequence[str] = (), trace_interval: int = 1,
    warm_up: int = WARM_UP_S, seed: int = 0, replicates: int = 1, carry_over: bool = False,
    traces_on_disk: bool = False,
) -> Plan:  # fmt: skip
    """Validate the arguments of ``simulate`` without allocating or running anything."""
    with arguments.argument_checks() as check:
        check(arguments.require_instance, "loop", loop, Loop, "give a fastcoil.Loop")
        cure = "give a fastcoil.Boundary, such as fastcoil.paper_day()"
        check(arguments.require_instance, "boundary", boundary, Boundary, cure)
    with arguments.argument_checks() as check:
        trace_interval = check(arguments.require_integer, "trace_interval", trace_interval, 1, boundary.n_steps)
        warm_up = check(arguments.require_integer, "warm_up", warm_up, *RUN_LIMITS["warm_up"])
        seed = check(arguments.require_integer, "seed", seed, *RUN_LIMITS["seed"])
        replicates = check(arguments.require_integer, "replicates", replicates, *RUN_LIMITS["replicates"])
        carry_over = check(arguments.require_flag, "carry_over", carry_over)
        _check_traces(check, traces)
        for name, value in loop.swept.items():
            if value.dims == (name,) and value.size == boundary.n_steps >= MIN_SERIES_VALUES:  # likely a series
                sentence = f"{name} has {value.size:,} values, one for each second of the boundary: {SERIES_HINT}"
                cure = f'to sweep it, name the dimension: {name}=("sample", values)'
                check.problems.append(Problem(f"{sentence}; {cure}", name, "shape"))
        if not check.problems and boundary.n_steps <= warm_up:
            durations = f"a day lasts {boundary.n_steps} s, the warm-up {short_repr(warm_up)} s"
            sentence = f"{durations}: nothing is left to count, give longer days"
            check.problems.append(Problem(sentence, "boundary", "data"))
    layout = Layout(loop, boundary, replicates)
    with arguments.argument_checks() as check:
        for rule in layout.loop.rules.values():
            if rule.is_loaded:
                check(rule.check)
    commands = read_commands(command, boundary)
    days = Days(boundary, commands, warm_up, seed, carry_over=carry_over)
    plan = Plan(layout, TraceRequest(tuple(traces), trace_interval), warm_up, seed, commands, days)
    in_memory = 5 * plan.metric_bytes + 3 * plan.trace_bytes  # the most that simulate takes, measured
    check_memory(sum(plan.memory_of_run(1, "threads")) if traces_on_disk else in_memory, plan.n_scenarios)
    check_clashes(layout.loop, np.array(boundary.extremes["T_set"]), boundary.extremes["backlash_scale"][0])
    check_test_times(layout.loop, boundary.n_steps * (len(days) if carry_over else 1), closed=commands is None)
    check_stability(layout)
    warn_mismatch(layout.loop, boundary, closed=commands is None)
    return plan


def simulation_attributes(plan: Plan) -> dict[str, Any]:
    """Return the attributes of a result that, with its coordinates, identify the simulation."""
    attrs = {
        "parameters": json.dumps(plan.layout.loop.constants),
        "boundary": plan.layout.boundary.describe(),
        "boundary_sha256": plan.layout.boundary.sha256,
        "day_sha256": json.dumps(plan.days.sha256),
        "warm_up_s": plan.warm_up,
        "seed": str(plan.seed),
        "rng": RNG_NAME,
    }
    if plan.carry_over:
        attrs["carry_over"] = 1
    if plan.command is not None:
        import joblib  # takes 0.1 s, not needed to open a study

        attrs["command_sha256"] = joblib.hash(plan.command, hash_name="sha1")
    return attrs


def _check_traces(check: arguments.Checks, traces: object) -> None:
    if not isinstance(traces, (list, tuple)):
        check.problems.append(Problem(f"traces = {short_repr(traces)}: give a list of names", "traces", "type"))
        return
    for name in traces:
        if name in BOUNDARY_SERIES:
            sentence = f"traces: {name!r} is an input: it is in the boundary, as boundary.series[{name!r}]"
            check.problems.append(Problem(sentence, "traces", "choice"))
        else:
            check(arguments.require_choice, "traces", name, TRACES)
    twice = [n for n in TRACES if traces.count(n) > 1]
    check.problems += [Problem(f"traces: {n} is listed twice", "traces", "duplicate") for n in twice]


@dataclass(frozen=True)
class Shard:
    """Scenarios that one worker runs: any of independent days, or some lanes on all days of a sequence."""

    lanes: np.ndarray  # ascending: flat indices, or in a sequence positions among the scenarios of a day
    n_per_day: int = 0  # of a sequence
    first_day: int = 0  # of a sequence, whose results are kept
    end_day: int = 1

    @property
    def index(self) -> np.ndarray:
        """Flat indices of its scenarios, ascending."""
        return np.asarray(np.arange(self.first_day, self.end_day)[:, np.newaxis] * self.n_per_day + self.lanes).ravel()

    @property
    def size(self) -> int:
        return self.lanes.size * (self.end_day - self.first_day)

    def halves(self) -> "list[Shard]":
        """Return two groups of its lanes."""
        return [replace(self, lanes=half) for half in np.array_split(self.lanes, 2)]


@dataclass(frozen=True)
class JobSlice:
    """The ``k``-th of ``n`` slices of the scenarios of a study, counted from 1, for different machines."""

    k: int
    n: int

    @classmethod
    def parse(cls, text: str) -> "JobSlice":
        """Read ``K/N``."""
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise InputError(f"--shard {text}: give K/N, the K-th of N shares, such as 1/8 to 8/8", "--shard", "format")
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"{self.k}-of-{self.n}"

    def index(self, plan: Plan) -> np.ndarray:
        """Return flat indices of its scenarios, ascending: neighbours, or some lanes on all days of a sequence."""
        n_total = plan.n_per_day if plan.carry_over else plan.n_scenarios
        selected = np.arange(n_total * (self.k - 1) // self.n, n_total * self.k // self.n)
        return Shard(selected, n_total, 0, len(plan.days)).index if plan.carry_over else selected


def cut_into_shards(plan: Plan, n_jobs: int, todo: np.ndarray | None = None) -> list[Shard]:
    """Cut ``todo``, ascending flat indices, or all scenarios into shards: whole blocks of one day each; or lanes."""
    n_per_day, todo = plan.n_per_day, np.arange(plan.n_scenarios) if todo is None else todo
    if not plan.carry_over:
        day = todo // n_per_day
        position_in_day = np.arange(todo.size) - np.searchsorted(day, day)
        edges = np.append(np.flatnonzero(position_in_day % LANES == 0), todo.size)  # where a block starts, and the end
        most_blocks, most_scenarios = plan.shard_limits(n_jobs, edges.size - 1)
        sizes = _double_sizes(plan.n_steps, most_blocks, n_jobs)
        shards: list[Shard] = []
        start = 0
        while start < edges.size - 1:
            last_within = int(np.searchsorted(edges, edges[start] + most_scenarios, side="right")) - 1
            stop = max(start + 1, min(start + next(sizes), last_within, edges.size - 1))
            shards.append(Shard(todo[edges[start] : edges[stop]]))
            start = stop
        return shards
    first_day, end_day = np.full(n_per_day, len(plan.days)), np.zeros(n_per_day, dtype=np.int64)
    np.minimum.at(first_day, todo % n_per_day, todo // n_per_day)
    np.maximum.at(end_day, todo % n_per_day, todo // n_per_day + 1)
    lanes = np.flatnonzero(end_day)
    max_lanes = plan.lanes_of_sequence(n_jobs, lanes.size)
    sizes = _double_sizes(plan.n_steps * len(plan.days), -(-max_lanes // LANES), n_jobs)
    day_ranges, range_index = np.unique(np.stack([first_day[lanes], end_day[lanes]]), axis=1, return_inverse=True)
    sequences = []
    for k, (begin, stop) in enumerate(day_ranges.T.tolist()):
        members = lanes[range_index.ravel() == k]
        while members.size:
            n_lanes = min(next(sizes) * LANES, max_lanes)
            sequences.append(Shard(members[:n_lanes], n_per_day, begin, stop))
            members = members[n_lanes:]
    return sequences


def _double_sizes(n_steps: int, most_blocks: int, n_jobs: int) -> Iterator[int]:
    """Yield numbers of blocks, each of ``n_steps``: few at first, so that something is soon on the disk."""
    first_blocks = max(1, round(_LANE_STEPS_PER_FIRST_SHARD / (n_steps * LANES)))
    for k in count():
        yield min(most_blocks, first_blocks << min(k // n_jobs, 30))
