"""Each plant at rest at its set-point, its response to a small step, and the open loop: numbers without labels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.model.engine import at_rest
from fastcoil.model.engine.lanes import Block, pad_members, parameter_matrix, run_sets, work_space
from fastcoil.model.engine.rows import LANES, PARAMETER_ROWS
from fastcoil.model.parameter_table import PARAMETERS

Complex = NDArray[np.complex128]


def frequency_response(response: Array, w: Array, ratio: Array | None = None) -> Complex:
    """Σ (r_k - r_(k-1)) e^(-jωk) over k ≥ 1: of step responses from sample 1 on, (n, n_steps), at w, (n_w,): (n, n_w).

    For a response of each second, from the opening to true T_sup, K per unit opening, at angular frequencies w, rad/s:
    the transfer function of the 1-s steps at z = e^(jω).  In general w is in radians per sample.
    ratio: of successive changes behind the end, (n,); without it as the last of them are.
    """
    changes = np.diff(response, axis=1, prepend=0.0)
    n = changes.shape[1]
    rotations = np.exp(-1j * np.outer(np.arange(1, n + 1), w))
    ratio = (_last_ratio(changes) if ratio is None else ratio)[:, None]
    delay = np.exp(-1j * w)[None, :]
    tail = changes[:, -1:] * ratio * rotations[-1] * delay / (1.0 - ratio * delay)
    transfer: Complex = changes @ rotations.real + 1j * (changes @ rotations.imag) + tail
    return transfer


def _last_ratio(changes: Array) -> Array:
    """Ratio of successive changes at the end of a response, (n,), between 0 and ``SLOWEST``."""
    span = min(at_rest.TAIL_STEPS, changes.shape[1] - 1)
    last, earlier = changes[:, -1], changes[:, -1 - span]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where((last * earlier > 0.0), np.abs(last / earlier) ** (1.0 / span), 0.0)
    return np.minimum(ratio, at_rest.MAX_TAIL_RATIO)


def _extend_response(response: Array, extra_seconds: int) -> tuple[Array, Array]:
    """The responses and ``extra_seconds`` seconds behind their end, as a geometric series, and its ratio, (n, 1)."""
    changes = np.diff(response, axis=1, prepend=0.0)
    ratio = _last_ratio(changes)[:, None]
    tail = response[:, -1:] + changes[:, -1:] * ratio * (1.0 - ratio ** np.arange(1, extra_seconds + 1)) / (1.0 - ratio)
    return np.concatenate([response, tail], axis=1), ratio


def _sensor_decay(tau: Array) -> Array:
    """What is left of what a sensor with lag tau, (n,), s, showed a second ago."""
    with np.errstate(divide="ignore"):
        return np.where(tau > 0.0, np.exp(-1.0 / tau), 0.0)


def sampled_response(response: Array, tau: Array, period: int, w: Array) -> Complex:
    """``frequency_response`` of every ``period``-th second of what a sensor with lag tau, (n,), s, shows; w in rad/s.

    Exact: from sample to sample what the sensor showed decays by d^period, d = e^(-1/tau), and the seconds between
    count by their age.
    """
    # two samples lie behind the end
    extended, ratio = _extend_response(response, 3 * period - response.shape[1] % period)
    decay = _sensor_decay(tau)[:, None]
    weight = (1.0 - decay) * decay ** np.arange(period - 1, -1, -1)
    sensor_samples = np.einsum("nkp,np->nk", extended.reshape(tau.size, -1, period), weight)
    transfer: Complex = frequency_response(sensor_samples, w * period, ratio[:, 0] ** period)
    transfer /= 1.0 - decay**period * np.exp(-1j * w * period)
    return transfer


def sensor_response(response: Array, tau: Array, extra_seconds: int) -> Array:
    """The responses as a sensor with lag tau, (n,), s, shows them; ``extra_seconds``, s, and by what the lag takes."""
    extended, _ = _extend_response(response, extra_seconds + 10 * math.ceil(tau.max()))
    if not tau.any():
        return extended
    decay, y = _sensor_decay(tau), np.zeros(tau.size)
    sensed = np.empty_like(extended)
    for t in range(extended.shape[1]):
        y = extended[:, t] + decay * (y - extended[:, t])
        sensed[:, t] = y
    return sensed


Columns = Mapping[str, NDArray[Any]]

PLANT_PARAMETERS = tuple(p.name for p in PARAMETERS.values() if p.group in ("coil", "valve") and p.name != "T_initial")
"""Parameters on which the plant depends, from the opening to the supply temperature."""
LONGEST_RESPONSE = 3600  # seconds of the longest response; one that goes on does so as a geometric series
OPENINGS = np.linspace(0.0, 1.0, 17)  # openings of the curve of T_sup
_SERIES_TOLERANCE = 1e-4
"""From where it stays this near to its end, as a fraction of the gain, a response is a geometric series."""


class Plants(NamedTuple):
    """Plants at rest, linearised; n loops, (n,) each.

    Gain and response are NaN where T_sup jumps past the set-point: a coil that exchanges less when it is wet than when
    it is dry has two states of rest.
    """

    opening: Array  # fraction; the end, 0 or 1, that comes nearest to the set-point where no opening holds it
    T_sup: Array  # °C, at rest there
    gain: Array  # K per unit opening, below 0 for cooling
    reachable: Mask  # whether an opening holds the set-point
    m_w: Array  # kg/s
    wet_volumes: Array  # one that is wet and dry by turns counts with the share of time in which it is wet
    response: Array  # (n, n_steps), K per unit opening: true T_sup 1 to n_steps s after a small step, until it settles
    same: Index  # loops with equal numbers have one and the same plant, 0 to the number of plants - 1
    curve: Array  # (n, 17), °C: T_sup at rest at each of OPENINGS

    def select(self, members: Index) -> Plants:
        """Those of the loops ``members``."""
        return Plants._make(field[members] for field in self)


def unique_columns(*parts: Array | Index) -> tuple[Index, Index]:
    """Index of the first of each kind of column, and which kind each column is; parts: (n_rows, n) or (n,)."""
    rows = np.concatenate([np.atleast_2d(part) for part in parts])
    rows = np.where(np.isnan(rows), -1e9, rows) + 0.0
    varying = rows[np.ptp(rows, axis=1) > 0.0]
    if not varying.size:
        return np.zeros(1, np.int64), np.zeros(rows.shape[1], np.int64)
    _, first, kind = np.unique(varying, axis=1, return_index=True, return_inverse=True)
    return first, kind.ravel()


def linearise_plants(columns: Columns, conditions: Mapping[str, Array]) -> Plants:
    """Find where the plants rest, and how they answer there.  Equal plants are computed once.

    columns: parameter name → (n,), see ``parameter_columns``.  conditions: (n,) each, m_a, kg/s; T_a_in, T_w_in and T_set, °C;
    W_a_in, kg/kg; they are held until all is steady.
    """
    matrix, entering, T_set, same = distinct_plants(columns, conditions)
    settle = _solve_plants if T_set.size <= LANES else _solve_plants.__wrapped__
    steady, response, ends, curve = settle(*(part.tobytes() for part in (matrix, entering, T_set)))
    steady_of_loops = {name: steady[k][same] for k, name in enumerate(at_rest.STEADY_ROWS)}
    # the series shows its ratio, however many other responses are longer
    response = np.ascontiguousarray(response[: int(ends.max()) + at_rest.TAIL_STEPS + 1].T)
    return Plants(
        steady_of_loops["opening"], steady_of_loops["T_sup"], steady_of_loops["gain"], steady_of_loops["nearest"] == 0.0, steady_of_loops["m_w"], steady_of_loops["wet_volumes"],
        np.broadcast_to(response, (same.size, response.shape[1])) if T_set.size == 1 else response[same], same,
        np.ascontiguousarray(curve.T)[same],
    )  # fmt: skip


@lru_cache(4)  # of 2 MB each; the gains, the gap and the motor leave the plants as they are
def _solve_plants(*parts: bytes) -> tuple[np.ndarray, ...]:
    """STEADY, responses, their ends and curves of plants; parts: of ``distinct_plants``."""
    T_set = np.frombuffer(parts[2])
    matrix, entering = (np.frombuffer(part).reshape(-1, T_set.size) for part in parts[:2])

    def run(block: Block, members: Index) -> list[np.ndarray]:
        of_lanes, rest, S, V = _bring_to_rest(block, members, entering, T_set)
        response, ends, curve = (
            np.empty((LONGEST_RESPONSE, LANES)),
            np.empty(LANES, np.int64),
            np.empty((OPENINGS.size, LANES)),
        )
        at_rest.simulate_step_response(
            block.rows, block.config, of_lanes, rest, V.copy(), S, V, _SERIES_TOLERANCE, response, ends
        )
        at_rest.rest_curve(block.rows, block.config, of_lanes, OPENINGS, S, V, curve)
        return [rest, response, ends, curve]

    return run_sets(matrix, run)


def distinct_plants(columns: Columns, conditions: Mapping[str, Array]) -> tuple[Array, Array, Array, Index]:
    """Parameters, (rows, n), what enters, (4, n), T_set, (n,), of the different plants, and the plant of each loop."""
    n = len(columns["C_w"])
    # all at its default that no plant depends on
    values_by_name = {name: np.full(n, math.nan if p.default is None else p.default) for name, p in PARAMETERS.items()}
    values_by_name |= {name: np.zeros(n) for name in PARAMETER_ROWS if name not in values_by_name}
    values_by_name["estimator"] = np.full(n, "none")
    matrix = parameter_matrix(values_by_name | {name: columns[name] for name in PLANT_PARAMETERS})
    entering = np.stack([np.asarray(conditions[name], float) for name in at_rest.CONDITIONS])
    T_set = np.asarray(conditions["T_set"], float)
    first, same = unique_columns(matrix, entering, T_set)
    return matrix[:, first], entering[:, first], T_set[first], same


def loop_response(columns: Columns, plants: Plants, w: Array) -> Complex:
    """The open loop L(jω) at angular frequencies w, (n_w,), rad/s: (n, n_w).  NaN above π/sample_time.

    PI, hold, gap, plant and sensor, with the sign turned so that the loop closes as 1 + L N = 0, where N is the
    describing function of the gap, 1 without one.  A stem that follows its motor opens the valve by α = 1/(1 - X) per
    stroke: that is in L.  The motor's rate limit, the inverse and resolutions are not.

    It is the exact transfer function of the loop as it is sampled, C(z) P(z) at z = e^(jω ts): a sampled temperature
    has been marched since the sample before, the integral takes in the new error before it is used, and P(z) is the
    step-invariant transform of the response, aliases included.
    """
    w = np.asarray(w, float)
    ts = np.asarray(columns["sample_time"], float)
    P, kind = sampled_plant_response(columns, plants, w)
    delayed = np.exp(-1j * np.outer(ts, w))
    kp, ti = np.asarray(columns["kp"], float)[:, None], np.asarray(columns["ti"], float)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        C = kp * (1.0 + ts[:, None] / ti / (1.0 - delayed))
    L = _opening_per_stroke(columns)[:, None] * C * P[kind]
    return np.where(np.outer(ts, w) <= math.pi * (1.0 + 1e-12), L, np.nan)


def stroke_gain(columns: Columns, plants: Plants) -> Array:
    """Gain of each plant per stroke of a motor that the stem follows, K, above 0 where the loop acts the right way."""
    return np.asarray(_opening_per_stroke(columns) * plants.gain)


def _opening_per_stroke(columns: Columns) -> Array:
    """From stroke to opening, with the sign that makes a loop of the right action 1 + L."""
    sign = np.where(np.asarray(columns["action"]) == "heating", 1.0, -1.0)
    return np.asarray(sign / (1.0 - np.asarray(columns["backlash"], float)))


def sampled_plant_response(columns: Columns, plants: Plants, w: Array) -> tuple[Complex, Index]:
    """From opening to T as sampled, K per unit opening, (n_kinds, n_w), and each loop's kind of plant and sensor."""
    ts, tau = (np.asarray(columns[name], float) for name in ("sample_time", "sensor_time_constant"))
    first, kind = unique_columns(plants.same, ts, tau)
    P = np.empty((first.size, w.size), complex)
    for period in np.unique(ts):
        of_period = np.flatnonzero(ts[first] == period)
        members = first[of_period]
        P[of_period] = sampled_response(plants.response[members], tau[members], int(period), w)
    return P, kind


def _bring_to_rest(block: Block, members: Index, entering: Array, T_set: Array) -> tuple[Array, Array, Array, Array]:
    """Bring a block to rest: what enters, STEADY of its lanes, and the work space S and V."""
    lanes, (S, V, *_) = pad_members(members), work_space(block)
    steady, of_lanes = np.empty((len(at_rest.STEADY_ROWS), LANES)), np.ascontiguousarray(entering[:, lanes])
    at_rest.find_rest(block.rows, block.config, of_lanes, T_set[lanes], S, V, steady)
    return of_lanes, steady, S, V


def state_names(n_volumes: int) -> tuple[str, ...]:
    """T_w_1 … T_w_N, T_c, T_a, K, and W_a, kg/kg; T_sup is T_a_1."""
    return tuple(f"{name}_{i}" for name in at_rest.STATES for i in range(1, n_volumes + 1))


def state_space_of(columns: Columns, conditions: Mapping[str, Array]) -> tuple[Array, Array]:
    """A, (n, 4 N, 4 N), and B, (n, 4 N), of x[t+1] = A x[t] + B opening[t] about rest, t in s; see ``state_names``."""
    matrix, entering, T_set, same = distinct_plants(columns, conditions)
    size = len(at_rest.STATES) * int(columns["n_volumes"][0])

    def run(block: Block, members: Index) -> list[np.ndarray]:
        of_lanes, rest, S, V = _bring_to_rest(block, members, entering, T_set)
        A, B = np.empty((size, size, LANES)), np.empty((size, LANES))
        at_rest.linearise_step(block.rows, block.config, of_lanes, rest, V.copy(), S, V, A, B)
        return [A, B]

    A, B = run_sets(matrix, run)
    return np.moveaxis(A, 2, 0)[same], B.T[same]
