"""Waiting times of users: targets, and the results on this machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

_COMMANDS = (
    ("import numpy, numba, xarray, netCDF4 and no more", "test_libraries", None),
    ("fastcoil --help", "test_help", None),
    ("fastcoil plan", "test_plan", 0.5),
    ("fastcoil run, without figures", "test_run_warm", 0.8),
    ("fastcoil run, with figures", "test_run_warm_with_figures", None),
    ("fastcoil run of a finished study", "test_run_again[dask]", 0.4),
    ("fastcoil run of a finished study, dask not installed", "test_run_again[no dask]", 0.4),
    ("fastcoil status", "test_status", 0.4),
    ("fastcoil diagnose, 8 h at 10 s", "test_diagnose_command", None),
    ("first compilation", "test_first_compile", 12.0),
    ("fastcoil run, nothing compiled", "test_run_cold", 14.0),
)
"""Label, benchmark, and target, s: of a command that runs in turns with the bare imports, what it takes beyond them.

Figures need matplotlib and ``diagnose`` needs scipy: their time has no target.
"""
_MOVE_LIMITS_S = {"median": 0.15, "95 %": 0.2}
"""Seconds of a move in ``fastcoil explore`` until its answer is painted."""
_STAGE_LIMITS_S = {"curves": _MOVE_LIMITS_S, "explanation": _MOVE_LIMITS_S, "map": dict.fromkeys(_MOVE_LIMITS_S)}
"""Stages of a move and their targets; the map has none."""

Rounds = Mapping[tuple[str, int], np.ndarray]
"""Seconds of each round of a contender on some threads."""


def wait_rows(results: dict[str, Any], peers: Mapping[int, Rounds]) -> Iterator[tuple[object, ...]]:
    """Yield one row for each wait.  results: of pytest-benchmark.  peers: alternating runs by sample time."""
    timed = {b["name"]: b for b in results["benchmarks"]}
    for label, name, limit in _COMMANDS:
        if name in timed:
            s, imports = timed[name]["stats"], timed[name]["extra_info"].get("imports")
            median, reached = s["median"], f"{s['median']:.3g} s ({s['min']:.3g}–{s['max']:.3g})"
            if imports and limit is not None:
                median -= float(np.median(imports))
                yield label, f"≤ imports + {limit} s", f"{reached}, imports + {median:.2f} s", _verdict(median, limit)
            else:
                yield label, _limit_text(limit, " s"), reached, _verdict(median, limit)
    moves = timed.get("test_browser", {}).get("extra_info", {})
    for stage, limits in _STAGE_LIMITS_S.items() if moves else ():
        for statistic, limit in limits.items():
            reached = moves[stage][statistic]
            label = f"a move in fastcoil explore until the {stage}, {statistic}"
            yield label, _limit_text(limit, " s"), f"{reached:.3g} s", _verdict(reached, limit)
    for sample_time, seconds_by_contender in peers.items():
        for (name, threads), seconds in seconds_by_contender.items():
            if name == "fastcoil, kernel":
                at = f"{sample_time} s, {threads} threads" if threads > 1 else f"{sample_time} s, 1 thread"
                whole = seconds_by_contender["fastcoil, simulate", threads]
                yield _ratio_row(f"simulate / its kernel, {at}", whole / seconds, 1.3)
                if ("C", threads) in seconds_by_contender:
                    yield _ratio_row(f"kernel / C, {at}", seconds / seconds_by_contender["C", threads], 1.15)


def _ratio_row(label: str, ratios: np.ndarray, limit: float) -> tuple[object, ...]:
    median = float(np.median(ratios))
    return label, _limit_text(limit), f"{median:.2f} ({ratios.min():.2f}–{ratios.max():.2f})", _verdict(median, limit)


def _limit_text(limit: float | None, unit: str = "") -> str:
    return "" if limit is None else f"≤ {limit:g}{unit}"


def _verdict(reached: float, limit: float | None) -> str:
    return "" if limit is None else "yes" if reached <= limit else "no"
