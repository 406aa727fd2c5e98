"""Study files to start from: the template of ``fastcoil init``, and the studies that come with fastcoil."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from fastcoil.base.errors import InputError, StorageError, nearest, shown

TEMPLATE = Path(__file__).with_name("template.toml").read_text(encoding="utf-8")
_ANALYSIS = "# Analysis: "  # begins the line of a study file that names the script for what `fastcoil run` does not do


@dataclass(frozen=True)
class ShippedStudy:
    """A study file to start from."""

    name: str
    text: str

    @property
    def title(self) -> str:
        return str(tomllib.loads(self.text)["title"])

    @property
    def analysis(self) -> str:
        """The script that analyses the results, in words; empty where `fastcoil run` is enough."""
        found = (line for line in self.text.splitlines() if line.startswith(_ANALYSIS))
        return next(found, "").removeprefix(_ANALYSIS)


def shipped_studies() -> list[ShippedStudy]:
    """All of them, by name."""
    folders = (folder for folder in _folder().iterdir() if folder.is_dir())
    found = [file for folder in folders for file in folder.iterdir() if file.name.endswith(".toml")]
    found.sort(key=lambda file: file.name)
    return [ShippedStudy(file.name.removesuffix(".toml"), file.read_text(encoding="utf-8")) for file in found]


def shipped_study(name: str) -> ShippedStudy:
    """The study called ``name``."""
    known = {study.name: study for study in shipped_studies()}
    if name not in known:
        raise InputError(f"--from {shown(name)}: no such study{nearest(name, known)}; choose one of {', '.join(known)}")
    return known[name]


def _folder() -> Traversable:
    package = files("fastcoil")
    installed = package / "studies"
    if installed.is_dir():
        return installed
    root = Path(str(package)).parent
    if (root / "pyproject.toml").is_file() and (root / "studies").is_dir():
        return root / "studies"
    raise StorageError("this installation of fastcoil has no studies: install it again")
