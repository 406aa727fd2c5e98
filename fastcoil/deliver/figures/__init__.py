"""Figures of results.  ``fc.plot`` is this package: ``traces``, ``map``, ``bands``, ``limit_cycle``, ``learning``.

These draw into one pair of axes, ``ax`` or those of a new figure as wide as a column of a journal, and return it.
``drawing`` has what all figures draw with; ``traces`` shows few scenarios over time, ``swept`` metrics over swept
parameters, for `fastcoil run` and `fastcoil plot` as panels of a whole study in one figure.
"""

from fastcoil.deliver.figures.swept import bands as bands
from fastcoil.deliver.figures.swept import map as map
from fastcoil.deliver.figures.traces import learning as learning
from fastcoil.deliver.figures.traces import limit_cycle as limit_cycle
from fastcoil.deliver.figures.traces import traces as traces

__all__ = ["bands", "learning", "limit_cycle", "map", "traces"]
