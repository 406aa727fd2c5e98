"""The backlash from command and temperature: every candidate's model fitted to the whole record, time and again."""

import math

import numpy as np

from reference.fixed import Fixed
from reference.rounding import clip

CANDIDATES = [
    0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04, 0.045, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12,
    0.13, 0.14, 0.15, 0.165, 0.18, 0.2, 0.22, 0.25,
]  # fmt: skip


def line(start, end, stroke_time, seconds):
    """Corners of the path of a motor: times and places, while it runs from start to end and then stands."""
    running = abs(end - start) * stroke_time
    return [0.0, running, seconds], [start, end, end]


def behind(times, places, stem, gap, seconds):
    """Where a stem behind a gap ends on the way of a motor, and its mean place."""
    end = clip(stem, places[-1] - gap, places[-1])
    if end == stem:
        return stem, stem
    # the motor runs one way: the stem waits until the flank that pushes it arrives
    touches = stem + gap if places[-1] > places[0] else stem
    waits = times[1] * (touches - places[0]) / (places[1] - places[0])
    area = stem * waits + 0.5 * (stem + end) * (times[1] - waits) + end * (seconds - times[1])
    return end, area / seconds


class Identify(Fixed):
    """Whole record in lists; a row of the model is one horizon of 30 s, or one sample if that is longer."""

    def __init__(self, parameters):
        super().__init__(parameters)
        p = parameters
        self.sample_time, self.stroke_time = p["sample_time"], p["identify_stroke_time"]
        self.width = max(1, math.floor(30.0 / self.sample_time + 0.5))
        self.decay = math.exp(-self.width * self.sample_time / p["identify_memory"])
        self.interval, self.certainty = p["identify_interval"], p["identify_certainty"]
        self.next_comparison = self.interval
        self.motor, self.stems = 0.0, [0.0] * len(CANDIDATES)
        self.before, self.T_set, self.step_at, self.inside_at = 0.0, None, -math.inf, 0.0
        self.m_a, self.gust_at = math.nan, -math.inf
        self.rows, self.rows_compared = [], 0  # (change and 6 before, 3 changes of the openings, that of the motor)
        self.begin()

    def begin(self):
        """Nothing of what came before is known to be unbroken."""
        self.temperatures, self.means, self.openings, self.places, self.place_means = [], [], None, [], []

    def look(self, t, seen):
        """One more sample."""
        if t % self.sample_time != 0 or not seen.enabled:
            return
        elapsed, interrupted = t - self.before, t - self.before > 1.5 * self.sample_time
        if interrupted or 0.0 < seen.u < 1.0:
            self.inside_at = t
        if interrupted or self.openings is None or len(self.openings) == self.width:
            self.gust_at = t if abs(seen.m_a - self.m_a) > 0.05 * self.m_a else self.gust_at
            self.m_a = seen.m_a
        if interrupted:
            self.begin()
        elif self.openings is None:
            self.temperatures, self.openings, self.places = [seen.T], [], []
        elif len(self.openings) == self.width:
            self.temperatures.append(seen.T)
            self.means.append(np.mean(self.openings, axis=0))
            self.place_means.append(np.mean(self.places))
            self.openings, self.places = [], []
            quiet = t - self.gust_at >= 300.0 and t - self.inside_at <= 600.0
            if len(self.temperatures) >= 8 and t - self.step_at <= 7200.0 and quiet:
                moves = np.diff(self.means[-4:], axis=0)[::-1]
                self.rows.append((np.diff(self.temperatures[-8:])[::-1], moves, np.diff(self.place_means[-2:])))

        most = elapsed / self.stroke_time if self.stroke_time > 0.0 else math.inf
        end = clip(seen.command, self.motor - most, self.motor + most)
        path = line(self.motor, end, self.stroke_time, elapsed)
        found = [behind(*path, q, x, elapsed) for q, x in zip(self.stems, CANDIDATES, strict=True)]
        self.motor, self.stems = end, [q for q, _ in found]
        if self.openings is not None:
            self.places.append(behind(*path, path[1][0], 0.0, elapsed)[1])
            self.openings.append([mean / (1.0 - x) for (_, mean), x in zip(found, CANDIDATES, strict=True)])

        if self.T_set is not None and abs(seen.T_set - self.T_set) >= 0.1:
            self.step_at = t
        self.T_set, self.before = seen.T_set, t
        if t >= self.next_comparison:
            self.next_comparison = t + self.interval
            if len(self.rows) > self.rows_compared:
                self.rows_compared = len(self.rows)
                self.compare()

    def compare(self):
        """Fit every candidate to all rows, and see what may be said."""
        n = len(self.rows)
        root = np.sqrt(self.decay ** np.arange(n - 1, -1, -1.0))[:, np.newaxis]
        counted = float(np.sum(root**2))
        if counted < 60.0:
            return
        changes = np.array([row[0] for row in self.rows]) * root
        moves = np.array([row[1] for row in self.rows]) * root[:, np.newaxis]
        motor = np.array([row[2] for row in self.rows]) * root
        before = np.hstack([changes[:, 1:], root])
        plain = probabilities(changes[:, 0], before, moves, counted - 7.0)
        earlier = probabilities(changes[:, 0], np.hstack([before, motor]), moves[:, 1:], counted - 8.0)
        self.judge(plain, earlier if self.width > 1 else plain)

    def judge(self, probability, earlier):
        """Keep the estimate, or take the mean of the probabilities, or none."""
        sizes = np.array(CANDIDATES)
        tolerance = np.maximum(0.2 * sizes, 0.01) + 1e-9
        mean = float(probability @ sizes)
        mean = mean if mean > 0.01 else 0.0
        none = sizes <= 0.0051
        has_backlash = probability[none].sum() <= 0.005 and earlier[none].sum() <= 0.05
        right = probability[abs(sizes - mean) <= tolerance].sum()
        not_too_large = probability[sizes >= self.estimate - tolerance * (sizes < self.estimate)].sum()
        if right >= self.certainty and (has_backlash or mean == 0.0):
            self.estimate = mean
        elif not_too_large <= 0.05:
            self.estimate = mean if has_backlash else 0.0


def probabilities(change, before, moves, freedom):
    """Of the candidates, from one row a horizon: changes, what comes before them, moves of the openings (n, k, N)."""
    own, _ = np.linalg.qr(before)
    y = change - own @ (own.T @ change)
    precision = 0.01 * (y @ y) / freedom
    evidence = []
    for moved in moves.transpose(2, 0, 1):
        D = moved - own @ (own.T @ moved)
        # coefficients have this precision each, so that the changes have 1 + D D' / precision times their variance
        small = np.eye(D.shape[1]) + D.T @ D / precision
        left = y @ y - y @ D @ np.linalg.solve(small, D.T @ y) / precision
        evidence.append(-0.5 * freedom * math.log(left / (y @ y)) - 0.5 * math.log(np.linalg.det(small)))
    found = np.exp(0.6 * (np.array(evidence) - max(evidence)))
    return found / found.sum()
