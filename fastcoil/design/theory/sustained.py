"""Which of the balanced swings of a loop sustain themselves, and at which of them a disturbance ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask


class Points(NamedTuple):
    """Swings in which the phases of L and N add up to -180°.

    product: |L| |N|.  w: rad/s.  u: amplitude of u, fraction of stroke.  T: amplitude of T_sup, K.
    """

    product: Array
    w: Array
    u: Array
    T: Array


def started(points: Points, disturbance: float) -> tuple[Mask, Points]:
    """The cycle at which a swing of T_sup with the amplitude ``disturbance``, K, ends: whether there is one, and it.

    Where |L| |N| falls through 1 as the amplitude grows, a larger swing decays and a smaller one grows: that cycle
    sustains itself.  Where it rises through 1, it parts the swings that grow from those that decay (Gelb and Vander
    Velde 1968, section 3.2).  Where the phase of L rises with the frequency it is the other way round.

    points: (3, n, n_amplitudes) each, of the pieces of ``harmonic_balance``.
    """
    F = points.product
    before, after = F[:, :, :-1], F[:, :, 1:]
    both = (before > 0.0) & (after > 0.0)
    falls, rises = (before >= 1.0) & (after < 1.0), (before < 1.0) & (after >= 1.0)
    other_way = np.array([False, False, True])[:, None, None]
    stable, parts = np.where(other_way, rises & both, falls), np.where(other_way, falls, rises)
    log_F = np.log(np.maximum(F, 1e-9))
    crossing = both & (stable | parts)
    # where the phases meet no more, the cycle is at the last amplitude at which they do
    share = np.where(crossing, -log_F[:, :, :-1] / np.where(crossing, np.diff(log_F, axis=2), 1.0), 0.0)

    def in_a_row(values: Array | Mask) -> Array:
        return np.asarray(values, float).transpose(1, 0, 2).reshape(values.shape[1], -1)

    def there(values: Array) -> Array:
        log = np.log(np.maximum(values, 1e-12))
        return in_a_row(np.exp(log[:, :, :-1] * (1.0 - share) + log[:, :, 1:] * share))

    at = Points(*map(there, points))
    is_stable, is_parting, is_above = in_a_row(stable) > 0, in_a_row(parts) > 0, at.T > disturbance
    above, below = np.where(is_stable & is_above, at.T, np.inf), np.where(is_stable & ~is_above, at.T, -np.inf)
    parting_above = np.where(is_parting & is_above, at.T, np.inf).min(axis=1)
    parting_below = np.where(is_parting & ~is_above, at.T, -np.inf).max(axis=1)
    nearest_above, nearest_below = above.min(axis=1), below.max(axis=1)
    nothing_below = (nearest_below == -np.inf) & (parting_below == -np.inf)
    grows = (parting_below > nearest_below) | (nothing_below & (nearest_above < parting_above))
    k = np.where(grows, above.argmin(axis=1), below.argmax(axis=1))
    goes_on = np.where(grows, nearest_above < np.inf, nearest_below > -np.inf)
    return goes_on, Points(*(values[np.arange(k.size), k] for values in at))
