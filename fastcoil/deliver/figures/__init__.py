"""Figures of results, each in one pair of axes: ``fc.plot.traces``, ``map``, ``bands``, ``limit_cycle``, ``learning``.

They take what ``fc.simulate`` and ``fc.open_study`` return, draw into ``ax`` or into a new figure as wide as a column
of a journal, and return the axes.
"""

from fastcoil.deliver.figures.swept import bands as bands
from fastcoil.deliver.figures.swept import map as map
from fastcoil.deliver.figures.traces import learning as learning
from fastcoil.deliver.figures.traces import limit_cycle as limit_cycle
from fastcoil.deliver.figures.traces import traces as traces

__all__ = ["bands", "learning", "limit_cycle", "map", "traces"]
