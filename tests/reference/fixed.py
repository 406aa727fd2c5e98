"""What every estimator has in common; by itself, an estimate that stays as it is."""

import math


class FixedEstimate:
    """The estimate that is given.

    ``look(t, seen)`` is called once a second, before the controller.  ``seen`` has T_set, m_a and enabled of this
    second; T and e of the last sample of the controller; and u, mode and the number of switches so far.
    """

    def __init__(self, parameters):
        self.is_off = type(self) is FixedEstimate
        self.estimate = parameters["backlash_estimate"]

    def observe(self, t, sample):
        """Nothing to see."""

    def metrics(self):
        """What only some estimators have."""
        return {
            "learn_time_reached": math.nan,
            "learn_time_confirmed": math.nan,
            "learn_time_first_down": math.nan,
            "estimate_first_down": math.nan,
            "learning_status": 0.0,
            "half_periods": math.nan,
            "half_period_spread": math.nan,
        }
