"""A gap that grows: who follows it, what that saves and wears, how long the motor lasts, and who notices first.

Run with ``python -m studies wear``.  The valves and controllers are those of ``wear.toml``; a weather file beside it,
as ``weather.toml`` asks for, adds days of a real year.
"""

from __future__ import annotations

from studies.wear import detect as wear_detect
from studies.wear import figure as wear_figure
from studies.wear import run as wear_year
from studies.wear import tables as wear_tables


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many valves."""
    runs = wear_year.run(size)
    chosen_on, fresh = wear_detect.run(wear_detect.CHOSEN_ON), wear_detect.run(wear_detect.FRESH)
    wear_tables.write(runs, chosen_on, fresh)
    wear_figure.draw(runs, chosen_on, fresh)
