"""The adaptive inverse with a normalised gradient and a reference model."""

from reference.fixed import FixedEstimate
from reference.rounding import clip


class Gradient(FixedEstimate):
    """From literature, section 3.2, with backward differences for all first-order filters."""

    def __init__(self, parameters):
        super().__init__(parameters)
        self.p = parameters
        self.sign = -1.0 if parameters["action"] == "heating" else 1.0
        self.T_ref = None

    def observe(self, t, sample):
        """Add the sample before this one, whose set-point follows from its error."""
        sample_time = self.p["sample_time"]
        if t == 0 or t % sample_time != 0 or not sample.enabled:
            return
        self.T_set = sample.T - self.sign * sample.e
        phi = (1.0 if sample.mode == 1 else 0.0) - sample.u
        if self.T_ref is None or sample.u <= 0.0:
            self.start(t, sample, phi)
        else:
            self.continue_adaptation(t, sample, phi)

    def start(self, t, sample, phi):
        """Start all filters at the present values, and pause."""
        self.T_ref = sample.T
        self.filter_towards("T_ref", self.T_set, self.p["gradient_reference_time"])
        self.fast = self.slow = phi
        self.m_a = sample.m_a
        self.pause_ends = t + self.p["gradient_pause"]
        self.adapt(t, sample, 0.0)

    def continue_adaptation(self, t, sample, phi):
        """Follow the set-point, and adapt with phi of the samples before."""
        self.filter_towards("T_ref", self.T_set, self.p["gradient_reference_time"])
        zeta = self.fast - self.slow
        self.filter_towards("fast", phi, self.p["gradient_filter_time"])
        self.filter_towards("slow", phi, 20.0 * self.p["gradient_filter_time"])
        if abs(sample.T_set - self.T_set) > 0.1:
            self.pause_ends = t + self.p["gradient_pause"]
        if abs(sample.m_a - self.m_a) > 0.05 * self.m_a:
            self.m_a = sample.m_a
            self.pause_ends = t + self.p["gradient_pause"]
        self.adapt(t, sample, zeta)

    def filter_towards(self, name, x, time_constant):
        """Step a first-order filter towards x."""
        z = getattr(self, name)
        weight = self.p["sample_time"] / (time_constant + self.p["sample_time"])
        setattr(self, name, z + weight * (x - z))

    def adapt(self, t, sample, zeta):
        """Step along the gradient, unless paused or with u at a limit."""
        if t < self.pause_ends or not 0.0 < sample.u < 1.0:
            return
        error = self.sign * (sample.T - self.T_ref)
        dead_zone = self.p["gradient_dead_zone"]
        outside = error - clip(error, -dead_zone, dead_zone)
        step = self.p["gradient_gain"] * self.p["sample_time"] * outside * zeta / (1.0 + zeta**2)
        self.estimate = clip(self.estimate + step, 0.0, self.p["gradient_cap"])
