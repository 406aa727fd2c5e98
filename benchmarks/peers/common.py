"""The work that the peers share with fastcoil, and the check that they do it.

The common work, or bare loop: many scenarios that differ in ``SCENARIO``, everything else as in the preset
``paper_like``, on one day; each peer returns ``rmse`` and ``switch_frequency`` as fastcoil defines them, the C peer
every metric.

Every peer exposes ``run(scenarios, series, warm_up)``: dicts of float64 arrays, one value per scenario and
one per second, and returns a dict of metrics.  C, JAX and fastcoil also do it with ``converged=True``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import fastcoil as fc
from fastcoil.model.metric_table import METRICS

Arrays = dict[str, np.ndarray]
Run = Callable[[Arrays, Arrays, int], Arrays]

SCENARIO = ("kp", "ti", "sample_time", "backlash", "estimate")
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
WARM_UP = 1800
SWITCH_BLOCK = 600

_VALVE = ("m_max", "valve_a", "valve_b", "valve_c")
_DEFAULT = {name: parameter.default for name, parameter in fc.parameters().items()}
N = int(_DEFAULT["n_volumes"])
C_W, C_C, CP_W, CP_A = (float(_DEFAULT[name]) for name in ("C_w", "C_c", "cp_w", "cp_a"))
BETA1, BETA2, BETA3, BETA4, BETA5, BETA6 = (float(_DEFAULT[f"beta{k}"]) for k in range(1, 7))
PRESSURE, T_INITIAL, BUFFER = (float(_DEFAULT[name]) for name in ("pressure", "T_initial", "buffer"))
M_MAX, VALVE_A, VALVE_B, VALVE_C = (float(_DEFAULT[name]) for name in _VALVE)
MASS_RATIO = 0.621945

# saturation pressure, Pa, in s = (T - 25)/25, highest power first: the package's own, 3.3e-11 relative on
# 0.01-50 degC, so that nobody is slower or faster for a better or worse steam table
P_WS = (
    6.0440527927853835e-05, 0.0018476855404687487, -0.008544918167897401, -0.18512738008059554,
    0.6903322167840471, 27.588163854011352, 240.23428223667085, 1118.6402979145653, 3070.402066967956,
    4723.276617581905, 3169.2164701436113,
)  # fmt: skip


def work(n: int, seconds: int, sample_time: float | list[float], seed: int = 1) -> tuple[Arrays, Arrays]:
    """Scenarios, whose sample times take turns, and the first ``seconds`` of a paper day.

    The tunings are slow enough for the loop to hunt regularly.  Faster ones (ti near 8 s at a sample time of
    30 s) include chaotic loops, in which two exact programs part ways after their first differing round-off.
    """
    random = np.random.default_rng(seed)
    scenarios = {
        "kp": random.uniform(0.01, 0.03, n),
        "ti": random.uniform(30.0, 90.0, n),
        "sample_time": np.resize(np.asarray(sample_time, dtype=float), n),
        "backlash": random.uniform(0.0, 0.15, n),
        "estimate": random.uniform(0.0, 0.12, n),
    }
    day = fc.paper_day(hours=seconds / 3600, seed=seed)
    return scenarios, {name: np.ascontiguousarray(day.series[name][0]) for name in SERIES}


def switch_seconds(n_steps: int, warm_up: int) -> tuple[int, int]:
    """Whole blocks of the switch frequency after the warm-up, and where the last one ends, s."""
    n_blocks = max(n_steps - warm_up, 0) // SWITCH_BLOCK
    return n_blocks, warm_up + n_blocks * SWITCH_BLOCK


def make_loop(scenarios: Arrays, converged: bool = False) -> fc.Loop:
    """Return the scenarios as one loop along ``case``."""
    names = {"estimate": "backlash_estimate"}
    return fc.Loop(converged=converged).assign(**{names.get(k, k): ("case", scenarios[k]) for k in SCENARIO})


def fastcoil_run(
    scenarios: Arrays, series: Arrays, warm_up: int = WARM_UP, threads: int = 1, converged: bool = False
) -> Arrays:
    """Do the common work with ``fastcoil.simulate``."""
    loop, day = make_loop(scenarios, converged), fc.Boundary(**series)
    ds = fc.simulate(loop, day, warm_up=warm_up, n_jobs=threads)
    return {name: ds[name].values for name in METRICS}


class Agreement(NamedTuple):
    """How many metrics a program computes, and their largest relative deviation from fastcoil's."""

    metrics: int
    deviation: float


def check(
    run: Run, n: int = 200, seconds: int = 7200, sample_time: float | list[float] = 30.0, converged: bool = False
) -> Agreement:
    """Raise ``AssertionError`` unless all that ``run`` returns is fastcoil's, to 1e-9; a count is then the same."""
    scenarios, series = work(n, seconds, sample_time)
    expected, metrics = fastcoil_run(scenarios, series, converged=converged), run(scenarios, series, WARM_UP)
    deviation = 0.0
    for name, values in metrics.items():
        np.testing.assert_allclose(values, expected[name], rtol=1e-9, atol=0.0, err_msg=name)
        scale = np.where(expected[name] == 0.0, 1.0, np.abs(expected[name]))
        deviation = max(deviation, float(np.nanmax(np.abs(values - expected[name]) / scale, initial=0.0)))
    return Agreement(len(metrics), deviation)
