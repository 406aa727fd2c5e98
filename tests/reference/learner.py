"""The self-learning of the backlash estimate."""

import math

from reference.fixed import FixedEstimate
from reference.rounding import clip


class Learner(FixedEstimate):
    """The self-learning rule of section 3.3 of the paper, and its variants.

    An interval without evidence is ignored: no step, and no reference frequency from it.
    """

    def __init__(self, parameters):
        super().__init__(parameters)
        self.p = p = parameters
        self.switches_before = 0  # those before this interval
        self.step = p["learning_step"] / p["learning_growth"]  # as if one step up had been made before
        self.interval = int(p["learning_interval"])
        self.interval_end = self.interval
        self.highest_reference = p["learning_max_reference"] * 600.0 / p["sample_time"]
        self.sample_time = int(p["sample_time"])
        self.stops_at_first_down = p["learning_stop"] == "first_step_down"
        self.reached_threshold = p["backlash"] - p["learning_step"] / 2.0 - 1e-12
        self.reference_frequency = None
        self.n_reference_intervals = int(p["learning_reference"])
        self.starting_up = self.n_reference_intervals > 0
        self.frequencies = []  # of the intervals of the reference
        self.errors, self.reference_errors = [], []  # settled ones, of this interval and of those of the reference
        self.T_set, self.settled_after, self.missing = None, 0, None
        self.time_reached = self.time_confirmed = self.time_first_down = self.estimate_first_down = math.nan

    @property
    def has_stopped(self):
        """Whether learning is over."""
        return self.stops_at_first_down and not math.isnan(self.time_first_down)

    @property
    def status(self):
        """State of the learner: its number among the flags of learning_status."""
        if self.has_stopped:
            return 3.0
        if not math.isnan(self.time_first_down):
            return 2.0
        if self.reference_frequency is None and self.missing is not None:
            return {"no_evidence": 4.0, "not_identifiable": 5.0}[self.missing]
        return 1.0

    def observe(self, t, sample):
        """Update the estimate at the end of an interval."""
        if t > 0 and t % self.sample_time == 0 and self.p["learning_error_ratio"] > 0.0:
            self.collect_error(t, sample)
        switches = sample.switches - self.switches_before
        if self.is_due(t, switches):
            self.update(t, switches)
            self.switches_before = sample.switches
            self.errors = []

    def collect_error(self, t, sample):
        """Keep an error unless a set-point step of the last 600 s or an end of the valve explains it."""
        has_stepped = self.T_set is not None and abs(sample.T_set - self.T_set) > 0.1
        self.T_set = sample.T_set
        if not 0.0 < sample.u < 1.0:
            self.settled_after = t + 600
            return
        if t > self.settled_after:
            self.errors.append(sample.e)
        if has_stepped:
            self.settled_after = t + 600

    def metrics(self):
        """Times at which the estimate moved, and the state of the learner."""
        return super().metrics() | {
            "learn_time_reached": self.time_reached,
            "learn_time_confirmed": self.time_confirmed,
            "learn_time_first_down": self.time_first_down,
            "estimate_first_down": self.estimate_first_down,
            "learning_status": self.status,
        }

    def is_due(self, t, switches):
        """Whether the estimate is updated in second t, after so many mode switches in the interval."""
        if self.has_stopped or t == 0:
            return False
        if t == self.interval_end:
            return True
        may_trip = self.p["learning_early_trip"] == 1 and self.reference_frequency is not None
        return may_trip and t % self.sample_time == 0 and self.is_chatter(switches)

    def is_chatter(self, switches):
        """Whether so many switches are too many for a whole interval."""
        threshold = self.p["learning_ratio"] * max(self.reference_frequency, self.p["learning_floor"])
        return switches / (self.interval / 600.0) > threshold

    def update(self, t, switches):
        """End the interval at second t, given its mode switches; the next one begins there."""
        is_whole, self.interval_end = t == self.interval_end, t + self.interval
        was_start, self.starting_up = self.starting_up, False
        frequency = switches / (self.interval / 600.0)
        self.missing = None
        if switches < self.p["learning_min_switches"]:
            self.missing = "no_evidence"
        elif self.reference_frequency is not None:
            self.move(t, self.is_chatter(switches) or (is_whole and self.has_become_worse()))
        elif frequency > self.highest_reference:
            self.missing = "not_identifiable"
        elif not was_start:
            self.add_to_reference(t, frequency)

    def add_to_reference(self, t, frequency):
        """Add an interval to the reference; the one that completes it also steps."""
        self.frequencies.append(frequency)
        self.reference_errors += self.errors
        if len(self.frequencies) >= self.n_reference_intervals:
            self.reference_frequency = mean = sum(self.frequencies) / len(self.frequencies)
            self.move(t, mean > self.p["learning_ratio"] * max(mean, self.p["learning_floor"]))

    def has_become_worse(self):
        """Whether the rms error of an interval exceeds that of the reference by too much."""
        if self.p["learning_error_ratio"] == 0.0 or not self.errors or not self.reference_errors:
            return False
        now, before = (math.sqrt(sum(e * e for e in some) / len(some)) for some in (self.errors, self.reference_errors))
        return now > self.p["learning_error_ratio"] * before

    def move(self, t, is_down):
        """Step up, each time by more until the first step down, which may end the learning; later steps are shorter."""
        is_first_climb = math.isnan(self.time_first_down)
        if is_first_climb and not is_down:
            self.step *= self.p["learning_growth"]
        lowest, highest = self.p["backlash_estimate"], self.p["learning_cap"]
        self.estimate = clip(self.estimate + (-self.step if is_down else self.step), lowest, highest)
        if math.isnan(self.time_reached) and self.estimate >= self.reached_threshold:
            self.time_reached = float(t)
        if not is_down:
            return
        self.step *= self.p["learning_shrink"]
        if math.isnan(self.time_confirmed) and not math.isnan(self.time_reached):
            self.time_confirmed = float(t)
        if is_first_climb:
            self.time_first_down, self.estimate_first_down = float(t), self.estimate
            if self.stops_at_first_down:
                self.estimate = max(self.estimate * self.p["learning_final"], lowest)
