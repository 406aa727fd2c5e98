"""Why loops hunt.

Read ``loops`` (valves, models, rules), ``backlash`` and ``cures`` (experiments), ``hunting`` (error rates, maps,
``main``); ``limit_cycles`` compares ``fc.limit_cycle`` with the emulator.
"""
