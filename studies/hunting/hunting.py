"""Why a loop hunts: the condition, a rule of thumb, and their error rates.

Run with ``python -m studies hunting``.  What is chosen is chosen on one set of valves and conditions and judged on
others:

* ``hunting_rules.py``, ``hunting_tables.py``: which number tells whether a loop hunts, and how often is it wrong?
* ``hunting_backlash.py``, ``hunting_start.py``: what does the backlash do, and must hunting be started?
* ``hunting_parts.py``: what do motor, sensor and controller do?
* ``hunting_cost.py``, ``hunting_cures.py``: what does a rule cost, and which gain is to be changed?
* ``hunting_map.py``: the maps, of the presets (``hunting.toml``) and of the valves.
"""

from __future__ import annotations

import time

from studies.days import kinds
from studies.hunting import backlash as hunting_backlash
from studies.hunting import cost as hunting_cost
from studies.hunting import cures as hunting_cures
from studies.hunting import loops as hunting_loops
from studies.hunting import map as hunting_map
from studies.hunting import parts as hunting_parts
from studies.hunting import rules as hunting_rules
from studies.hunting import start as hunting_start
from studies.hunting import tables as hunting_tables
from studies.hunting.rules import Rule

CHOICE, FRESH, WIDE, DAYS, SIZES, START, PARTS, COST, CURES = range(15001, 15900, 100)
"""Seeds of the valves; those of the conditions are one more."""
OF_DAYS = range(15911, 15914)


def main(size: int = 384, days: int = 6) -> None:
    """Run everything, write the tables and draw the figures; ``size`` valves, ``days`` conditions of a kind."""
    began = time.monotonic()

    def said(what: str) -> None:
        print(f"{what} after {time.monotonic() - began:.0f} s", flush=True)

    choice = hunting_loops.population(CHOICE, 2 * size, days)
    rules, shape = hunting_rules.chosen(choice)
    said(f"chose {', '.join(f'{rule.name}: {rule.limit:g}' for rule in rules)}")
    fresh = hunting_loops.population(FRESH, 2 * size, days + 2)
    wide = hunting_loops.population(WIDE, size, days, wide=True)
    hunting_tables.write_errors(rules, {"fresh valves": fresh, "other plants": wide})
    hunting_tables.write_by_backlash(rules, fresh)
    cautious = hunting_rules.cautious(rules[1], choice)
    hunting_tables.write_one_step(rules[1], cautious, fresh)
    hunting_tables.write_practice(rules, fresh)
    said("ran fresh valves and other plants")
    hunting_tables.write_days(rules, {kind: hunting_loops.on_days(DAYS, size, kind, OF_DAYS) for kind in kinds()})
    said("ran other days")
    sizes = hunting_backlash.run(SIZES, size // 2, max(days // 2, 2))
    hunting_backlash.write(sizes, rules[0].limit)
    hunting_backlash.write_bands(sizes)
    hunting_start.write(hunting_start.run(START, size // 2, max(days // 2, 2)))
    said("ran every backlash, and kicks")
    hunting_parts.write(hunting_parts.run(PARTS, size // 8, 2))
    said("ran other motors, sensors and controllers")
    margin, formula, product, *_ = rules
    slow = Rule("Ti ≥ T", lambda ds: ds["T"] / ds.ti, 1.0, 1.0)
    obeyed = {f"{rule.name} ≤ {rule.limit:g}": rule for rule in (margin, formula, product)}
    hunting_cost.write(*hunting_cost.run(COST, size // 4, {**obeyed, slow.name: slow}))
    hunting_cures.write(*hunting_cures.run(CURES, size, formula, shape, cautious))
    said("ran what rules cost")
    presets = hunting_map.of_presets()
    hunting_map.write_presets(presets, rules)
    hunting_map.draw_presets(presets, rules)
    hunting_map.draw_population(fresh, sizes, rules)
    said("drew")
