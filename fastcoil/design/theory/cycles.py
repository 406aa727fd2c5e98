"""Margin and limit cycle of many loops at once, from their plants and describing functions: numbers without labels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.theory.curve_of_plant import Swings, refined, swings_of
from fastcoil.design.theory.describing_function import Complex, limited
from fastcoil.design.theory.elements import Elements, too_smooth, unknown
from fastcoil.design.theory.harmonic_balance import Balance, balance, between, frequency
from fastcoil.design.theory.limited_pi import LimitedPI
from fastcoil.design.theory.margins import at_180
from fastcoil.design.theory.plants import Columns, Plants, driven_gain, frequency_response, loop_response
from fastcoil.design.theory.sustained import Points, started
from fastcoil.design.theory.wave import amplitude_of
from fastcoil.model.metric_table import HUNTING_SWING

HUNTS_ABOVE = 0.85
"""Margin from which a gap keeps a loop swinging for hours, though in the end it may come to rest."""
OF_A_GAP = 1.5
"""Amplitude of u over the gap up to which that is so: there the gap shapes the swing."""
DISTURBANCE = 2.0
"""Amplitude of T_sup, K, of the disturbance that a cycle is started by."""
UNSTABLE = 1.02
"""|L| at 180° above which a loop is unstable without a gap, and a little, by which that may be wrong."""
NO_GAP = 1e-6
"""A gap or a buffer up to this size is round-off."""
MOST = 30.0
"""Largest amplitude of u that is looked at, before u is limited to 0–1."""
_AMPLITUDES, _FREQUENCIES = 44, 136
ROUNDS = 2
"""How often a cycle that reaches an end of the integral is computed again."""
_NEAR_ONE = 0.7
_SLOWEST = 3e-4
"""Lowest frequency, rad/s: a period of 6 h."""
_AT_ONCE = 512


class Cycles(NamedTuple):
    """Margin and limit cycle of each loop, (n,).

    margin: largest |L| |N|, where L and N lag 180° together, over the swings of T_sup of up to ``DISTURBANCE``; without
    a gap, 1 over the gain margin.  0 where the two never do, or no opening holds the set-point.
    hunts: 1 where a disturbance starts a swing of more than 0.1 K from peak to peak that goes on, else 0.
    period: s.  amplitude: half of peak to peak of true T_sup, K.  NaN where it does not hunt.
    frequency: of the margin, rad/s.
    """

    margin: Array
    hunts: Array
    period: Array
    amplitude: Array
    frequency: Array


def cycles_of(columns: Columns, plants: Plants) -> Cycles:
    """Foretell margin and limit cycle.

    Parameters
    ----------
    columns
        Parameter name → (n,), as ``columns_of`` in ``simulation/scenarios.py`` gives them.
    plants
        Of these loops, as ``plants_of`` gives them.

    Returns
    -------
    Cycles
        All NaN where theory says nothing, see ``unknown``, and where a plant has no gain.
    """
    n = plants.opening.size
    periods = np.asarray(columns["sample_time"], float)
    told = ~np.any(list(unknown(columns).values()), axis=0) & np.isfinite(plants.gain)
    found = Cycles(*(np.full(n, np.nan) for _ in Cycles._fields))
    # where no opening holds the set-point, or the loop acts the wrong way round or not at all, the valve stands
    acts = plants.reachable & (driven_gain(columns, plants) > 0.0) & (np.asarray(columns["kp"], float) > 0.0)
    found.margin[told & ~acts], found.hunts[told & ~acts] = 0.0, 0.0
    for period in np.unique(periods):
        members = np.flatnonzero(told & acts & (periods == period))
        for first in range(0, members.size, _AT_ONCE):
            some = members[first : first + _AT_ONCE]
            part = _of_one_period({name: values[some] for name, values in columns.items()}, plants.some(some), period)
            for values, of_part in zip(found, part, strict=True):
                values[some] = of_part
    return found


def _of_one_period(columns: Columns, plants: Plants, period: float) -> Cycles:
    """Of loops with one sample time."""
    w = np.geomspace(_SLOWEST, np.pi / period, _FREQUENCIES)
    L = loop_response(columns, plants, w)
    plants = plants._replace(curve=refined(plants.curve))
    elements, swings = Elements.of(columns), swings_of(plants.curve, plants.T_sup, plants.gain)
    A = elements.amplitudes(MOST, _AMPLITUDES)
    pi = LimitedPI.of(columns, elements)
    of = _balanced(w, L, elements, swings, A, pi, plants)
    at = frequency(w, of.place)
    T = A * of.size * _response(plants, w, of.place) / (1.0 - elements.backlash)
    T *= np.abs(np.sinc(at * period / (2.0 * np.pi)))
    points = Points(*(_in_a_row(np.broadcast_to(values, T.shape)) for values in (of.product, at, A, T)))

    rows = np.arange(A.shape[0])
    best = np.where(points.T <= DISTURBANCE, points.product, 0.0).argmax(axis=1)
    # without a gap, that of the smallest swing: the linear loop's
    has_none = (np.abs(elements.width) <= NO_GAP)[:, 0] & (elements.wait <= NO_GAP)[:, 0]
    smallest = np.arange(0, points.product.shape[1], _AMPLITUDES)
    best = np.where(has_none, smallest[points.product[:, smallest].argmax(axis=1)], best)
    margin, w_margin = points.product[rows, best], points.w[rows, best]
    # a gap is crossed the more slowly the smaller the error: a swing that dies away takes hours
    shaped = (points.u < OF_A_GAP * elements.width) & (points.product > HUNTS_ABOVE)
    slow = np.where(shaped, points.product, 0.0).argmax(axis=1)
    lingers = shaped[rows, slow]
    goes_on, cycle = started(Points(of.product, at, np.broadcast_to(A, T.shape), T), DISTURBANCE)
    lingering = Points(*(values[rows, slow] for values in points))
    cycle = Points(*(np.where(goes_on, values, late) for values, late in zip(cycle, lingering, strict=True)))
    swing = np.full(A.shape[0], np.nan)

    def seen(found: Index) -> Mask:
        if found.size:
            u, part = cycle.u[found, None], elements.part(found)
            mean = part.mean(u, swings.part(found))
            swing[found] = amplitude_of(u, mean, cycle.w[found, None], pi.part(found), part, plants.some(found))
        return 2.0 * swing > HUNTING_SWING

    hunts = seen(np.flatnonzero(goes_on | lingers))
    # an unstable loop swings from end to end, also where no balance is found, such as in a cycle of two samples
    size, w_180 = at_180(L, w)
    runs_away = ~hunts & (size * elements.slope[:, 0] > UNSTABLE)
    ends = Points(size, w_180, np.full(size.size, MOST), size)
    cycle = Points(*(np.where(runs_away, far, values) for values, far in zip(cycle, ends, strict=True)))
    hunts = seen(np.flatnonzero(runs_away))

    seen_u, seen_w = np.where(hunts, cycle.u, points.u[rows, best]), np.where(hunts, cycle.w, w_margin)
    told = ~too_smooth(columns, seen_u, seen_w)
    hunts_told = hunts & told
    return Cycles(
        np.where(told, margin, np.nan), np.where(told, hunts.astype(float), np.nan),
        np.where(hunts_told, 2.0 * np.pi / cycle.w, np.nan), np.where(hunts_told, swing, np.nan),
        np.where(told & (margin > 0.0), w_margin, np.nan),
    )  # fmt: skip


def _balanced(
    w: Array, L: Complex, elements: Elements, swings: Swings, A: Array, pi: LimitedPI, plants: Plants
) -> Balance:
    """Balance of the loops; where the integral reaches an end, again with what that changes, at the frequency found."""
    mean = elements.mean(A, swings)
    passed = limited(A, -mean, 1.0 - mean).astype(complex)

    def of(some: Index) -> Balance:
        part, of_part, A_part, passed_part = elements.part(some), swings.part(some), A[some], passed[some]
        leads = (part.width < part.wait - NO_GAP)[:, 0] | (np.angle(passed_part).max(axis=1) > 0.0)
        lead = np.where(leads, 0.5 * np.pi, 0.0)
        return balance(w, L[some], lambda at: part.describe(A_part, at, of_part, passed_part), _AMPLITUDES, lead)

    found = of(np.arange(A.shape[0]))
    room = np.minimum(mean, 1.0 - mean)
    reaches = pi.parts(A, frequency(w, found.place[0]))[1] > room
    ended = np.flatnonzero((reaches & (found.product[0] > _NEAR_ONE)).any(axis=1))
    for _ in range(ROUNDS if ended.size else 0):
        at = frequency(w, found.place[0][ended])
        of_pi = pi.part(ended)
        reaches = of_pi.parts(A[ended], at)[1] > room[ended]
        passed[ended] = np.where(reaches, of_pi.passed(A[ended], at, plants.some(ended))[0], passed[ended])
        for values, part in zip(found, of(ended), strict=True):
            values[:, ended] = part
    return found


def _response(plants: Plants, w: Array, place: Array) -> Array:
    """|T_sup| per opening at places between frequencies w; smooth, so that every fifth of them is enough."""
    _, first, which = np.unique(plants.same, return_index=True, return_inverse=True)
    some = np.linspace(0.0, w.size - 1.0, (w.size + 4) // 5)
    G = np.abs(frequency_response(plants.response[first], frequency(w, some)))
    log_G = np.log(np.maximum(G, 1e-300))[which.ravel()]
    return np.exp(np.stack([between(log_G, piece * (some.size - 1.0) / (w.size - 1.0)) for piece in place]))


def _in_a_row(values: Array) -> Array:
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)
