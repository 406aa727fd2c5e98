"""Base class for results with text, notebook and TOML output, and the HTML card that notebooks show.

A card has a heading and folding tables, and no script.  All text is escaped.  Colours are inherited from the page,
light or dark; in an untrusted notebook, which drops the style, plain tables remain.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastcoil.base.arguments import path_of
from fastcoil.base.errors import InputError
from fastcoil.base.files import commit, may_be_file

if TYPE_CHECKING:
    from jinja2 import Template


_CURVE = (110.0, 18.0)
"""Width and height of a curve in a table cell, pixels."""
_ROUND_OFF = 1e-9
_TEMPLATE = """\
<div class="fastcoil-card"><style>
.fastcoil-card {font-size: 13px; line-height: 1.5; max-width: 760px}
.fastcoil-card p {margin: 0; padding: 0 0 4px}
.fastcoil-card .fc-head {border-bottom: 1px solid rgba(128,128,128,.4); margin-bottom: 4px}
.fastcoil-card .fc-soft, .fastcoil-card caption {opacity: .7}
.fastcoil-card summary {cursor: pointer; padding: 1px 0}
.fastcoil-card table {border-collapse: collapse; border: 0; margin: 0 0 4px 14px; font-size: inherit}
.fastcoil-card tr, .fastcoil-card tr:nth-child(even), .fastcoil-card td {background: transparent}
.fastcoil-card td {border: 0; padding: 1px 14px 1px 0; text-align: left; vertical-align: middle}
.fastcoil-card td:first-child {font-family: monospace; white-space: nowrap}
.fastcoil-card td:nth-child(2) {min-width: 60px}
.fastcoil-card td:last-child {opacity: .7}
.fastcoil-card td.fc-plain {opacity: 1}
.fastcoil-card svg {vertical-align: middle}
.fastcoil-card pre {margin: 0 0 4px 14px; white-space: pre-wrap; background: transparent; color: inherit}
</style>
<p class="fc-head"><span class="fc-soft">{{ kind }}</span> <strong>{{ heading }}</strong></p>
{% for is_table, some in lines|by_indent %}{% if is_table %}<pre>{{ some|join("\n") }}</pre>{% else %}
{%- for line in some %}<p>{{ line }}</p>{% endfor %}{% endif %}
{% endfor -%}
{% for s in sections %}<details{% if s.is_open %} open{% endif %}><summary>{{ s.title }}
{%- if s.soft %} <span class="fc-soft">{{ s.soft }}</span>{% endif %}</summary>
{% if s.text %}<pre>{{ s.text }}</pre>{% endif %}
{%- if s.rows %}<table>
{% for row in s.rows %}<tr>{% for cell in row %}<td>{% if cell is string %}{{ cell }}{% else %}
<svg width="{{ width }}" height="{{ height }}" role="img" aria-label="{{ cell.words }}">
{%- for points in cell.lines %}<polyline points="{{ points }}" fill="none" stroke="currentColor" stroke-width="1"
 opacity="{{ cell.opacity }}"/>{% endfor %}</svg>
{%- endif %}</td>{% endfor %}</tr>
{% endfor %}</table>{% endif %}</details>
{% endfor %}</div>"""


@dataclass(frozen=True)
class Curves:
    """Small overlaid curves in a table cell.

    lines: the points of each curve in SVG notation.  words: alternative text.
    """

    lines: tuple[str, ...]
    words: str

    @property
    def opacity(self) -> str:
        """Opacity of each curve; overlaid ones are translucent."""
        return "0.9" if len(self.lines) == 1 else "0.45"

    @classmethod
    def of(cls, values: Sequence[Sequence[float]], words: str) -> Curves:
        """Curves of equally spaced values on one scale; a constant curve is drawn in the middle."""
        width, height = _CURVE
        low, high = min(min(one) for one in values), max(max(one) for one in values)
        # means of equal values differ by round-off
        span = high - low if high - low > _ROUND_OFF * max(abs(low), abs(high)) else 0.0

        def place(k: int, n: int, value: float) -> str:
            share = (value - low) / span if span > 0.0 else 0.5
            return f"{width * k / max(n - 1, 1):.1f},{1.0 + (height - 2.0) * (1.0 - share):.1f}"

        def points(one: Sequence[float]) -> str:
            ends = [*one, one[0]] if len(one) == 1 else one
            return " ".join(place(k, len(ends), value) for k, value in enumerate(ends))

        return cls(tuple(points(one) for one in values), words)


@dataclass(frozen=True)
class Section:
    """A folding part of a card.

    soft: subdued text beside the title.  rows: cells of text or curves.  text: preformatted text.
    """

    title: str
    rows: Sequence[Sequence[str | Curves]] = ()
    soft: str = ""
    text: str = ""
    is_open: bool = False


def card(kind: str, heading: str, lines: Sequence[str] = (), sections: Sequence[Section] = ()) -> str:
    """HTML of a card: kind of object, heading, lines of text, folding sections."""
    shown: dict[str, Any] = {"kind": kind, "heading": heading, "lines": lines, "sections": sections}
    return _template().render(**shown, width=f"{_CURVE[0]:g}", height=f"{_CURVE[1]:g}")


@cache
def _template() -> Template:
    from jinja2 import Environment

    page = Environment(autoescape=True)
    page.filters["by_indent"] = _by_indent
    return page.from_string(_TEMPLATE)


def _by_indent(lines: Sequence[str]) -> list[tuple[bool, list[str]]]:
    """Group lines into text and table rows (indented, or with columns), whose spaces are kept."""
    return [(key, list(some)) for key, some in groupby(lines, _is_row)]


def _is_row(line: str) -> bool:
    return line.startswith("  ") or "   " in line.strip()


class Result(ABC):
    """Base class for results with text, notebook and TOML output."""

    @abstractmethod
    def summary(self) -> list[str]:
        """The result as lines of text."""

    @abstractmethod
    def to_toml(self, path: str | Path | None = None) -> str:
        """The result as TOML, also written to ``path`` if given."""

    def __repr__(self) -> str:
        return "\n".join([f"<fastcoil {type(self).__name__}>", *self.summary()])

    def _repr_html_(self) -> str:
        first, *others = self.summary()
        toml = Section("for a study file", text=self.to_toml())
        return card(f"fastcoil {type(self).__name__}", first, others, [toml])


def as_toml(lines: Iterable[str], path: str | Path | None) -> str:
    """Join lines of TOML, and write them to ``path`` if given.

    Raises
    ------
    InputError
        If ``path`` is a folder, or its folder does not exist.
    StorageError
        If it cannot be written; no partial file remains.
    """
    text = "\n".join(lines) + "\n"
    if path is not None:
        path = path_of("path", path)
        if not may_be_file(path):
            raise InputError(f"{path} cannot be written: give a file in a folder that exists")
        commit(path, text.encode())
    return text


def toml_table(name: str, values: Mapping[str, object], remark: str = "") -> list[str]:
    """Lines of a table in TOML notation, after an empty one."""
    head = f"[{name}]  # {remark}" if remark else f"[{name}]"
    return ["", head, *(f"{key} = {in_toml(value)}" for key, value in values.items())]


def in_toml(value: object) -> str:
    """A text, a number, a boolean, or a list of these in TOML notation."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (int, float)):
        return repr(float(value)) if isinstance(value, float) else repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(in_toml, value))}]"
    raise TypeError(f"{type(value).__name__} in TOML")
