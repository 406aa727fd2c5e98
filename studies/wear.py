"""A gap that grows: who follows it, what that saves and wears, how long the motor lasts, and who notices first.

Run with ``python studies/wear.py``.  The valves and controllers are those of ``wear.toml``; a weather file beside it,
as ``weather.toml`` asks for, adds days of a real year.
"""

from __future__ import annotations

import wear_detect
import wear_figure
import wear_tables
import wear_year


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many valves."""
    runs = wear_year.run(size)
    chosen_on, fresh = wear_detect.run(wear_detect.CHOSEN_ON), wear_detect.run(wear_detect.FRESH)
    wear_tables.write(runs, chosen_on, fresh)
    wear_figure.draw(runs, chosen_on, fresh)


if __name__ == "__main__":
    main()
