"""Classes of rules and of estimators, what they see of their loop, and filters for them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.control import sample_number
from fastcoil.model.numerics.jit import exact


@exact
def filter_weight(time_constant, sample_time):
    """Weight of a new value in a first-order filter, times in s.

    A backward difference: no overshoot however slow the samples are.
    """
    return sample_time / (time_constant + sample_time)


@exact
def low_pass(z, x, weight):
    """Output of a first-order filter after one more value x; z, the output before, is NaN where x is the first."""
    return x if np.isnan(z) else z + weight * (x - z)


@exact
def is_sample(t, sample_time):
    """Whether a controller sample is at t, s: because of other lanes an estimator may be called more often."""
    return sample_number(t, sample_time) * sample_time == t


class Sample(NamedTuple):
    """Signals that an estimator sees when a controller sample begins; a controller in the field knows them all.

    ``e`` to ``switches`` belong to the sample before: the new estimate acts from this sample on.
    """

    t: float  # time since the start, s
    T_set: float  # set-point now, °C
    m_a: float  # air flow now, kg/s
    T: float  # measured supply temperature, °C
    e: float  # control error, K; positive where the valve should open
    u: float  # output of the control law, 0–1
    command: float  # command to the actuator, 0–1
    mode: float  # direction of the inverse: 1 rising, -1 falling
    switches: float  # mode switches since the start
    estimate: float  # present estimate, fraction of stroke
    test: float  # 1 while a valve test runs; estimators that do not read it are not called then


def memory_defaults(Memory: Any) -> tuple[float, ...]:  # noqa: N803 — a class
    """Return the initial values of a memory: the defaults of its fields, 0 for a field without one."""
    return tuple(float(Memory._field_defaults.get(n, 0.0)) for n in Memory._fields)


@dataclass(frozen=True)
class StepRule:
    """A rule that is called again and again with a memory: a law in place of the PI, a plant in place of the coil.

    name: the word in ``law = …``, ``plant = …`` or ``estimator = …``.
    Parameters, Memory: named tuples of floats.  The fields of ``Parameters`` are names of loop parameters; ``Memory``
    is what one call leaves to the next.
    step: (Sample, Parameters, Memory) → (u, Memory) at every controller sample; of a plant (PlantInputs, Parameters,
    Memory) → (temperature of what leaves, °C, Memory) in every second.
    fingerprint: text that changes with what a user's rule does; empty for those of the package.
    """

    name: str
    Parameters: Any
    Memory: Any
    step: Any
    fingerprint: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Estimator(StepRule):
    """A rule that estimates the backlash.

    step: (Sample, Parameters, Memory) → (estimate, Memory), called at every controller sample but the first.
    start: Parameters → Memory at the start; by default the defaults of Memory.
    periods: rows of a block by name → seconds at whose multiples the rule may act, where these are not the controller
    samples; the rule then decides itself when to act.
    confirms: (t, Parameters, Memory, true backlash, reached, confirmed) → (reached, confirmed), the times at which an
    estimate that moves in steps reached the true backlash and stepped back from it.
    results: Memory of arrays, one value per lane, at the end of a run → metrics by name.
    n_floats: size of an array that each lane has as well, 0 at the start.  ``step`` then takes it as fourth argument,
    changes it in place, and is called for no lane that does not sample or is off.
    waives_buffer: whether the loop is plain PI, without the buffer of the inverse, while its estimate is 0.
    sees_error: rows of a block by name → whether a rule with ``periods`` looks at T or e; without them it may.
    """

    start: Any = None
    periods: Callable[[Mapping[str, np.ndarray]], np.ndarray] | None = None
    confirms: Any = None
    results: Callable[[Any], dict[str, np.ndarray]] | None = None
    n_floats: int = 0
    waives_buffer: bool = False
    sees_error: Callable[[Mapping[str, np.ndarray]], bool] | None = None

    @property
    def sees_air(self) -> bool:
        """Whether the estimator reads the air flow."""
        return self._reads_field("m_a")

    @property
    def sees_test(self) -> bool:
        """Whether the estimator reads the input that says that a valve test runs."""
        return self._reads_field("test")

    def _reads_field(self, name: str) -> bool:
        return name in getattr(self.step, "py_func", self.step).__code__.co_names

    def is_watching(self, rows: Mapping[str, np.ndarray]) -> bool:
        """Whether a block of lanes has to keep the temperature and the error for this estimator."""
        return self.periods is None if self.sees_error is None else self.sees_error(rows)
