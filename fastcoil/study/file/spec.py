"""The strict reader of study files (TOML): every mistake is reported, all at once, and nothing is guessed.

A study has the tables ``[loop]`` (constants, ``preset``, ``include``), ``[sweep]`` (a parameter on its own axis),
``[cases.NAME]`` (named alternatives along a dimension NAME), ``[sample]`` (parameters drawn from distributions),
``[boundary]`` (``kind`` and its arguments) and ``[run]``; all but ``[loop]`` may be absent.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastcoil.errors import InputError, collecting
from fastcoil.simulation.plan import Plan, plan_simulation
from fastcoil.study.file.boundary import study_boundary
from fastcoil.study.file.include import included
from fastcoil.study.file.loop import study_loop
from fastcoil.study.file.reduction import Reduction, find_reduction
from fastcoil.study.file.tables import shaped

LARGEST_FILE = 2**20
"""Bytes: nobody writes a larger study by hand."""


@dataclass(frozen=True)
class Study:
    """A study that can be run: its text and tables, what it asks, and the validated plan.

    ``folder`` is where its relative paths start, ``sample_method`` how ``[sample]`` was drawn, ``reduction`` what
    ``[run] reduce`` names; ``None`` without.  ``included`` holds the parameters from the files in ``[loop] include``.
    """

    text: str
    tables: Mapping[str, Any] = field(repr=False)
    title: str
    question: str
    plan: Plan
    folder: Path
    sample_method: str | None
    reduction: Reduction | None
    included: Mapping[str, Any] = field(default_factory=dict)

    @property
    def kept_traces(self) -> tuple[str, ...]:
        """Names of the traces that results have: none where they are reduced."""
        return () if self.reduction else self.plan.traces.names

    @property
    def sha256(self) -> str:
        """Hash of everything that decides the result: the tables, what they include, the boundary, the reduction.

        Title, question, comments and spelling do not.
        """
        decisive = {name: table for name, table in self.tables.items() if name not in ("title", "question")}
        # dates and times, which TOML has and JSON has not, are as good as their text
        parts = [json.dumps(decisive, default=str), self.plan.layout.boundary.sha256]
        parts += [self.reduction.sha256] if self.reduction else []
        parts += [json.dumps(self.included)] if self.included else []
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read_study(path: Path, folder: Path | None = None) -> Study:
    """Read and validate a study file.

    Parameters
    ----------
    path
        The TOML file.
    folder
        Where relative paths in ``[boundary]`` and ``include`` and the module of ``[run] reduce`` start from; the
        file's folder by default.

    Raises
    ------
    InputError
        With one sentence for each mistake in the file.
    """
    text = _text(path)
    folder = path.parent if folder is None else folder
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of a number with more digits than Python reads
        raise InputError(f"{path} is not valid TOML: {error}") from None
    file, problems = shaped(tables)
    loop = boundary = plan = reduction = None
    from_files: dict[str, Any] = {}
    with collecting(problems, "[loop] "):
        from_files = included(file.loop, folder)
    with collecting(problems):
        loop = study_loop(file, from_files)
    with collecting(problems):
        boundary = study_boundary(file.boundary, folder)
    if loop is not None and boundary is not None:
        with collecting(problems):
            plan = plan_simulation(loop, boundary, **file.run.model_dump(exclude={"reduce"}), traces_on_disk=True)
    if file.run.reduce is not None:
        with collecting(problems, "[run] "):
            reduction = find_reduction(file.run.reduce, folder)
        if not file.run.traces:
            problems.append(
                f"[run] reduce = {file.run.reduce!r} without traces: list those that it needs, such as "
                'traces = ["T_sup"]'
            )
    if problems or plan is None:
        raise InputError([f"{path}: {problem}" for problem in problems])
    method = file.sample["method"] if file.sample else None
    return Study(text, tables, file.title or path.stem, file.question, plan, folder, method, reduction, from_files)


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
