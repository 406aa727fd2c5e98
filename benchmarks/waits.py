"""Where people wait: what was asked for, and what this machine reached."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

ASKED_SIMULATE, ASKED_KERNEL = 1.3, 1.15
"""``simulate`` over its kernel; kernel over C."""
_COMMANDS = (
    ("import numpy, numba, xarray, netCDF4 and no more", "test_libraries", None),
    ("fastcoil --help", "test_help", None),
    ("fastcoil plan", "test_plan", 0.6),
    ("fastcoil run, without figures", "test_run_warm", 1.2),
    ("fastcoil run, with figures", "test_run_warm_with_figures", 1.3),
    ("fastcoil run of a finished study", "test_run_again", 0.6),
    ("fastcoil run of a finished study, dask not installed", "test_run_again_without_dask", 0.6),
    ("fastcoil status", "test_status", 0.6),
    ("fastcoil diagnose, 8 h at 10 s", "test_diagnose_command", 1.0),
    ("first compilation", "test_first_compile", 9.0),
    ("fastcoil run, nothing compiled", "test_run_cold", 11.0),
)
"""What, benchmark, and the seconds asked for."""
_ASKED_MOVE = {"median": 0.15, "95 %": 0.2}
"""Seconds of a move in ``fastcoil explore`` until its answer is painted."""
_ANSWERS = {"curves": _ASKED_MOVE, "explanation": _ASKED_MOVE, "map": dict.fromkeys(_ASKED_MOVE)}
"""What follows a move, in this order, and what was asked for; nothing was for the map."""

Rounds = Mapping[tuple[str, int], np.ndarray]
"""Seconds of each round of a contender on some threads."""


def waits(results: dict[str, Any], peers: Mapping[int, Rounds]) -> Iterator[tuple[object, ...]]:
    """One row for each wait.  results: of pytest-benchmark.  peers: alternating runs by sample time."""
    timed = {b["name"]: b for b in results["benchmarks"]}
    for what, name, asked in _COMMANDS:
        if name in timed:
            s = timed[name]["stats"]
            yield (
                what,
                _limit(asked, " s"),
                f"{s['median']:.3g} s ({s['min']:.3g}–{s['max']:.3g})",
                _verdict(s["median"], asked),
            )
    moves = timed.get("test_browser", {}).get("extra_info", {})
    for stage, limits in _ANSWERS.items() if moves else ():
        for which, asked in limits.items():
            reached = moves[stage][which]
            what = f"a move in fastcoil explore until the {stage}, {which}"
            yield what, _limit(asked, " s"), f"{reached:.3g} s", _verdict(reached, asked)
    for sample_time, found in peers.items():
        for (name, threads), seconds in found.items():
            if name == "fastcoil, kernel":
                at = f"{sample_time} s, {threads} threads" if threads > 1 else f"{sample_time} s, 1 thread"
                whole = found["fastcoil, simulate", threads]
                yield _ratio(f"simulate / its kernel, {at}", whole / seconds, ASKED_SIMULATE)
                if ("C", threads) in found:
                    yield _ratio(f"kernel / C, {at}", seconds / found["C", threads], ASKED_KERNEL)


def _ratio(what: str, ratios: np.ndarray, asked: float) -> tuple[object, ...]:
    middle = float(np.median(ratios))
    return what, _limit(asked), f"{middle:.2f} ({ratios.min():.2f}–{ratios.max():.2f})", _verdict(middle, asked)


def _limit(asked: float | None, unit: str = "") -> str:
    return "" if asked is None else f"≤ {asked:g}{unit}"


def _verdict(reached: float, asked: float | None) -> str:
    return "" if asked is None else "yes" if reached <= asked else "no"
