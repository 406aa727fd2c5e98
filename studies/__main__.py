"""Run studies by name, or list them: ``python -m studies [NAME ...]``.  The list is the table of ``README.md``.

``--all`` runs every study and writes all tables anew, which takes hours; ``--sample`` computes some rows of each in a
quarter of an hour and writes nothing.  Both say which cells are not those of the tables as they stand.
"""

from __future__ import annotations

import importlib
import re
import sys
import time
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from studies.common import compare_with_tables
from studies.days import WEATHER_FILE

_ROW = re.compile(r"^\| (?P<text>.+?) \| \[(?P<name>\w+)\]\((?P<path>[\w/]+)\.py\) \| (?P<time>.+?) \|", re.MULTILINE)


class Question(NamedTuple):
    """A question, the module whose ``main`` runs it, and how long that takes on two cores."""

    text: str
    module: str
    time: str


def questions() -> dict[str, Question]:
    """Return name → question, in the order of the table."""
    text = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    return {
        row["name"]: Question(row["text"], f"studies.{row['path'].replace('/', '.')}", row["time"])
        for row in _ROW.finditer(text)
    }


QUICK_TIMES = ("seconds", "a minute")  # studies that a sample runs whole, by their time


def format_seeds(module: ModuleType) -> str:
    """Format the seeds and sizes of a study, as its module names them."""
    constants = {name: value for name, value in vars(module).items() if name.isupper() and type(value) in (int, tuple)}
    suffixes = ("SEED", "FRESH", "FIRST_DAY", "VALVES", "UNITS", "DAYS", "SAMPLES")
    return ", ".join(f"{name} = {value}" for name, value in constants.items() if name.endswith(suffixes))


def run(name: str, question: Question, *, is_sample: bool) -> list[str]:
    """Run a study, or a sample of it; return a line for each changed cell."""
    module, start = importlib.import_module(question.module), time.monotonic()
    sample = getattr(module, "sample", module.main if question.time in QUICK_TIMES else None)
    print(f"{name}: {format_seeds(module) or 'seeds in its study file'}", flush=True)
    if is_sample and sample is None:
        print(f"{name}: no sample, {module.NO_SAMPLE}; whole it takes {question.time}")
        return []
    with compare_with_tables(is_sample=is_sample) as replication:
        sample() if is_sample else module.main()
    duration = f"{time.monotonic() - start:.0f} s"
    print(f"{name}: {len(replication.changes)} of {sum(replication.cell_counts)} cells changed, {duration}", flush=True)
    return replication.changes


def main(args: list[str]) -> int:
    """Run the studies that are named; without any, list them."""
    questions_by_name = questions()
    options, names = [arg for arg in args if arg.startswith("-")], [arg for arg in args if not arg.startswith("-")]
    if unknown_options := [option for option in options if option not in ("--all", "--sample")]:
        sys.exit(f"no option {unknown_options[0]}: give --all or --sample")
    for name in names:
        if name not in questions_by_name:
            matches = get_close_matches(name, questions_by_name, 1)
            sys.exit(
                f"no study {name!r}{f'; did you mean {matches[0]!r}?' if matches else ''}; python -m studies lists all"
            )
    if not args:
        print(
            "\n".join(f"{name:22}  {question.text}  ({question.time})" for name, question in questions_by_name.items())
        )
    is_sample = "--sample" in options
    if args and not WEATHER_FILE.is_file():
        print("without studies/year/weather.csv, rows of days of weather are missing from what is written", flush=True)
    changed_cells: list[str] = []
    for name in names or (questions_by_name if options else ()):
        changed_cells += run(name, questions_by_name[name], is_sample=is_sample)
    if changed_cells:
        print("Changed:", *changed_cells, sep="\n  ")
    return int(is_sample and bool(changed_cells))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
