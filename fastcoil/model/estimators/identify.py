"""The backlash from the controller's own command and temperature, while it works, without provoking anything.

The play operator turns the command into an opening behind each of CANDIDATES; a linear model from opening to
temperature is fitted to each (``identify_equations``), and the candidates that fit best are the likely ones.  After
Jelali (2008), done recursively.

Only the hours after a step of the set-point count, and not the minutes after a step of the air flow.  Between steps the
command follows the temperature and nothing else, and a stem that stands still looks like one without a gap.  Nothing is
forgotten meanwhile.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.model.estimators.identify_equations import (
    CANDIDATES,
    DRIVEN,
    MOVES,
    OWN,
    WORDS,
    N,
    add_row,
    compare,
    remember_change,
)
from fastcoil.model.estimators.identify_verdict import judged
from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.numerics.elementary import exp
from fastcoil.model.numerics.jit import exact
from fastcoil.model.physics.actuator import motor
from fastcoil.model.physics.valve import backlash

HORIZON = 30.0
"""Seconds over which the model foretells: long against the noise of a sensor, short against a coil."""
SET_POINT_STEP = 0.1
"""A change of the set-point between two samples that is a step, K."""
PROVOKED = 7200.0
"""Seconds after a step that count."""
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
    compares = now.t >= memory.compares_at
    x_hat = now.estimate
    if compares and added > 0.0 and rows >= LEAST_ROWS and compare(w, rows):
        x_hat = judged(w, now.estimate, p.identify_certainty, memory.width > 1.0)
    after = Memory(
        memory.width,
        memory.decay,
        now.t,
        now.T_set,
        now.t + PROVOKED if steps else memory.counts_until,
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


IDENTIFY = Estimator("identify", Parameters, Memory, step, start, words=WORDS + 3 * N, waives_buffer=True)
