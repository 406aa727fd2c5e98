"""Base class of the estimators: a constant estimate."""

import math


class FixedEstimate:
    """The estimate of the parameters.

    ``observe(t, sample)`` is called once a second, before the controller.  ``sample`` has T_set, m_a and enabled of
    this second; T and e of the last sample of the controller; u, mode and the number of switches so far.
    """

    def __init__(self, parameters):
        self.is_off = type(self) is FixedEstimate
        self.estimate = parameters["backlash_estimate"]

    def observe(self, t, sample):
        """Do nothing."""

    def metrics(self):
        """Metrics of single estimators; here none of them."""
        names = ("learn_time_reached", "learn_time_confirmed", "learn_time_first_down", "estimate_first_down")
        return dict.fromkeys((*names, "half_periods", "half_period_spread"), math.nan) | {"learning_status": 0.0}
