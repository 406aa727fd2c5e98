"""The time shift between the command and the flow of a log: sought stretch by stretch, told, and taken out.

Each candidate shift and backlash turns the command into an opening; a curve of straight lines from opening to flow,
one for the whole log, is solved for linearly.  Shift and backlash are sought at once, so that neither passes for the
other.  The shift of each stretch is the one that fits best, less a price for every shift and every change of it
(Viterbi's search), so that chance moves no log.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import Log
from fastcoil.measured.fit.lag_search import BACKLASHES, Curve, Stretches, cheapest, search, worthwhile
from fastcoil.measured.fit.least_squares import autocorrelation
from fastcoil.measured.fit.play_curve import N_KNOTS, hats
from fastcoil.measured.fit.valve_record import step_of
from fastcoil.model.engine.recorded import valve_flows

_NEAR, _AROUND = 6, 2
"""Shifts tried: up to so many samples either way, and around the one that the cross-correlation proposes."""
_FARTHEST = 7200.0
"""The cross-correlation proposes shifts up to this, s: clocks that differ by an hour."""
_STRETCH = 100
"""Samples: a longer piece is cut into stretches of one to two times this."""
_PRICE, _PRICE_WITHIN = 12.0, 30.0
"""Of a shift and of a change of it between pieces, and of a change within one, in logarithms of likelihood."""
_MOST_MEMORY = 0.98
_ROUND_OFF = 1e-6


def delayed(log: Log, lag: Array | float) -> tuple[Array, Mask]:
    """The command ``lag`` seconds before each sample, (n,) each, and where no row of its piece gives it."""
    given, lag = log.values["command"], np.broadcast_to(lag, log.time.shape)
    command, outside = given.copy(), np.zeros(given.size, dtype=bool)
    for piece in np.split(np.arange(given.size), np.flatnonzero(np.diff(log.batch)) + 1):
        time = log.time[piece]
        wanted = time - lag[piece] + _ROUND_OFF
        at = np.searchsorted(time, wanted, side="right") - 1
        command[piece] = given[piece[np.maximum(at, 0)]]
        outside[piece] = (at < 0) | (wanted > time[-1] + 2.0 * _ROUND_OFF)
    return command, outside


def with_lag(log: Log, lag: float) -> Log:
    """The log with the command that was given ``lag`` seconds before each flow."""
    note = f"the flow is compared with the command {abs(lag):g} s {'before' if lag > 0.0 else 'after'} it, as given"
    return log if lag == 0.0 else _moved(log, np.full(log.time.size, lag), [note])


def without_lag(log: Log, good: Mask, fitting: Mask) -> Log:
    """The log with the shift of each stretch taken out, and a note of it; itself if it has none.

    good, fitting: (n,), samples that may be compared, and those of the part to fit; what follows that part has no
    influence on its shifts.
    """
    step = step_of(log, fitting)
    lags_tried = _lags_to_try(log, good & fitting, step)
    found = _stretches(log, good, fitting, step, lags_tried, 0.0)
    chosen, curve = search(found.of(found.fitted), 1.0)
    memory, _ = _correlation(log, good & fitting, found, chosen, curve, step, 0.0)
    found = _stretches(log, good, fitting, step, lags_tried, memory)
    chosen, curve = search(found.of(found.fitted), 1.0)
    _, worth = _correlation(log, good & fitting, found, chosen, curve, step, memory)
    chosen, curve = search(found.of(found.fitted), worth)
    lags = np.zeros(found.fitted.size)
    lags[found.fitted] = worthwhile(found.of(found.fitted), chosen, curve)
    if not found.fitted.all():
        rest = found.of(~found.fitted)
        lags[~found.fitted] = worthwhile(rest, cheapest(rest, curve), curve)
    shifts = lags[found.number]
    return _moved(log, shifts * step, _told(log, shifts, step)) if shifts.any() else log


def _moved(log: Log, lag: Array, notes: list[str]) -> Log:
    command, outside = delayed(log, lag)
    values = log.values | {"command": command, "m_w": np.where(outside, np.nan, log.values["m_w"])}
    return replace(log, values=values, notes=log.notes + notes)


def _told(log: Log, shifts: Array, step: float) -> list[str]:
    """A sentence for each shift."""
    ends = np.flatnonzero(np.diff(shifts)) + 1
    notes = []
    for run in np.split(np.arange(shifts.size), ends):
        n = int(shifts[run[0]])
        if n == 0:
            continue
        samples = "one sample" if abs(n) == 1 else f"{abs(n)} samples"
        first, last = int(run[0]), int(run[-1])
        where = "throughout" if run.size == shifts.size else f"from row {log.rows[first]}"
        if run.size < shifts.size and log.n_batches > 1:
            where += f" (piece {log.batch[first] + 1} of {log.n_batches})"
        if run.size < shifts.size:
            where += " on" if last == shifts.size - 1 else f" to row {log.rows[last]}"
        what = ("flow", "command") if n > 0 else ("command", "flow")
        notes.append(
            f"{where} the {what[0]} is logged {samples} ({abs(n) * step:g} s) after the {what[1]}: the fit takes this "
            "shift out; lag=0, --lag 0 leaves it in"
        )
    return notes


def _stretches(log: Log, good: Mask, fitting: Mask, step: float, lags: Index, memory: float) -> Stretches:
    """Pieces, long ones cut and none partly fitted, and their sums.

    memory: of the residuals, from one sample to the next; that share of the sample before is subtracted from each.
    """
    n = log.time.size
    border = (np.diff(log.batch) != 0) | (np.diff(fitting.astype(int)) != 0)
    number, price = np.zeros(n, dtype=np.int64), [_PRICE]
    for part in np.split(np.arange(n), np.flatnonzero(border) + 1):
        cuts = max(part.size // _STRETCH, 1)
        number[part] = len(price) - 1 + np.arange(part.size) * cuts // part.size
        price += [_PRICE_WITHIN] * (cuts - 1) + [_PRICE]
    ends = np.searchsorted(number, np.arange(len(price)))
    rows, start = np.ones((5, BACKLASHES.size)), np.full((log.n_batches, BACKLASHES.size), 0.5)
    rows[0] = BACKLASHES
    openings, flows = np.empty((n, BACKLASHES.size)), np.empty((n, BACKLASHES.size))
    sums = np.zeros((len(price) - 1, lags.size, BACKLASHES.size, N_KNOTS + 1, N_KNOTS + 1))
    counts = np.zeros((len(price) - 1, lags.size))
    follows = np.append(False, ~border)
    for i, lag in enumerate(lags):
        command, outside = delayed(log, lag * step)
        valve_flows(command, log.batch, rows, start, openings, flows)
        used = good & ~outside
        if memory:
            used &= follows & np.append(False, used[:-1])
        counts[:, i] = np.add.reduceat(used, ends[:-1])
        for j in range(BACKLASHES.size):
            A = np.column_stack([hats(openings[:, j]), log.values["m_w"]])
            if memory:
                A[1:] -= memory * A[:-1]
            A = np.where(used[:, None], A, 0.0)
            for s in range(len(price) - 1):
                part = A[ends[s] : ends[s + 1]]
                sums[s, i, j] = part.T @ part
    return Stretches(lags, number, sums, counts, np.array(price[:-1]), fitting[ends[:-1]])


def _lags_to_try(log: Log, used: Mask, step: float) -> Index:
    """Shifts in samples: a few either way, and some around the peak of the cross-correlation of the changes."""
    lags = np.arange(-_NEAR, _NEAR + 1)
    most = min(int(_FARTHEST / step), log.time.size // 4)
    both = used[1:] & used[:-1] & (np.diff(log.batch) == 0)
    if most <= _NEAR or not both.any():
        return lags
    moves, answers = (np.where(both, np.diff(log.values[name]), 0.0) for name in ("command", "m_w"))
    size = 1 << (2 * moves.size - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(answers, size) * np.conj(np.fft.rfft(moves, size)), size)
    far = np.concatenate([np.arange(-most, -_NEAR), np.arange(_NEAR + 1, most + 1)])
    peak = int(far[np.argmax(product[far])])
    return np.union1d(lags, np.arange(peak - _AROUND, peak + _AROUND + 1))


def _correlation(
    log: Log, used: Mask, found: Stretches, chosen: Index, curve: Curve, step: float, memory: float
) -> tuple[float, float]:
    """Of the residuals of the fitted part: from one to the next; samples that are worth one independent one.

    memory: what is subtracted from each first, as a share of the one before.
    """
    lags = np.zeros(found.fitted.size)
    lags[found.fitted] = found.lags[chosen]
    command, outside = delayed(log, lags[found.number] * step)
    rows = np.ones((5, 1))
    rows[0] = BACKLASHES[curve.backlash]
    openings, flows = np.empty((log.time.size, 1)), np.empty((log.time.size, 1))
    valve_flows(command, log.batch, rows, np.full((log.n_batches, 1), 0.5), openings, flows)
    used = used & ~outside
    r = np.where(used, hats(openings[:, 0]) @ curve.flows - log.values["m_w"], 0.0)
    r[1:] -= memory * r[:-1]
    n = int(np.flatnonzero(used)[-1]) + 1
    rho = autocorrelation(r[:n], log.batch[:n], used[:n])
    return min(float(rho[0]), _MOST_MEMORY) if rho.size else 0.0, max(1.0 + 2.0 * float(rho.sum()), 1.0)
