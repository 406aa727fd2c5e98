"""Days in sequence: memory of many days of 24 h, and speed beside the same days run each by itself.

``python benchmarks/years.py [LANES [DAYS [ROUNDS]]]``: each run is a process of its own with one thread; the two kinds
take turns.  Prints a line for each run, then the ratio of their median speeds.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import fastcoil as fc

SECONDS_A_DAY = 86_400


def make(label: int) -> dict[str, np.ndarray]:
    """A day: on from 6 to 20 h, with a set-point that moves every hour."""
    t = np.arange(float(SECONDS_A_DAY))
    swing = np.sin(2 * np.pi * t / SECONDS_A_DAY + 0.1 * label)
    return {
        "m_a": 1.2 + 0.1 * swing,
        "T_a_in": 25.0 + 2.0 * swing,
        "W_a_in": 0.011 + 0.0005 * swing,
        "T_w_in": 7.0 + 0.3 * np.sin(t / 860),
        "T_set": np.where(t % 7200 < 3600, 14.0, 15.0),
        "enabled": ((t >= 6 * 3600) & (t < 20 * 3600)).astype(float),
    }


def run(lanes: int, days: int, *, carry_over: bool) -> str:
    """Simulate; returns lane-seconds per second of CPU, wall time, s, and peak memory, MiB."""
    boundary = fc.Boundary.from_days(make, day=range(days), hours=SECONDS_A_DAY / 3600)
    loop = fc.Loop.preset("lbnl").assign(
        backlash=("sample", np.linspace(0.0, 0.15, lanes)), learning_step=0.005, noise_std=0.05
    )
    boundary.sha256  # noqa: B018 — a stream is looked at once, before anything runs
    fc.simulate(loop, boundary.isel(day=[0]), n_jobs=1)
    wall, cpu = time.perf_counter(), time.process_time()
    fc.simulate(loop, boundary, carry_over=carry_over, n_jobs=1)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return f"{lanes * days * SECONDS_A_DAY / cpu:.4g} {wall:.1f} {int(status['VmHWM'].split()[0]) / 1024:.0f}"


def main(lanes: int = 256, days: int = 8, rounds: int = 3) -> None:
    """Run both kinds in turns."""
    speeds: dict[str, list[float]] = {"in sequence": [], "each by itself": []}
    for k in range(2 * rounds):
        kind = [*speeds][(k + k // 2) % 2]  # A B B A A B …
        command = [sys.executable, __file__, "--one", kind, str(lanes), str(days)]
        figures = subprocess.run(command, capture_output=True, check=True, text=True).stdout.split()
        speeds[kind].append(float(figures[0]))
        sys.stdout.write(f"{kind}: {figures[0]} lane-seconds per s of CPU, {figures[1]} s, {figures[2]} MiB\n")
        sys.stdout.flush()
    sequence, separate = (statistics.median(of_kind) for of_kind in speeds.values())
    sys.stdout.write(f"{lanes} lanes x {days} days of 24 h: in sequence at {sequence / separate:.2f} of the speed\n")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        sys.stdout.write(run(int(sys.argv[3]), int(sys.argv[4]), carry_over=sys.argv[2] == "in sequence"))
    else:
        main(*map(int, sys.argv[1:]))
