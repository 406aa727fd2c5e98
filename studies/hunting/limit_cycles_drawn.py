"""Loops, plants and operating points for ``limit_cycles.py``, drawn at random, and the textbook's forecast."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

import fastcoil as fc
from fastcoil.design.theory.cycles import HUNTS_ABOVE, Cycles
from fastcoil.design.theory.describing_function import describing_function
from fastcoil.design.theory.harmonic_balance import balance, frequency
from fastcoil.design.theory.plants import Plants, frequency_response, loop_response
from fastcoil.model.moist_air import humidity_ratio

HOURS, STEP_AT, STEP = 16, 2 * 3600, 1.5
"""Length of a constant day, h; when its set-point steps, s, and by how much, K."""
HEATING_GAIN = 0.3
"""The drawn kp is for cooling; a loop with warm water responds about three times as much."""


class Population(NamedTuple):
    """What sets loops apart.  words: for the table.  ratio: estimate over backlash, from and to.  loop: parameters."""

    words: str
    ratio: tuple[float, float] = (0.0, 0.0)
    buffer: tuple[float, float] = (1e-9, 1e-9)
    loop: Mapping[str, object] = {}


POPULATIONS = {
    "cooling": Population("plain PI, cooling"),
    "heating": Population("plain PI, heating", loop={"action": "heating"}),
    "too small": Population("inverse, estimate 30 to 98 %", (0.3, 0.98)),
    "too large": Population("inverse, estimate 105 to 150 %", (1.05, 1.5)),
    "buffer": Population("inverse, estimate 30 to 100 %, buffer 0.2 to 1 %", (0.3, 1.0), (0.002, 0.01)),
    "additive": Population("additive compensation, 30 to 98 %", (0.3, 0.98), loop={"compensation": "additive"}),
    "smooth": Population("smooth compensation, 30 to 98 %", (0.3, 0.98), loop={"compensation": "smooth"}),
    "noise": Population("noise 0.05 K, which theory leaves out", loop={"noise_std": 0.05}),
}


def drawn(name: str, seed: int, n_loops: int, n_points: int) -> tuple[fc.Loop, dict[str, np.ndarray]]:
    """A population: loops along ``sample``, and operating points, (n_points,) each.

    An eighth of the valves has no gap.
    """
    of = POPULATIONS[name]
    heats = of.loop.get("action") == "heating"
    draw = np.random.default_rng([seed, list(POPULATIONS).index(name)])

    def loguniform(low: float, high: float) -> np.ndarray:
        return np.exp(draw.uniform(np.log(low), np.log(high), n_loops))

    backlash = np.where(draw.random(n_loops) < 0.5, loguniform(0.005, 0.15), draw.uniform(0.01, 0.15, n_loops))
    backlash[::8] = 0.0
    values = {
        "backlash": backlash,
        "rangeability": loguniform(20.0, 100.0),
        "authority": loguniform(0.02, 0.9),
        "m_full": draw.uniform(1.2, 2.0, n_loops),
        "C_w": draw.uniform(8.8, 14.0, n_loops),
        "C_c": loguniform(10.0, 30.0),
        "kp": loguniform(0.005, 0.06) * (HEATING_GAIN if heats else 1.0),
        "ti": loguniform(5.0, 600.0),
        "sample_time": draw.choice([1.0, 5.0, 10.0, 15.0, 30.0, 60.0], n_loops),
        "sensor_time_constant": np.where(draw.random(n_loops) < 0.25, 0.0, draw.uniform(0.0, 60.0, n_loops)),
        "stroke_time": np.where(draw.random(n_loops) < 0.3, 0.0, draw.uniform(15.0, 150.0, n_loops)),
        "backlash_estimate": draw.uniform(*of.ratio, n_loops) * backlash,
        "buffer": draw.uniform(*of.buffer, n_loops),
    }
    loop = fc.Loop().assign(**{name: ("sample", value) for name, value in values.items()}, **of.loop)
    return loop, _points(draw, n_points, heats)


def _points(draw: np.random.Generator, n: int, heats: bool) -> dict[str, np.ndarray]:
    m_a = draw.uniform(0.6, 1.5, n)
    if heats:
        T_a_in, T_w_in = draw.uniform(-5.0, 20.0, n), draw.uniform(35.0, 65.0, n)
        T_set = draw.uniform(np.maximum(T_a_in + 4.0, 18.0), np.maximum(T_a_in + 8.0, 30.0))
        return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": np.full(n, 0.003), "T_w_in": T_w_in, "T_set": T_set}
    T_a_in, T_w_in = draw.uniform(20.0, 33.0, n), draw.uniform(5.0, 10.0, n)
    W_a_in = humidity_ratio(T_a_in, draw.uniform(0.2, 0.8, n))
    T_set = draw.uniform(T_w_in + 5.5, np.minimum(T_a_in - 2.0, 19.0))
    return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": W_a_in, "T_w_in": T_w_in, "T_set": T_set}


def constant_days(points: Mapping[str, np.ndarray], population: str) -> fc.Boundary:
    """A day for each point on which nothing happens but one step of the set-point."""
    heats = POPULATIONS[population].loop.get("action") == "heating"
    series = {name: np.repeat(values[:, None], HOURS * 3600, axis=1) for name, values in points.items()}
    series["T_set"][:, :STEP_AT] += -STEP if heats else STEP
    return fc.Boundary(**series, day=list(range(points["T_set"].size)))


def textbook(columns: Mapping[str, np.ndarray], plants: Plants) -> Cycles:
    """The gap alone: the same threshold, and amplitude and period where |L| |N| is 1, or nearest to it."""
    n, w = plants.opening.size, np.geomspace(3e-4, np.pi, 300)
    found = Cycles(*(np.full(n, np.nan) for _ in Cycles._fields))
    found.margin[:], found.hunts[:] = 0.0, 0.0
    for ts in np.unique(columns["sample_time"]):
        some = np.flatnonzero((columns["sample_time"] == ts) & plants.reachable)
        if not some.size:
            continue
        of, of_plants, x_bl = {k: v[some] for k, v in columns.items()}, plants.some(some), columns["backlash"][some]
        w = np.geomspace(3e-4, np.pi / ts, 200)
        gap = np.maximum(x_bl, 1e-6)[:, None]
        A = 0.5005 * gap * np.geomspace(1.0, 1e4, 120)
        N = describing_function(A, gap, gap)
        at = balance(w, loop_response(of, of_plants, w), lambda _, N=N: N, A.shape[1], np.zeros(some.size))
        product, place = at.product.max(axis=0), at.place[0]
        margin = np.where(x_bl > 0.0, product.max(axis=1), product[:, -1])
        last = product.shape[1] - 1 - (product[:, ::-1] >= 1.0).argmax(axis=1)
        rows = np.arange(some.size)
        k = np.where(margin >= 1.0, last, product.argmax(axis=1))
        cycle = frequency(w, place[rows, k])
        G = np.abs(frequency_response(of_plants.response, w))
        T = (
            A[rows, k]
            * np.abs(N[rows, k])
            / (1.0 - x_bl)
            * G[rows, np.clip(place[rows, k].round().astype(int), 0, 199)]
        )
        hunts = (margin > np.where(x_bl > 0.0, HUNTS_ABOVE, 1.0)) & (2.0 * T > 0.1)
        found.margin[some], found.hunts[some] = margin, hunts
        found.period[some], found.amplitude[some] = (
            np.where(hunts, values, np.nan) for values in (2.0 * np.pi / cycle, T)
        )
    return found
