"""Results that tell themselves: in lines, in a notebook, and as TOML that a study file can include."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path

from fastcoil.base.arguments import path_of
from fastcoil.base.errors import InputError
from fastcoil.base.files import commit
from fastcoil.base.look import may_be_file
from fastcoil.base.notebook_card import Section, card


class Told(ABC):
    """A result that tells itself in lines, shown as these and in a notebook with its TOML."""

    @abstractmethod
    def summary(self) -> list[str]:
        """The result in words, line by line."""

    @abstractmethod
    def to_toml(self, path: str | Path | None = None) -> str:
        """The result as TOML, written to ``path`` if one is given."""

    def __repr__(self) -> str:
        return "\n".join([f"<fastcoil {type(self).__name__}>", *self.summary()])

    def _repr_html_(self) -> str:
        first, *others = self.summary()
        toml = Section("for a study file", text=self.to_toml())
        return card(f"fastcoil {type(self).__name__}", first, others, [toml])


def as_toml(lines: Iterable[str], path: str | Path | None) -> str:
    """The text of these lines, written to ``path`` if one is given.

    Raises
    ------
    InputError
        If ``path`` is a folder, or in none that exists.
    StorageError
        If it cannot be written; nothing half-written is left behind.
    """
    text = "\n".join(lines) + "\n"
    if path is not None:
        path = path_of("path", path)
        if not may_be_file(path):
            raise InputError(f"{path} cannot be written: give a file in a folder that exists")
        commit(path, text.encode())
    return text


def in_toml(value: object) -> str:
    """A text, a number, a truth, or a list of such, as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (int, float)):
        return repr(float(value)) if isinstance(value, float) else repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(in_toml, value))}]"
    raise TypeError(f"{type(value).__name__} in TOML")
