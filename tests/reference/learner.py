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
        p = parameters
        self.switches_before = 0  # those before this interval
        self.growth = p["learning_growth"]
        self.step = p["learning_step"] / self.growth  # as if one step up had been made before
        self.interval = int(p["learning_interval"])
        self.interval_end = self.interval
        self.ratio = p["learning_ratio"]
        self.floor = p["learning_floor"]
        self.least_switches = p["learning_min_switches"]
        self.highest_reference = p["learning_max_reference"] * 600.0 / p["sample_time"]
        self.trips_early = p["learning_early_trip"] == 1
        self.sample_time = int(p["sample_time"])
        self.shrink = p["learning_shrink"]
        self.final = p["learning_final"]
        self.lowest = p["backlash_estimate"]
        self.highest = p["learning_cap"]
        self.stops_at_first_down = p["learning_stop"] == "first_step_down"
        self.reached_threshold = p["backlash"] - p["learning_step"] / 2.0 - 1e-12
        self.reference_frequency = None
        self.n_reference_intervals = int(p["learning_reference"])
        self.starting_up = self.n_reference_intervals > 0
        self.frequencies = []  # of the intervals of the reference
        self.error_ratio = p["learning_error_ratio"]
        self.errors = []  # settled ones, of this interval
        self.reference_errors = []
        self.T_set = None
        self.settled_after = 0
        self.missing = None
        self.time_reached = math.nan
        self.time_confirmed = math.nan
        self.time_first_down = math.nan
        self.estimate_first_down = math.nan

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
        if t > 0 and t % self.sample_time == 0 and self.error_ratio > 0.0:
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
        may_trip = self.trips_early and t % self.sample_time == 0 and self.reference_frequency is not None
        return may_trip and self.is_chatter(switches)

    def is_chatter(self, switches):
        """Whether so many switches are too many for a whole interval."""
        threshold = self.ratio * max(self.reference_frequency, self.floor)
        return switches / (self.interval / 600.0) > threshold

    def update(self, t, switches):
        """End the interval at second t, given its mode switches; the next one begins there."""
        is_whole, self.interval_end = t == self.interval_end, t + self.interval
        was_start, self.starting_up = self.starting_up, False
        frequency = switches / (self.interval / 600.0)
        self.missing = None
        if switches < self.least_switches:
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
            self.move(t, mean > self.ratio * max(mean, self.floor))

    def has_become_worse(self):
        """Whether the rms error of an interval exceeds that of the reference by too much."""
        if self.error_ratio == 0.0 or not self.errors or not self.reference_errors:
            return False
        now, before = (math.sqrt(sum(e * e for e in some) / len(some)) for some in (self.errors, self.reference_errors))
        return now > self.error_ratio * before

    def move(self, t, is_down):
        """Step down or up."""
        if is_down:
            self.step_down(t)
        else:
            self.step_up(t)

    def step_up(self, t):
        """Step up, by more than the last time if there was no step down yet."""
        if math.isnan(self.time_first_down):
            self.step *= self.growth
        self.move_by(self.step, t)

    def step_down(self, t):
        """Step down as far as the last step up; later steps are shorter, and the first one may end the learning."""
        self.move_by(-self.step, t)
        self.step *= self.shrink
        if math.isnan(self.time_confirmed) and not math.isnan(self.time_reached):
            self.time_confirmed = float(t)
        if math.isnan(self.time_first_down):
            self.time_first_down = float(t)
            self.estimate_first_down = self.estimate
            if self.stops_at_first_down:
                self.estimate = max(self.estimate * self.final, self.lowest)

    def move_by(self, distance, t):
        """Move the estimate within its limits."""
        self.estimate = clip(self.estimate + distance, self.lowest, self.highest)
        if math.isnan(self.time_reached) and self.estimate >= self.reached_threshold:
            self.time_reached = float(t)
