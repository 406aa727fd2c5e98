"""The backlash from command and temperature: the model of every candidate, fitted to the whole record repeatedly."""

import math

import numpy as np

from reference.fixed import FixedEstimate
from reference.rounding import clip

CANDIDATES = [
    0.0, 0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04, 0.045, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12,
    0.13, 0.14, 0.15, 0.165, 0.18, 0.2, 0.22, 0.25,
]  # fmt: skip


def motor_path(start, end, stroke_time, seconds):
    """Times and positions of the corners of a motor's path: it runs from start to end and then stands."""
    running = abs(end - start) * stroke_time
    return [0.0, running, seconds], [start, end, end]


def stem_behind_gap(times, places, stem, gap, seconds):
    """Final and mean position of a stem behind a gap along the path of a motor."""
    end = clip(stem, places[-1] - gap, places[-1])
    if end == stem:
        return stem, stem
    # the motor runs one way: the stem waits until the flank that pushes it arrives
    contact = stem + gap if places[-1] > places[0] else stem
    waiting_time = times[1] * (contact - places[0]) / (places[1] - places[0])
    area = stem * waiting_time + 0.5 * (stem + end) * (times[1] - waiting_time) + end * (seconds - times[1])
    return end, area / seconds


class Identify(FixedEstimate):
    """The whole record in lists; a row of the model is one horizon of 30 s, or one sample if that is longer."""

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
        self.rows, self.rows_compared = [], 0  # (change and 6 before, 3 changes of the openings, deviation before)
        self.start_piece()

    def start_piece(self):
        """Start a new unbroken piece of the record."""
        self.temperatures, self.deviations, self.means, self.readings, self.openings = [], [], [], [], None

    def observe(self, t, sample):
        """Add a sample."""
        if t % self.sample_time != 0 or not sample.enabled:
            return
        elapsed, interrupted = t - self.before, t - self.before > 1.5 * self.sample_time
        if interrupted or 0.0 < sample.u < 1.0:
            self.inside_at = t
        if interrupted or self.openings is None or len(self.openings) == self.width:
            self.gust_at = t if abs(sample.m_a - self.m_a) > 0.05 * self.m_a else self.gust_at
            self.m_a = sample.m_a
        if interrupted:
            self.start_piece()
        elif self.openings is None:
            self.temperatures, self.openings = [sample.T], []
        elif len(self.openings) == self.width:
            self.temperatures.append(sample.T)
            self.deviations.append(sample.T - np.mean(self.readings))
            self.means.append(np.mean(self.openings, axis=0))
            self.readings, self.openings = [], []
            is_quiet = t - self.gust_at >= 300.0 and t - self.inside_at <= 600.0
            if len(self.temperatures) >= 8 and t - self.step_at <= 7200.0 and is_quiet:
                # the last horizon as if the stems stood still after its first sample
                moves = np.diff([*self.means[-4:-1], self.first_means], axis=0)[::-1]
                self.rows.append((np.diff(self.temperatures[-8:])[::-1], moves, self.deviations[-2:-1]))

        max_travel = elapsed / self.stroke_time if self.stroke_time > 0.0 else math.inf
        end = clip(sample.command, self.motor - max_travel, self.motor + max_travel)
        path = motor_path(self.motor, end, self.stroke_time, elapsed)
        stem_paths = [stem_behind_gap(*path, q, x, elapsed) for q, x in zip(self.stems, CANDIDATES, strict=True)]
        stem_paths[0] = sample.command, sample.command  # the first candidate has no motor
        self.motor, self.stems = end, [q for q, _ in stem_paths]
        if self.openings is not None:
            self.readings.append(sample.T)
            self.openings.append([mean / (1.0 - x) for (_, mean), x in zip(stem_paths, CANDIDATES, strict=True)])
            if len(self.openings) == 1:
                still = [q / (1.0 - x) for (q, _), x in zip(stem_paths, CANDIDATES, strict=True)]
                self.first_means = np.mean([self.openings[0], *[still] * (self.width - 1)], axis=0)

        if self.T_set is not None and abs(sample.T_set - self.T_set) >= 0.1:
            self.step_at = t
        self.T_set, self.before = sample.T_set, t
        if t >= self.next_comparison:
            self.next_comparison = t + self.interval
            if len(self.rows) > self.rows_compared:
                self.rows_compared = len(self.rows)
                self.compare()

    def compare(self):
        """Fit every candidate to all rows and decide on the estimate."""
        n = len(self.rows)
        ages = self.decay ** np.arange(n - 1, -1, -1.0)
        n_effective = float(np.sum(ages))
        if n_effective < 60.0:
            return
        travel = np.array([np.abs(row[1][:, 1]).sum() for row in self.rows])  # of the motor in 3 horizons
        root_weights = np.sqrt(ages / (1.0 + (travel / 0.03) ** 2))[:, np.newaxis]
        changes = np.array([row[0] for row in self.rows]) * root_weights
        moves = np.array([row[1] for row in self.rows]) * root_weights[:, np.newaxis]
        before = [changes[:, 1:], root_weights]
        if self.width > 1:  # else it is the change before
            before.append(np.array([row[2] for row in self.rows]) * root_weights)
        self.judge(probabilities(changes[:, 0], np.hstack(before), moves, n_effective - 8.0))

    def judge(self, probability):
        """Keep the estimate, or take the mean of the probabilities, or 0."""
        sizes = np.array(CANDIDATES)
        tolerance = np.maximum(0.2 * sizes, 0.01) + 1e-9
        mean = float(probability @ sizes)
        mean = mean if mean > 0.01 else 0.0
        has_backlash = probability[sizes <= 0.0051].sum() <= 0.002
        probability_right = probability[abs(sizes - mean) <= tolerance].sum()
        probability_not_too_large = probability[sizes >= self.estimate - tolerance * (sizes < self.estimate)].sum()
        if probability_right >= self.certainty and (has_backlash or mean == 0.0):
            self.estimate = mean
        elif probability_not_too_large <= 0.05:
            self.estimate = mean if has_backlash else 0.0


def probabilities(change, before, moves, freedom):
    """Probabilities of the candidates; a row per horizon: changes, regressors, moves of the openings (n, k, N)."""
    basis, _ = np.linalg.qr(before)
    y = change - basis @ (basis.T @ change)
    precision = 0.01 * (y @ y) / freedom
    evidence = []
    for opening_moves in moves.transpose(2, 0, 1):
        D = opening_moves - basis @ (basis.T @ opening_moves)
        # coefficients have this precision each, so that the changes have 1 + D D' / precision times their variance
        small = np.eye(D.shape[1]) + D.T @ D / precision
        residual = y @ y - y @ D @ np.linalg.solve(small, D.T @ y) / precision
        evidence.append(-0.5 * freedom * math.log(residual / (y @ y)) - 0.5 * math.log(np.linalg.det(small)))
    weights = np.exp(0.6 * (np.array(evidence) - max(evidence)))
    return weights / weights.sum()
