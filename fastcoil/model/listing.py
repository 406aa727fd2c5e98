"""The parameters of a loop as a list to read: in a terminal, in a notebook, on the command line."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

from fastcoil.base.notebook_card import Section, card
from fastcoil.model.parameter_table import Parameter


class Listing(dict[str, Parameter]):
    """Parameters by name, shown as a list by the parts of the loop."""

    def __repr__(self) -> str:
        return "\n".join(lines_of(self.values()))

    def _repr_html_(self) -> str:
        sections = [
            Section(group, [(p.name, _default(p), p.bounds, p.text) for p in of_group], is_open=len(self) < _FEW)
            for group, of_group in ((group, list(some)) for group, some in groupby(self.values(), _group))
        ]
        return card("fastcoil.parameters", f"{len(self)} parameters of a loop", (), sections)


_FEW = 12
"""So few are not folded."""


def lines_of(parameters: Iterable[Parameter]) -> list[str]:
    """A heading for each part of the loop, and a line for each parameter: default, unit, meaning, allowed values."""
    lines = []
    for group, some in groupby(parameters, _group):
        lines.append(group)
        for p in some:
            default = "-" if p.default is None else f"{p.default}"
            unit = "" if p.unit == "1" else p.unit
            lines.append(f"  {p.name:<22}{default:>10} {unit:<12} {p.text} ({p.bounds})")
    return lines


def _group(p: Parameter) -> str:
    return p.group


def _default(p: Parameter) -> str:
    if p.default is None:
        return "-"
    return f"{p.default}" if p.unit in ("", "1") else f"{p.default} {p.unit}"
