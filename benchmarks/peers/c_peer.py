"""Hand-written C (``coil_loop.c``), compiled on the spot and called through ctypes, which releases the GIL.

The yardstick of fastcoil's kernel: the same metrics, the same accuracy of saturation, exp and log, and the constants of
the plant known at compile time.
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

from fastcoil.model import hunting
from fastcoil.model.engine import metrics
from fastcoil.model.engine.coil import MILD_T, MILD_W
from fastcoil.model.metric_table import OFF_SET_POINT_ERROR_K, PEAK_BLOCK_S

from . import common
from .common import SCENARIO, SERIES, Arrays

LANES = 64
"""Scenarios side by side; of 16 to 256 the fastest, by 2 to 40 % at 1-s sampling."""
SOURCE = Path(__file__).with_name("coil_loop.c")
COMPILER_FLAGS = (
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

SCHEDULE_FLAGS = (
    "IS_COUNTED", "IS_SETTLED", "WINDOW_STARTS", "WINDOW_ENDS", "IN_SWITCH_BLOCK", "IN_PEAK_BLOCK", "PEAK_BLOCK_ENDS",
    "IS_SWING_SAMPLE", "SWING_STARTS", "IN_SWING_BLOCK", "SWING_BLOCK_ENDS",
)  # fmt: skip
SWING_CONSTANTS = {
    "SAMPLE_S": hunting.SWING_SAMPLE_S, "MEAN_S": hunting.SWING_MEAN_S, "LAG_S": hunting.COIL_LAG_S,
    "TURN_K": hunting.LEAST_TURN_K, "FLOW_SHARE": hunting.FLOW_SHARE, "WET_SHARE": hunting.WET_SHARE,
    "LATENT_K": hunting.LATENT_K, "LEAST_DRYING": hunting.LEAST_DRYING,
}  # fmt: skip
SUMS = (
    "E2", "ABS_E", "OFF", "BELOW", "ABOVE", "E2_SETTLED", "SWING", "PERIODS", "SUM_PERIODS", "ALIKE", "SWITCHES",
    "STEM_TRAVEL", "MOTOR_TRAVEL", "REVERSALS", "FLOW", "POWER", "PEAK_POWER", "CONDENSATE",
)  # fmt: skip


class Unavailable(RuntimeError):
    """No compiler, or one that does not understand the flags."""


class _Scenarios(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in SCENARIO]


class _Day(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in (*SERIES, "flags", "eps_a", "eps_star", "T_dry")] + [
        ("n_steps", ctypes.c_long)
    ]


def _command_output(*arguments: str) -> str:
    return subprocess.run(arguments, capture_output=True, text=True, check=False).stdout


def command(*to: str, converged: bool = False) -> list[str]:
    """The command that compiles ``coil_loop.c`` for this machine and a march, with further words that say to what.

    Raises
    ------
    Unavailable
        Where there is no gcc.
    """
    gcc = shutil.which("gcc")
    if gcc is None:
        raise Unavailable("the C peer needs gcc, which is not on the PATH")
    macros = {name: repr(getattr(common, name)) for name in MACROS}
    macros |= {name: str(getattr(metrics, name)) for name in SCHEDULE_FLAGS}
    macros |= {name: repr(float(value)) for name, value in SWING_CONSTANTS.items()}
    macros |= {
        "CONVERGED": str(int(converged)),
        "LANES": str(LANES),
        "LOG_M_MAX": repr(math.log(common.M_MAX)),
        "SUMS": ",".join(SUMS),
    }
    macros |= {"MOVED": repr(metrics.MIN_STEM_MOVE), "OFF_ERROR": repr(OFF_SET_POINT_ERROR_K)}
    return [
        gcc,
        "-std=gnu11",
        *COMPILER_FLAGS,
        *(f"-D{name}={value}" for name, value in macros.items()),
        str(SOURCE),
        *to,
    ]


@functools.cache
def load_library(converged: bool = False) -> ctypes.CDLL:
    """Return the library; compiled once per source, march, flags and machine.

    Raises
    ------
    Unavailable
        Where there is no gcc, or it fails.
    """
    gcc, *flags = command(converged=converged)
    native = _command_output(gcc, "-march=native", "-Q", "--help=target")
    parts = [SOURCE.read_text(), *flags, _command_output(gcc, "--version"), native]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
    cache = os.environ.get("XDG_CACHE_HOME")
    folder = (Path(cache) if cache else Path.home() / ".cache") / "fastcoil" / "peers"
    folder.mkdir(parents=True, exist_ok=True)
    library = folder / f"coil_loop-{key}.so"
    if not library.exists():
        unfinished = library.with_suffix(f".{os.getpid()}")
        compile_command = command("-shared", "-fPIC", "-o", str(unfinished), "-lm", converged=converged)
        process = subprocess.run(compile_command, capture_output=True, text=True, check=False)
        if process.returncode:
            raise Unavailable(f"the C peer does not compile: {process.stderr.strip()}")
        unfinished.replace(library)
    loop = ctypes.CDLL(str(library))
    loop.coil_loop.argtypes = [_Scenarios, ctypes.c_long, _Day, *3 * [ctypes.c_void_p]]
    loop.coil_loop.restype = None
    return loop


def sums_of(
    scenarios: Arrays, series: Arrays, schedule: metrics.Schedule, converged: bool
) -> tuple[np.ndarray, np.ndarray]:
    """SUMS, (len(SUMS), n), and blocks of the swing, of scenarios sorted by sample time, n a multiple of LANES."""
    columns = [np.ascontiguousarray(scenarios[k], dtype=float) for k in SCENARIO]
    rows = [np.ascontiguousarray(series[k], dtype=float) for k in SERIES]
    n, n_steps = columns[0].size, rows[0].size
    if n % LANES:
        raise ValueError(f"{n} scenarios do not fill blocks of {LANES}")
    if min(series["T_a_in"].min(), series["T_w_in"].min()) < MILD_T or series["W_a_in"].max() > MILD_W:
        raise ValueError("the C peer knows neither frost nor air that condenses above 50 degC")
    sums, scratch = np.empty((len(SUMS), n)), np.empty((3, n_steps))
    swings = np.empty((schedule.n_swing_blocks, hunting.N_SWING_ROWS, n))
    day = _Day(*(r.ctypes.data for r in rows), schedule.flags.ctypes.data, None, None, None, n_steps)
    block = _Scenarios(*(c.ctypes.data for c in columns))
    load_library(converged).coil_loop(block, n, day, scratch.ctypes.data, sums.ctypes.data, swings.ctypes.data)
    return sums, swings


def run(scenarios: Arrays, series: Arrays, warm_up: int, threads: int = 1, converged: bool = False) -> Arrays:
    """Do the common work on ``threads`` threads: sorted by sample time, padded to whole blocks."""
    order = np.argsort(scenarios["sample_time"], kind="stable")
    padded = np.concatenate([order, np.full(-order.size % LANES, order[-1])])
    parts = [np.concatenate(p) for p in np.array_split(padded.reshape(-1, LANES), threads) if len(p)]
    schedule = metrics.make_schedule(series["T_set"], np.ones(series["T_set"].size), warm_up)

    def run_part(at: np.ndarray) -> np.ndarray:
        sums, swings = sums_of({k: scenarios[k][at] for k in SCENARIO}, series, schedule, converged)
        return np.concatenate([sums, hunting.judge_swing(swings)])

    load_library(converged)
    with ThreadPoolExecutor(threads) as pool:
        sorted_sums = np.concatenate(list(pool.map(run_part, parts)), axis=1)
    sums = np.empty((len(SUMS) + 2, order.size))
    sums[:, order] = sorted_sums[:, : order.size]
    return metrics_of(dict(zip((*SUMS, "HUNTS", "MEDIAN_SWING"), sums, strict=True)), scenarios, schedule)


def metrics_of(sums: Arrays, scenarios: Arrays, schedule: metrics.Schedule) -> Arrays:
    """Every metric of the common work that is not NaN or 0 by definition, each (n,)."""
    settled, windows = schedule.n_settled or np.nan, schedule.n_windows or np.nan  # a short day has none
    seconds, periods, heat = schedule.n_counted, sums["PERIODS"], common.C_W
    peak = sums["PEAK_POWER"] if schedule.n_peak_blocks else np.full(periods.size, np.nan)
    return {
        "rmse": np.sqrt(sums["E2"] / seconds),
        "rmse_settled": np.sqrt(sums["E2_SETTLED"] / settled),
        "iae": sums["ABS_E"] / 3600.0,
        "share_off": sums["OFF"] / seconds,
        "settled_range": sums["SWING"] / windows,
        "hunting_swing": sums["MEDIAN_SWING"],
        "hunting_period": sums["SUM_PERIODS"] / np.where(periods > 0.0, periods, np.nan),
        "swing_regularity": sums["ALIKE"] / np.where(periods > 1.0, periods - 1.0, np.nan),
        "hunts": sums["HUNTS"],
        "switch_frequency": sums["SWITCHES"] / schedule.n_switch_blocks,
        "stem_travel": sums["STEM_TRAVEL"],
        "motor_travel": sums["MOTOR_TRAVEL"],
        "reversals": sums["REVERSALS"],
        "estimate_final": scenarios["estimate"],
        "estimate_settled": scenarios["estimate"],
        "size_error": scenarios["estimate"] - scenarios["backlash"],
        "backlash_final": scenarios["backlash"],
        "coil_energy": heat * sums["POWER"] / 3600.0,
        "coil_peak_power": heat * peak / PEAK_BLOCK_S,
        "reheat_energy": -common.CP_A * sums["BELOW"] / 3600.0,
        "recool_energy": common.CP_A * sums["ABOVE"] / 3600.0,
        "water_volume": heat / common.CP_W * sums["FLOW"] / 1000.0,
        "condensate": common.MASS_RATIO * sums["CONDENSATE"],
        "frost_time": np.zeros(periods.size),
        "freeze_time": np.zeros(periods.size),
    }
