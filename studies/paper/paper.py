"""The scorecard of the paper's claims, and its section 3 on one loop, as tables.

Writes the paper's simulated figures and a page into ``results/paper``.  Where there is a weather file (see
``weather.toml``), the claims are judged on its summer days, too.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import fastcoil as fc
from studies.common import RESULTS, results, write_table
from studies.days import SUMMER_DAYS, WEATHER_FILE
from studies.paper.grid import KINDS, T_SET, Days, stepped_days, with_constant_set_point
from studies.paper.regenerate import regenerate

TABLE_TITLES = {
    "scorecard_changes": "Claims that depend on the kind of day",
    "scorecard": "Claims that do not depend on the kind of day",
}


def all_kinds(path: Path) -> dict[str, Days]:
    """The three kinds of days, and weather where there is a file."""

    def weather(hours: float, seeds: Sequence[int]) -> fc.Boundary:
        """Summer days of a weather file with 30 % outdoor air, drawn by the seed, and a constant set-point."""
        return with_constant_set_point(
            stepped_days(hours, seeds), seeds, [_summer_day(path, hours, seed) for seed in seeds]
        )

    return {**KINDS, "weather": weather} if path.is_file() else dict(KINDS)


def _summer_day(path: Path, hours: float, seed: int) -> fc.Boundary:
    day_of_year = int(np.random.default_rng([seed, 21]).choice(SUMMER_DAYS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # hourly data have no fast disturbances: the paper's days add them
        return fc.weather_day(
            path, days=[day_of_year], hour=9 if hours <= 8 else 0, hours=hours, m_a=1.15, T_w_in=7.0, T_set=T_SET,
            outdoor_fraction=0.3, T_return=24.0, RH_return=0.5,
        )  # fmt: skip


def parse_tables(text: str) -> list[tuple[list[str], list[list[str]]]]:
    """Head and rows of every table in a Markdown text."""
    parsed = []
    for block in text.split("\n\n"):
        if block.startswith("| "):
            head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines())
            parsed.append((head, rows))
    return parsed


def sample() -> None:
    """Write the table of one loop."""
    write_one_loop()


def main(*, quick: bool = False) -> None:
    """Regenerate the paper's figures and scorecard, and write the tables of verdicts."""
    folder = RESULTS / "paper"
    verdicts, _ = regenerate(
        folder, quick=quick, report=lambda line: print(line, flush=True), kinds=all_kinds(WEATHER_FILE)
    )
    print(*verdicts, f"Page, figures and data: {folder}", sep="\n")
    markdown_tables = parse_tables((folder / "scorecard.md").read_text(encoding="utf-8"))
    write_one_loop()
    for (name, title), (head, rows) in zip(TABLE_TITLES.items(), markdown_tables, strict=False):
        write_table(f"paper/{name}", title, head, rows)


def write_one_loop() -> None:
    """Write section 3 of the paper for one loop, median of ten days."""
    days = results("paper_like")
    ds = days.median("day")
    without = ds.sel(backlash=0.0, estimate_ratio=0.0)
    columns = ("rmse", "rmse_settled", "hunting_swing", "switch_frequency")
    rows = [["no backlash, plain PI", *(f"{float(without[c]):.3f}" for c in columns)]]
    for ratio in (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.3, 1.5):
        d = ds.sel(backlash=0.07, estimate_ratio=ratio)
        rows.append([f"estimate {ratio:.0%}", *(f"{float(d[c]):.3f}" for c in columns)])
    write_table(
        "paper/paper_like",
        f"The paper's phenomena on `paper_like`: backlash 7 %, median of {days.sizes['day']} days",
        ["", "RMSE, K", "settled RMSE, K", "peak to peak, K", "switches per 10 min"],
        rows,
    )
