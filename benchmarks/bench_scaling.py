"""``fastcoil.simulate`` from beginning to end: cost per lane-step and memory over the number of scenarios."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

import pytest
from conftest import Timed
from peers import common
from suite import MODE, THREADS

import fastcoil as fc

SIZES = [100] if MODE == "quick" else [1_000, 10_000, 100_000, 1_000_000]
SECONDS = {"quick": 3600, "": 2 * 3600, "full": 8 * 3600}[MODE]
"""Of the day, the same for all sizes, so that the cost of a call can be told apart from the cost of a step."""

PEAK = """
import resource, sys
from peers import common
n, seconds, threads = map(int, sys.argv[1:])
common.fastcoil_run(*common.work(n, seconds, 30.0), threads=threads)
try:  # of this process alone: Linux counts the parent's pages in ru_maxrss
    status = dict(line.split(":", 1) for line in open("/proc/self/status"))
    print(int(status["VmHWM"].split()[0]))
except (OSError, KeyError):
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_mib(*arguments: int) -> float:
    """Peak memory of a process of its own that does the work, MiB."""
    command = [sys.executable, "-c", PEAK, *map(str, arguments)]
    process = subprocess.run(command, cwd=common.__file__.rpartition("/peers/")[0], capture_output=True, check=True)
    return int(process.stdout) / 1024


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("n", SIZES)
def test_simulate(timed: Timed, n: int, threads: int) -> None:
    run = partial(common.fastcoil_run, *common.work(n, SECONDS, 30.0), threads=threads)
    fc.simulate(fc.Loop(), fc.paper_day(hours=1))  # the kernel is loaded
    rounds = max(1, min(5, round(5e8 / (n * SECONDS))))
    # 8-h days per second follow from lane_steps and the median
    timed(run, rounds, lane_steps=n * SECONDS, lanes=n, threads=threads, warm_up=False,
          peak_mib=round(peak_mib(n, SECONDS, threads)))  # fmt: skip
