"""The backlash from the controller's own command and temperature, while it works, without provoking anything.

The play operator turns the command into an opening behind each of CANDIDATES.  A linear model from opening to
temperature is fitted to each: the change of the temperature over a horizon, from its own changes before, a constant,
and the last changes of the opening behind the candidate, as in ``fastcoil.measured.identify``.  The
candidates that fit best are the likely ones.  After Jelali (2008), done recursively.

Only the hours after a step of the set-point and the time of a valve test count, and not the minutes after a step of the
air flow.  Otherwise the command follows the temperature and nothing else, and a stem that stands still looks like one
without a gap.  Nothing is forgotten meanwhile.

What the candidates share is summed once.  All is in one array of WORDS floats, the candidates innermost, so that loops
over them run as vectors.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import exact
from fastcoil.model.physics import backlash, motor

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
SHARED = SOLVED + (DRIVEN + 1) * COMMON
"""Scratch: what each opening of a candidate shares with the change and not with the rest, (2, DRIVEN): without, and
with the motor among the rest."""
PAIRS = SHARED + 2 * DRIVEN
"""Scratch: the same of the openings with one another, (2, DRIVEN, DRIVEN)."""
PROBABILITY = PAIRS + 2 * DRIVEN * DRIVEN
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
def share_out(w, c):
    """What the openings behind candidate c share with the change, and with one another, less what the rest explains."""
    for a in range(DRIVEN):
        solve_row(w, 1 + a, CROSSED + a * COMMON * N + c, N)
    for a in range(DRIVEN):
        common = 0.0
        for i in range(1, MOTOR):
            common += w[SOLVED + (1 + a) * COMMON + i] * w[SOLVED + i]
        w[SHARED + a] = w[CROSSED + a * COMMON * N + c] - common
        common += w[SOLVED + (1 + a) * COMMON + MOTOR] * w[SOLVED + MOTOR]
        w[SHARED + DRIVEN + a] = w[CROSSED + a * COMMON * N + c] - common
        for b in range(a + 1):
            pair = w[PAIRED + (a * (a + 1) // 2 + b) * N + c]
            common = 0.0
            for i in range(1, MOTOR):
                common += w[SOLVED + (1 + a) * COMMON + i] * w[SOLVED + (1 + b) * COMMON + i]
            w[PAIRS + a * DRIVEN + b] = pair - common
            common += w[SOLVED + (1 + a) * COMMON + MOTOR] * w[SOLVED + (1 + b) * COMMON + MOTOR]
            w[PAIRS + (DRIVEN + a) * DRIVEN + b] = pair - common


@exact
def evidence(total, found, sharpness, freedom):
    """Log-likelihood of a candidate that explains ``found`` of the ``total``, K², its coefficients integrated out."""
    left = total - found
    left = REDUNDANT * total if left < REDUNDANT * total else left
    return -0.5 * freedom * log(left / total) - sharpness


@exact
def weigh(w, c, total, freedom):
    """Log-likelihood of candidate c by all its openings, whose coefficients have a normal prior, into PROBABILITY."""
    prior = PRECISION * total / freedom
    s_00 = w[PAIRS] + prior
    r_10 = w[PAIRS + DRIVEN] / s_00
    r_20 = w[PAIRS + 2 * DRIVEN] / s_00
    s_11 = w[PAIRS + DRIVEN + 1] + prior - r_10 * r_10 * s_00
    s_21 = w[PAIRS + 2 * DRIVEN + 1] - r_10 * r_20 * s_00
    s_22 = w[PAIRS + 2 * DRIVEN + 2] + prior - r_20 * r_20 * s_00 - s_21 * s_21 / s_11
    b_0 = w[SHARED]
    b_1 = w[SHARED + 1] - r_10 * b_0
    b_2 = w[SHARED + 2] - r_20 * b_0 - s_21 / s_11 * b_1
    found = b_0 * b_0 / s_00 + b_1 * b_1 / s_11 + b_2 * b_2 / s_22
    sharpness = 0.5 * log(s_00 / prior * (s_11 / prior) * (s_22 / prior))
    w[PROBABILITY + c] = evidence(total, found, sharpness, freedom)


@exact
def weigh_earlier(w, c, left, freedom):
    """The same by the openings before this horizon, with what the motor did in it as given, into EARLIER."""
    prior = PRECISION * left / freedom
    s_11 = w[PAIRS + (DRIVEN + 1) * DRIVEN + 1] + prior
    r_21 = w[PAIRS + (DRIVEN + 2) * DRIVEN + 1] / s_11
    s_22 = w[PAIRS + (DRIVEN + 2) * DRIVEN + 2] + prior - r_21 * r_21 * s_11
    b_1 = w[SHARED + DRIVEN + 1]
    b_2 = w[SHARED + DRIVEN + 2] - r_21 * b_1
    found = b_1 * b_1 / s_11 + b_2 * b_2 / s_22
    w[EARLIER + c] = evidence(left, found, 0.5 * log(s_11 / prior * (s_22 / prior)), freedom)


@exact
def compare(w, rows):
    """Log-likelihoods of the candidates into PROBABILITY and, of earlier openings alone, into EARLIER.

    rows: horizons in the sums, each by how much it still counts.  Returns whether there is anything to explain.
    """
    factorise(w)
    solve_row(w, 0, SUMS, COMMON)
    common = 0.0
    for i in range(1, MOTOR):
        common += w[SOLVED + i] * w[SOLVED + i]
    total = w[SUMS] - common
    left = w[SUMS] - (common + w[SOLVED + MOTOR] * w[SOLVED + MOTOR])
    freedom = rows - OWN - 1.0
    if not (freedom > 1.0 and left > REDUNDANT * w[SUMS]):
        return False
    for c in range(N):
        share_out(w, c)
        weigh(w, c, total, freedom)
        weigh_earlier(w, c, left, freedom - 1.0)
    return True


WEIGHT = 0.6
"""Share of the log-likelihood that counts: residuals are neither independent nor normal."""
GOOD = 0.01
"""Up to this backlash a valve is called good and left alone; also the least tolerance of an estimate."""
TOLERANCE = 0.2
"""Of an estimate, as a share of it."""
NO_BACKLASH = 0.0051
"""Up to this size a candidate is no backlash."""
DOUBT, DOUBT_EARLIER = 0.005, 0.05
"""Largest probability of no backlash at which there is an estimate: on a good valve each does harm.  The second is by
the openings of earlier horizons, where the controller samples several times in one: there it answers the very change
that is to be explained, and a gap that filters its answer seems to explain the change."""
TOO_LARGE = 0.05
"""Largest probability of being not too large at which an estimate is given up."""


@exact
def right(candidate, estimate):
    """Whether an estimate is right if the backlash is this candidate."""
    tolerance = TOLERANCE * candidate if TOLERANCE * candidate > GOOD else GOOD
    return abs(candidate - estimate) <= tolerance + 1e-9


@exact
def normalise(w, at):
    """Turn the log-likelihoods at ``at`` into probabilities."""
    highest, total = w[at], 0.0
    for c in range(1, N):
        highest = w[at + c] if w[at + c] > highest else highest
    for c in range(N):
        w[at + c] = exp(WEIGHT * (w[at + c] - highest))
        total += w[at + c]
    for c in range(N):
        w[at + c] /= total


@exact
def judged(w, kept, certainty, answers):
    """The estimate after a comparison.

    It is the mean of the probabilities if that is right with this certainty, 0 for a good valve.  Otherwise it is what
    was kept, unless that is nearly certainly too large.  answers: whether the controller samples several times in a
    horizon.
    """
    normalise(w, PROBABILITY)
    normalise(w, EARLIER)
    mean, is_right, is_none, is_none_earlier, is_as_large = 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(N):
        mean += w[PROBABILITY + c] * CANDIDATES[c]
    mean = 0.0 if mean <= GOOD else mean
    for c in range(N):
        p = w[PROBABILITY + c]
        is_right += p if right(CANDIDATES[c], mean) else 0.0
        is_as_large += p if CANDIDATES[c] >= kept or right(CANDIDATES[c], kept) else 0.0
        is_none += p if CANDIDATES[c] <= NO_BACKLASH else 0.0
        is_none_earlier += w[EARLIER + c] if CANDIDATES[c] <= NO_BACKLASH else 0.0
    has_backlash = is_none <= DOUBT and (is_none_earlier <= DOUBT_EARLIER or not answers)
    if is_right >= certainty and (mean == 0.0 or has_backlash):
        return mean
    return (mean if has_backlash else 0.0) if is_as_large <= TOO_LARGE else kept


HORIZON = 30.0
"""Seconds over which the model foretells: long against the noise of a sensor, short against a coil."""
SET_POINT_STEP = 0.1
"""A change of the set-point between two samples that is a step, K."""
PROVOKED, TESTED = 7200.0, 600.0
"""Seconds after a step, and after a valve test, that count."""
AIR_FLOW_STEP, DISTURBED = 0.05, 300.0
"""A change of the air flow in a horizon, as a share of it, after which nothing counts for so many seconds."""
AT_END = 600.0
"""Seconds at an end of the stroke after which nothing counts: the coil is another one there."""
LEAST_ROWS = 60.0
"""Horizons before there is an estimate."""
STEM, OPENED, MEAN = WORDS, WORDS + N, WORDS + 2 * N
"""Behind the normal equations, (N,) each: place in the gap, opening summed over the horizon, mean of the last one."""


@exact
def mean_place(q_before, q, ran, stroke_time, interval):
    """Mean place of a stem over an interval in which it waited for its gap to close, moved, and stopped at q.

    ran: how long the motor ran, s; stroke_time: s.
    """
    moved = q - q_before
    return q - moved * (ran - 0.5 * abs(moved) * stroke_time) / interval


class Parameters(NamedTuple):
    """Parameters of the loop that the identification uses."""

    sample_time: float
    identify_stroke_time: float
    identify_memory: float
    identify_interval: float
    identify_certainty: float


class Memory(NamedTuple):
    """What it remembers beside its array.  NaN: nothing yet."""

    width: float
    """Samples in a horizon."""
    decay: float
    """What a horizon in the sums still counts after one more."""
    sampled_at: float
    """Time of the last sample, s."""
    T_set: float
    """Set-point of the last sample, °C."""
    counts_until: float
    """End of the time that counts, s."""
    left_end_at: float
    """When u was last not at an end of the stroke, s."""
    position: float
    """Of the motor, fraction of stroke."""
    moved: float
    """Sum of its mean places in this horizon so far, and their mean in the one before."""
    motor: float
    samples: float
    """Since the horizon began."""
    T: float
    """Temperature when it began, °C."""
    m_a: float
    """Air flow when it began, kg/s; NaN where it is not known."""
    resumes: float
    """End of the time that does not count after a step of the air flow, s."""
    horizons: float
    """Since the last interruption."""
    rows: float
    """Horizons in the sums, each by how much it still counts."""
    compares_at: float
    """When the candidates are compared next, s."""
    added: float
    """1 if a horizon was added since the last time."""


@exact
def start(p):
    """Memory at the start: a valve at rest and closed."""
    width = np.floor(HORIZON / p.sample_time + 0.5)
    width = 1.0 if width < 1.0 else width
    decay = exp(-width * p.sample_time / p.identify_memory)
    first = p.identify_interval
    return Memory(
        width, decay, 0.0, np.nan, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.nan, np.nan, 0.0, 0.0, 0.0, first, 0.0,
    )  # fmt: skip


@exact
def close_horizon(w, width, change, moved):
    """Take the changes over the horizon that ends: of the temperature, K, the motor, and the candidates' openings."""
    remember_change(w, change, moved)
    for a in range(DRIVEN - 1, 0, -1):
        for c in range(N):
            w[MOVES + a * N + c] = w[MOVES + (a - 1) * N + c]
    for c in range(N):
        mean = w[OPENED + c] / width
        w[MOVES + c] = mean - w[MEAN + c]
        w[MEAN + c] = mean
        w[OPENED + c] = 0.0


@exact
def move_stems(w, position, ran, stroke_time, interval):
    """Move the stem behind each candidate with the motor, and add its mean opening to the horizon."""
    for c in range(N):
        q = backlash(w[STEM + c], position, CANDIDATES[c])
        mean = mean_place(w[STEM + c], q, ran, stroke_time, interval)
        w[OPENED + c] += mean / (1.0 - CANDIDATES[c])
        w[STEM + c] = q


@exact
def step(now, p, memory, w):
    """Follow motor and stems to this sample, close the horizon where one ends, and compare at every interval.

    The temperature is that of the sample before: the openings up to then are in the sums already.  After an
    interruption the motor stands where the command is, or on its way, and the lags start anew.
    """
    elapsed = now.t - memory.sampled_at
    interrupted = elapsed > 1.5 * p.sample_time
    begins = interrupted or np.isnan(memory.T)
    ends = begins or memory.samples == memory.width
    inside = now.u > 0.0 and now.u < 1.0
    left_end_at = now.t if inside or interrupted else memory.left_end_at
    horizons = 0.0 if begins else memory.horizons
    rows, added = memory.rows, memory.added
    gusts = ends and abs(now.m_a - memory.m_a) > AIR_FLOW_STEP * memory.m_a
    resumes = now.t + DISTURBED if gusts else memory.resumes
    motor_now = memory.moved / memory.width
    if ends:
        close_horizon(w, memory.width, 0.0 if begins else now.T - memory.T, motor_now - memory.motor)
        horizons += 0.0 if begins else 1.0
        if horizons > OWN and resumes <= now.t <= memory.counts_until and now.t - left_end_at <= AT_END:
            add_row(w, memory.decay)
            rows = memory.decay * rows + 1.0
            added = 1.0

    most = elapsed / p.identify_stroke_time if p.identify_stroke_time > 0.0 else np.inf
    position = motor(memory.position, now.command, most)
    ran = abs(position - memory.position) * p.identify_stroke_time
    place = mean_place(memory.position, position, ran, p.identify_stroke_time, elapsed)
    move_stems(w, position, ran, p.identify_stroke_time, elapsed)

    steps = abs(now.T_set - memory.T_set) >= SET_POINT_STEP
    counts_until = now.t + PROVOKED if steps else memory.counts_until
    after_test = now.t + TESTED
    counts_until = after_test if now.test > 0.0 and after_test > counts_until else counts_until
    compares = now.t >= memory.compares_at
    x_hat = now.estimate
    if compares and added > 0.0 and rows >= LEAST_ROWS and compare(w, rows):
        x_hat = judged(w, now.estimate, p.identify_certainty, memory.width > 1.0)
    after = Memory(
        memory.width,
        memory.decay,
        now.t,
        now.T_set,
        counts_until,
        left_end_at,
        position,
        place if ends else memory.moved + place,
        motor_now if ends else memory.motor,
        1.0 if ends else memory.samples + 1.0,
        np.nan if interrupted else (now.T if ends else memory.T),
        now.m_a if ends else memory.m_a,
        resumes,
        horizons,
        rows,
        now.t + p.identify_interval if compares else memory.compares_at,
        0.0 if compares else added,
    )
    return x_hat, after


ESTIMATOR = Estimator("identify", Parameters, Memory, step, start, words=WORDS + 3 * N, waives_buffer=True)
