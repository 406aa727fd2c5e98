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

HOUR, DAY = 3600, 8 * 3600
SIZES = {
    "quick": {100: HOUR},
    "": {1_000: DAY, 10_000: DAY // 2, 100_000: HOUR},
    "full": {1_000: DAY, 10_000: DAY, 100_000: DAY, 1_000_000: DAY},
}[MODE]
"""Scenarios → seconds of the day."""

PEAK = """
import resource, sys
from peers import common
n, seconds, threads = map(int, sys.argv[1:])
common.fastcoil_run(*common.work(n, seconds, 30.0), n_jobs=threads)
try:  # of this process alone: Linux counts the parent's pages in ru_maxrss
    status = dict(line.split(":", 1) for line in open("/proc/self/status"))
    print(int(status["VmHWM"].split()[0]))
except (OSError, KeyError):
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_mib(*arguments: int) -> float:
    """Peak memory of a process of its own that does the work, MiB."""
    command = [sys.executable, "-c", PEAK, *map(str, arguments)]
    done = subprocess.run(command, cwd=common.__file__.rpartition("/peers/")[0], capture_output=True, check=True)
    return int(done.stdout) / 1024


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("n", SIZES)
def test_simulate(timed: Timed, n: int, threads: int) -> None:
    seconds = SIZES[n]
    run = partial(common.fastcoil_run, *common.work(n, seconds, 30.0), n_jobs=threads)
    fc.simulate(fc.Loop(), fc.paper_day(hours=1))  # the kernel is loaded
    rounds = max(1, min(5, round(5e8 / (n * seconds))))
    # 8-h days per second follow from lane_steps and the median
    timed(run, rounds, lane_steps=n * seconds, lanes=n, threads=threads, warm_up=False,
          peak_mib=round(peak_mib(n, seconds, threads)))  # fmt: skip
