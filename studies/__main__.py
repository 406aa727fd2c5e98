"""Run studies by name, or list them: ``python -m studies [NAME ...]``.  The list is the table of ``README.md``."""

from __future__ import annotations

import importlib
import re
import sys
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

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


def main(names: list[str]) -> None:
    """Run the studies called ``names``; without any, list them."""
    known = questions()
    if not names:
        print("\n".join(f"{name:22}  {of.text}  ({of.time})" for name, of in known.items()))
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, 1)
            sys.exit(f"no study {name!r}{f'; did you mean {near[0]!r}?' if near else ''}; python -m studies lists all")
    for name in names:
        importlib.import_module(known[name].module).main()


if __name__ == "__main__":
    main(sys.argv[1:])
