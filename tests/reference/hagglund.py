"""Hägglund's estimate of the gap from the half periods of the control error."""

import math
from statistics import median

from reference.fixed import FixedEstimate


class Hagglund(FixedEstimate):
    """From literature, section 2: d = K (Dt/Ti - 1/(K Kp)) Dy where Dt >= 5 Ti, e_max < 2 Dy and 0 < d < 1.

    The whole half period is kept as a list, and so are all gaps.
    """

    def __init__(self, parameters):
        super().__init__(parameters)
        self.p = parameters
        self.filtered = None
        self.half_period = None  # filtered errors since the last zero crossing
        self.gaps = []

    def observe(self, t, sample):
        """Add an error, if this is a sample."""
        sample_time = self.p["sample_time"]
        if t % sample_time != 0 or not sample.enabled:
            return
        before = self.filtered
        if before is None:
            self.filtered = sample.e
        else:
            tau = self.p["hagglund_filter_ratio"] * self.p["ti"]
            self.filtered += sample_time / (tau + sample_time) * (sample.e - self.filtered)
        if before is not None and (before > 0.0) != (self.filtered > 0.0):
            if self.half_period is not None:
                self.end_half_period()
            self.half_period = []
        if self.half_period is not None:
            self.half_period.append(abs(self.filtered))
        if not 0.0 < sample.u < 1.0:
            self.half_period = None

    def end_half_period(self):
        """Add the gap of this half period, if it qualifies."""
        K, Ti, Kp = self.p["kp"], self.p["ti"], self.p["plant_gain"]
        Dt = len(self.half_period) * self.p["sample_time"]
        Dy = sum(self.half_period) / len(self.half_period)
        d = K * (Dt / Ti - 1.0 / (K * Kp)) * Dy
        least_half_periods = self.p["hagglund_least_half_periods"]
        if self.p["estimate_share"] > 0.0 and len(self.gaps) >= least_half_periods:
            return
        if Dt >= 5.0 * Ti and max(self.half_period) < 2.0 * Dy and 0.0 < d < 1.0:
            self.gaps.append(d)
            if len(self.gaps) >= least_half_periods:
                self.estimate = median(self.gaps[-5:])

    def metrics(self):
        """Number of half periods that count, and the range of the last five gaps."""
        last_gaps = self.gaps[-5:]
        spread = max(last_gaps) - min(last_gaps) if len(last_gaps) == 5 else math.nan
        return super().metrics() | {"half_periods": float(len(self.gaps)), "half_period_spread": spread}
