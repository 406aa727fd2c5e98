"""User rules for the tests."""

from collections import namedtuple
from typing import NamedTuple

import fastcoil as fc

LARGEST_ESTIMATE = 0.2
RULE_HEADER = """
from typing import NamedTuple
import fastcoil as fc

class Parameters(NamedTuple):
    gain: float = fc.parameter(0.01)

class Memory(NamedTuple):
    last: float = 0.0

@fc.estimator(Parameters, Memory)
"""
"""Source of a rule up to its function."""


class Parameters(NamedTuple):
    sample_time: float
    kp: float
    gain: float = fc.parameter(3e-4, unit="K-1 s-1", lower=0.0, upper=1.0, text="how fast it moves")


class Memory(NamedTuple):
    integral: float = 0.0
    calls: float = 0.0


@fc.estimator(Parameters, Memory)
def by_error(now, p, memory):
    if now.mode > 0:
        estimate = clip_to(now.estimate + p.gain * abs(now.e) * p.sample_time, LARGEST_ESTIMATE)
        return estimate, Memory(calls=memory.calls + 1)
    return now.estimate, Memory(0, memory.calls + 1)


@fc.estimator(Parameters, Memory)
def by_switches(now, p, memory):
    return clip_to(0.01 * now.switches, LARGEST_ESTIMATE), memory


@fc.law(Parameters, Memory)
def own_pi(now, p, memory):
    integral = clip_to(memory.integral + p.gain * now.e, 1.0)
    return p.kp * now.e + integral, Memory(integral, memory.calls + 1)


class FirstOrder(NamedTuple):
    T_initial: float
    cooling: float = fc.parameter(20.0, unit="K", text="fall of the temperature at full opening")
    lag: float = fc.parameter(120.0, unit="s", lower=1.0, text="time constant")


class Temperature(NamedTuple):
    T: float = 20.0


@fc.plant(FirstOrder, Temperature)
def first_order(now, p, memory):
    T = memory.T if now.t > 0 else p.T_initial
    T += (now.T_a_in - p.cooling * now.opening - T) / p.lag
    return T, Temperature(T)


def clip_to(x, largest):
    """Clip to 0 … ``largest``; defined below the rules that call it."""
    return min(max(x, 0.0), largest)


def constant_rule(now, p, memory):
    return 0.1, memory


def make_parameters(**fields):
    """Make a class of parameters with these defaults; ``None`` for a field without one."""
    names = sorted(fields, key=lambda n: fields[n] is not None)
    return namedtuple("Parameters", names, defaults=[fields[n] for n in names if fields[n] is not None])
