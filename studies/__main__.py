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

from studies.common import replicating

_ROW = re.compile(r"^\| (?P<text>.+?) \| \[(?P<name>\w+)\]\((?P<path>[\w/]+)\.py\) \| (?P<time>.+?) \|", re.MULTILINE)


class Question(NamedTuple):
    """A question, the module whose ``main`` runs it, and how long that takes on two cores."""

    text: str
    module: str
    time: str


def questions() -> dict[str, Question]:
    """Name → question, in the order of the table."""
    text = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    return {
        row["name"]: Question(row["text"], f"studies.{row['path'].replace('/', '.')}", row["time"])
        for row in _ROW.finditer(text)
    }


QUICK = ("seconds", "a minute")
"""Studies that a sample runs whole, by their time."""


def seeds_of(module: ModuleType) -> str:
    """The seeds of a study and how much it draws, as its module names them."""
    known = {name: value for name, value in vars(module).items() if name.isupper() and type(value) in (int, tuple)}
    wanted = ("SEED", "FRESH", "FIRST_DAY", "VALVES", "DAYS", "SAMPLES")
    return ", ".join(f"{name} = {value}" for name, value in known.items() if name.endswith(wanted))


def run(name: str, of: Question, *, is_sample: bool) -> list[str]:
    """Run a study, or a sample of it; a line for each cell that changed."""
    module, began = importlib.import_module(of.module), time.monotonic()
    sample = getattr(module, "sample", module.main if of.time in QUICK else None)
    print(f"{name}: {seeds_of(module) or 'seeds in its study file'}", flush=True)
    if is_sample and sample is None:
        print(f"{name}: no sample; whole it takes {of.time}")
        return []
    with replicating(is_sample=is_sample) as found:
        sample() if is_sample else module.main()
    took = f"{time.monotonic() - began:.0f} s"
    print(f"{name}: {len(found.changed)} of {sum(found.compared)} cells changed, {took}", flush=True)
    return found.changed


def main(args: list[str]) -> int:
    """Run the studies that are named; without any, list them."""
    known = questions()
    options, names = [arg for arg in args if arg.startswith("-")], [arg for arg in args if not arg.startswith("-")]
    if wrong := [option for option in options if option not in ("--all", "--sample")]:
        sys.exit(f"no option {wrong[0]}: give --all or --sample")
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, 1)
            sys.exit(f"no study {name!r}{f'; did you mean {near[0]!r}?' if near else ''}; python -m studies lists all")
    if not args:
        print("\n".join(f"{name:22}  {of.text}  ({of.time})" for name, of in known.items()))
    is_sample = "--sample" in options
    changed: list[str] = []
    for name in names or (known if options else ()):
        changed += run(name, known[name], is_sample=is_sample)
    if changed:
        print("Changed:", *changed, sep="\n  ")
    return int(is_sample and bool(changed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
