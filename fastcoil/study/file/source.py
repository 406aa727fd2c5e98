"""A study's own code, ``module:function``: a reduction of traces, an estimator or a control law.

Here its source is found and read as text, so that it can be sent to other processes and hashed with the study.  Nothing
of it is run, nor of a package that it lies in: a study may be a stranger's.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import TooLargeError, is_file, read_bytes, require_usable

_LARGEST = 2**18
"""Bytes of source: to read one as Python takes 500 times its memory."""


@dataclass(frozen=True)
class Source:
    """A function of the user: ``name`` is ``module:function``, ``source`` the text of the module, ``path`` its file."""

    name: str
    source: str = field(repr=False)
    path: Path = field(compare=False)

    @property
    def sha256(self) -> str:
        """Hash of the name and the text."""
        return hashlib.sha256(f"{self.name}\0{self.source}".encode()).hexdigest()


def find_source(what: str, text: str, folder: Path) -> Source:
    """Find ``module:function``: ``module.py`` in ``folder`` if there is one, else a module that can be imported.

    what: the word of the study file that names it.

    Raises
    ------
    InputError
        If there is no such module, or it cannot be read.
    """
    module, _, function = text.partition(":")
    parts = module.split(".")
    if not all(part.isidentifier() for part in (*parts, function)):
        raise InputError(
            f"{what} = {text!r}: give module:function, such as 'mine:overshoot' for the function overshoot in mine.py"
        )
    path = folder.joinpath(*parts).with_suffix(".py")
    require_usable(path, f"give {what} = {shown(text)} a shorter name")
    if not is_file(path):
        path = _find_importable(what, text, parts, path)
    try:
        source = importlib.util.decode_source(read_bytes(path, _LARGEST))  # in the encoding that it declares
        source.encode()
    except TooLargeError as error:
        raise InputError(f"{what} = {text!r}: {path} {error}: move what the function does not need elsewhere") from None
    except (OSError, SyntaxError, ValueError, LookupError) as error:
        raise InputError(f"{what} = {text!r}: {path} cannot be read: {type(error).__name__}: {error}") from None
    return Source(text, source, path)


def _find_importable(what: str, text: str, parts: Sequence[str], tried: Path) -> Path:
    """Source file of a module that can be imported."""
    spec = _find_spec(parts)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        found = "no module" if spec is None else "no module written in Python"
        raise InputError(
            f"{what} = {text!r}: there is no {tried}, and {found} {'.'.join(parts)} can be imported: put {tried.name} "
            "next to the study file, or install the module"
        )
    return Path(spec.origin)


def _find_spec(parts: Sequence[str]) -> ModuleSpec | None:
    """Where a module would be imported from; ``importlib.util.find_spec`` imports the packages that it lies in."""
    top, *rest = parts
    specs = (finder.find_spec(top, None) for finder in sys.meta_path)
    spec = next((s for s in specs if s is not None), None)
    for part in rest:
        if spec is None or spec.submodule_search_locations is None:
            return None
        spec = PathFinder.find_spec(part, list(spec.submodule_search_locations))
    return spec
