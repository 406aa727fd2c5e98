"""Write the report: ratios from alternating runs, then every benchmark of a pytest-benchmark JSON file.

``python benchmarks/report.py results.json > RESULTS.md``
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import accuracy
import curves
import numpy as np
from llvmlite.binding import get_host_cpu_name
from peers import common, jax_peer
from suite import LANES, OPTIONS, QUICK, SAMPLE_TIMES, contenders, kernel, plan
from waits import wait_rows

from fastcoil.model.numerics.jit import fingerprint

LANES_IN_ALL = 2 * LANES if QUICK else 1024
SECONDS = 2400 if QUICK else 7200
ROUNDS = 1 if QUICK else 9
CURVES = Path(curves.__file__).with_name("curves.json")


def alternate(runs: Mapping[Any, Callable[[], object]]) -> dict[Any, np.ndarray]:
    """Time runs in turns, s, (ROUNDS,) each: A B C C B A A B C …, so that a slow moment of the machine hits all."""
    seconds: dict[Any, list[float]] = {name: [] for name in runs}
    for k in range(1 + ROUNDS):  # the first one warms up
        for name, run in list(runs.items())[:: -1 if k % 2 else 1]:
            time.sleep(0.0 if QUICK else 0.1)  # until idle threads of the previous run stop spinning
            start = time.perf_counter()
            run()
            if k > 0:
                seconds[name].append(time.perf_counter() - start)
    return {name: np.array(s) for name, s in seconds.items()}


def spread(values: np.ndarray, digits: int) -> str:
    """Median (minimum–maximum)."""
    return f"{np.median(values):.{digits}f} ({values.min():.{digits}f}–{values.max():.{digits}f})"


def table(head: tuple[str, ...], rows: Iterator[tuple[object, ...]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|---|" + "---:|" * (len(head) - 1)
    for row in rows:
        yield "| " + " | ".join(map(str, row)) + " |"
    yield ""


class Race(NamedTuple):
    """How each contender, by name and threads, agrees with fastcoil, and its seconds in alternating rounds."""

    agreements: dict[tuple[str, int], common.Agreement]
    seconds: dict[tuple[str, int], np.ndarray]


def race(sample_time: int, converged: bool) -> Race:
    """Check and time every contender with one of the marches."""
    all_contenders = list(contenders(converged))
    agreements = {c[:2]: c.check(sample_time) for c in all_contenders}
    work = common.work(LANES_IN_ALL, SECONDS, sample_time)
    return Race(agreements, alternate({c[:2]: c.prepare(*work) for c in all_contenders}))


def peer_rows(race: Race, converged: bool) -> Iterator[tuple[object, ...]]:
    """Yield one row per contender, compared with the kernel and the C on as many threads."""
    for (name, threads), seconds in race.seconds.items():
        ratios = [
            spread(seconds / race.seconds[yardstick, threads], 2) if (yardstick, threads) in race.seconds else ""
            for yardstick in ("fastcoil, kernel", "C")
        ]
        metrics, deviation = race.agreements[name, threads]
        label, cost = f"{name}, converged" if converged else name, spread(nanoseconds(seconds), 1)
        yield label, threads, cost, metrics, f"{deviation:.0e}", *ratios


def nanoseconds(seconds: np.ndarray) -> np.ndarray:
    """Return ns per lane-step of the common work."""
    return 1e9 * seconds / (LANES_IN_ALL * SECONDS)


def option_rows(sample_time: int) -> Iterator[tuple[object, ...]]:
    """Yield one row per set of options, compared with the bare loop."""
    lanes, seconds = (LANES, 2400) if QUICK else (4 * LANES, 7200)
    works = {name: plan(lanes, seconds, sample_time, option) for name, option in OPTIONS.items()}
    times = alternate({name: kernel(work) for name, work in works.items()})
    for name, s in times.items():
        yield name, spread(1e9 * s / (lanes * seconds), 1), spread(s / times["bare"], 2)


def lane_rows(sample_time: int) -> Iterator[tuple[object, ...]]:
    """Yield one row per number of lanes, compared with one block."""
    seconds = 2400 if QUICK else 7200
    counts = (LANES, 4 * LANES, 16 * LANES)
    seconds_by_lanes = alternate({n: kernel(plan(n, seconds, sample_time)) for n in counts})
    cost = {n: 1e9 * s / (n * seconds) for n, s in seconds_by_lanes.items()}
    for n in counts:
        yield n, spread(cost[n], 1), spread(cost[n] / cost[LANES], 2)


def benchmark_rows(results: dict[str, Any]) -> Iterator[tuple[object, ...]]:
    """Yield one row per benchmark of the JSON file."""
    for b in results["benchmarks"]:
        info, stats = b["extra_info"], b["stats"]
        n, median = info["lane_steps"], stats["median"]
        yield (
            f"{Path(b['fullname']).name.removeprefix('bench_').replace('.py::test_', ': ')}",
            info["lanes"] or "",
            info["threads"],
            stats["rounds"],
            f"{median:.4g} ({stats['min']:.4g}–{stats['max']:.4g})",
            f"{1e9 * median / n:.1f}" if n else "",
            f"{n / 28800 / median:,.0f}" if n else "",
            info.get("peak_mib", ""),
        )


def first_line(*command: str) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[0]
    except (OSError, subprocess.CalledProcessError):
        return "none"


def versions() -> Iterator[str]:
    yield f"Python {platform.python_version()}"
    yield from (f"{name} {version(name)}" for name in ("numpy", "numba", "llvmlite"))
    yield jax_peer.version()
    yield f"gcc: {first_line('gcc', '--version')}"


def report(results: dict[str, Any]) -> Iterator[str]:
    cpu = results["machine_info"].get("cpu", {})
    brand, load = cpu.get("brand_raw", platform.processor()), f"{os.getloadavg()[1]:.1f} (the suite's own included)"
    yield "# Results of the benchmarks\n"
    yield "Written by `make bench`; [README.md](README.md) says what the rows mean.\n"
    yield f"- Machine: {brand}, {get_host_cpu_name()}, {os.cpu_count()} cores, {platform.system()}"
    yield f"- Versions: {', '.join(versions())}"
    yield f"- Date: {datetime.now(UTC):%Y-%m-%d}; kernel {fingerprint()}; load of the last 5 minutes {load}\n"
    yield "Cells are medians (minimum–maximum).  A lane-step is one scenario for one second.\n"

    races = {(s, converged): race(s, converged) for s in SAMPLE_TIMES for converged in (False, True)}
    yield "## Where people wait\n"
    yield (
        "Commands on a study of 100 scenarios × 8 h, each in a process of its own; ratios of alternating runs, round "
        f"by round, {LANES_IN_ALL} scenarios × {SECONDS} s, at two sample times.\n"
    )
    yield from table(
        ("", "asked", "reached", "met"), wait_rows(results, {s: races[s, False].seconds for s in SAMPLE_TIMES})
    )

    yield "## Peers\n"
    yield (
        f"Alternating runs, {ROUNDS} rounds, {LANES_IN_ALL} scenarios × {SECONDS} s; ratios are those of each round, "
        "on as many threads.  All computed the same metrics first: the table has their number, and their largest "
        "relative deviation from those of `simulate`.\n"
    )
    for (sample_time, converged), result in races.items():
        yield f"{'Converged' if converged else 'Printed'} march, sample time {sample_time} s:\n"
        head = ("", "threads", "ns per lane-step, wall", "metrics", "deviation", "time / kernel's", "time / C's")
        yield from table(head, peer_rows(result, converged))

    yield "## Error over cost\n"
    yield accuracy.TEXT
    errors = accuracy.read_errors()
    costs = {
        (name, march): float(np.median(nanoseconds(seconds)))
        for march, converged in (("printed", False), ("converged", True))
        for (name, threads), seconds in races[SAMPLE_TIMES[0], converged].seconds.items()
        if threads == 1 and name in accuracy.PROGRAMS
    }
    yield from table(accuracy.HEAD, accuracy.rows(errors, costs))
    accuracy.draw(errors, costs, Path(os.devnull) if QUICK else accuracy.FIGURE)
    yield f"![Error of the RMSE over time per simulated second]({accuracy.FIGURE.name})\n"

    yield "## Kernel\n"
    yield "Alternating runs on one thread, ratios round by round.\n"
    for sample_time in SAMPLE_TIMES:
        yield f"Sample time {sample_time} s:\n"
        yield from table(("options", "ns per lane-step", "time / bare"), option_rows(sample_time))
        yield from table(("lanes", "ns per lane-step", f"cost / {LANES} lanes"), lane_rows(sample_time))

    if CURVES.exists():
        yield "## What a study costs\n"
        yield (
            "`python benchmarks/curves.py`: `fastcoil run` of a study of random valves, from the shell to the summary, "
            "once each; 30 and 365 days in sequence; shares include the run that merges them, dask a running cluster.  "
            "Memory is that of the largest process, pages of files included.\n"
        )
        yield "![Cost of a lane-step, memory and disk over the number of scenarios; time over processes](curves.png)\n"
        head = ("scenarios", "length", "run by", "s", "ns per lane-step", "peak, MiB", "folder, MiB")
        yield from table(head, curves.rows(json.loads(CURVES.read_text(encoding="utf-8"))))

    yield "## Every benchmark\n"
    yield "One after the other, by pytest-benchmark.  A scenario-day has 8 h; peak memory is that of a process alone.\n"
    head = ("", "lanes", "threads", "rounds", "s", "ns per lane-step", "scenario-days/s", "peak, MiB")
    yield from table(head, benchmark_rows(results))


if __name__ == "__main__":
    for line in report(json.loads(Path(sys.argv[1]).read_text())):
        print(line, flush=True)
