"""Thousands of loops at once: the scalar formulas of ``physics`` and ``control`` over blocks of lanes."""
