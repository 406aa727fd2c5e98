"""Base class for results with text and TOML output."""

import json
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

from fastcoil.base.arguments import require_path
from fastcoil.base.errors import InputError
from fastcoil.base.files import is_possible_file, write_atomically


class Result(ABC):
    """Base class for results with text and TOML output."""

    @abstractmethod
    def summary(self) -> list[str]:
        """Return the result as lines of text."""

    @abstractmethod
    def to_toml(self, path: str | Path | None = None) -> str:
        """Return the result as TOML, also written to ``path`` if given."""

    def __repr__(self) -> str:
        return "\n".join([f"<fastcoil {type(self).__name__}>", *self.summary()])

    def _repr_html_(self) -> str:
        return html_table(self.summary())


def html_table(lines: Iterable[str]) -> str:
    """Return lines such as ``Gap: 7 %`` as a table for a notebook, the part before the colon as its head."""
    cells = (line.split(": ", 1) if ": " in line else ("", line) for line in lines)
    rows = (f"<tr><th>{escape(head)}</th><td style='text-align: left'>{escape(text)}</td></tr>" for head, text in cells)
    return f"<table>{''.join(rows)}</table>"


def toml_document(lines: Iterable[str], path: str | Path | None) -> str:
    """Join lines of TOML, and write them to ``path`` if given; ``StorageError`` if it cannot be written."""
    text = "\n".join(lines) + "\n"
    if path is not None:
        path = require_path("path", path)
        if not is_possible_file(path):
            raise InputError(f"{path} cannot be written: give a file in a folder that exists", "path", "path")
        write_atomically(path, text.encode())
    return text


def toml_table(name: str, values: Mapping[str, object], remark: str = "") -> list[str]:
    """Return the lines of a table in TOML notation, after an empty one."""
    head = f"[{name}]  # {remark}" if remark else f"[{name}]"
    return ["", head, *(f"{key} = {format_toml_value(value)}" for key, value in values.items())]


def format_toml_value(value: object) -> str:
    """Format a text, a number, a boolean, or a list of these in TOML notation."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (int, float)):
        return repr(float(value)) if isinstance(value, float) else repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(format_toml_value, value))}]"
    raise TypeError(f"{type(value).__name__} in TOML")
