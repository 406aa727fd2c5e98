"""How large should the buffer of a backlash inverse be?  Both bounds as closed formulas, and what they cost.

Run with ``python -m studies buffer``; under three minutes on two cores.  The formulas are in ``buffer_rule.py``, the
runs in ``buffer_run.py``.  The constants of the formulas come from valves and days of one seed, the tables from others.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from studies.buffer.costs import write_constants, write_crossing, write_rules
from studies.buffer.figure import draw
from studies.buffer.lower import write_allowed, write_lower, write_noise
from studies.buffer.run import Runs, on_lower, on_rules, on_still, on_upper, population
from studies.buffer.upper import write_cycles, write_upper
from studies.days import CONSTANT, HEATING, STEPPED, kinds

CHOICE, FRESH = 15, 1501
"""Seeds of the valves that the constants come from, and of those of the tables."""
CHOICE_DAYS, FRESH_DAYS = (5101, 5102), (5201, 5202, 5203)
CHOICE_KINDS = (CONSTANT, STEPPED, HEATING)
VALVES = 256


def run(size: int, seed: int, some: Sequence[str], days: Sequence[int], *, everything: bool = True) -> Runs:
    """All runs on valves of a seed; without ``everything`` those that the constants come from."""
    started = time.monotonic()
    groups = {False: [k for k in some if k != HEATING], True: [k for k in some if k == HEATING]}
    valves = {heats: population(size, seed, group[0]) for heats, group in groups.items() if group}
    found = Runs(valves, {}, {heats: on_still(v, groups[heats][0]) for heats, v in valves.items()}, {}, {})
    for kind in some:
        found.lower[kind] = on_lower(found.of(kind), kind, days)
        if everything:
            found.upper[kind] = on_upper(found.of(kind), kind, days)
            found.rules[kind] = on_rules(found.of(kind), kind, days)
        print(f"{kind} after {time.monotonic() - started:.0f} s", flush=True)
    return found


def main(size: int = VALVES) -> None:
    """Run everything, write the tables and draw the figure; ``size``: so many valves."""
    choice = run(size, CHOICE, CHOICE_KINDS, CHOICE_DAYS, everything=False)
    fresh = run(size, FRESH, kinds(), FRESH_DAYS)
    write_noise()
    write_constants(choice, fresh)
    write_lower(fresh)
    write_allowed(fresh)
    write_cycles(fresh)
    write_upper(fresh)
    write_rules(fresh)
    write_crossing(fresh)
    draw(fresh)
