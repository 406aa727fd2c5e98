"""A report as data, and as one HTML file: no script, no other file, nothing from a network.

Every text on it is escaped, whoever wrote it, and shown with its control characters written out.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from fastcoil.base.errors import InputError
from fastcoil.base.files import commit, exists, may_be_file, read_bytes
from fastcoil.base.machine import package_version
from fastcoil.base.text import printable

_MARK = b'<meta name="generator" content="fastcoil '
_MARK_WITHIN = 2000
"""Bytes at the beginning of a page that hold its mark."""
_LARGEST = 2**28
"""Bytes of a page."""
_BESIDE = ("baseline", "never", "yes", "no")
"""Words in a column of numbers."""
_LONGEST = 2000
"""Characters of a text in a row or a sentence."""


@dataclass(frozen=True)
class Words:
    """Paragraphs, or with ``bullets`` the items of a list."""

    lines: Sequence[str]
    bullets: bool = False
    kind: ClassVar[str] = "words"


@dataclass(frozen=True)
class Facts:
    """Names and values."""

    pairs: Sequence[tuple[str, str]]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class Table:
    """Cells as they are shown; the first column names the row.  note: what is left out, or means what."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    kind: ClassVar[str] = "table"

    @property
    def sides(self) -> list[str]:
        """A class for each column: numbers stand to the right, words to the left."""
        columns = zip(*self.rows, strict=True)
        return [
            "words" if any(cell[:1].isalpha() for cell in column if cell not in _BESIDE) else "" for column in columns
        ]


@dataclass(frozen=True)
class Picture:
    """A PNG, with what its dots, lines and bands mean, and ``alt``: a few words for who cannot see it."""

    png: bytes = field(repr=False)
    caption: str
    alt: str
    kind: ClassVar[str] = "picture"

    @property
    def source(self) -> str:
        """The picture as a URI that holds all of it."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode()


@dataclass(frozen=True)
class Code:
    """Text in which every space counts."""

    text: str
    kind: ClassVar[str] = "code"

    @property
    def lines(self) -> list[str]:
        return self.text.rstrip("\n").replace("\r\n", "\n").split("\n")


Block = Words | Facts | Table | Picture | Code


@dataclass(frozen=True)
class Section:
    """A heading and what follows it."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A report.

    label: what kind of report.  question: what was asked.  warnings: what the reader must know before the answer.
    answer: sentences, the most important first.  origin: SHA-256 of what it was made from.
    """

    label: str
    title: str
    question: str
    warnings: Sequence[str]
    answer: Sequence[str]
    sections: Sequence[Section]
    origin: str = ""

    def html(self) -> str:
        """The whole file."""
        from jinja2 import Environment, PackageLoader, StrictUndefined

        made = Environment(
            loader=PackageLoader("fastcoil.deliver.report"), autoescape=True, undefined=StrictUndefined,
            finalize=_shown, trim_blocks=True, lstrip_blocks=True,
        )  # fmt: skip
        sections = [section for section in self.sections if section.blocks]
        return made.get_template("page.html").render(page=self, sections=sections, version=package_version())

    def write(self, path: Path) -> Path:
        """Write the file, whole or not at all."""
        commit(path, self.html().encode())
        return path


def _shown(value: Any) -> Any:
    """Text of anybody as it may be shown; what the template makes itself as it is."""
    if type(value) is not str:
        return value
    if value.startswith("data:"):
        return value
    cut = value if len(value) <= _LONGEST else f"{value[:_LONGEST]}… ({len(value):,} characters)"
    return printable(cut)


def anchor(title: str) -> str:
    """The name of a section in a link."""
    return re.sub(r"\W+", "-", title.lower()).strip("-")


def require_page(path: Path, option: str = "path") -> None:
    """Refuse, before any work, a path that cannot be written, or that holds anything but an earlier report.

    Raises
    ------
    InputError
        With the name of the ``option`` that gave it.
    """
    if path.suffix.lower() not in (".html", ".htm") or not may_be_file(path):
        raise InputError(f"{option} {path}: give a file NAME.html in a folder that exists")
    if exists(path) and not _is_page(path):
        raise InputError(f"{option} {path}: this file exists and is no report, choose another name or delete it")


def _is_page(path: Path) -> bool:
    try:
        return _MARK in read_bytes(path, _LARGEST)[:_MARK_WITHIN]
    except (OSError, ValueError):
        return False
