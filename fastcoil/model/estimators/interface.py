"""Classes of rules and of estimators, what they see of their loop, and filters for them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.control import sample_number
from fastcoil.model.numerics.jit import exact


@exact
def filter_weight(time_constant, sample_time):
    """Weight of a new value in a first-order filter, times in s: a backward difference, without overshoot."""
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
    """Signals that an estimator sees when a sample begins; ``e`` to ``switches`` belong to the sample before."""

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
    """A rule that is called again and again with a memory: a law in place of the PI, a plant in place of the coil."""

    name: str  # the word in ``law = …``, ``plant = …`` or ``estimator = …``
    Parameters: Any  # a named tuple of floats, whose fields are names of loop parameters
    Memory: Any  # a named tuple of floats: what one call leaves to the next
    # (Sample, Parameters, Memory) → (u, Memory) at every controller sample; of a plant in every second
    # (PlantInputs, Parameters, Memory) → (temperature of what leaves, °C, Memory)
    step: Any
    fingerprint: str = field(default="", kw_only=True)  # text that changes with what a user's rule does


@dataclass(frozen=True)
class Estimator(StepRule):
    """A rule that estimates the backlash; step: (Sample, Parameters, Memory) → (estimate, Memory), not at the start."""

    start: Any = None  # Parameters → Memory at the start; by default the defaults of Memory
    # rows of a block by name → seconds at whose multiples the rule decides whether to act, if not the samples
    periods: Callable[[Mapping[str, np.ndarray]], np.ndarray] | None = None
    # (t, Parameters, Memory, true backlash, reached, confirmed) → (reached, confirmed), the times at which an
    # estimate that moves in steps reached the true backlash and stepped back from it
    confirms: Any = None
    results: Callable[[Any], dict[str, np.ndarray]] | None = None  # Memory of arrays, a value per lane, at the end
    # size of an array that each lane has as well, 0 at the start: ``step`` takes it as fourth argument, changes it in
    # place, and is called for no lane that does not sample or is off
    n_floats: int = 0
    waives_buffer: bool = False  # whether the loop is plain PI, without the buffer, while its estimate is 0
    # rows of a block by name → whether a rule with ``periods`` looks at T or e; without them it may
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
