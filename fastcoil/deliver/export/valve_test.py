"""One cycle of the valve test, as ``translate`` writes it: the kernel's parts, put together as the kernel does."""

from types import SimpleNamespace
from typing import Any

from fastcoil.model import valve_test
from fastcoil.model.control import clipped
from fastcoil.model.engine.controller import opening_behind
from fastcoil.model.valve_test import OFF, begin, held_command, mean_of, step


def run_test(now: Any, p: Any, memory: Any) -> Any:
    """One cycle of the valve test; PI and compensation follow its command, to go on without a bump."""
    starts = now.begins and memory.phase == OFF
    if memory.phase == OFF and not starts:
        if not now.enabled:
            return now.command, memory
        return now.command, mean_of(now.command, p, memory)
    held = held_command(now.command, memory) if starts else now.command
    running = begin(now.T_set, p, memory) if starts else memory
    sign = 1.0 - 2.0 * p.action
    command, after = step(sign * (now.T - running.reference), held, now.enabled, p, running)
    if after.phase == OFF:  # the PI acts in this cycle
        return now.command, after, 0.0
    mode = after.direction if after.direction != 0.0 else now.mode
    e = sign * (now.T - now.T_set)
    u = opening_behind(command, mode, now.estimate, p.compensation)
    return command, after, 1.0, e, mode > 0.0, u, u, clipped(u - p.kp * e)


TEST = SimpleNamespace(
    name="run_test", Memory=valve_test.Memory, step=run_test,
    Parameters=SimpleNamespace(_fields=(*valve_test.Parameters._fields, "kp", "action", "compensation")),
    follows=("test", "e", "rising", "u", "u_ext", "integral_part"),
)  # fmt: skip
"""As a rule.  follows: state of the controller that it returns behind its memory."""
