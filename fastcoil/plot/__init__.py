"""Figures of results, each in one pair of axes: ``fc.plot.traces``, ``map``, ``bands``, ``limit_cycle``, ``learning``.

They take what ``fc.simulate`` and ``fc.open_study`` return, draw into ``ax`` or into a new figure as wide as a column
of a journal, and return the axes.
"""

from fastcoil.plot.learned import learning as learning
from fastcoil.plot.over_time import traces as traces
from fastcoil.plot.swept import bands as bands
from fastcoil.plot.swept import map as map
from fastcoil.plot.swing import limit_cycle as limit_cycle

__all__ = ["bands", "learning", "limit_cycle", "map", "traces"]
