"""What a study costs: wall time, memory and disk from a thousand to ten million scenarios, from an hour to a year.

``python benchmarks/curves.py [quick]``: each study is run by the command, in processes of their own, into a temporary
folder.  Writes curves.json, of which ``make bench`` makes a table, and the figure curves.png.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).parent
FASTCOIL_COMMAND = (sys.executable, "-m", "fastcoil")
SCHEDULER_PORT = 8797


class Case(NamedTuple):
    """One study and who runs it: threads of each process, and processes of a kind (one, dask or shares)."""

    scenarios: int
    days: int
    hours: int
    threads: int = 2
    kind: str = "one"
    processes: int = 1

    @property
    def lane_steps(self) -> int:
        return self.scenarios * self.days * self.hours * 3600

    @property
    def runs_by(self) -> str:
        threads = f"{self.threads} thread{'s' * (self.threads > 1)}"
        if self.kind == "one":
            return threads
        unit = "dask worker" if self.kind == "dask" else "share"
        return f"{self.processes} {unit}{'s' * (self.processes > 1)} of {threads}"


def cases(quick: bool) -> Iterator[Case]:
    sizes = (100, 200) if quick else (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
    for n in sizes:
        yield Case(n, 1, 1)
        if n <= 1_000_000:
            yield Case(n, 1, 1, threads=1)
    for days in (1, 2) if quick else (1, 30, 365):
        yield Case(100 if quick else 256, days, 1 if quick else 24)
    for kind in ("dask", "shares"):
        for processes in (1, 2) if quick else (1, 2, 4):
            yield Case(sizes[0] if quick else 100_000, 1, 1, 1, kind, processes)


def study(case: Case) -> str:
    days = f"seed = [{', '.join(map(str, range(1, case.days + 1)))}]\n" if case.days > 1 else ""
    carry_over_line = "carry_over = true\n" if case.days > 1 else ""
    return (
        '[loop]\npreset = "lbnl"\nlearning_step = 0.005\nnoise_std = 0.05\n'
        f'[sample]\nmethod = "random"\nsize = {case.scenarios}\nbacklash = {{ uniform = [0.02, 0.15] }}\n'
        f"[boundary]\nhours = {case.hours}\n{days}[run]\nwarm_up = 1800\n{carry_over_line}"
    )


def measure(case: Case) -> dict[str, Any]:
    """Wall time, s, peak memory of the largest process, MiB, and size of the folder, MiB."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as ending:
        file, out = Path(name, "study.toml"), Path(name, "out")
        file.write_text(study(case), encoding="utf-8")
        run = [*FASTCOIL_COMMAND, "run", str(file), "-o", str(out), "--no-figures", "-j", str(case.threads)]
        if case.kind == "dask":
            run[-2:] = ["--backend", "dask", "--scheduler", cluster(case, ending)]
        start = time.perf_counter()
        if case.kind == "shares":
            shares = [[*run, "--shard", f"{k}/{case.processes}"] for k in range(1, case.processes + 1)]
            peak = max(wait_for([spawn(command) for command in shares]))
            run = [*run[:-1], "1"]
            peak = max(peak, *wait_for([spawn(run)]))
        else:
            peak = max(wait_for([spawn(run)]))
        wall = time.perf_counter() - start
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    return {**case._asdict(), "runs_by": case.runs_by, "wall": wall, "peak_mib": peak / 1024, "disk_mib": size / 2**20,
            "ns": 1e9 * wall / case.lane_steps}  # fmt: skip


def spawn(command: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def wait_for(running: list[subprocess.Popen[bytes]]) -> list[int]:
    """Peak memory of each process, KiB."""
    peaks = []
    for process in running:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, process.args)
        peaks.append(usage.ru_maxrss)
    return peaks


def cluster(case: Case, ending: ExitStack) -> str:
    """Start a scheduler and its workers; returns the address."""
    dask, address = shutil.which("dask", path=str(Path(sys.executable).parent)), f"tcp://127.0.0.1:{SCHEDULER_PORT}"
    if dask is None:
        raise FileNotFoundError("dask is not installed")
    commands = [[dask, "scheduler", "--host", "127.0.0.1", "--port", str(SCHEDULER_PORT), "--no-dashboard"]]
    commands += [[dask, "worker", address, "--nworkers", str(case.processes), "--nthreads", "1", "--no-dashboard"]]
    for command in commands:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        ending.callback(process.wait)
        ending.callback(process.terminate)
        time.sleep(5.0)
    return address


def draw(measurements: list[dict[str, Any]], path: Path) -> None:
    """Cost of a lane-step, memory and disk over the number of scenarios, and cost over the length."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(10.0, 3.2), layout="constrained")
    single_process_rows = [row for row in measurements if row["kind"] == "one"]
    for threads in (1, 2):
        rows = [
            row for row in single_process_rows if row["threads"] == threads and row["days"] == 1 and row["hours"] == 1
        ]
        label = f"{threads} thread{'s' * (threads > 1)}"
        axes[0].loglog([r["scenarios"] for r in rows], [r["ns"] for r in rows], "o-", label=label)
        if threads == 2:
            axes[1].loglog([r["scenarios"] for r in rows], [r["peak_mib"] for r in rows], "o-", label="peak memory")
            axes[1].loglog([r["scenarios"] for r in rows], [r["disk_mib"] for r in rows], "s-", label="folder")
    axes[0].set(xlabel="scenarios × 1 h", ylabel="wall time per lane-step, ns")
    axes[1].set(xlabel="scenarios × 1 h", ylabel="MiB")
    for kind, marker in (("dask", "s-"), ("shares", "o-")):
        rows = [row for row in measurements if row["kind"] == kind]
        axes[2].plot([r["processes"] for r in rows], [r["wall"] for r in rows], marker, label=kind)
    axes[2].set(xlabel="processes of one thread", ylabel="wall time, s", ylim=(0, None))
    for ax in axes:
        ax.legend(frameon=False)
        ax.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def rows(measurements: list[dict[str, Any]]) -> Iterator[tuple[object, ...]]:
    """Rows of the table."""
    for r in measurements:
        length = f"{r['hours']} h" if r["days"] == 1 else f"{r['days']} × {r['hours']} h"
        yield (f"{r['scenarios']:,}", length, r["runs_by"], f"{r['wall']:.1f}", f"{r['ns']:.1f}",
               f"{r['peak_mib']:,.0f}", f"{r['disk_mib']:,.0f}")  # fmt: skip


def main(quick: bool) -> None:
    subprocess.run([*FASTCOIL_COMMAND, "demo"], check=True, stdout=subprocess.DEVNULL)  # compiles the kernel, once
    measurements: list[dict[str, Any]] = []
    for case in cases(quick):
        measurements.append(measure(case))
        sys.stdout.write(" | ".join(map(str, next(rows(measurements[-1:])))) + "\n")
        sys.stdout.flush()
    if not quick:
        (FOLDER / "curves.json").write_text(json.dumps(measurements, indent=1) + "\n", encoding="utf-8")
        draw(measurements, FOLDER / "curves.png")


if __name__ == "__main__":
    main(sys.argv[1:] == ["quick"])
