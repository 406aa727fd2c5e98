"""JAX (``jax_scan.py``) in an environment of its own, which ``make bench`` makes, on one process per thread.

Each process has a part of the scenarios, because XLA's own threads make this work slower.  Sending a work and its
metrics through pipes takes less than 1 % of the time of a benchmark.
"""

from __future__ import annotations

import atexit
import functools
import os
import pickle
import subprocess
from pathlib import Path

import numpy as np

from .common import Arrays

ROOT = Path(__file__).parents[2]
ENVIRONMENT = ROOT / ".venv-jax"
PYTHON = ENVIRONMENT / "bin" / "python"
SETTINGS = {
    "JAX_PLATFORMS": "cpu",
    "NPROC": "1",  # threads
    "XLA_FLAGS": "--xla_cpu_prefer_vector_width=512",  # as the C and the kernel; 10 % at 30-s sampling
    "PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "benchmarks"))),
}


def is_installed() -> bool:
    return (ENVIRONMENT / ".installed").exists()


@functools.cache
def process(number: int) -> subprocess.Popen[bytes]:
    """Start a process, once per number."""
    command = [str(PYTHON), "-m", "peers.jax_scan"]
    started = subprocess.Popen(command, env=os.environ | SETTINGS, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    atexit.register(started.communicate)  # closes its input, which ends it
    return started


def run(scenarios: Arrays, series: Arrays, warm_up: int, threads: int = 1, converged: bool = False) -> Arrays:
    """Do the common work on ``threads`` processes."""
    parts = {name: np.array_split(values, threads) for name, values in scenarios.items()}
    for k in range(threads):
        stdin = process(k).stdin
        assert stdin is not None
        pickle.dump(({name: part[k] for name, part in parts.items()}, series, warm_up, converged), stdin)
        stdin.flush()
    metrics = [pickle.load(process(k).stdout) for k in range(threads)]  # type: ignore[arg-type]
    return {name: np.concatenate([part[name] for part in metrics]) for name in metrics[0]}


def version() -> str:
    """Return the version of JAX, or that there is none."""
    if not is_installed():
        return "no jax"
    code = "import importlib.metadata; print('jax', importlib.metadata.version('jax'))"
    return subprocess.run([str(PYTHON), "-c", code], capture_output=True, text=True, check=True).stdout.strip()
