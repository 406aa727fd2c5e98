"""The strict reader of study files (TOML): it guesses nothing and reports all mistakes together.

A study has the tables ``[loop]`` (constants, ``preset``, ``include``), ``[sweep]`` (a parameter on its own axis),
``[cases.NAME]`` (named alternatives along a dimension NAME), ``[sample]`` (parameters drawn from distributions),
``[boundary]`` (``kind`` and its arguments), ``[run]``, ``[tune]`` and ``[tariff]``; all but ``[loop]`` may be absent.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastcoil.base.errors import InputError, collecting
from fastcoil.base.files import read_text
from fastcoil.design.theory.operating_points import require_one_gap
from fastcoil.design.tuning.plan import Asked
from fastcoil.loops.loop import words_used
from fastcoil.loops.plan import Plan, plan_simulation
from fastcoil.model.numerics.jit import model_sha256
from fastcoil.study.analysis.cost_summary import Billing
from fastcoil.study.file.billing import billing_of
from fastcoil.study.file.boundary import build_boundary
from fastcoil.study.file.include import read_includes
from fastcoil.study.file.loop import build_loop
from fastcoil.study.file.rules import find_rules
from fastcoil.study.file.size import require_room
from fastcoil.study.file.source import Source, find_source
from fastcoil.study.file.tables import parse_tables
from fastcoil.study.file.toml import parse_toml
from fastcoil.study.file.tune import asked_of_tuning

LARGEST_FILE = 2**20
"""Bytes; no study written by hand is larger."""
_NOT_DECISIVE = ("title", "question", "tune", "tariff")
"""Tables on which no scenario depends."""
_LONGEST_NAME = 200
"""Characters of a path that an advice repeats."""


@dataclass(frozen=True)
class Study:
    """A study that can be run: its text and tables, its question, and the validated plan.

    folder: where its relative paths start.  sample_method: how ``[sample]`` was drawn.  reduction: the function that
    ``[run] reduce`` names.  Both are ``None`` without.  included: the parameters from the files in ``[loop] include``.
    rules: the code of its own estimators and control laws, by name.  predict: whether results get ``PREDICTIONS``.
    tuning: what ``[tune]`` asks, if anything.  billing: what ``[tariff]`` asks, if anything.
    """

    text: str
    tables: Mapping[str, Any] = field(repr=False)
    title: str
    question: str
    plan: Plan
    folder: Path
    sample_method: str | None
    reduction: Source | None
    included: Mapping[str, Any] = field(default_factory=dict)
    rules: Mapping[str, Source] = field(default_factory=dict)
    predict: bool = False
    tuning: Asked | None = None
    billing: Billing | None = None

    @property
    def kept_traces(self) -> tuple[str, ...]:
        """Names of the traces that results keep: none if they are reduced."""
        return () if self.reduction else self.plan.traces.names

    @property
    def model_sha256(self) -> str:
        """Hash of the sources of the model that it uses."""
        return model_sha256(frozenset(words_used(self.plan.layout.loop, "estimator")))

    @property
    def sha256(self) -> str:
        """Hash of everything that decides the result: the tables, included files, the boundary, its own code.

        Title, question, ``[tune]``, ``[tariff]``, comments and formatting do not.
        """
        decisive = {name: table for name, table in self.tables.items() if name not in _NOT_DECISIVE}
        # TOML has dates and times, JSON does not: their text will do
        parts = [json.dumps(decisive, default=str), self.plan.layout.boundary.sha256]
        parts += [self.reduction.sha256] if self.reduction else []
        parts += [json.dumps(self.included)] if self.included else []
        parts += [self.rules[name].sha256 for name in sorted(self.rules)]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read_study(
    path: Path, folder: Path | None = None, *, prepare: Callable[[str, Source], object] | None = None
) -> Study:
    """Read and validate a study file.

    Parameters
    ----------
    path
        The TOML file.
    folder
        Where relative paths in ``[boundary]`` and ``include`` and the modules of its own code start from; the file's
        folder by default.
    prepare
        Loads the study's own code, called with the word that names it, ``reduce``, ``estimator`` or ``law``, and its
        source, so that its mistakes are reported with the others.  By default nothing does: reading a study runs no
        code that comes with it.

    Raises
    ------
    InputError
        With one sentence for each mistake in the file.
    """
    what = "a study file, or make one with `fastcoil init" + (f" {path}`" if len(str(path)) < _LONGEST_NAME else "`")
    text = read_text(path, what, LARGEST_FILE).replace("\r\n", "\n")
    folder = path.parent if folder is None else folder
    tables = parse_toml(text, str(path))
    file, problems = parse_tables(tables)
    try:
        require_room(file)
    except InputError as error:
        raise InputError([f"{path}: {problem}" for problem in problems + error.problems]) from None
    try:
        file, sources, rules = find_rules(file, folder)
        if prepare is not None:
            for name, rule in rules.items():
                rule.adopt(prepare(rule.kind, sources[name]))
    except InputError as error:
        raise InputError([f"{path}: {problem}" for problem in problems + error.problems]) from None
    loop = boundary = plan = reduction = None
    from_files: dict[str, Any] = {}
    with collecting(problems, "[loop] "):
        from_files = read_includes(file.loop, folder)
    with collecting(problems):
        loop = build_loop(file, from_files, rules)
    with collecting(problems):
        boundary = build_boundary(file.boundary, folder)
    if loop is not None and boundary is not None:
        with collecting(problems):
            plan = plan_simulation(
                loop, boundary, **file.run.model_dump(exclude={"reduce", "predict"}), traces_on_disk=True
            )
    if file.run.predict and boundary is not None:
        with collecting(problems, "[run] predict: "):
            require_one_gap(boundary)
    tuning = None
    if file.tune is not None and loop is not None and boundary is not None:
        with collecting(problems, "[tune] "):
            tuning = asked_of_tuning(file.tune, file.run, loop, boundary, folder)
    billing = None
    if file.tariff is not None:
        with collecting(problems, "[tariff] "):
            billing = billing_of(file.tariff, None if plan is None else plan.layout)
    if file.run.reduce is not None:
        with collecting(problems, "[run] "):
            reduction = find_source("reduce", file.run.reduce, folder)
            if prepare is not None:
                prepare("reduce", reduction)
        if not file.run.traces:
            problems.append(
                f"[run] reduce = {file.run.reduce!r} without traces: list the traces it needs, such as "
                'traces = ["T_sup"]'
            )
    if problems or plan is None:
        raise InputError([f"{path}: {problem}" for problem in problems])
    method = file.sample["method"] if file.sample else None
    return Study(
        text, tables, file.title or path.stem, file.question, plan, folder, method, reduction, from_files, sources,
        file.run.predict, tuning, billing,
    )  # fmt: skip
