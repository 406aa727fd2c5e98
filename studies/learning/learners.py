"""Estimators of the backlash under many conditions: which finds it, where it fails, what it does to a good valve.

Run with ``python -m studies learners``.  The estimators are the rows of ``learners.toml``; the conditions are those of
``learners_conditions.py``.  All estimators of a loop see the same days and the same noise.
"""

from __future__ import annotations

from studies.learning import learners_figure, learners_run, learners_tables


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many loops and valves."""
    runs = learners_run.run(size)
    learners_tables.write(runs)
    learners_figure.draw(runs)
