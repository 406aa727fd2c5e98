"""The loop itself: parameters and outputs, the paper's equations, and the kernel that runs thousands of loops at once.

Read ``parameters.toml`` and ``outputs.toml`` first, which ``parameter_table`` and ``metric_table`` read, then the
equations in ``physics`` and ``control``, the rules in ``estimators``, and ``engine.emulator``, the loop.  ``numerics``
holds the compiler's settings, the kernel cache and the elementary functions; ``user_rules`` makes estimators and laws
of plain functions; ``moist_air`` is for arrays.
"""
