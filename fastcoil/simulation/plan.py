"""A validated simulation: what will be run, how large it is, and whether it fits."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from fastcoil.boundary import Boundary
from fastcoil.engine.emulator import DAY_COLUMNS, Day
from fastcoil.engine.host import Traces
from fastcoil.engine.rows import LANES
from fastcoil.engine.schedule import schedule
from fastcoil.errors import InputError, nearest
from fastcoil.numerics.noise import RNG
from fastcoil.outputs import METRICS, TRACES, WARM_UP
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.scenarios import Layout
from fastcoil.simulation.stability import check_stability

RUN_LIMITS: dict[str, tuple[int, int | None]] = {
    "trace_interval": (1, None),
    "warm_up": (0, None),
    "seed": (0, 2**64 - 1),
    "replicates": (1, 2**32),
}
"""Least and largest value of the whole numbers that say how to run; a boundary may limit them further."""

_LANE_STEPS_PER_SHARD = 60e6
"""About 1 to 2 s of work on one core."""
_SHARDS_PER_WORKER = 4
_BYTES_PER_SHARD = 64 * 2**20


@dataclass(frozen=True)
class Plan:
    """A validated simulation: everything a shard needs, and the size of what will come out."""

    layout: Layout
    traces: Traces
    warm_up: int
    seed: int
    command: np.ndarray | None
    days: tuple[Day, ...] = field(repr=False)

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
    def lane_steps(self) -> int:
        return self.n_scenarios * self.n_steps

    @property
    def metric_bytes(self) -> int:
        """Size of metrics and status of all scenarios."""
        return self.n_scenarios * 8 * (len(METRICS) + 1)

    @property
    def trace_bytes(self) -> int:
        """Size of the traces of all scenarios."""
        rows = sum(self.n_volumes if TRACES[n].per_volume else 1 for n in self.traces.names)
        return self.n_scenarios * 8 * rows * self.traces.n_points(self.n_steps)

    def memory_bytes(self, n_jobs: int, *, traces_on_disk: bool) -> int:
        """Memory that the run takes at most: the result, its image on the way to disk, a copy while it is put together.

        Traces on the disk are only in memory by the shard.
        """
        if not traces_on_disk:
            return 3 * (self.metric_bytes + self.trace_bytes)
        of_shard = -(-(self.metric_bytes + self.trace_bytes) // self.n_scenarios) * self.shard_size(n_jobs)
        return 3 * self.metric_bytes + 3 * (n_jobs + 1) * of_shard

    def disk_bytes(self, *, traces_kept: bool = True) -> int:
        """Room that a study takes at most on the disk while it is merged."""
        return 2 * self.metric_bytes + 3 * self.trace_bytes * traces_kept

    def shard_size(self, n_jobs: int, n_scenarios: int | None = None) -> int:
        """Scenarios of a shard where ``n_scenarios`` (all) are to be run: whole blocks."""
        by_work = _LANE_STEPS_PER_SHARD / self.n_steps
        by_workers = (n_scenarios or self.n_scenarios) / (n_jobs * _SHARDS_PER_WORKER)
        by_size = _BYTES_PER_SHARD * self.n_scenarios / (self.metric_bytes + self.trace_bytes)
        return max(1, round(min(by_work, by_workers, by_size) / LANES)) * LANES

    def shards(self, n_jobs: int, todo: np.ndarray | None = None) -> list[np.ndarray]:
        """Cut the scenarios ``todo``, all by default, into whole blocks of one day: enough to keep all workers busy.

        Returns flat indices, ascending.
        """
        todo = np.arange(self.n_scenarios) if todo is None else todo
        size = self.shard_size(n_jobs, todo.size)
        per_day = self.n_scenarios // len(self.days)
        of_days = np.split(todo, np.searchsorted(todo, np.arange(1, len(self.days)) * per_day))
        return [day[start : start + size] for day in of_days for start in range(0, day.size, size)]


def prepare(
    loop: Loop,
    boundary: Boundary,
    *,
    command: Any = None,
    traces: Sequence[str] = (),
    trace_interval: int = 1,
    warm_up: int = WARM_UP,
    seed: int = 0,
    replicates: int = 1,
    traces_on_disk: bool = False,
) -> Plan:
    """Validate the arguments of ``simulate``; nothing is allocated and nothing run.  All mistakes at once."""
    if not isinstance(loop, Loop):
        raise InputError(f"loop is a {type(loop).__name__}: give a fastcoil.Loop")
    if not isinstance(boundary, Boundary):
        raise InputError(
            f"boundary is a {type(boundary).__name__}: give a fastcoil.Boundary, such as fastcoil.paper_day()"
        )
    given = {"trace_interval": trace_interval, "warm_up": warm_up, "seed": seed, "replicates": replicates}
    limits = RUN_LIMITS | {"trace_interval": (1, boundary.n_steps)}
    problems = [p for name, value in given.items() for p in whole_number_problems(name, value, *limits[name])]
    if not isinstance(traces, (list, tuple)):
        problems.append(f"traces = {traces!r}: give a list of names")
        traces = ()
    known = [n for n in traces if isinstance(n, str) and n in TRACES]
    problems += [
        f"traces: {n!r} is not a trace{nearest(str(n), TRACES)}; known: {', '.join(TRACES)}"
        for n in traces
        if n not in known
    ]
    problems += [f"traces: {n} is listed twice" for n in sorted(set(known)) if known.count(n) > 1]
    if not problems and boundary.n_steps <= warm_up:
        problems.append(
            f"the boundary lasts {boundary.n_steps} s, the warm-up {warm_up} s: nothing is left to count, "
            "give a longer boundary"
        )
    if problems:
        raise InputError(problems)
    layout = Layout(loop, boundary, replicates)
    commands = _commands(command, boundary)
    words = (seed & 0xFFFFFFFF, seed >> 32)
    days = tuple(
        Day(
            series=np.stack([boundary.series[n][d] for n in DAY_COLUMNS], axis=1),
            command=commands[d] if commands is not None else np.empty(0),
            schedule=schedule(boundary.series["T_set"][d], boundary.series["enabled"][d], warm_up),
            label=int(boundary.day[d]),
            seed=words,
        )
        for d in range(boundary.n_days)
    )
    plan = Plan(layout, Traces(tuple(traces), trace_interval), warm_up, seed, commands, days)
    _check_memory(plan, traces_on_disk)
    layout.check_together()
    check_stability(layout)
    return plan


def settings(plan: Plan) -> dict[str, Any]:
    """The attributes that, with the coordinates, say what was simulated."""
    attrs = {
        "parameters": json.dumps(plan.layout.loop.constants),
        "boundary": plan.layout.boundary.describe(),
        "boundary_sha256": plan.layout.boundary.sha256,
        "day_sha256": json.dumps([day_sha256(day) for day in plan.days]),
        "warm_up_s": plan.warm_up,
        "seed": str(plan.seed),
        "rng": RNG,
    }
    if plan.command is not None:
        attrs["command_sha256"] = joblib.hash(plan.command, hash_name="sha1")
    return attrs


def day_sha256(day: Day) -> str:
    """Hash of all that a scenario meets on a day, its label included: that keys the noise."""
    return hashlib.sha256(f"{day.label} ".encode() + day.series.tobytes() + day.command.tobytes()).hexdigest()


def available_memory() -> int:
    """Bytes of memory that can be used without swapping."""
    try:
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):  # not Linux: take what the machine has
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_disk(plan: Plan, folder: Path, *, traces_kept: bool = True) -> None:
    """Refuse a result that cannot fit where it is to be written."""
    nearest_existing = next(p for p in [folder, *folder.absolute().parents] if p.exists())
    free = shutil.disk_usage(nearest_existing).free
    needed = plan.disk_bytes(traces_kept=traces_kept)
    if needed > free:
        raise InputError(
            f"the study needs up to {gib(needed)} on disk, {gib(free)} are free in {nearest_existing}: "
            "choose another folder, or sweep fewer values, ask for fewer traces or a longer trace_interval"
        )


def gib(n_bytes: float) -> str:
    """Bytes in words."""
    return f"{n_bytes / 2**30:,.1f} GiB" if n_bytes >= 2**30 else f"{n_bytes / 2**20:,.1f} MiB"


def _check_memory(plan: Plan, traces_on_disk: bool) -> None:
    needed, available = plan.memory_bytes(1, traces_on_disk=traces_on_disk), available_memory()
    if needed > available:
        raise InputError(
            f"{plan.n_scenarios:,} scenarios need {gib(needed)} of memory for their results, "
            f"{gib(available)} are available: sweep fewer values, ask for fewer traces or a longer trace_interval"
        )


def whole_number_problems(name: str, value: object, low: int, high: int | None) -> list[str]:
    """A sentence if ``value`` is not a whole number from ``low`` to ``high``, else nothing."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        return [f"{name} = {value!r}: give a whole number"]
    if value < low or (high is not None and value > high):
        return [f"{name} = {value}: must be at least {low}" + (f" and at most {high}" if high is not None else "")]
    return []


def _commands(command: Any, boundary: Boundary) -> np.ndarray | None:
    """The open-loop command as (n_days, n_steps), or None in closed loop."""
    if command is None:
        return None
    try:
        values = np.asarray(command)
        if values.dtype.kind not in "iuf":
            raise TypeError
        values = values.astype(float)
    except (TypeError, ValueError):
        raise InputError(f"command is a {type(command).__name__}: give 1-s samples, an array of numbers") from None
    shape = (boundary.n_days, boundary.n_steps)
    if values.shape not in (shape, shape[1:]):
        raise InputError(f"command has shape {values.shape}: give 1-s samples, {shape[1:]} or (day, second) = {shape}")
    bad = np.argwhere(~((values >= 0.0) & (values <= 1.0)))
    if bad.size:
        raise InputError(
            f"command = {values[tuple(bad[0])]} at second {bad[0][-1]}: must be a fraction of stroke, 0 to 1"
        )
    return np.array(np.broadcast_to(values, shape), order="C")
