"""Where motor and stem stood while a trend log was written: Eq (1) for many candidate sizes of the backlash at once."""

from __future__ import annotations

import numpy as np

from fastcoil.model.numerics.jit import kernel
from fastcoil.model.physics.actuator import motor
from fastcoil.model.physics.valve import backlash, opening


@kernel
def motor_positions(command, most_travel, positions):
    """Motor position at each sample, just before the command of that sample acts, and one sample after the last.

    command: (n,), fraction of stroke, held from sample to sample.  most_travel: fraction of stroke between two samples.
    positions: out, (n + 1,).  The motor stands at the first command when the log begins.
    """
    positions[0] = command[0]
    for k in range(command.size):
        positions[k + 1] = motor(positions[k], command[k], most_travel)


@kernel
def mean_openings(positions, sizes, width, openings, squares):
    """Mean opening behind each candidate backlash, and the mean of its square, over ``width`` intervals at a time.

    positions: (n + 1,), of the motor.  sizes: (c,), fractions of stroke.  openings, squares: out, (m, c); row k covers
    the samples from k · width to (k + 1) · width.

    Between two samples the motor runs one way, so that Eq (1) at the samples is exact; the opening between them counts
    as the mean of both.  Nobody knows where the stem stood when the log began; it starts in the middle of its play, and
    the first turn of the motor that closes the gap makes up for that.
    """
    q = np.empty(sizes.size)
    before = np.empty(sizes.size)
    for j in range(sizes.size):
        q[j] = min(max(positions[0] - sizes[j] / 2.0, 0.0), 1.0 - sizes[j])
        q[j] = backlash(q[j], positions[0], sizes[j])
        before[j] = opening(q[j], sizes[j])
    for k in range(openings.shape[0]):
        for j in range(sizes.size):
            openings[k, j] = 0.0
            squares[k, j] = 0.0
        for i in range(k * width + 1, (k + 1) * width + 1):
            for j in range(sizes.size):
                q[j] = backlash(q[j], positions[i], sizes[j])
                now = opening(q[j], sizes[j])
                between = 0.5 * (before[j] + now)
                openings[k, j] += between / width
                squares[k, j] += between * between / width
                before[j] = now
