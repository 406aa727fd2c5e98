"""``ValveTest``: twenty minutes of commands up and down, from which the temperature shows the backlash."""

from dataclasses import dataclass, fields, replace
from typing import Any, Self

from fastcoil.base.arguments import argument_checks
from fastcoil.loops.assignment import check_value
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.valve_test import LARGEST_OVERSHOOT_SHARE, LONGEST_RAMP_STROKE, TARGET_OVERSHOOT_K


@dataclass(frozen=True, kw_only=True)
class ValveTest:
    """A valve test: the command takes over from the PI, goes up and down past the gap, and hands back without a bump.

    A test does not begin while the valve is at an end of its stroke and the temperature requires more, nor until the
    air flow has been calm for five minutes; after an hour of waiting it is refused.  Then the command holds for
    ``settle`` s and moves at ``rate`` in the direction that brings the temperature back to the set-point of the start.
    Once the temperature has passed it by ``threshold``, the command holds for ``hold`` s, and moves the other way; each
    next ramp has the rate at which the temperature overshoots by 0.5 K, or by a third of ``excursion`` if that is less.
    The same are parameters of a loop, ``test_start`` and so on, and can be swept.

    Parameters
    ----------
    start
        Start, s from the start of the day.
    every
        Days from one test to the next where days are a sequence; 0 for a single test.
    minutes
        Longest duration, min.
    rate
        Rate of the first ramp, 1/s: slower than the motor.  Later ones have 0.2 to 4 times as much.
    threshold
        Error at which a ramp ends, K.
    settle, hold
        Seconds for which the command holds before the first ramp, and after each.  A loop that hunts takes 300 s or
        more to settle; with 900 s the test also shows whether a swing comes from outside the loop.
    excursion
        Error at which the test is aborted, K; twice that before the first ramp has ended, since a loop that hunts may
        be anywhere at the start, and on the side to which air drives the temperature whose flow has just changed.

    Raises
    ------
    InputError
        With one sentence for each value out of its bounds.

    Examples
    --------
    >>> import fastcoil as fc
    >>> test = fc.ValveTest(start=3600, minutes=20)
    >>> ds = fc.simulate(fc.Loop(sample_time=5), fc.constant_day(hours=2), test=test, traces=["T_measured", "test"])
    >>> float(ds.test_aborted)
    0.0
    """

    start: float = 0.0
    every: float = 0.0
    minutes: float = float(PARAMETERS["test_minutes"].default or 0.0)
    rate: float = float(PARAMETERS["test_rate"].default or 0.0)
    threshold: float = float(PARAMETERS["test_threshold"].default or 0.0)
    settle: float = float(PARAMETERS["test_settle"].default or 0.0)
    hold: float = float(PARAMETERS["test_hold"].default or 0.0)
    excursion: float = float(PARAMETERS["test_excursion"].default or 0.0)

    def __post_init__(self) -> None:
        with argument_checks() as check:
            for field in fields(self):
                parameter = PARAMETERS[f"test_{field.name}"]
                value = check(check_value, replace(parameter, name=field.name), getattr(self, field.name))
                object.__setattr__(self, field.name, value)

    @classmethod
    def gentle(cls, **options: Any) -> Self:
        """Return a test that moves the temperature less: 45 minutes, most days within 1 K."""
        return cls(**{"minutes": 45.0, "rate": 3e-4, "threshold": 0.1, "hold": 90.0, "excursion": 1.0} | options)

    @classmethod
    def heating(cls, **options: Any) -> Self:
        """Return a test of a heating coil, whose temperature responds more: 30 minutes, within 3 K."""
        return cls(**{"minutes": 30.0, "rate": 5e-4, "hold": 60.0, "excursion": 3.0} | options)

    def parameters(self) -> dict[str, float]:
        """Return the test as parameters of a loop."""
        return {f"test_{field.name}": getattr(self, field.name) for field in fields(self)}

    def instructions(self) -> list[str]:
        """Return instructions for a technician with a stop-watch, step by step."""
        interval = 30.0  # s between two commands
        step, stroke = 100 * self.rate * interval, 100 * LONGEST_RAMP_STROKE
        overshoot = min(TARGET_OVERSHOOT_K, LARGEST_OVERSHOOT_SHARE * self.excursion)
        return [
            "Before: log command, T_sup and, if possible, m_a, T_a_in and T_w_in every 5 s, from an hour before the "
            "test.  Choose an hour in which load and water are steady, the valve neither fully closed nor fully open.  "
            "If the air flow varies, begin after five minutes within 8 % of its mean.",
            f"Limits: if T_sup is ever more than {self.excursion:g} K from its set-point, or water, fan or set-point "
            "change, stop: give the valve back to the controller.  A change of the air flow by more than 5 % allows "
            f"{2 * self.excursion:g} K for some minutes on the side to which it drives T_sup.",
            "1. Note the time, the set-point and the command.  Switch the valve to manual and keep its command.",
            f"2. Wait {self.settle:g} s.  If T_sup still moves by more than 0.3 K in a minute, keep waiting, or stop.",
            f"3. Change the command by {step:.2g} % of the stroke every {interval:g} s, in the direction that brings "
            "T_sup back to the set-point: open to cool (to heat, if it heats) where that is needed, else close.",
            f"4. When T_sup has passed the set-point by {self.threshold:g} K, or after {stroke:.0f} % of the "
            f"stroke, leave the command for {self.hold:g} s.",
            f"5. If T_sup overran by more than {overshoot:.2g} K after step 4, halve the change of step 3; if by less"
            f" than {overshoot / 2:.2g} K, double it.  Then move the command the other way, as in steps 3 and 4.",
            f"6. Keep going back and forth until {self.minutes:g} min have passed since step 1, at least twice in each "
            "direction.",
            "7. Note the time.  Give the valve back to the controller, bumplessly if it can, and log ten minutes more.",
            "After: fastcoil valve-test read LOG.csv --between START END, both in seconds from the start of the log.",
        ]
