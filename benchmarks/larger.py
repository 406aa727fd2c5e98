"""Results larger than the memory: what each command takes on a study with traces.

``python benchmarks/larger.py [GIB [FOLDER]]``: of 10 GiB of traces by default, in a folder that is deleted afterwards;
this takes twice that room.  ``python benchmarks/larger.py scenarios [N [FOLDER]]``: N scenarios of 360 s without
traces, ten million by default.  A row for each command, a process with one thread: its highest private memory, which
no other process shares and no file holds, and its time.  Linux only.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fastcoil.base.machine import private_memory

FASTCOIL_COMMAND = [sys.executable, "-m", "fastcoil"]
SECONDS, TRACES = 3600, ("T_sup", "u")
STUDY = f"""
title = "{{title}}"
[loop]
preset = "lbnl"
noise_std = 0.05
[sample]
method = "random"
size = {{size}}
backlash = {{{{ uniform = [0.02, 0.15] }}}}
[boundary]
hours = {SECONDS / 3600:g}
[run]
traces = {list(TRACES)}
trace_interval = 1
"""
READ_PROGRAM = """
import sys, fastcoil as fc
ds = fc.open_study(sys.argv[1])
print(float(ds.T_sup.isel(sample=ds.sizes["sample"] // 2).max()), float(ds.u.isel(elapsed_time=-1).mean()))
"""
DASK_PROGRAM = """
import sys, fastcoil as fc
ds = fc.open_study(sys.argv[1])
trace = ds.T_sup.chunk(ds.T_sup.encoding["preferred_chunks"])
print(float(trace.max("elapsed_time").mean()))
"""


def measure(label: str, command: list[str]) -> None:
    """Run a command and print what it took."""
    start, peak = time.perf_counter(), 0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        peak = max(peak, private_memory(str(process.pid)))
        time.sleep(0.01)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    sys.stdout.write(f"| {label} | {peak / 2**20:,.0f} | {time.perf_counter() - start:,.0f} |\n")
    sys.stdout.flush()


def main(gib: float = 10.0, folder: str | None = None) -> None:
    """Print the forecast of ``fastcoil plan``, then the table."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        file, out = Path(name, "study.toml"), str(Path(name, "out"))
        size = round(gib * 2**30 / (8 * SECONDS * len(TRACES)))
        text = STUDY.format(title="large", size=size)
        file.write_text(text, encoding="utf-8")
        subprocess.run([*FASTCOIL_COMMAND, "plan", str(file), "-j", "1"], check=True)
        run = [*FASTCOIL_COMMAND, "run", str(file), "-o", out, "-j", "1"]
        sys.stdout.write("\n| | private memory, MiB | s |\n|---|---:|---:|\n")
        measure("`run`", run)
        bytes_left = sum(path.stat().st_size for path in Path(out).glob("*.nc"))
        for command in ("verify", "report"):
            measure(f"`{command}`", [*FASTCOIL_COMMAND, command, out])
        measure("`export --csv`", [*FASTCOIL_COMMAND, "export", out, "--csv", "-o", str(Path(name, "table.csv"))])
        measure("`open_study`, one loop and one moment", [sys.executable, "-c", READ_PROGRAM, out])
        measure("the highest value of each loop, with dask", [sys.executable, "-c", DASK_PROGRAM, out])
        file.write_text(text.replace('"large"', '"other words"'), encoding="utf-8")
        measure("`run` with another title", run)
        file.write_text(text.replace(f"size = {size}", f"size = {size + size // 100}"), encoding="utf-8")
        measure("`run --extend` by a hundredth", [*run, "--extend"])
        sys.stdout.write(f"\n{size:,} loops, {gib:g} GiB of traces, {bytes_left / 2**30:.1f} GiB on the disk\n")


def without_traces(size: float = 1e7, folder: str | None = None) -> None:
    """Print the forecast of ``fastcoil plan``, then what a run and its report take."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        file, out = Path(name, "study.toml"), str(Path(name, "out"))
        text = STUDY.format(title="many", size=round(size)).replace(f"hours = {SECONDS / 3600:g}", "hours = 0.1")
        file.write_text(f"{text.split('[run]')[0]}[run]\nwarm_up = 0\n", encoding="utf-8")
        subprocess.run([*FASTCOIL_COMMAND, "plan", str(file), "-j", "1"], check=True)
        sys.stdout.write("\n| | private memory, MiB | s |\n|---|---:|---:|\n")
        measure("`run`", [*FASTCOIL_COMMAND, "run", str(file), "-o", out, "-j", "1"])
        measure("`report`", [*FASTCOIL_COMMAND, "report", out])


if __name__ == "__main__":
    which, words = (without_traces, sys.argv[2:]) if sys.argv[1:2] == ["scenarios"] else (main, sys.argv[1:])
    which(*(float(word) if k == 0 else word for k, word in enumerate(words)))
