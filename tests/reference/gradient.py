"""The adaptive inverse with a normalised gradient and a reference model."""

from reference.fixed import Fixed
from reference.rounding import clip


class Gradient(Fixed):
    """From literature, section 3.2, with backward differences for all first-order filters."""

    def __init__(self, parameters):
        super().__init__(parameters)
        self.p = parameters
        self.sign = -1.0 if parameters["action"] == "heating" else 1.0
        self.T_ref = None

    def look(self, t, seen):
        """One more sample: the one before, whose set-point follows from its error."""
        sample_time = self.p["sample_time"]
        if t == 0 or t % sample_time != 0 or not seen.enabled:
            return
        self.T_set = seen.T - self.sign * seen.e
        phi = (1.0 if seen.mode == 1 else 0.0) - seen.u
        if self.T_ref is None or seen.u <= 0.0:
            self.start(t, seen, phi)
        else:
            self.go_on(t, seen, phi)

    def start(self, t, seen, phi):
        """Start everything where the loop is, and pause."""
        self.T_ref = seen.T
        self.follow("T_ref", self.T_set, self.p["gradient_reference_time"])
        self.fast = self.slow = phi
        self.m_a = seen.m_a
        self.pause_ends = t + self.p["gradient_pause"]
        self.adapt(t, seen, 0.0)

    def go_on(self, t, seen, phi):
        """Follow the set-point, and adapt to what phi was before this sample."""
        self.follow("T_ref", self.T_set, self.p["gradient_reference_time"])
        zeta = self.fast - self.slow
        self.follow("fast", phi, self.p["gradient_filter_time"])
        self.follow("slow", phi, 20.0 * self.p["gradient_filter_time"])
        if abs(seen.T_set - self.T_set) > 0.1:
            self.pause_ends = t + self.p["gradient_pause"]
        if abs(seen.m_a - self.m_a) > 0.05 * self.m_a:
            self.m_a = seen.m_a
            self.pause_ends = t + self.p["gradient_pause"]
        self.adapt(t, seen, zeta)

    def follow(self, name, x, time_constant):
        """One step of a first-order filter towards x."""
        z = getattr(self, name)
        weight = self.p["sample_time"] / (time_constant + self.p["sample_time"])
        setattr(self, name, z + weight * (x - z))

    def adapt(self, t, seen, zeta):
        """One step along the gradient, unless it pauses or u is at an end."""
        if t < self.pause_ends or not 0.0 < seen.u < 1.0:
            return
        error = self.sign * (seen.T - self.T_ref)
        dead_zone = self.p["gradient_dead_zone"]
        outside = error - clip(error, -dead_zone, dead_zone)
        step = self.p["gradient_gain"] * self.p["sample_time"] * outside * zeta / (1.0 + zeta**2)
        self.estimate = clip(self.estimate + step, 0.0, self.p["gradient_cap"])
