"""Plants at rest at their set-points, their responses to a small step, and the open loop, as arrays without labels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.own_plants import rest_plant
from fastcoil.model.engine import at_rest
from fastcoil.model.engine.rows import LANES, PARAMETER_ROWS
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.user_rules import Rule, rules_for_kernels

from fastcoil.model.engine.lanes import (  # isort: skip
    NO_USER_RULES, Block, UserRules, pad_members, parameter_matrix, run_sets, work_space,
)  # fmt: skip

Complex = NDArray[np.complex128]


def frequency_response(response: Array, w: Array, ratio: Array | None = None) -> Complex:
    """Σ (r_k - r_(k-1)) e^(-jωk) over k ≥ 1 of step responses from sample 1 on, (n, n_steps), at w, (n_w,): (n, n_w).

    The transfer function of the steps at z = e^(jω); w: radians per sample.  ratio: of successive changes beyond the
    end, (n,); by default that of the last ones.
    """
    changes = np.diff(response, axis=1, prepend=0.0)
    rotations = np.exp(-1j * np.outer(np.arange(1, changes.shape[1] + 1), w))
    ratio = (_last_ratio(changes) if ratio is None else ratio)[:, None]
    delay = np.exp(-1j * w)[None, :]
    tail = changes[:, -1:] * ratio * rotations[-1] * delay / (1.0 - ratio * delay)
    transfer: Complex = changes @ rotations.real + 1j * (changes @ rotations.imag) + tail
    return transfer


def _last_ratio(changes: Array) -> Array:
    """Ratio of successive changes at the end of a response, (n,), at least 0."""
    span = min(at_rest.TAIL_STEPS, changes.shape[1] - 1)
    last, earlier = changes[:, -1], changes[:, -1 - span]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(last * earlier > 0.0, np.abs(last / earlier) ** (1.0 / span), 0.0)
    return np.minimum(ratio, at_rest.MAX_TAIL_RATIO)


def _extend_response(response: Array, n_more: int) -> tuple[Array, Array]:
    """Continue the responses for ``n_more`` seconds as a geometric series; return them and its ratio, (n, 1)."""
    changes = np.diff(response, axis=1, prepend=0.0)
    ratio = _last_ratio(changes)[:, None]
    tail = response[:, -1:] + changes[:, -1:] * ratio * (1.0 - ratio ** np.arange(1, n_more + 1)) / (1.0 - ratio)
    return np.concatenate([response, tail], axis=1), ratio


def _sensor_decay(tau: Array) -> Array:
    """Share of its last reading that a sensor with lag tau, (n,), s, keeps for a second."""
    with np.errstate(divide="ignore"):
        return np.where(tau > 0.0, np.exp(-1.0 / tau), 0.0)


def sampled_response(response: Array, tau: Array, period: int, w: Array) -> Complex:
    """``frequency_response`` of every ``period``-th second of a sensor with lag tau, (n,), s; w in rad/s.  Exact."""
    # two samples lie beyond the end
    extended, ratio = _extend_response(response, 3 * period - response.shape[1] % period)
    decay = _sensor_decay(tau)[:, None]
    weight = (1.0 - decay) * decay ** np.arange(period - 1, -1, -1)
    readings = np.einsum("nkp,np->nk", extended.reshape(tau.size, -1, period), weight)
    transfer: Complex = frequency_response(readings, w * period, ratio[:, 0] ** period)
    transfer /= 1.0 - decay**period * np.exp(-1j * w * period)
    return transfer


def sensor_response(response: Array, tau: Array, n_more: int) -> Array:
    """Responses as a sensor with lag tau, (n,), s, reads them, for ``n_more`` seconds and ten lags longer."""
    extended, _ = _extend_response(response, n_more + 10 * math.ceil(tau.max()))
    if not tau.any():
        return extended
    decay, y = _sensor_decay(tau), np.zeros(tau.size)
    sensed = np.empty_like(extended)
    for t in range(extended.shape[1]):
        y = extended[:, t] + decay * (y - extended[:, t])
        sensed[:, t] = y
    return sensed


Columns = Mapping[str, NDArray[Any]]

PLANT_PARAMETERS = tuple(
    p.name for p in PARAMETERS.values() if p.group in ("coil", "valve", "plant") and p.name != "T_initial"
)
"""Parameters on which the plant depends, from the opening to what leaves it."""
ROOM_RESPONSE = 600  # s beyond the response of the supply air, after which a room follows by a geometric series alone
LONGEST_RESPONSE = 3600  # s; a longer response continues as a geometric series
OPENINGS = np.linspace(0.0, 1.0, 17)  # of the curve of T_sup at rest


def floats(columns: Columns, *names: str) -> Iterator[Array]:
    """Yield columns as arrays of floats."""
    return (np.asarray(columns[name], float) for name in names)


class Plants(NamedTuple):
    """Linearised plants at rest of n loops, (n,) each, a controlled room included."""

    opening: Array  # fraction; the end, 0 or 1, that comes nearest to the set-point where no opening holds it
    T_sup: Array  # °C, at rest there: supply air, or the room where it is controlled
    # K per unit opening, below 0 for cooling; NaN, as the response, where T_sup jumps past the set-point: a coil that
    # exchanges less when it is wet than when it is dry has two states of rest
    gain: Array
    reachable: Mask  # whether an opening holds the set-point
    m_w: Array  # kg/s
    wet_volumes: Array  # one that is wet and dry by turns counts with the share of time in which it is wet
    response: Array  # (n, n_steps), K per unit opening: true T_sup 1 to n_steps s after a small step, until it settles
    kind: Index  # number of the distinct plant, from 0
    curve: Array  # (n, 17), °C: T_sup at rest at each of OPENINGS

    def select(self, members: Index) -> Plants:
        """Return the plants of the loops ``members``."""
        return Plants._make(field[members] for field in self)


def unique_columns(*parts: Array | Index) -> tuple[Index, Index]:
    """Index of the first column of each kind, and the kind of each column; parts: (n_rows, n) or (n,)."""
    rows = np.concatenate([np.atleast_2d(part) for part in parts])
    rows = np.where(np.isnan(rows), -1e9, rows) + 0.0
    varying = rows[np.ptp(rows, axis=1) > 0.0]
    if not varying.size:
        return np.zeros(1, np.int64), np.zeros(rows.shape[1], np.int64)
    _, first, kind = np.unique(varying, axis=1, return_index=True, return_inverse=True)
    return first, kind.ravel()


def linearise_plants(
    columns: Columns, conditions: Mapping[str, Array], rules: Mapping[str, Rule] | None = None
) -> Plants:
    """Find where plants rest under held conditions, (n,) each, and how they answer; equal ones are computed once."""
    controls_room = np.asarray(columns["controlled"]) == "T_room"
    if controls_room.any():
        return _plants_with_rooms(columns, conditions, controls_room, rules)
    plants = {name: rule for name, rule in (rules or {}).items() if rule.kind == "plant"}
    kernel_rules = rules_for_kernels(plants) if plants else NO_USER_RULES
    matrix, entering, T_set, kind = distinct_plants(columns, conditions, kernel_rules)
    if np.any(np.asarray(columns["plant"]) != "coil"):
        steady, response, ends, curve = _solve_own_plants(matrix, entering, T_set, kernel_rules)
    else:
        solve = _solve_plants if T_set.size <= LANES else _solve_plants.__wrapped__
        steady, response, ends, curve = solve(*(part.tobytes() for part in (matrix, entering, T_set)))
    rest = {name: steady[k][kind] for k, name in enumerate(at_rest.STEADY_ROWS)}
    # the series shows its ratio, however many other responses are longer
    response = np.ascontiguousarray(response[: int(ends.max()) + at_rest.TAIL_STEPS + 1].T)
    return Plants(
        rest["opening"], rest["T_sup"], rest["gain"], rest["nearest"] == 0.0, rest["m_w"], rest["wet_volumes"],
        np.broadcast_to(response, (kind.size, response.shape[1])) if T_set.size == 1 else response[kind], kind,
        np.ascontiguousarray(curve.T)[kind],
    )  # fmt: skip


@lru_cache(4)  # of 2 MB each; the gains, the gap and the motor leave the plants as they are
def _solve_plants(*parts: bytes) -> tuple[np.ndarray, ...]:
    """``STEADY_ROWS``, responses, their ends and curves of plants; parts: of ``distinct_plants``."""
    T_set = np.frombuffer(parts[2])
    matrix, entering = (np.frombuffer(part).reshape(-1, T_set.size) for part in parts[:2])

    def run(block: Block, members: Index) -> list[np.ndarray]:
        lanes, (S, V, *_) = pad_members(members), work_space(block)
        loops = (block.rows, block.config, np.ascontiguousarray(entering[:, lanes]))
        rest = np.empty((len(at_rest.STEADY_ROWS), LANES))
        at_rest.find_rest(*loops, T_set[lanes], S, V, rest)
        response, ends = np.empty((LONGEST_RESPONSE, LANES)), np.empty(LANES, np.int64)
        tolerance = 1e-4  # share of the gain: from where it stays this near to its end, it is a geometric series
        curve = np.empty((OPENINGS.size, LANES))
        at_rest.simulate_step_response(*loops, rest, V.copy(), S, V, tolerance, response, ends)
        at_rest.rest_curve(*loops, OPENINGS, S, V, curve)
        return [rest, response, ends, curve]

    return run_sets(matrix, run)


def _solve_own_plants(
    matrix: Array, entering: Array, T_set: Array, rules: UserRules
) -> tuple[Array, Array, Index, Array]:
    """``_solve_plants`` where some of the plants are the user's, who are run one by one."""
    is_own = matrix[PARAMETER_ROWS.index("plant")] != 0.0
    n = T_set.size
    steady, ends = np.full((len(at_rest.STEADY_ROWS), n), np.nan), np.full(n, LONGEST_RESPONSE, np.int64)
    response, curve = np.empty((LONGEST_RESPONSE, n)), np.empty((OPENINGS.size, n))
    coils = np.flatnonzero(~is_own)
    if coils.size:
        parts = (matrix[: len(PARAMETER_ROWS), coils], entering[:, coils], T_set[coils])
        solved = _solve_plants(*(np.ascontiguousarray(part).tobytes() for part in parts))
        steady[:, coils], response[:, coils], ends[coils], curve[:, coils] = solved
    for k in np.flatnonzero(is_own):
        rest = rest_plant(matrix[:, k : k + 1], rules, entering[:, k], T_set[k], OPENINGS, LONGEST_RESPONSE)
        row = {"opening": rest.opening, "T_sup": rest.T, "gain": rest.gain, "nearest": float(not rest.is_reachable)}
        steady[:, k] = [row.get(name, np.nan) for name in at_rest.STEADY_ROWS]
        response[:, k], curve[:, k] = rest.response, rest.curve
    return steady, response, ends, curve


def _plants_with_rooms(
    columns: Columns, conditions: Mapping[str, Array], controls_room: Mask, rules: Mapping[str, Rule] | None
) -> Plants:
    """``linearise_plants`` with rooms: the plant at the supply air that they need, then the room by Euler's step."""
    capacity, ua, cp_a = floats(columns, "room_capacity", "room_ua", "cp_a")
    C_air, T_set = np.asarray(conditions["m_a"]) * cp_a, np.asarray(conditions["T_set"], float)
    outside = ua * np.asarray(conditions["T_out"]) + np.asarray(conditions["Q_room"])  # kW, of a room at 0 °C
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(controls_room, ((C_air + ua) * T_set - outside) / C_air, T_set)
    others = {**columns, "controlled": np.full(T_set.size, "T_sup")}
    plants = linearise_plants(others, {**conditions, "T_set": needed}, rules)
    share = np.where(controls_room, C_air / (C_air + ua), 1.0)
    offset = np.where(controls_room, outside / (C_air + ua), 0.0)
    response, _ = _extend_response(plants.response, ROOM_RESPONSE)
    room, seen = np.zeros(T_set.size), np.empty_like(response)
    for t in range(response.shape[1]):
        seen[:, t] = room  # the room follows the air of the second before
        room = room + (C_air * (response[:, t] - room) - ua * room) / capacity
    response = np.where(controls_room[:, None], seen, response)
    _, kind = unique_columns(plants.kind, controls_room.astype(float), capacity, ua, C_air)
    return plants._replace(
        T_sup=share * plants.T_sup + offset, gain=share * plants.gain, response=response, kind=kind,
        curve=share[:, None] * plants.curve + offset[:, None],
    )  # fmt: skip


def distinct_plants(
    columns: Columns, conditions: Mapping[str, Array], rules: UserRules = NO_USER_RULES
) -> tuple[Array, Array, Array, Index]:
    """Parameters, (rows, n), what enters, (5, n), T_set, (n,), of the distinct plants, and the plant of each loop."""
    n = len(columns["C_w"])
    # what no plant depends on is at its default
    values = {name: np.full(n, math.nan if p.default is None else p.default) for name, p in PARAMETERS.items()}
    values |= {name: np.zeros(n) for name in PARAMETER_ROWS if name not in values}
    values["estimator"] = np.full(n, "none")
    read = (*PLANT_PARAMETERS, *(name for plant in rules.plants for name in plant.Parameters._fields))
    matrix = parameter_matrix(values | {name: columns[name] for name in read}, rules)
    entering = np.stack([np.asarray(conditions[name], float) for name in at_rest.CONDITIONS])
    T_set = np.asarray(conditions["T_set"], float)
    first, kind = unique_columns(matrix, entering, T_set)
    return matrix[:, first], entering[:, first], T_set[first], kind


def loop_response(columns: Columns, plants: Plants, w: Array) -> Complex:
    """Open loop L(jω) at angular frequencies w, (n_w,), rad/s: (n, n_w).  NaN above π/sample_time.

    L has PI, hold, α, plant and sensor, not the motor's rate limit, the inverse and resolutions; the loop closes as 1 +
    L N = 0, where N is the describing function of the gap, 1 without one.  It is the exact transfer function of the
    sampled loop, C(z) P(z) at z = e^(jω ts), aliases included: P(z) is the step-invariant transform of the response,
    and the integral takes in the new error before it is used.
    """
    w = np.asarray(w, float)
    ts, kp, ti = floats(columns, "sample_time", "kp", "ti")
    P, kind = sampled_plant_response(columns, plants, w)
    with np.errstate(divide="ignore", invalid="ignore"):
        C = kp[:, None] * (1.0 + ts[:, None] / ti[:, None] / (1.0 - np.exp(-1j * np.outer(ts, w))))
    L = _opening_per_stroke(columns)[:, None] * C * P[kind]
    return np.where(np.outer(ts, w) <= math.pi * (1.0 + 1e-12), L, np.nan)


def stroke_gain(columns: Columns, plants: Plants) -> Array:
    """Gain of each plant per stroke of a motor that the stem follows, K, positive where the loop acts the right way."""
    return np.asarray(_opening_per_stroke(columns) * plants.gain)


def _opening_per_stroke(columns: Columns) -> Array:
    """Opening per stroke, with the sign that makes a loop of the right action 1 + L."""
    (x_bl,) = floats(columns, "backlash")
    return np.asarray(np.where(np.asarray(columns["action"]) == "heating", 1.0, -1.0) / (1.0 - x_bl))


def sampled_plant_response(columns: Columns, plants: Plants, w: Array) -> tuple[Complex, Index]:
    """Response of the sampled T to the opening, K, (n_kinds, n_w), and each loop's kind of plant and sensor."""
    ts, tau = floats(columns, "sample_time", "sensor_time_constant")
    first, kind = unique_columns(plants.kind, ts, tau)
    P = np.empty((first.size, w.size), complex)
    for period in np.unique(ts):
        of_period = np.flatnonzero(ts[first] == period)
        members = first[of_period]
        P[of_period] = sampled_response(plants.response[members], tau[members], int(period), w)
    return P, kind
