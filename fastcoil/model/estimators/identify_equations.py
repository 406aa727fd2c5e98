"""Sums of the normal equations of a linear model for each candidate backlash, and how well each candidate does.

The model is that of ``fastcoil.measured.diagnosis.likelihood``: the change of the temperature over a horizon, from
its own changes before, a constant, and the last changes of the opening behind the candidate.  What the candidates
share is summed once.  All is in one array of WORDS floats, the candidates innermost, so that loops
over them run as vectors.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.numerics.elementary import log
from fastcoil.model.numerics.jit import exact

CANDIDATES = np.concatenate([np.arange(10) * 0.005, np.arange(5, 16) * 0.01, np.array([0.165, 0.18, 0.20, 0.22, 0.25])])
"""Sizes that are compared, fractions of stroke: closer together where a valve is nearly good."""
N = 26
OWN, DRIVEN = 6, 3
"""Changes of the temperature before this one, and of the opening, that the model has."""
MOTOR = OWN + 2
COMMON = MOTOR + 1
"""The change that is to be explained, those before it, the constant, and the change of the motor: in this order."""
PRECISION = 0.01
"""Of the prior of the opening's coefficients, 1/K²: each is known to ± 10 K per stroke before anything is seen."""
REDUNDANT = 1e-10
"""A column of which less than this share is its own is left out."""

LAGS = 0
"""Where each part starts: what the candidates have in common, (COMMON,)."""
SUMS = LAGS + COMMON
"""Sums of their products, (COMMON, COMMON), lower half."""
FACTOR = SUMS + COMMON * COMMON
"""Scratch: the Cholesky factor of those sums but for the first, with the reciprocals of its diagonal."""
SOLVED = FACTOR + COMMON * COMMON
"""Scratch: one row of what is to be explained and DRIVEN rows of the openings, each solved with that factor."""
PROBABILITY = SOLVED + (DRIVEN + 1) * COMMON
"""Log-likelihoods, then probabilities, (N,)."""
EARLIER = PROBABILITY + N
"""The same, with the motor in place of the opening in the horizon in which the change happens."""
MOVES = EARLIER + N
"""Last changes of the opening, (DRIVEN, N)."""
CROSSED = MOVES + DRIVEN * N
"""Sums of their products with LAGS, (DRIVEN, COMMON, N)."""
PAIRED = CROSSED + DRIVEN * COMMON * N
"""Sums of their products with one another, the lower half row by row, (DRIVEN * (DRIVEN + 1) / 2, N)."""
WORDS = PAIRED + DRIVEN * (DRIVEN + 1) // 2 * N


@exact
def remember_change(w, change, moved):
    """Move the last changes of temperature on by one, and put this one, K, in front; moved: that of the motor."""
    for i in range(OWN, 0, -1):
        w[LAGS + i] = w[LAGS + i - 1]
    w[LAGS] = change
    w[LAGS + OWN + 1] = 1.0
    w[LAGS + MOTOR] = moved


@exact
def add_row(w, decay):
    """Add one horizon to all sums; what was in them counts ``decay`` as much as before."""
    for i in range(COMMON):
        for k in range(i + 1):
            at = SUMS + i * COMMON + k
            w[at] = decay * w[at] + w[LAGS + i] * w[LAGS + k]
    for a in range(DRIVEN):
        move = MOVES + a * N
        for i in range(COMMON):
            at, lag = CROSSED + (a * COMMON + i) * N, w[LAGS + i]
            for c in range(N):
                w[at + c] = decay * w[at + c] + lag * w[move + c]
        for b in range(a + 1):
            at, other = PAIRED + (a * (a + 1) // 2 + b) * N, MOVES + b * N
            for c in range(N):
                w[at + c] = decay * w[at + c] + w[move + c] * w[other + c]


@exact
def factorise(w):
    """Cholesky factor of the sums of what comes before a change; a redundant column gets the reciprocal 0."""
    for i in range(1, COMMON):
        for k in range(1, i + 1):
            left = w[SUMS + i * COMMON + k]
            for m in range(1, k):
                left -= w[FACTOR + i * COMMON + m] * w[FACTOR + k * COMMON + m]
            if k < i:
                w[FACTOR + i * COMMON + k] = left * w[FACTOR + k * COMMON + k]
            else:
                own = left > REDUNDANT * w[SUMS + i * COMMON + i]
                w[FACTOR + i * COMMON + i] = 1.0 / np.sqrt(left) if own else 0.0


@exact
def solve_row(w, row, at, stride):
    """Solve the factor for the products at ``at``, ``at + stride`` and so on; into a row of SOLVED."""
    for i in range(1, COMMON):
        left = w[at + i * stride]
        for m in range(1, i):
            left -= w[FACTOR + i * COMMON + m] * w[SOLVED + row * COMMON + m]
        w[SOLVED + row * COMMON + i] = left * w[FACTOR + i * COMMON + i]


@exact
def product(w, row, other, end):
    """Product of two rows of SOLVED up to ``end``: what two columns share with what comes before a change."""
    found = 0.0
    for i in range(1, end):
        found += w[SOLVED + row * COMMON + i] * w[SOLVED + other * COMMON + i]
    return found


@exact
def with_change(w, c, a, end):
    """Product of column a of the openings behind candidate c and the change, less what both share with the rest."""
    return w[CROSSED + a * COMMON * N + c] - product(w, 1 + a, 0, end)


@exact
def with_other(w, c, a, b, end):
    """Product of two columns of the openings behind candidate c, less what both share with the rest; b up to a."""
    return w[PAIRED + (a * (a + 1) // 2 + b) * N + c] - product(w, 1 + a, 1 + b, end)


@exact
def explained(w, c, precision):
    """What the openings behind candidate c explain of the changes, K², and half the log of how sharply.

    Their coefficients have a normal prior of this precision.
    """
    s_00 = with_other(w, c, 0, 0, MOTOR) + precision
    r_10 = with_other(w, c, 1, 0, MOTOR) / s_00
    r_20 = with_other(w, c, 2, 0, MOTOR) / s_00
    s_11 = with_other(w, c, 1, 1, MOTOR) + precision - r_10 * r_10 * s_00
    s_21 = with_other(w, c, 2, 1, MOTOR) - r_10 * r_20 * s_00
    s_22 = with_other(w, c, 2, 2, MOTOR) + precision - r_20 * r_20 * s_00 - s_21 * s_21 / s_11
    b_0 = with_change(w, c, 0, MOTOR)
    b_1 = with_change(w, c, 1, MOTOR) - r_10 * b_0
    b_2 = with_change(w, c, 2, MOTOR) - r_20 * b_0 - s_21 / s_11 * b_1
    found = b_0 * b_0 / s_00 + b_1 * b_1 / s_11 + b_2 * b_2 / s_22
    return found, 0.5 * log(s_00 / precision * (s_11 / precision) * (s_22 / precision))


@exact
def explained_earlier(w, c, precision):
    """The same of the openings before this horizon, with what the motor did in it as given."""
    s_11 = with_other(w, c, 1, 1, COMMON) + precision
    r_21 = with_other(w, c, 2, 1, COMMON) / s_11
    s_22 = with_other(w, c, 2, 2, COMMON) + precision - r_21 * r_21 * s_11
    b_1 = with_change(w, c, 1, COMMON)
    b_2 = with_change(w, c, 2, COMMON) - r_21 * b_1
    return b_1 * b_1 / s_11 + b_2 * b_2 / s_22, 0.5 * log(s_11 / precision * (s_22 / precision))


@exact
def evidence(total, found, sharpness, freedom):
    """Log-likelihood of a candidate that explains ``found`` of the ``total``, K², its coefficients integrated out."""
    left = total - found
    left = REDUNDANT * total if left < REDUNDANT * total else left
    return -0.5 * freedom * log(left / total) - sharpness


@exact
def compare(w, rows):
    """Log-likelihoods of the candidates into PROBABILITY and, of earlier openings alone, into EARLIER.

    rows: horizons in the sums, each by how much it still counts.  Returns whether there is anything to explain.
    """
    factorise(w)
    solve_row(w, 0, SUMS, COMMON)
    total, left = w[SUMS] - product(w, 0, 0, MOTOR), w[SUMS] - product(w, 0, 0, COMMON)
    freedom = rows - OWN - 1.0
    if not (freedom > 1.0 and left > REDUNDANT * w[SUMS]):
        return False
    for c in range(N):
        for a in range(DRIVEN):
            solve_row(w, 1 + a, CROSSED + a * COMMON * N + c, N)
        found, sharpness = explained(w, c, PRECISION * total / freedom)
        w[PROBABILITY + c] = evidence(total, found, sharpness, freedom)
        found, sharpness = explained_earlier(w, c, PRECISION * left / (freedom - 1.0))
        w[EARLIER + c] = evidence(left, found, sharpness, freedom - 1.0)
    return True
