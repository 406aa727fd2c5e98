"""Margin and limit cycle of many loops at once, from their plants and describing functions: numbers without labels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.arrays import Array, Mask
from fastcoil.outputs import HUNTING_SWING
from fastcoil.theory.curve_of_plant import swings_of
from fastcoil.theory.elements import Elements, too_smooth, unknown
from fastcoil.theory.harmonic_balance import Balance, balance, between, frequency
from fastcoil.theory.plants import Plants, frequency_response, loop_response

HUNTS_ABOVE = 0.85
"""Margin from which a gap keeps a loop swinging for hours, though in the end it may come to rest."""
OF_A_GAP = 1.5
"""Amplitude of u over the gap up to which that is so: there the gap shapes the swing."""
DISTURBANCE = 2.0
"""Amplitude of T_sup, K, of the disturbance that a cycle is started by."""
MOST = 30.0
"""Largest amplitude of u that is looked at, before u is limited to 0–1."""
_AMPLITUDES, _FREQUENCIES = 44, 180
_SLOWEST = 3e-4
"""Lowest frequency, rad/s: a period of 6 h."""
_AT_ONCE = 512
_COLUMNS = (
    "backlash", "backlash_estimate", "neutral_zone", "stroke_time", "estimate_share", "compensation", "sample_time",
    "sensor_time_constant", "ti", "kp", "action", "noise_std", "buffer", "buffer_ratio", "buffer_swing", "plant_gain",
    "smooth_rate", "estimator", "law", "slip_jump", "error_dead_band",
)  # fmt: skip


class Cycles(NamedTuple):
    """Margin and limit cycle of each loop, (n,); see ``cycles_of``."""

    margin: Array
    hunts: Array
    period: Array
    amplitude: Array
    frequency: Array


def cycles_of(columns: Mapping[str, NDArray], plants: Plants) -> Cycles:
    """Foretell margin and limit cycle.

    margin: largest |L| |N| over the amplitudes of T_sup up to ``DISTURBANCE``, where L and N lag 180° together; without
    a gap 1 / gain margin.  0 where no opening holds the set-point: the valve then stands at its end.
    hunts: 1 where a disturbance starts a cycle that goes on and swings T_sup by more than 0.1 K from peak to peak.
    period: s.  amplitude: half of peak to peak of true T_sup, K.  NaN where it does not hunt.
    frequency: of the margin, rad/s.
    All are NaN where theory says nothing; see ``unknown``.

    columns: parameter name → (n,), as ``columns_of`` in ``simulation/scenarios.py`` gives them.  plants: of these loops.
    """
    n = plants.opening.size
    parts = []
    for first in range(0, n, _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        of_some = {name: np.asarray(columns[name])[some] for name in _COLUMNS if name in columns}
        of_some |= {"backlash": np.asarray(columns["backlash"], float)[some]}
        parts.append(_cycles_of(of_some, Plants(*(value[some] for value in plants))))
    found = Cycles(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    nothing = np.any(list(unknown(columns).values()), axis=0)
    return Cycles(*(np.where(nothing, np.nan, value) for value in found))


def _cycles_of(columns: Mapping[str, NDArray], plants: Plants) -> Cycles:
    w = np.geomspace(_SLOWEST, np.pi / float(np.min(columns["sample_time"])), _FREQUENCIES)
    L = np.where(plants.reachable[:, None], loop_response(columns, plants, w), np.nan)
    L = np.where(np.abs(L) > 0.0, L, np.nan)
    is_open = ~np.isfinite(L[:, 0])
    L[is_open] = 1e-9 * np.exp(-0.5j * np.pi - 1j * w)
    elements, swings = Elements.of(columns), swings_of(plants.curve, plants.T_sup, plants.gain)
    A = elements.amplitudes(MOST, _AMPLITUDES)
    lead = np.where(elements.width[:, 0] < elements.wait[:, 0], 0.5 * np.pi, 0.0)
    of = balance(w, L, lambda at: elements.describe(A, at, swings), _AMPLITUDES, lead)

    log_G = np.log(np.abs(frequency_response(plants.response, w)) + 1e-300)
    at = frequency(w, of.place)
    hold = np.abs(np.sinc(at * elements.sample_time / (2.0 * np.pi)))
    response = np.exp(np.stack([between(log_G, place) for place in of.place]))
    T = A * of.size * response * hold / (1.0 - elements.backlash)

    low = np.where(T <= DISTURBANCE, of.product, 0.0)
    flat = low.transpose(1, 0, 2).reshape(A.shape[0], -1)
    best = flat.argmax(axis=1)
    margin, w_margin = flat.max(axis=1), _flat(at)[np.arange(best.size), best]
    goes_on, amplitude, w_cycle, u = _started(of, A, T, at)
    # a swing that dies away more and more slowly, since a gap is crossed more slowly the smaller the error
    shaped = (A < OF_A_GAP * elements.width) & (of.product > HUNTS_ABOVE)
    slow = np.where(shaped, of.product, 0.0).transpose(1, 0, 2).reshape(A.shape[0], -1)
    k, rows = slow.argmax(axis=1), np.arange(best.size)
    lingers = ~goes_on & (slow[rows, k] > 0.0)
    amplitude = np.where(lingers, _flat(T)[rows, k], amplitude)
    w_cycle = np.where(lingers, _flat(at)[rows, k], w_cycle)
    u = np.where(lingers, _flat(np.broadcast_to(A, T.shape))[rows, k], np.where(goes_on, u, _flat(np.broadcast_to(A, T.shape))[rows, best]))
    with np.errstate(invalid="ignore"):
        hunts = (goes_on | lingers) & (2.0 * amplitude > HUNTING_SWING) & ~is_open
    blurred = too_smooth(columns, u, np.where(hunts, w_cycle, w_margin))
    margin = np.where(is_open, 0.0, margin)

    def where(good: Mask, values: Array) -> Array:
        return np.where(good & ~blurred, values, np.nan)

    return Cycles(
        where(~blurred, margin), where(~blurred, hunts.astype(float)), where(hunts, 2.0 * np.pi / w_cycle),
        where(hunts, amplitude), where(margin > 0.0, w_margin),
    )  # fmt: skip


def _flat(values: Array) -> Array:
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)


def _started(of: Balance, A: Array, T: Array, at: Array) -> tuple[Mask, Array, Array, Array]:
    """The cycle at which a swing of ``DISTURBANCE`` ends: whether there is one, amplitudes of T_sup and u, frequency.

    Where |L| |N| falls through 1 as the amplitude grows, a larger swing decays and a smaller one grows: the cycle is
    stable, and where it rises it parts the swings that grow from those that decay (Gelb and Vander Velde 1968, section
    3.2); on the piece on which the phase of L rises it is the other way round.
    """
    F = of.product
    both = (F[:, :, :-1] > 0.0) & (F[:, :, 1:] > 0.0)
    down, up = (F[:, :, :-1] >= 1.0) & (F[:, :, 1:] < 1.0), (F[:, :, :-1] < 1.0) & (F[:, :, 1:] >= 1.0)
    turned = np.array([False, False, True])[:, None, None]
    stable, parts = np.where(turned, up & both, down), np.where(turned, down, up)
    log_F = np.log(np.maximum(F, 1e-9))
    crossing = stable | parts
    share = np.where(crossing, -log_F[:, :, :-1] / np.where(crossing, np.diff(log_F, axis=2), 1.0), 0.0)
    # where the phases meet no more, it is the last amplitude at which they do
    share = np.where(both, share, 0.0)

    def there(values: Array) -> Array:
        log = np.log(np.maximum(values, 1e-12))
        return _flat(np.exp(log[:, :, :-1] * (1.0 - share) + log[:, :, 1:] * share))

    T_there, w_there, u_there = there(T), there(at), there(np.broadcast_to(A, T.shape))
    is_stable, is_parting = _flat(stable), _flat(parts)
    is_above = T_there > DISTURBANCE
    above, below = np.where(is_stable & is_above, T_there, np.inf), np.where(is_stable & ~is_above, T_there, -np.inf)
    parts_above = np.where(is_parting & is_above, T_there, np.inf).min(axis=1)
    parts_below = np.where(is_parting & ~is_above, T_there, -np.inf).max(axis=1)
    highest, lowest = below.max(axis=1), above.min(axis=1)
    alone = (highest == -np.inf) & (parts_below == -np.inf)
    grows = (parts_below > highest) | (alone & (lowest < parts_above))
    goes_on = np.where(grows, lowest < np.inf, highest > -np.inf)
    rows, k = np.arange(A.shape[0]), np.where(grows, above.argmin(axis=1), below.argmax(axis=1))
    return goes_on, T_there[rows, k], w_there[rows, k], u_there[rows, k]
