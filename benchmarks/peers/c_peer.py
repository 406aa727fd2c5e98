"""Hand-written C (``coil_loop.c``), compiled on the spot and called through ctypes, which releases the GIL.

The yardstick of fastcoil's kernel: same accuracy of saturation, exp and log, only the two metrics, and the
constants of the plant known at compile time.  Agrees with fastcoil to 1e-9 in RMSE and in every switch.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from . import common
from .common import SCENARIO, SERIES, Arrays, switch_seconds

LANES = 64
"""Scenarios side by side; of 16 to 256 the fastest, by 2 to 40 % at 1-s sampling."""
SOURCE = Path(__file__).with_name("coil_loop.c")
FLAGS = (
    "-O3", "-march=native", "-mprefer-vector-width=512",
    "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
    # comparisons become vminpd and vmaxpd: 7 % (no NaN arises here, and none is looked for)
    "-ffinite-math-only", "-fno-signed-zeros",
    "-funroll-loops",  # 2 % at 1-s sampling
)  # fmt: skip
MACROS = (
    "N", "C_W", "C_C", "CP_W", "CP_A", "BETA1", "BETA2", "BETA3", "BETA4", "BETA5", "BETA6",
    "PRESSURE", "T_INITIAL", "BUFFER", "VALVE_A", "VALVE_B", "VALVE_C",
)  # fmt: skip


class Unavailable(RuntimeError):
    """No compiler, or one that does not understand the flags."""


class _Scenarios(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in SCENARIO]


class _Day(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in (*SERIES, "eps_a", "eps_star")] + [
        (name, ctypes.c_long) for name in ("n_steps", "warm_up", "switches_end")
    ]


def _output(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


@functools.cache
def compiled(lanes: int = LANES, extra: tuple[str, ...] = ()) -> ctypes.CDLL:
    """Return the library for a block size; compiled once per source, flags and machine.

    Raises
    ------
    Unavailable
        Where there is no gcc, or it fails.
    """
    gcc = shutil.which("gcc")
    if gcc is None:
        raise Unavailable("the C peer needs gcc, which is not on the PATH")
    macros = {name: repr(getattr(common, name)) for name in MACROS}
    macros |= {"LANES": str(lanes), "LOG_M_MAX": repr(math.log(common.M_MAX))}
    flags = [*FLAGS, *extra, *(f"-D{name}={value}" for name, value in macros.items())]
    native = _output(gcc, "-march=native", "-Q", "--help=target")
    parts = [SOURCE.read_text(), *flags, _output(gcc, "--version"), native]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
    cache = os.environ.get("XDG_CACHE_HOME")
    folder = (Path(cache) if cache else Path.home() / ".cache") / "fastcoil" / "peers"
    folder.mkdir(parents=True, exist_ok=True)
    library = folder / f"coil_loop-{key}.so"
    if not library.exists():
        unfinished = library.with_suffix(f".{os.getpid()}")
        command = [gcc, "-std=gnu11", "-shared", "-fPIC", *flags, str(SOURCE), "-o", str(unfinished), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Unavailable(f"the C peer does not compile: {done.stderr.strip()}")
        unfinished.replace(library)
    loop = ctypes.CDLL(str(library))
    loop.coil_loop.argtypes = [_Scenarios, ctypes.c_long, _Day, *3 * (ctypes.c_void_p,)]
    loop.coil_loop.restype = None
    return loop


def sums_of(
    scenarios: Arrays, series: Arrays, warm_up: int, lanes: int = LANES, extra: tuple[str, ...] = ()
) -> np.ndarray:
    """(2, n): squared errors and switches of scenarios sorted by sample time, n a multiple of ``lanes``."""
    columns = [np.ascontiguousarray(scenarios[k], dtype=float) for k in SCENARIO]
    rows = [np.ascontiguousarray(series[k], dtype=float) for k in SERIES]
    n, n_steps = columns[0].size, rows[0].size
    if n % lanes:
        raise ValueError(f"{n} scenarios do not fill blocks of {lanes}")
    sums, eps = np.empty((2, n)), np.empty((2, n_steps))
    last = switch_seconds(n_steps, warm_up)[1]
    day = _Day(*(r.ctypes.data for r in rows), None, None, n_steps, warm_up, last)
    block = _Scenarios(*(c.ctypes.data for c in columns))
    compiled(lanes, extra).coil_loop(block, n, day, eps.ctypes.data, sums[0].ctypes.data, sums[1].ctypes.data)
    return sums


def run(scenarios: Arrays, series: Arrays, warm_up: int, threads: int = 1) -> Arrays:
    """Do the common work on ``threads`` threads: sorted by sample time, padded to whole blocks."""
    order = np.argsort(scenarios["sample_time"], kind="stable")
    padded = np.concatenate([order, np.full(-order.size % LANES, order[-1])])
    parts = [np.concatenate(p) for p in np.array_split(padded.reshape(-1, LANES), threads) if len(p)]

    def part(at: np.ndarray) -> np.ndarray:
        return sums_of({k: scenarios[k][at] for k in SCENARIO}, series, warm_up)

    compiled()
    with ThreadPoolExecutor(threads) as pool:
        sorted_sums = np.concatenate(list(pool.map(part, parts)), axis=1)
    sums = np.empty((2, order.size))
    sums[:, order] = sorted_sums[:, : order.size]
    n_steps = series["m_a"].size
    blocks = switch_seconds(n_steps, warm_up)[0]
    return {"rmse": np.sqrt(sums[0] / (n_steps - warm_up)), "switch_frequency": sums[1] / blocks}
