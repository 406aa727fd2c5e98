"""Pages that show files of the repository, and the lists of parameters, metrics and signals."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click

from fastcoil.cli.main import main
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS

LANGUAGES = {".py": "python", ".toml": "toml", ".md": "markdown", ".cff": "yaml", ".json": "json"}
FRONT_MATTER = "---\norphan: true\nnosearch: true\n---\n\n"


def file_page(root: Path, path: str) -> str:
    """Return a page that shows a file, lists the Python files of a folder, or shows its tables."""
    title = f"{FRONT_MATTER}# `{path}`\n\n"
    if (root / path).name == "tables":
        tables = sorted((root / path).glob("*.md"))
        return title + "\n\n".join(f"## {table.stem}\n\n{table.read_text()}" for table in tables)
    if (root / path).parent.name == "tables":
        return title + (root / path).read_text()
    if not (root / path).is_dir():
        language = LANGUAGES.get(Path(path).suffix, "text")
        text = (root / path).read_text()
        if path.endswith(".ipynb"):
            download = f"{{download}}`Download this notebook <../../../{path}>`\n\n"
            return title + download + "\n\n".join(_notebook_cells(json.loads(text)))
        return f"{title}``````{{code-block}} {language}\n:linenos:\n\n{text.rstrip()}\n``````\n"
    files = sorted((root / path).glob("*.py"))
    return title + "\n".join(f"* [`{f.name}`]({Path(path).name}/{f.name}.md)" for f in files) + "\n"


def _notebook_cells(notebook: dict[str, Any]) -> Iterator[str]:
    """Yield the cells of a notebook, headings one level down."""
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        yield f"```python\n{text}\n```" if cell["cell_type"] == "code" else re.sub(r"(?m)^#", "##", text)


def with_members(root: Path, paths: Iterable[str]) -> set[str]:
    """Return ``paths`` and the Python files of the folders among them."""
    paths = set(paths)
    members = {str(f.relative_to(root)) for path in paths if (root / path).is_dir() for f in (root / path).glob("*.py")}
    return paths | members


def _escape_cell(text: object) -> str:
    return str(text).replace("|", "\\|").replace("*", "\\*").replace("<", "\\<")


def _markdown_table(head: str, rows: Iterable[Iterable[object]]) -> str:
    lines = [head, "|" + " --- |" * head.count(" | ") + " --- |"]
    return "\n".join([*lines, *("| " + " | ".join(map(_escape_cell, row)) + " |" for row in rows)]) + "\n"


def _unit_text(unit: str) -> str:
    """Return the unit; fractions and counts have none."""
    return "" if unit == "1" else unit


def parameter_page() -> str:
    """Return a page with every parameter of a loop, by group."""
    groups: dict[str, list] = {}
    for p in PARAMETERS.values():
        groups.setdefault(p.group, []).append(p)
    text = "# Parameters of a loop\n\nThe same names are used in Python, in study files and in results.  "
    text += "The defaults are those of the preset `paper_like`.\n"
    for group, members in groups.items():
        rows = (
            (f"`{p.name}`", _unit_text(p.unit), "" if p.default is None else p.default, p.bounds, p.text)
            for p in members
        )
        text += f"\n## {group[0].upper()}{group[1:]}\n\n"
        text += _markdown_table("| name | unit | default | values | meaning |", rows)
    return text


def output_page() -> str:
    """Return a page with every metric and every signal of a result."""
    head = "| name | unit | meaning | how it is found |"
    text = "# Metrics and signals\n\nA result has the metrics always, one number for each scenario, and the signals"
    text += " that you ask for with `traces=[…]`.  Where no unit is given it is a fraction or a count.  An empty cell"
    text += " (NaN) is never a zero.\n"
    for title, outputs in (("Metrics", METRICS), ("Signals", TRACES)):
        rows = ((f"`{o.name}`", _unit_text(o.unit), o.long_name, o.comment) for o in outputs.values())
        text += f"\n## {title}\n\n" + _markdown_table(head, rows)
    return text


def _help_texts(command: click.Command, name: str, parent: click.Context | None = None):
    context = click.Context(command, info_name=name, parent=parent, max_content_width=100)
    yield context.command_path, command.get_help(context)
    if isinstance(command, click.Group):
        for member in sorted(command.commands):
            yield from _help_texts(command.commands[member], member, context)


def command_page() -> str:
    """Return a page with the ``--help`` of every command."""
    text = "# Commands\n\nWhat `--help` says of each command.\n"
    for path, help_text in _help_texts(main, "fastcoil"):
        text += f"\n## {path}\n\n```text\n{help_text}\n```\n"
    return text
