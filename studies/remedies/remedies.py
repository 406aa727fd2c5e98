"""Remedies for backlash against the best plain PI: error, travel and harm, on every kind of day.

Run with ``python -m studies remedies``.  Four questions, all on ``remedies.toml``:

* ``remedies_run.py``: what does every remedy do behind the best gains of its valve, and behind those of SIMC?
* ``remedies_front.py``: and behind gains tuned for the remedy itself?  Which one is to be chosen?
* ``remedies_found.py``: and behind the gains as somebody left them?
* ``remedies_valves.py``: does that hold for valves with a neutral zone, stick-slip or a tight seat?

All remedies of a valve see the same days and the same noise.
"""

from __future__ import annotations

import xarray as xr

from studies.remedies import found as remedies_found
from studies.remedies import front as remedies_front
from studies.remedies import run as remedies_run
from studies.remedies import tables as remedies_tables
from studies.remedies import valves as remedies_valves
from studies.remedies.figure import draw


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many valves."""
    plain = remedies_run.picked(remedies_run.population(size), controller=0)
    remedies_tables.write(*remedies_run.run(size), backlash=xr.DataArray(plain["backlash"]))
    own, by_simc = remedies_front.run(size or remedies_front.VALVES)
    remedies_front.write(own, by_simc)
    draw(own, by_simc)
    remedies_found.write(remedies_found.run(size or remedies_found.VALVES))
    remedies_valves.write(remedies_valves.run(size or remedies_valves.VALVES))
