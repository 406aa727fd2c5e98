"""The backlash from the controller's own command and temperature, while it works, without provoking anything.

The play operator turns the command into an opening behind each of CANDIDATES.  A linear model from opening to
temperature is fitted to each: the change of the temperature over a horizon, from its changes before, a constant, and
the last changes of the opening behind the candidate, as in ``fastcoil.measured.identify``.  The candidates that fit
best are the likely ones.  After Jelali (2008), done recursively.

The model knows all samples before a horizon and nothing of what happens in it.  Otherwise a controller that samples
several times in a horizon makes a good valve look worn: its command follows the noise of the sensor, the temperature
does not follow that command, and a gap filters it out of the opening.

Only the hours after a step of the set-point and the time of a valve test count, and not the minutes after a step of the
air flow.  Otherwise the command follows the temperature and nothing else, and a stem that stands still looks like one
without a gap.  Nothing is forgotten meanwhile.

Sums that the candidates share are taken once.  All is in one array of floats, the candidates innermost, so that loops
over them run as vectors.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import exact
from fastcoil.model.physics import backlash, motor_position

CANDIDATES = np.concatenate(
    [[0.0], np.arange(10) * 0.005, np.arange(5, 16) * 0.01, np.array([0.165, 0.18, 0.20, 0.22, 0.25])]
)
"""Sizes that are compared, fractions of stroke: closer together where a valve is nearly good.

The first has no motor either: its stem is where the command is.  A motor that is faster than reckoned makes a good
valve look worn.
"""
N_CANDIDATES = 27  # of ``CANDIDATES``
N_LAGS = 6  # changes of the temperature before this one, in the model
N_MOVES = 3  # last changes of the opening, in the model
DEVIATION_AT = N_LAGS + 2  # index of the deviation among what the candidates have in common
N_COMMON = DEVIATION_AT + 1
"""The change to be explained, those before it, the constant, and the deviation of the last temperature from the mean of
its horizon, in this order."""
PRIOR_PRECISION = 0.01  # of the coefficients of the opening, 1/K²: ± 10 K per stroke before anything is seen
REDUNDANT_SHARE = 1e-10  # a column of which less than this share is independent of the others is left out

# Where each part of the array starts, and its shape.
LAGS_AT = 0  # (N_COMMON,): what the candidates have in common
SUMS_AT = LAGS_AT + N_COMMON  # (N_COMMON, N_COMMON), lower half: sums of their products
FACTOR_AT = SUMS_AT + N_COMMON * N_COMMON
"""Scratch: the Cholesky factor of those sums but for the first, with the reciprocals of its diagonal."""
SOLVED_AT = FACTOR_AT + N_COMMON * N_COMMON
"""Scratch: a row of what is to be explained and N_MOVES rows of the openings, each solved with that factor."""
RESIDUALS_AT = SOLVED_AT + (N_MOVES + 1) * N_COMMON
"""Scratch, (N_MOVES,): product of each opening of a candidate with the change, less what the rest explains."""
PAIRS_AT = RESIDUALS_AT + N_MOVES  # scratch, (N_MOVES, N_MOVES): products of the openings, likewise
P_AT = PAIRS_AT + N_MOVES * N_MOVES  # (N_CANDIDATES,): log-likelihoods, then probabilities
MOVES_AT = P_AT + N_CANDIDATES
"""(N_MOVES, N_CANDIDATES): last changes of the mean opening from horizon to horizon; that to the present one as if the
stem stood still after the first sample."""
CROSS_AT = MOVES_AT + N_MOVES * N_CANDIDATES
"""(N_MOVES, N_COMMON, N_CANDIDATES): sums of their products with what the candidates have in common."""
PRODUCTS_AT = CROSS_AT + N_MOVES * N_COMMON * N_CANDIDATES
"""(N_MOVES * (N_MOVES + 1) / 2, N_CANDIDATES): sums of their products with one another, lower half row by row."""
STEMS_AT = PRODUCTS_AT + N_MOVES * (N_MOVES + 1) // 2 * N_CANDIDATES  # (N_CANDIDATES,): place of each stem
OPENING_SUMS_AT = STEMS_AT + N_CANDIDATES  # (N_CANDIDATES,): opening summed over the horizon
OPENING_MEANS_AT = OPENING_SUMS_AT + N_CANDIDATES  # (N_CANDIDATES,): mean opening of the last horizon
N_FLOATS = OPENING_MEANS_AT + N_CANDIDATES  # size of the array


@exact
def remember_change(w, change):
    """Shift the last changes of temperature by one, and put this one, K, in front."""
    for i in range(N_LAGS, 0, -1):
        w[LAGS_AT + i] = w[LAGS_AT + i - 1]
    w[LAGS_AT] = change
    w[LAGS_AT + N_LAGS + 1] = 1.0


@exact
def add_row(w, decay):
    """Add one horizon to all sums, which first ``decay``; the more the motor moves, the less the horizon counts."""
    move = 0.0
    for a in range(N_MOVES):
        move += abs(w[MOVES_AT + a * N_CANDIDATES + 1])
    weight = 1.0 / (1.0 + move * move / (LINEAR_MOVE * LINEAR_MOVE))
    for i in range(N_COMMON):
        for k in range(i + 1):
            at = SUMS_AT + i * N_COMMON + k
            w[at] = decay * w[at] + weight * w[LAGS_AT + i] * w[LAGS_AT + k]
    for a in range(N_MOVES):
        first_move = MOVES_AT + a * N_CANDIDATES
        for i in range(N_COMMON):
            at, lag = CROSS_AT + (a * N_COMMON + i) * N_CANDIDATES, weight * w[LAGS_AT + i]
            for c in range(N_CANDIDATES):
                w[at + c] = decay * w[at + c] + lag * w[first_move + c]
        for b in range(a + 1):
            at, other_move = PRODUCTS_AT + (a * (a + 1) // 2 + b) * N_CANDIDATES, MOVES_AT + b * N_CANDIDATES
            for c in range(N_CANDIDATES):
                w[at + c] = decay * w[at + c] + weight * w[first_move + c] * w[other_move + c]


@exact
def factorise(w):
    """Store the Cholesky factor of the sums of what comes before a change; a redundant column gets the reciprocal 0."""
    for i in range(1, N_COMMON):
        for k in range(1, i + 1):
            remainder = w[SUMS_AT + i * N_COMMON + k]
            for m in range(1, k):
                remainder -= w[FACTOR_AT + i * N_COMMON + m] * w[FACTOR_AT + k * N_COMMON + m]
            if k < i:
                w[FACTOR_AT + i * N_COMMON + k] = remainder * w[FACTOR_AT + k * N_COMMON + k]
            else:
                is_independent = remainder > REDUNDANT_SHARE * w[SUMS_AT + i * N_COMMON + i]
                w[FACTOR_AT + i * N_COMMON + i] = 1.0 / np.sqrt(remainder) if is_independent else 0.0


@exact
def solve_row(w, row, at, stride):
    """Solve the Cholesky factor for the sums at ``at``, ``at + stride``, …; store the result as a row at SOLVED_AT."""
    for i in range(1, N_COMMON):
        remainder = w[at + i * stride]
        for m in range(1, i):
            remainder -= w[FACTOR_AT + i * N_COMMON + m] * w[SOLVED_AT + row * N_COMMON + m]
        w[SOLVED_AT + row * N_COMMON + i] = remainder * w[FACTOR_AT + i * N_COMMON + i]


@exact
def project_out_common(w, c):
    """Store the products of candidate c's openings with the change and one another, less what the rest explains."""
    for a in range(N_MOVES):
        solve_row(w, 1 + a, CROSS_AT + a * N_COMMON * N_CANDIDATES + c, N_CANDIDATES)
    for a in range(N_MOVES):
        common = 0.0
        for i in range(1, N_COMMON):
            common += w[SOLVED_AT + (1 + a) * N_COMMON + i] * w[SOLVED_AT + i]
        w[RESIDUALS_AT + a] = w[CROSS_AT + a * N_COMMON * N_CANDIDATES + c] - common
        for b in range(a + 1):
            common = 0.0
            for i in range(1, N_COMMON):
                common += w[SOLVED_AT + (1 + a) * N_COMMON + i] * w[SOLVED_AT + (1 + b) * N_COMMON + i]
            w[PAIRS_AT + a * N_MOVES + b] = w[PRODUCTS_AT + (a * (a + 1) // 2 + b) * N_CANDIDATES + c] - common


@exact
def log_likelihood(total, explained, sharpness, freedom):
    """Log-likelihood of a candidate that explains so much of the ``total``, K², its coefficients integrated out."""
    residual = total - explained
    residual = REDUNDANT_SHARE * total if residual < REDUNDANT_SHARE * total else residual
    return -0.5 * freedom * log(residual / total) - sharpness


@exact
def weigh_candidate(w, c, total, freedom):
    """Store the log-likelihood of candidate c by all its openings, whose coefficients have a normal prior."""
    prior = PRIOR_PRECISION * total / freedom
    s_00 = w[PAIRS_AT] + prior
    r_10 = w[PAIRS_AT + N_MOVES] / s_00
    r_20 = w[PAIRS_AT + 2 * N_MOVES] / s_00
    s_11 = w[PAIRS_AT + N_MOVES + 1] + prior - r_10 * r_10 * s_00
    s_21 = w[PAIRS_AT + 2 * N_MOVES + 1] - r_10 * r_20 * s_00
    s_22 = w[PAIRS_AT + 2 * N_MOVES + 2] + prior - r_20 * r_20 * s_00 - s_21 * s_21 / s_11
    b_0 = w[RESIDUALS_AT]
    b_1 = w[RESIDUALS_AT + 1] - r_10 * b_0
    b_2 = w[RESIDUALS_AT + 2] - r_20 * b_0 - s_21 / s_11 * b_1
    explained = b_0 * b_0 / s_00 + b_1 * b_1 / s_11 + b_2 * b_2 / s_22
    sharpness = 0.5 * log(s_00 / prior * (s_11 / prior) * (s_22 / prior))
    w[P_AT + c] = log_likelihood(total, explained, sharpness, freedom)


@exact
def compare_candidates(w, rows):
    """Store the log-likelihoods of the candidates after ``rows`` horizons; return whether any can be told apart."""
    factorise(w)
    solve_row(w, 0, SUMS_AT, N_COMMON)
    total = w[SUMS_AT]
    for i in range(1, N_COMMON):
        total -= w[SOLVED_AT + i] * w[SOLVED_AT + i]
    freedom = rows - N_LAGS - 2.0
    if not (freedom > 1.0 and total > REDUNDANT_SHARE * w[SUMS_AT]):
        return False
    for c in range(N_CANDIDATES):
        project_out_common(w, c)
        weigh_candidate(w, c, total, freedom)
    return True


# calibrated in studies/learning/identify_online.py
LIKELIHOOD_WEIGHT = 0.6  # share of the log-likelihood that counts: residuals are neither independent nor normal
GOOD_BACKLASH = 0.01  # up to this a valve is called good and left alone; also the least tolerance of an estimate
TOLERANCE_SHARE = 0.2  # of the backlash, by which a right estimate may be off
NEGLIGIBLE_BACKLASH = 0.0051  # up to this a candidate is no backlash
LARGEST_P_NONE = 0.002  # probability of no backlash at which there is an estimate: on a good valve each does harm
GIVE_UP_PROBABILITY = 0.05  # largest probability of being not too large at which an estimate is given up
LINEAR_MOVE = 0.03  # motor's move over N_MOVES horizons, fraction of stroke, at which a horizon counts half
HORIZON_S = 30.0  # over which the model predicts: long against the noise of a sensor, short against a coil
SET_POINT_STEP_K = 0.1  # change between two samples that is a step
COUNTS_AFTER_STEP_S = 7200.0  # time after a step that counts
COUNTS_AFTER_TEST_S = 600.0  # time after a valve test that counts
AIR_FLOW_STEP_SHARE = 0.05  # change in a horizon that is a gust, over the flow
PAUSE_AFTER_GUST_S = 300.0  # time after a gust in which nothing counts
MOST_AT_END_S = 600.0  # time at an end of the stroke, after which nothing counts: the coil is another one there
LEAST_ROWS = 60.0  # number of horizons before there is an estimate


@exact
def is_right_estimate(candidate, estimate):
    """Whether an estimate is right if the backlash is this candidate."""
    tolerance = TOLERANCE_SHARE * candidate if TOLERANCE_SHARE * candidate > GOOD_BACKLASH else GOOD_BACKLASH
    return abs(candidate - estimate) <= tolerance + 1e-9


@exact
def normalise_probabilities(w):
    """Turn the log-likelihoods into probabilities."""
    highest, total = w[P_AT], 0.0
    for c in range(1, N_CANDIDATES):
        highest = w[P_AT + c] if w[P_AT + c] > highest else highest
    for c in range(N_CANDIDATES):
        w[P_AT + c] = exp(LIKELIHOOD_WEIGHT * (w[P_AT + c] - highest))
        total += w[P_AT + c]
    for c in range(N_CANDIDATES):
        w[P_AT + c] /= total


@exact
def decide_estimate(w, estimate, certainty):
    """Return the estimate after a comparison of the candidates.

    It is the mean of the probabilities if that is right with this certainty, 0 for a good valve.  Otherwise it stays,
    unless it is nearly certainly too large.
    """
    normalise_probabilities(w)
    mean, p_right, p_none, p_as_large = 0.0, 0.0, 0.0, 0.0
    for c in range(N_CANDIDATES):
        mean += w[P_AT + c] * CANDIDATES[c]
    mean = 0.0 if mean <= GOOD_BACKLASH else mean
    for c in range(N_CANDIDATES):
        p = w[P_AT + c]
        p_right += p if is_right_estimate(CANDIDATES[c], mean) else 0.0
        p_as_large += p if CANDIDATES[c] >= estimate or is_right_estimate(CANDIDATES[c], estimate) else 0.0
        p_none += p if CANDIDATES[c] <= NEGLIGIBLE_BACKLASH else 0.0
    has_backlash = p_none <= LARGEST_P_NONE
    if p_right >= certainty and (mean == 0.0 or has_backlash):
        return mean
    return (mean if has_backlash else 0.0) if p_as_large <= GIVE_UP_PROBABILITY else estimate


@exact
def mean_position(q_before, q, running_time, stroke_time, interval):
    """Mean place of a stem over an interval in which it waited for its gap to close, moved, and stopped at q."""
    stroke = q - q_before
    return q - stroke * (running_time - 0.5 * abs(stroke) * stroke_time) / interval


class Parameters(NamedTuple):
    """Parameters of the loop that the identification reads."""

    sample_time: float
    identify_stroke_time: float
    identify_memory: float
    identify_interval: float
    identify_certainty: float


class Memory(NamedTuple):
    """State from one sample to the next, beside the array.  NaN: nothing yet."""

    width: float  # number of samples in a horizon
    decay: float  # weight of a horizon in the sums after one more
    sampled_at: float  # time of the last sample, s
    T_set: float  # set-point of the last sample, °C
    counts_until: float  # end of the time that counts, s
    left_end_at: float  # when u was last not at an end of the stroke, s
    position: float  # position of the motor, fraction of stroke
    n_samples: float  # number of samples since the horizon began
    T: float  # temperature when it began, °C
    T_rise_sum: float  # sum over its samples of the rise since then, K
    m_a: float  # air flow when it began, kg/s; NaN where it is not known
    resumes_at: float  # end of the time that does not count after a step of the air flow, s
    n_horizons: float  # number of horizons since the last interruption
    rows: float  # number of horizons in the sums, each by how much it still counts
    compares_at: float  # time of the next comparison, s
    has_new_row: float  # 1 if a horizon was added since the last comparison


@exact
def initial_memory(p):
    """Memory at the start: a valve at rest and closed."""
    width = np.floor(HORIZON_S / p.sample_time + 0.5)
    width = 1.0 if width < 1.0 else width
    decay = exp(-width * p.sample_time / p.identify_memory)
    first = p.identify_interval
    return Memory(
        width, decay, 0.0, np.nan, -1.0, 0.0, 0.0, 0.0, np.nan, 0.0, np.nan, 0.0, 0.0, 0.0, first, 0.0,
    )  # fmt: skip


@exact
def close_horizon(w, width, deviation):
    """Store the changes of mean openings to the horizon that ends; deviation: of its last temperature, K."""
    w[LAGS_AT + DEVIATION_AT] = deviation
    for c in range(N_CANDIDATES):
        for a in range(N_MOVES - 1, 1, -1):
            w[MOVES_AT + a * N_CANDIDATES + c] = w[MOVES_AT + (a - 1) * N_CANDIDATES + c]
        mean = w[OPENING_SUMS_AT + c] / width
        w[MOVES_AT + N_CANDIDATES + c] = mean - w[OPENING_MEANS_AT + c]
        w[OPENING_MEANS_AT + c] = mean
        w[OPENING_SUMS_AT + c] = 0.0


@exact
def move_stems(w, command, position, running_time, stroke_time, interval):
    """Move the stem behind each candidate with the motor, the first with the command; add each mean opening."""
    w[OPENING_SUMS_AT] += command
    w[STEMS_AT] = command
    for c in range(1, N_CANDIDATES):
        q = backlash(w[STEMS_AT + c], position, CANDIDATES[c])
        mean = mean_position(w[STEMS_AT + c], q, running_time, stroke_time, interval)
        w[OPENING_SUMS_AT + c] += mean / (1.0 - CANDIDATES[c])
        w[STEMS_AT + c] = q


@exact
def predict_openings(w, width):
    """Store the changes of the mean openings to this horizon if no stem moves after its first sample."""
    for c in range(N_CANDIDATES):
        rest = (width - 1.0) * w[STEMS_AT + c] / (1.0 - CANDIDATES[c])
        w[MOVES_AT + c] = (w[OPENING_SUMS_AT + c] + rest) / width - w[OPENING_MEANS_AT + c]


@exact
def update_estimate(now, p, memory, w):
    """Follow motor and stems to this sample, close the horizon where one ends, and compare at every interval.

    The temperature is that of the sample before: the openings up to then are in the sums already.  After an
    interruption the motor stands where the command is, or on its way, and the lags start anew.
    """
    elapsed = now.t - memory.sampled_at
    interrupted = elapsed > 1.5 * p.sample_time
    begins = interrupted or np.isnan(memory.T)
    ends = begins or memory.n_samples == memory.width
    inside = now.u > 0.0 and now.u < 1.0
    left_end_at = now.t if inside or interrupted else memory.left_end_at
    n_horizons = 0.0 if begins else memory.n_horizons
    rows, has_new_row = memory.rows, memory.has_new_row
    has_gust = ends and abs(now.m_a - memory.m_a) > AIR_FLOW_STEP_SHARE * memory.m_a
    resumes_at = now.t + PAUSE_AFTER_GUST_S if has_gust else memory.resumes_at
    T_rise = 0.0 if begins else now.T - memory.T
    if ends:
        remember_change(w, T_rise)
        n_horizons += 0.0 if begins else 1.0
        if n_horizons > N_LAGS and resumes_at <= now.t <= memory.counts_until and now.t - left_end_at <= MOST_AT_END_S:
            add_row(w, memory.decay)
            rows = memory.decay * rows + 1.0
            has_new_row = 1.0
        close_horizon(w, memory.width, T_rise - memory.T_rise_sum / memory.width)

    max_travel = elapsed / p.identify_stroke_time if p.identify_stroke_time > 0.0 else np.inf
    position = motor_position(memory.position, now.command, max_travel)
    running_time = abs(position - memory.position) * p.identify_stroke_time
    move_stems(w, now.command, position, running_time, p.identify_stroke_time, elapsed)
    if ends:
        predict_openings(w, memory.width)

    has_step = abs(now.T_set - memory.T_set) >= SET_POINT_STEP_K
    counts_until = now.t + COUNTS_AFTER_STEP_S if has_step else memory.counts_until
    after_test = now.t + COUNTS_AFTER_TEST_S
    counts_until = after_test if now.test > 0.0 and after_test > counts_until else counts_until
    compares = now.t >= memory.compares_at
    x_hat = now.estimate
    if compares and has_new_row > 0.0 and rows >= LEAST_ROWS and compare_candidates(w, rows):
        x_hat = decide_estimate(w, now.estimate, p.identify_certainty)
    next_memory = Memory(
        memory.width,
        memory.decay,
        now.t,
        now.T_set,
        counts_until,
        left_end_at,
        position,
        1.0 if ends else memory.n_samples + 1.0,
        np.nan if interrupted else (now.T if ends else memory.T),
        0.0 if ends else memory.T_rise_sum + T_rise,
        now.m_a if ends else memory.m_a,
        resumes_at,
        n_horizons,
        rows,
        now.t + p.identify_interval if compares else memory.compares_at,
        0.0 if compares else has_new_row,
    )
    return x_hat, next_memory


ESTIMATOR = Estimator(
    "identify", Parameters, Memory, update_estimate, initial_memory, n_floats=N_FLOATS, waives_buffer=True
)
