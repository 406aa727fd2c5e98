"""The valve test of an exported controller: one cycle, which ``translate`` writes as laws, from the kernel's parts."""

from typing import Any, NamedTuple

from fastcoil.model import valve_test
from fastcoil.model.control import Law, clipped
from fastcoil.model.engine.controller import opening_behind
from fastcoil.model.valve_test import DISABLED, OFF, begin, held_command, mean_of, step


class Parameters(NamedTuple):
    """Parameters of the loop that it uses, those of ``valve_test.Parameters`` among them."""

    sample_time: float
    test_minutes: float
    test_rate: float
    test_threshold: float
    test_settle: float
    test_hold: float
    test_excursion: float
    kp: float
    compensation: float
    action: float


class Refused(NamedTuple):
    """What is left of a test that is asked for while the plant is off."""

    aborted: float


class Over(NamedTuple):
    """What the last cycle of a test leaves: the PI acts in it."""

    test: float


class Followed(NamedTuple):
    """Where the PI stands while a test runs."""

    test: float
    e: float
    rising: Any
    u: float
    u_ext: float
    integral_part: float


def run_test(now: Any, p: Any, memory: Any) -> Any:
    """One cycle of the valve test; PI and compensation follow its command, to go on without a bump."""
    asked = now.begins and memory.phase == OFF
    starts = asked and now.enabled
    if memory.phase == OFF and not starts:
        if now.enabled:
            return now.command, mean_of(now.command, p, memory)
        return now.command, Refused(DISABLED if asked else memory.aborted)
    held = held_command(now.command, memory) if starts else now.command
    running = begin(now.T_set, p, memory) if starts else memory
    sign = 1.0 - 2.0 * p.action
    command, after = step(sign * (now.T - running.reference), held, now.enabled, p, running)
    if after.phase == OFF:
        return now.command, after, Over(0.0)
    mode = after.direction if after.direction != 0.0 else now.mode
    e = sign * (now.T - now.T_set)
    u = opening_behind(command, mode, now.estimate, p.compensation)
    return command, after, Followed(1.0, e, mode > 0.0, u, u, clipped(u - p.kp * e))


TEST = Law("run_test", Parameters, valve_test.Memory, run_test, "")
SHARED = ("e", "rising", "u", "u_ext", "integral_part", "test")
"""What it stores in the state of the controller."""
