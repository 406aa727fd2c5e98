"""limit_cycle: hunting index of every loop, whether, how fast and how far it hunts."""

from __future__ import annotations

import json
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.design.linearise import phase_crossover
from fastcoil.design.operating_points import OperatingPoints, index_chunks
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.provenance import provenance
from fastcoil.model.metric_table import HUNTING_SWING_K

from fastcoil.design.describing_function import (  # isort: skip
    Elements, interpolate, is_too_smooth, limiter_gain, refine_curve, swing_amplitude, unpredictable_loops,
)  # fmt: skip
from fastcoil.design.plants import (  # isort: skip
    Columns, Complex, Plants, floats, frequency_response, loop_response, stroke_gain, unique_columns,
)  # fmt: skip

DescribingFunction = Callable[[Array], Complex]
"""Frequencies, rad/s, of loops and amplitudes → the describing function there."""


class HarmonicBalance(NamedTuple):
    """Balance of each piece of the phase curves, loop and amplitude, (3, n, n_amplitudes)."""

    product: Array  # |L| |N| where L and N lag 180° together; 0 where they do nowhere
    place: Array  # index of the frequency, with a fraction
    size: Array  # |N|


def frequency_at(w: Array, place: Array) -> Array:
    """Frequencies at indices with a fraction of w, which ascends by equal ratios."""
    return np.asarray(w[0] * np.exp(place * np.log(w[1] / w[0])))


def harmonic_balance(
    w: Array, L: Complex, N: Callable[[Index], DescribingFunction], n_amplitudes: int, lead: Array
) -> HarmonicBalance:
    """Find where L and N lag 180° together, for each loop and amplitude.

    With fast integral action the phase of L falls, rises and falls again: the three pieces are kept apart.

    w: rad/s, (n_w,), ascending by equal ratios.  L: (n, n_w).  N: members, (m,) → their describing function at
    frequencies, (m, n_amplitudes).  lead: upper limit of the lead of N, rad, (n,).
    """
    phase_left, log_L, pieces = np.pi + np.unwrap(np.angle(L), axis=1), np.log(np.abs(L)), []
    for low, high, turn in _phase_pieces(phase_left, lead):
        members = np.flatnonzero(high > low)  # the loops that have this piece
        a, b = (np.repeat(end[:, None].astype(float), n_amplitudes, axis=1) for end in (low, high))
        product, place, size = np.zeros(a.shape), a.copy(), np.zeros(a.shape)
        if members.size:
            phase, N_members = phase_left[members], N(members)

            def excess(at: Array, turn: float = turn, phase: Array = phase, N: DescribingFunction = N_members) -> Array:
                return turn * (interpolate(phase, at) + np.angle(N(frequency_at(w, at))))

            at, crosses = _find_root(excess, a[members], b[members])
            place[members], size[members] = at, np.abs(N_members(frequency_at(w, at)))
            product[members] = np.where(crosses, np.exp(interpolate(log_L[members], at)) * size[members], 0.0)
        pieces.append((product, place, size))
    product, place, size = (np.stack(part) for part in zip(*pieces, strict=True))
    return HarmonicBalance(product, place, size)


def _find_root(excess: Callable[[Array], Array], a: Array, b: Array) -> tuple[Array, Mask]:
    """Find where a falling function crosses 0 between a and b, and whether it does."""
    fa, fb = excess(a), excess(b)
    crosses = (fa >= 0.0) & (fb <= 0.0) & (b > a)
    for _ in range(10):  # halvings
        x = 0.5 * (a + b)
        fx = excess(x)
        left = fx > 0.0
        a, fa, b, fb = np.where(left, x, a), np.where(left, fx, fa), np.where(left, b, x), np.where(left, fb, fx)
    return a + (b - a) * np.clip(fa / np.where(fa > fb, fa - fb, 1.0), 0.0, 1.0), crosses


def _phase_pieces(phase_left: Array, lead: Array) -> list[tuple[Index, Index, float]]:
    """First and last index of the last fall of each curve, of the first and of the rise between; -1 for the rise."""
    n, n_w = phase_left.shape
    is_over = phase_left < -lead[:, None]
    last = np.where(is_over.any(axis=1), is_over.argmax(axis=1), n_w - 1)
    phase = np.where(np.arange(n_w) <= last[:, None], phase_left, -np.inf)
    later_maximum = np.maximum.accumulate(phase[:, ::-1], axis=1)[:, ::-1]
    rise = np.where(np.isfinite(phase), later_maximum, 0.0) - np.where(np.isfinite(phase), phase, 0.0)
    dip = rise.argmax(axis=1)
    has_rise = rise[np.arange(n), dip] > 0.01  # rad; below, it is round-off
    dip = np.where(has_rise, dip, 0)
    peak = np.where(has_rise, np.where(np.arange(n_w) >= dip[:, None], phase, -np.inf).argmax(axis=1), 0)
    return [(peak, last, 1.0), (np.zeros_like(dip), dip, 1.0), (dip, peak, -1.0)]


class Swings(NamedTuple):
    """Swings at which L and N lag 180° together: |L| |N|, w, rad/s, amplitudes u, fraction of stroke, and T, K."""

    product: Array
    w: Array
    u: Array
    T: Array


def find_sustained_cycle(swings: Swings, disturbance: float) -> tuple[Mask, Swings]:
    """Find the cycle in which a swing of T_sup with the amplitude ``disturbance``, K, ends, and whether there is one.

    Where |L| |N| falls through 1 as the amplitude grows, a cycle sustains itself; where it rises, it parts the swings
    that grow from those that decay (Gelb and Vander Velde 1968, section 3.2).  Where the phase of L rises with the
    frequency it is the other way round.
    """
    F = swings.product
    before, after = F[:, :, :-1], F[:, :, 1:]
    both = (before > 0.0) & (after > 0.0)
    falls, rises = (before >= 1.0) & (after < 1.0), (before < 1.0) & (after >= 1.0)
    is_rise_piece = np.array([False, False, True])[:, None, None]
    stable, parting = np.where(is_rise_piece, rises & both, falls), np.where(is_rise_piece, falls, rises)
    log_F = np.log(np.maximum(F, 1e-9))
    crossing = both & (stable | parting)
    # where the phases meet no more, the cycle is at the last amplitude at which they do
    share = np.where(crossing, -log_F[:, :, :-1] / np.where(crossing, np.diff(log_F, axis=2), 1.0), 0.0)

    def at_crossing(values: Array) -> Array:
        log_values = np.log(np.maximum(values, 1e-12))
        return np.asarray(_join_pieces(np.exp(log_values[:, :, :-1] * (1.0 - share) + log_values[:, :, 1:] * share)))

    crossings = Swings(*map(at_crossing, swings))
    is_stable, is_parting, T = _join_pieces(stable), _join_pieces(parting), crossings.T
    is_above = T > disturbance
    above, below = np.where(is_stable & is_above, T, np.inf), np.where(is_stable & ~is_above, T, -np.inf)
    parting_above = np.where(is_parting & is_above, T, np.inf).min(axis=1)
    parting_below = np.where(is_parting & ~is_above, T, -np.inf).max(axis=1)
    nearest_above, nearest_below = above.min(axis=1), below.max(axis=1)
    nothing_below = (nearest_below == -np.inf) & (parting_below == -np.inf)
    is_growing = (parting_below > nearest_below) | (nothing_below & (nearest_above < parting_above))
    k = np.where(is_growing, above.argmin(axis=1), below.argmax(axis=1))
    is_sustained = np.where(is_growing, nearest_above < np.inf, nearest_below > -np.inf)
    return is_sustained, Swings(*(values[np.arange(k.size), k] for values in crossings))


# Thresholds of the verdict; the first is the best one of ``choose`` in studies/hunting/limit_cycles.py
HUNTING_INDEX_LIMIT = 0.85  # from which a gap keeps a loop swinging for hours, though it may come to rest
GAP_SHAPED_RATIO = 1.5  # amplitude of u over the gap up to which that is so: there the gap shapes the swing
DISTURBANCE = 2.0  # amplitude of T_sup, K, of the disturbance that starts a cycle
UNSTABLE_GAIN = 1.02  # |L| at 180° above which a loop is unstable without a gap; 2 % for errors of |L|
INTEGRAL_LIMIT_ROUNDS = 2  # how often a cycle that reaches a limit of the integral is computed again

_ROUND_OFF_GAP = 1e-6  # fraction of stroke; a gap or a buffer up to this size is round-off
_LARGEST_AMPLITUDE = 30.0  # of u in strokes, before it is limited to 0–1
_N_AMPLITUDES = 44  # of u, by equal ratios


class Cycles(NamedTuple):
    """Hunting index and limit cycle of each loop, (n,)."""

    # largest |L| |N| where both lag 180° together, over swings of T_sup of up to ``DISTURBANCE``; without a gap 1 over
    # the gain margin; 0 where the two never do, or no opening holds the set-point
    hunting_index: Array
    hunts: Array  # 1 where a disturbance starts a swing of more than 0.1 K from peak to peak that goes on, else 0
    period: Array  # s, NaN where it does not hunt, as the amplitude
    amplitude: Array  # half of peak to peak of true T_sup, K
    frequency: Array  # of the hunting index, rad/s


def predict_cycles(columns: Columns, plants: Plants) -> Cycles:
    """Predict hunting index and limit cycle; all NaN in ``unpredictable_loops`` and where a plant has no gain."""
    periods, kp = floats(columns, "sample_time", "kp")
    is_known = ~np.any(list(unpredictable_loops(columns).values()), axis=0) & np.isfinite(plants.gain)
    cycles = Cycles(*(np.full(plants.opening.size, np.nan) for _ in Cycles._fields))
    # where no opening holds the set-point, or the loop acts the wrong way round or not at all, the valve stands
    is_acting = plants.reachable & (stroke_gain(columns, plants) > 0.0) & (kp > 0.0)
    cycles.hunting_index[is_known & ~is_acting], cycles.hunts[is_known & ~is_acting] = 0.0, 0.0
    for period in np.unique(periods):
        members = np.flatnonzero(is_known & is_acting & (periods == period))
        for k in index_chunks(members.size, 512):
            chunk = members[k]
            part = {name: values[chunk] for name, values in columns.items()}
            predicted = _predict_cycles_at_sample_time(part, plants.select(chunk), period)
            for values, of_chunk in zip(cycles, predicted, strict=True):
                values[chunk] = of_chunk
    return cycles


def _predict_cycles_at_sample_time(columns: Columns, plants: Plants, period: float) -> Cycles:
    """``predict_cycles`` of loops with one sample time, s."""
    w = np.geomspace(3e-4, np.pi / period, 136)  # from a period of 6 h
    L = loop_response(columns, plants, w)
    plants = plants._replace(curve=refine_curve(plants.curve))
    elements = Elements.from_columns(columns, plants)
    A = elements.amplitudes(_LARGEST_AMPLITUDE, _N_AMPLITUDES)
    balance = _balance_with_limits(w, L, elements, A, plants)
    w_balance = frequency_at(w, balance.place)
    T = A * balance.size * _plant_gain_at(plants, w, balance.place) / (1.0 - elements.backlash)
    T *= np.abs(np.sinc(w_balance * period / (2.0 * np.pi)))
    pieces = Swings(balance.product, w_balance, np.broadcast_to(A, T.shape), T)
    swings = Swings(*map(_join_pieces, pieces))
    rows = np.arange(A.shape[0])
    best = np.where(swings.T <= DISTURBANCE, swings.product, 0.0).argmax(axis=1)
    # without a gap, that of the smallest swing: the linear loop's
    has_no_gap = ((np.abs(elements.width) <= _ROUND_OFF_GAP) & (elements.reversal_band <= _ROUND_OFF_GAP))[:, 0]
    smallest = np.arange(0, swings.product.shape[1], _N_AMPLITUDES)
    best = np.where(has_no_gap, smallest[swings.product[:, smallest].argmax(axis=1)], best)
    hunting_index, w_index = swings.product[rows, best], swings.w[rows, best]
    # a gap is crossed the more slowly the smaller the error: a swing that dies away takes hours
    is_gap_shaped = (swings.u < GAP_SHAPED_RATIO * elements.width) & (swings.product > HUNTING_INDEX_LIMIT)
    slowest = np.where(is_gap_shaped, swings.product, 0.0).argmax(axis=1)
    lingers = is_gap_shaped[rows, slowest]
    is_sustained, cycle = find_sustained_cycle(pieces, DISTURBANCE)
    cycle = Swings(*(np.where(is_sustained, c, s[rows, slowest]) for c, s in zip(cycle, swings, strict=True)))
    swing = np.full(A.shape[0], np.nan)

    def is_visible(members: Index) -> Mask:
        if members.size:
            u, part = cycle.u[members, None], elements.select(members)
            swing[members] = swing_amplitude(u, part.mean_u(u), cycle.w[members, None], part, plants.select(members))
        return 2.0 * swing > HUNTING_SWING_K

    hunts = is_visible(np.flatnonzero(is_sustained | lingers))
    # an unstable loop swings from end to end, also where there is no balance, such as in a cycle of two samples
    size, w_180 = phase_crossover(L, w)
    runs_away = ~hunts & (size * elements.slope[:, 0] > UNSTABLE_GAIN)
    end_to_end = Swings(size, w_180, np.full(size.size, _LARGEST_AMPLITUDE), size)
    cycle = Swings(*(np.where(runs_away, e, c) for c, e in zip(cycle, end_to_end, strict=True)))
    hunts = is_visible(np.flatnonzero(runs_away))
    u = np.where(hunts, cycle.u, swings.u[rows, best])
    is_known = ~is_too_smooth(columns, u, np.where(hunts, cycle.w, w_index))
    hunts_known = hunts & is_known
    return Cycles(
        np.where(is_known, hunting_index, np.nan), np.where(is_known, hunts.astype(float), np.nan),
        np.where(hunts_known, 2.0 * np.pi / cycle.w, np.nan), np.where(hunts_known, swing, np.nan),
        np.where(is_known & (hunting_index > 0.0), w_index, np.nan),
    )  # fmt: skip


def _balance_with_limits(w: Array, L: Complex, elements: Elements, A: Array, plants: Plants) -> HarmonicBalance:
    """Balance the loops; where the integral reaches a limit, again with its effect at the resulting frequency."""
    mean = elements.mean_u(A)
    limit_gain = limiter_gain(A, -mean, 1.0 - mean).astype(complex)

    def balance_loops(loops: Index) -> HarmonicBalance:
        part = elements.select(loops)
        leads = (part.width < part.reversal_band - _ROUND_OFF_GAP)[:, 0]
        lead = np.where(leads | (np.angle(limit_gain[loops]).max(axis=1) > 0.0), 0.5 * np.pi, 0.0)

        def N(which: Index) -> DescribingFunction:
            members = loops[which]
            return elements.select(members).make_describing_function(A[members], limit_gain[members])

        return harmonic_balance(w, L[loops], N, _N_AMPLITUDES, lead)

    balance = balance_loops(np.arange(A.shape[0]))
    room = np.minimum(mean, 1.0 - mean)
    reaches = elements.pi_amplitudes(A, frequency_at(w, balance.place[0]))[1] > room
    k = np.flatnonzero((reaches & (balance.product[0] > 0.7)).any(axis=1))  # loops that may cycle there
    for _ in range(INTEGRAL_LIMIT_ROUNDS if k.size else 0):
        w_balance, part = frequency_at(w, balance.place[0][k]), elements.select(k)
        reaches = part.pi_amplitudes(A[k], w_balance)[1] > room[k]
        limit_gain[k] = np.where(reaches, part.pi_limit_gain(A[k], w_balance, plants.select(k))[0], limit_gain[k])
        for values, again in zip(balance, balance_loops(k), strict=True):
            values[:, k] = again
    return balance


def _plant_gain_at(plants: Plants, w: Array, place: Array) -> Array:
    """|T_sup| per opening at places between frequencies w; smooth, so that every fifth of them is enough."""
    first, kind = unique_columns(plants.kind)
    every_fifth = np.linspace(0.0, w.size - 1.0, (w.size + 4) // 5)
    G = np.abs(frequency_response(plants.response[first], frequency_at(w, every_fifth)))
    log_G, scale = np.log(np.maximum(G, 1e-300))[kind], every_fifth.size - 1.0
    return np.exp(np.stack([interpolate(log_G, piece * scale / (w.size - 1.0)) for piece in place]))


def _join_pieces(values: np.ndarray) -> np.ndarray:
    """Put the pieces of each loop, (3, n, m), into one row, (n, 3 m)."""
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)


_VARIABLES = {  # long_name, units, comment
    "hunting_index": ("hunting index of the describing function", "1", "largest |L| |N| where L and N lag 180 degrees "
        f"together, over swings up to {DISTURBANCE:g} K; from {HUNTING_INDEX_LIMIT:g} a gap keeps the loop swinging; "
        "without a gap 1/gain margin; 0 if T_set is out of reach"),
    "hunts": ("whether the loop is predicted to hunt", "1", f"1 if a swing of {DISTURBANCE:g} K ends in one that goes "
        "on, by more than 0.1 K from peak to peak"),
    "period": ("period of the predicted cycle", "s", "NaN where it does not hunt"),
    "amplitude": ("amplitude of T_sup in the predicted cycle", "K", "half of peak to peak; NaN where it does not hunt"),
    "frequency": ("angular frequency of the hunting index", "rad s-1", "NaN where the index is 0"),
}  # fmt: skip


def limit_cycle(loop: Loop, boundary: Boundary, *, at: Any = None) -> xr.Dataset:
    """Predict, without simulating, whether each loop hunts on each day, how fast and how far.

    The loop is linear but for one element, the describing function of all that lies between the controller's u and the
    supply temperature at rest: limits of the stroke, the motor's speed, gap, inverse with a right or wrong estimate,
    buffer, and the curve of valve and plant (Gelb and Vander Velde 1968).  Noise is left out.

    Parameters
    ----------
    loop, boundary, at
        As for ``linearise``; a sweep, several days and a list of seconds give results of these dims.

    Returns
    -------
    xarray.Dataset
        hunting_index (above 0.85 a loop hunts), hunts (0 or 1), period [s], amplitude [K, half of peak to peak, of true
        T_sup], frequency of the hunting index [rad/s].  The attributes of each say what it is.  All are NaN, with a
        warning that says why, in scenarios about which theory says nothing: a user's law, an estimator that changes the
        estimate, stick-slip, a neutral zone, resolutions, an error dead band, a smooth compensation slower than the
        cycle.

    Raises
    ------
    InputError
        With one sentence for each mistake; for an unstable coil; if theory says nothing about any scenario.

    Examples
    --------
    >>> loop = fc.Loop.preset("lbnl").assign(ti=[8.0, 30.0])
    >>> cycles = fc.limit_cycle(loop, fc.constant_day(hours=1))
    >>> cycles.hunting_index.values.round(2).tolist(), cycles.hunts.values.tolist()
    ([1.1, 0.18], [1.0, 0.0])
    """
    points = OperatingPoints(loop, boundary, at)
    reasons: Counter[str] = Counter()

    def evaluate(columns: Columns, plants: Plants) -> Iterable[tuple[str, Array]]:
        cycles, why = predict_cycles(columns, plants), unpredictable_loops(columns)
        why |= {"T_sup jumps past the set-point, from dry to wet: there is nothing to linearise": np.isnan(plants.gain)}
        is_slow = np.isnan(cycles.hunts) & ~np.any(list(why.values()), axis=0)
        slow = "the smooth compensation crosses the gap more slowly than u reverses: lower smooth_rate, or simulate it"
        reasons.update({reason: int(where.sum()) for reason, where in (why | {slow: is_slow}).items()})
        return cycles._asdict().items()

    variables = points.evaluate(evaluate)
    n_unpredicted = {reason: count for reason, count in reasons.items() if count}
    is_unpredicted = np.isnan(variables["hunts"])
    if is_unpredicted.all():
        sentences = [f"limit_cycle says nothing about these loops: {reason}" for reason in n_unpredicted]
        raise InputError(sentences, "loop", "unsupported")
    n = is_unpredicted.size
    note = "; ".join(f"NaN in {count:,} of {n:,} scenarios: {reason}" for reason, count in n_unpredicted.items())
    if note:
        warnings.warn(note, stacklevel=2)
    attrs = {n: dict(zip(("long_name", "units", "comment"), texts, strict=True)) for n, texts in _VARIABLES.items()}
    ds = points.dataset({name: (values, attrs[name]) for name, values in variables.items()})
    about = {"parameters": json.dumps(points.loop.constants)} | ({"note": note} if note else {})
    return ds.assign_attrs(title="fastcoil limit cycles, predicted", **about, **provenance())
