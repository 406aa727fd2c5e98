"""A validated simulation: its scenarios, the memory and disk space it takes, and the shards that it is cut into.

A shard is a set of scenarios that one worker runs.  Independent days are cut anywhere.  Where days are a sequence, a
shard is some lanes (one loop and replicate each) on all days from the first on.
"""

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, choice_of, collecting, flag_of, instance_of, whole_of
from fastcoil.base.arrays import LARGE
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.base.files import exists, storage_errors
from fastcoil.base.machine import available_memory, gib
from fastcoil.loops.assignment import SERIES_HINT, SHORTEST_SERIES
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.clashes import check_clashes, check_stability, check_test_times, tell_doubts
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import Days, Layout, commands_of
from fastcoil.model.engine.emulator import DAY_COLUMNS
from fastcoil.model.engine.lanes import TraceRequest
from fastcoil.model.engine.rows import LANES
from fastcoil.model.metric_table import METRICS, TRACES, WARM_UP
from fastcoil.model.numerics.noise import RNG

_CURE = "sweep fewer values, ask for fewer traces or a longer trace_interval"


def check_memory(needed: int, n_scenarios: int) -> None:
    """Refuse results of ``needed`` bytes that do not fit into memory."""
    available = available_memory()
    if needed > available:
        sizes = f"{gib(needed)} of memory, {gib(available)} are available"
        raise InputError(f"{n_scenarios:,} scenarios need {sizes}: {_CURE}")


def check_workers(alone: int, each: int, n_jobs: int) -> None:
    """Refuse ``n_jobs`` workers of ``each`` bytes that, with a run of ``alone`` bytes, do not fit into memory."""
    available = available_memory()
    if alone + n_jobs * each > available:
        fit = (available - alone) // each
        sizes = f"{gib(alone + n_jobs * each)} of memory, {gib(available)} are available"
        raise InputError(f"{n_jobs} workers need {sizes}: {f'use -j {fit}' if fit >= 1 else _CURE}")


def check_disk(needed: int, folder: Path) -> None:
    """Refuse results of ``needed`` bytes that do not fit where they are to be written; ``folder`` need not exist."""
    nearest_existing = next(p for p in [folder, *folder.absolute().parents] if exists(p))
    with storage_errors(nearest_existing, "read"):
        free = shutil.disk_usage(nearest_existing).free
    if needed > free:
        raise InputError(
            f"the study needs up to {gib(needed)} on disk, {gib(free)} are free in {nearest_existing}: "
            f"choose another folder, or {_CURE}"
        )


RUN_LIMITS: dict[str, tuple[int, int | None]] = {
    "trace_interval": (1, None),
    "warm_up": (0, None),
    "seed": (0, 2**64 - 1),
    "replicates": (1, 2**32),
}
"""Least and largest value of the whole numbers that say how to run; a boundary may limit them further."""

_LANE_STEPS_PER_SHARD = 60e6  # about 1 to 2 s of work on one core
_SHARDS_PER_WORKER = 4
_BYTES_PER_SHARD, _BYTES_IN_FLIGHT = 64 * 2**20, 192 * 2**20  # of results; of the shards of all workers and one more
_LANE_STEPS_PER_SEQUENCE = 1e10  # about two minutes, which a kill costs at most, but for the fewest blocks
_FEWEST_BLOCKS = 8  # of days in sequence: each shard makes its days itself, which fewer do not repay
_BLOCKS_PER_GROUP, _GROUPS_PER_WORKER = 4, 4
"""Fewer, where workers would have nothing to do; more groups even out what they have to do."""
_OF_PROCESS = 170 * 2**20
"""Memory of a worker that is a process, measured; libraries are shared."""
_OF_PARAMETERS, PARAMETERS_AT_ONCE = 2400, 128 * LANES
"""Bytes of the parameters of a scenario, measured, ten times those of its metrics; scenarios with them at a time."""


@dataclass(frozen=True)
class Plan:
    """A validated simulation: everything a shard needs, and the size of the result."""

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
    def n_a_day(self) -> int:
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
        """Memory in bytes that a run with traces on disk takes besides what this process has: itself, each worker.

        Itself: while workers run, indices of all scenarios, a shard on its way to the disk, its file, and one that the
        allocator keeps; then values and labels of the results and, in the merge, the file of a shard twice with a trace
        of it and of two others, or two copies of a metric in the summary.  A worker: a shard, parameters, a block and a
        day; a trace more to reduce it; as another process, the shard twice, its own libraries and boundary.
        """
        n, layout = self.n_scenarios, self.layout
        if self.carry_over:
            largest = min(self.lanes_of_sequence(n_jobs, self.n_a_day), self.n_a_day) * len(self.days)
        else:
            blocks, scenarios = self.shard_limits(n_jobs, len(self.days) * -(-self.n_a_day // LANES))
            largest = min(blocks * LANES, scenarios, n)
        each = -(-(self.metric_bytes + self.trace_bytes) // n) * largest
        written = each if traces_kept else self.metric_bytes // n * largest
        trace = max(map(self._trace_bytes, self.traces.names), default=0) // n * largest
        each += trace * (not traces_kept) if backend == "threads" else each
        each += -(-self.trace_bytes // n) * LANES + self.n_steps * 8 * (len(DAY_COLUMNS) + 8)
        each += _OF_PARAMETERS * min(largest, PARAMETERS_AT_ONCE)
        if backend != "threads":
            each += _OF_PROCESS + (0 if layout.boundary.is_streamed else 2 * self.boundary_bytes)
        afterwards = max(2 * written + 3 * trace * traces_kept, 16 * n)  # when there are no workers
        afterwards += sum(values.nbytes for values in layout.loop.swept.values()) + 2 * 8 * sum(layout.sizes.values())
        return max(8 * n + 3 * written, afterwards - n_jobs * each), each

    def disk_bytes(
        self, *, traces_kept: bool = True, metrics_left: float = 1.0, traces_left: float = 1.0
    ) -> tuple[int, int]:
        """Room that a study takes on disk while it is merged, and what is left of it.

        Shards are not compressed, and are there until the results are; in between metrics are put together, and each
        trace of days in sequence, whose shards are not in their order.

        metrics_left, traces_left: the share of their bytes that results take, see ``estimate``; by default the most.
        """
        traces = [self._trace_bytes(name) // (8 if name == "mode" else 1) for name in self.traces.names if traces_kept]
        left = int(self.n_scenarios * 8 * len(METRICS) * metrics_left + sum(traces) * traces_left)
        left += sum(values.nbytes for values in self.layout.loop.swept.values())
        put_together = self.metric_bytes * (8 * self.n_scenarios >= LARGE) + max([0, *traces]) * self.carry_over
        return self.metric_bytes + sum(traces) + put_together + left, left

    def shard_limits(self, n_jobs: int, n_blocks: int) -> tuple[int, int]:
        """Most blocks and most scenarios of a shard, if ``n_blocks`` are to be run."""
        by_work = _LANE_STEPS_PER_SHARD / (self.n_steps * LANES)
        by_workers = n_blocks / (n_jobs * _SHARDS_PER_WORKER)
        room = min(_BYTES_PER_SHARD, _BYTES_IN_FLIGHT // (n_jobs + 1))
        by_size = room * self.n_scenarios // (self.metric_bytes + self.trace_bytes)
        return max(1, round(min(by_work, by_workers))), max(LANES, by_size)

    def lanes_of_sequence(self, n_jobs: int, n_lanes: int) -> int:
        """Most lanes of a shard, if ``n_lanes`` are to be run on days in sequence."""
        n_blocks, n_groups = -(-n_lanes // LANES), 1
        if n_jobs > 1:
            n_groups = max(n_jobs, min(n_blocks // _BLOCKS_PER_GROUP, n_jobs * _GROUPS_PER_WORKER))
        by_work = max(_FEWEST_BLOCKS, int(_LANE_STEPS_PER_SEQUENCE / (self.n_steps * len(self.days) * LANES)))
        room = min(_BYTES_PER_SHARD, _BYTES_IN_FLIGHT // (n_jobs + 1))
        by_size = room * self.n_a_day // (self.metric_bytes + self.trace_bytes)
        return max(1, min(LANES * min(-(-n_blocks // n_groups), by_work), by_size))


def plan_simulation(
    loop: Loop,
    boundary: Boundary,
    *,
    command: Any = None,
    traces: Sequence[str] = (),
    trace_interval: int = 1,
    warm_up: int = WARM_UP,
    seed: int = 0,
    replicates: int = 1,
    carry_over: bool = False,
    traces_on_disk: bool = False,
) -> Plan:
    """Validate the arguments of ``simulate``: nothing is allocated and nothing runs."""
    with checking() as check:
        check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        check(instance_of, "boundary", boundary, Boundary, "give a fastcoil.Boundary, such as fastcoil.paper_day()")
    with checking() as check:
        trace_interval = check(whole_of, "trace_interval", trace_interval, 1, boundary.n_steps)
        warm_up = check(whole_of, "warm_up", warm_up, *RUN_LIMITS["warm_up"])
        seed = check(whole_of, "seed", seed, *RUN_LIMITS["seed"])
        replicates = check(whole_of, "replicates", replicates, *RUN_LIMITS["replicates"])
        carry_over = check(flag_of, "carry_over", carry_over)
        check.problems += _trace_problems(traces)
        check.problems += [  # most likely series, and not sweeps
            f"{name} has {value.size:,} values, one for each second of the boundary: {SERIES_HINT}; "
            f'to sweep it, name the dimension: {name}=("sample", values)'
            for name, value in loop.swept.items()
            if value.dims == (name,) and value.size == boundary.n_steps >= SHORTEST_SERIES
        ]
        if not check.problems and boundary.n_steps <= warm_up:
            lasts = f"a day lasts {boundary.n_steps} s, the warm-up {shown(warm_up)} s"
            check.problems.append(f"{lasts}: nothing is left to count, give longer days")
    layout = Layout(loop, boundary, replicates)
    with checking() as check:
        for rule in layout.loop.rules.values():
            if rule.is_loaded:
                check(rule.check)
    commands = commands_of(command, boundary)
    days = Days(boundary, commands, warm_up, seed, carry_over=carry_over)
    plan = Plan(layout, TraceRequest(tuple(traces), trace_interval), warm_up, seed, commands, days)
    in_memory = 5 * plan.metric_bytes + 3 * plan.trace_bytes  # what simulate takes at most, measured
    check_memory(sum(plan.memory_of_run(1, "threads")) if traces_on_disk else in_memory, plan.n_scenarios)
    check_clashes(layout.loop, np.array(boundary.extremes["T_set"]), boundary.extremes["backlash_scale"][0])
    seconds = boundary.n_steps * (len(days) if carry_over else 1)
    check_test_times(layout.loop, seconds, closed=commands is None)
    check_stability(layout)
    tell_doubts(layout.loop, boundary, closed=commands is None)
    return plan


def simulation_attributes(plan: Plan) -> dict[str, Any]:
    """Attributes of a result that, with its coordinates, say what was simulated."""
    attrs = {
        "parameters": json.dumps(plan.layout.loop.constants),
        "boundary": plan.layout.boundary.describe(),
        "boundary_sha256": plan.layout.boundary.sha256,
        "day_sha256": json.dumps(plan.days.sha256),
        "warm_up_s": plan.warm_up,
        "seed": str(plan.seed),
        "rng": RNG,
    }
    if plan.carry_over:
        attrs["carry_over"] = 1
    if plan.command is not None:
        import joblib  # takes 0.1 s, which a study that is only looked at need not wait

        attrs["command_sha256"] = joblib.hash(plan.command, hash_name="sha1")
    return attrs


def _trace_problems(traces: object) -> list[str]:
    if not isinstance(traces, (list, tuple)):
        return [WrongType(f"traces = {shown(traces)}: give a list of names")]
    problems: list[str] = []
    for name in traces:
        if name in BOUNDARY_SERIES:
            problems.append(f"traces: {name!r} is an input: it is in the boundary, as boundary.series[{name!r}]")
        else:
            with collecting(problems):
                choice_of("traces", name, TRACES)
    return problems + [f"traces: {n} is listed twice" for n in TRACES if traces.count(n) > 1]


@dataclass(frozen=True)
class Shard:
    """Scenarios that one worker runs: of independent days any, of a sequence of days some lanes on all of them."""

    lanes: np.ndarray  # (n,), ascending: flat indices, or in a sequence positions among the ``of`` scenarios of a day
    of: int = 0
    first: int = 0  # day of a sequence from which on results are kept
    end: int = 1  # day before which a sequence ends

    @property
    def is_sequence(self) -> bool:
        """Whether its days are a sequence."""
        return self.of > 0

    @property
    def index(self) -> np.ndarray:
        """Flat indices of its scenarios, ascending."""
        return np.asarray(np.arange(self.first, self.end)[:, np.newaxis] * self.of + self.lanes).ravel()

    @property
    def size(self) -> int:
        return self.lanes.size * (self.end - self.first)

    def halves(self) -> "list[Shard]":
        """Two groups of its lanes."""
        return [replace(self, lanes=half) for half in np.array_split(self.lanes, 2)]


@dataclass(frozen=True)
class Share:
    """The ``k``-th of ``n`` shares of the scenarios of a study, counted from 1, which different machines run."""

    k: int
    n: int

    @classmethod
    def parse(cls, text: str) -> "Share":
        """Read ``K/N``."""
        words = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if words is None or not 1 <= int(words[1]) <= int(words[2]):
            raise InputError(f"--shard {text}: give K/N, the K-th of N shares, such as 1/8 to 8/8")
        return cls(int(words[1]), int(words[2]))

    def __str__(self) -> str:
        return f"{self.k}-of-{self.n}"

    def index(self, plan: Plan) -> np.ndarray:
        """Flat indices of its scenarios, ascending: neighbours, or of days in sequence some lanes on all days."""
        whole = plan.n_a_day if plan.carry_over else plan.n_scenarios
        some = np.arange(whole * (self.k - 1) // self.n, whole * self.k // self.n)
        return Shard(some, whole, 0, len(plan.days)).index if plan.carry_over else some


def shards_of(plan: Plan, n_jobs: int, todo: np.ndarray | None = None) -> list[Shard]:
    """The shards of ``todo``, flat indices, ascending, or of all: ranges of whole blocks, each of one day; or lanes."""
    of, todo = plan.n_a_day, np.arange(plan.n_scenarios) if todo is None else todo
    if not plan.carry_over:
        day = todo // of
        in_day = np.arange(todo.size) - np.searchsorted(day, day)
        edges = np.append(np.flatnonzero(in_day % LANES == 0), todo.size)  # where a block starts, and the end
        most_blocks, most_scenarios = plan.shard_limits(n_jobs, edges.size - 1)
        shards, start = [], 0
        while start < edges.size - 1:
            within = int(np.searchsorted(edges, edges[start] + most_scenarios, side="right")) - 1
            stop = max(start + 1, min(start + most_blocks, within, edges.size - 1))
            shards.append(Shard(todo[edges[start] : edges[stop]]))
            start = stop
        return shards
    first, end = np.full(of, len(plan.days)), np.zeros(of, dtype=np.int64)
    np.minimum.at(first, todo % of, todo // of)
    np.maximum.at(end, todo % of, todo // of + 1)
    lanes = np.flatnonzero(end)
    most = plan.lanes_of_sequence(n_jobs, lanes.size)
    ways, way_of = np.unique(np.stack([first[lanes], end[lanes]]), axis=1, return_inverse=True)
    found = []
    for k, (begin, stop) in enumerate(ways.T.tolist()):
        alike = lanes[way_of.ravel() == k]
        found += [Shard(alike[n : n + most], of, begin, stop) for n in range(0, alike.size, most)]
    return found
