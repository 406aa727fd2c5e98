"""The strict reader of study files (TOML): every mistake is reported, all at once, and nothing is guessed.

A study has the tables ``[loop]`` (constants, ``preset``), ``[sweep]`` (a parameter on its own axis),
``[cases.NAME]`` (named alternatives along a dimension NAME), ``[sample]`` (parameters drawn from distributions),
``[boundary]`` (``kind`` and its arguments) and ``[run]``; all but ``[loop]`` may be absent.
"""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from pathlib import Path

from fastcoil.errors import InputError, collecting
from fastcoil.plan import Plan, prepare
from fastcoil.study.axes import study_loop
from fastcoil.study.days import study_boundary
from fastcoil.study.tables import shaped

LARGEST_FILE = 2**20
"""Bytes: nobody writes a larger study by hand."""


@dataclass(frozen=True)
class Study:
    """A study that can be run: its text, what it asks, the validated plan, and how it was sampled, if it was."""

    text: str
    title: str
    question: str
    plan: Plan
    sample_method: str | None

    @property
    def sha256(self) -> str:
        """Hash of everything that decides the result: the text and the boundary's samples."""
        return hashlib.sha256(f"{self.text}\0{self.plan.layout.boundary.sha256}".encode()).hexdigest()


def read_study(path: Path) -> Study:
    """Read and validate a study file.  Relative paths in ``[boundary]`` start from the file's folder.

    Raises
    ------
    InputError
        With one sentence for each mistake in the file.
    """
    text = _text(path)
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of a number with more digits than Python reads
        raise InputError(f"{path} is not valid TOML: {error}") from None
    file, problems = shaped(tables)
    loop = boundary = plan = None
    with collecting(problems):
        loop = study_loop(file)
    with collecting(problems):
        boundary = study_boundary(file.boundary, path.parent)
    if loop is not None and boundary is not None:
        with collecting(problems):
            plan = prepare(loop, boundary, **file.run.model_dump())
    if problems or plan is None:
        raise InputError([f"{path}: {problem}" for problem in problems])
    return Study(text, file.title or path.stem, file.question, plan, file.sample["method"] if file.sample else None)


def _text(path: Path) -> str:
    if path.is_dir():
        raise InputError(f"{path} is a folder: give the study's TOML file")
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path} has {path.stat().st_size:,} bytes: a study file has at most {LARGEST_FILE:,}")
        return path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give a study file, or make one with `fastcoil init {path}`") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 (byte {error.start}): save it as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
