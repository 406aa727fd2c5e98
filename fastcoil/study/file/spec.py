"""Build the days on which a study is run from the table ``[boundary]``.

The size of a study from its tables alone: one that does not fit is refused before any of its values is made.

What the table ``[tariff]`` of a study asks for.

What the table ``[tune]`` of a study asks for.

The strict reader of study files (TOML): it guesses nothing and reports all mistakes together.

A study has the tables ``[loop]`` (constants, ``preset``, ``include``), ``[sweep]`` (a parameter on its own axis),
``[cases.NAME]`` (named alternatives along a dimension NAME), ``[sample]`` (parameters drawn from distributions),
``[boundary]`` (``kind`` and its arguments), ``[run]``, ``[tune]`` and ``[tariff]``; all but ``[loop]`` may be absent.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastcoil.base.errors import InputError, collecting, nearest, shown
from fastcoil.base.files import read_text
from fastcoil.design.operating_points import require_one_gap
from fastcoil.design.tuning_plan import Asked, plan_tuning
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, design_day, heating_day, paper_day
from fastcoil.loops.boundary.weather import weather_day
from fastcoil.loops.boundary.weather_year import weather_year
from fastcoil.loops.loop import Loop, words_used
from fastcoil.loops.plan import Plan, check_memory, plan_simulation
from fastcoil.loops.scenarios import Layout
from fastcoil.model.metric_table import METRICS
from fastcoil.model.numerics.jit import model_sha256
from fastcoil.study.analysis.cost import TAKEN, tariff_of
from fastcoil.study.analysis.summary import Billing
from fastcoil.study.file.loop import axis_size, build_loop, read_includes
from fastcoil.study.file.own_code import Source, find_rules, find_source
from fastcoil.study.file.sampling import design_size
from fastcoil.study.file.tables import RunTable, StudyFile, TariffTable, TuneTable, parse_tables, parse_toml, with_hints

BOUNDARY_KINDS: dict[str, Callable[..., Boundary]] = {
    "paper_day": paper_day,
    "constant_day": constant_day,
    "design_day": design_day,
    "heating_day": heating_day,
    "csv": Boundary.from_csv,
    "weather": weather_day,
    "weather_year": weather_year,
}


def build_boundary(table: Mapping[str, Any], folder: Path) -> Boundary:
    """Build the boundary of a study; ``paper_day`` of 8 h with seed 1 where the table is absent."""
    arguments = dict(table)
    kind = arguments.pop("kind", "paper_day")
    if not isinstance(kind, str) or kind not in BOUNDARY_KINDS:
        raise InputError(
            f"[boundary] kind = {shown(kind)}: unknown{nearest(str(kind), BOUNDARY_KINDS)}; "
            f"choose one of {', '.join(BOUNDARY_KINDS)}"
        )
    make = BOUNDARY_KINDS[kind]
    signature = inspect.signature(make).parameters
    problems = [
        f"[boundary] {name} is not an argument of {kind}{hint}; it takes {', '.join(signature)}"
        for name, hint in with_hints((name for name in arguments if name not in signature), signature)
    ]
    problems += [
        f"[boundary] {name} is missing: {kind} needs it"
        for name, p in signature.items()
        if p.default is p.empty and name not in arguments
    ]
    if problems:
        raise InputError(problems)
    if "path" in arguments:
        arguments["path"] = folder / str(arguments["path"])
    try:
        return make(**arguments)
    except InputError as error:
        raise InputError([f"[boundary] {p}" for p in error.problems]) from None


_BYTES_PER_SCENARIO = 3 * 8 * (len(METRICS) + 1)
"""Metrics and status: the result, its image on the way to disk, a copy while it is put together."""

_MOST_OF_ANY = 2**32


def require_room(file: StudyFile) -> None:
    """Refuse a study of more scenarios than this machine can hold the metrics of.

    Tables that are wrong in another way count as 1; their readers refuse them.
    """
    days = next((file.boundary[key] for key in ("seed", "days") if isinstance(file.boundary.get(key), list)), [0])
    sizes = [
        *map(axis_size, file.sweep.values()),
        *map(len, file.cases.values()),
        design_size(file.sample or {}),
        len(days),
        file.run.replicates,
    ]
    # each of them has a bound of its own, which is checked elsewhere
    n_scenarios = math.prod(min(max(1, size), _MOST_OF_ANY) for size in sizes)
    check_memory(n_scenarios * _BYTES_PER_SCENARIO, n_scenarios)


_MOST_LABELS = 10


def billing_of(table: TariffTable, layout: Layout | None) -> Billing:
    """The prices, and the labels with which costs are compared.

    layout: of the study, None where it could not be planned; the labels are then not checked.
    """
    tariff = tariff_of(table.model_dump(exclude={"baseline"}))
    baseline = dict(table.baseline)
    if len(baseline) > 1:
        raise InputError(f"baseline = {shown(baseline)}: give one dimension and one of its labels")
    problems: list[str] = []
    if layout is not None:
        named = [f"the costs also have a dimension or number {dim}: rename it" for dim in layout.sizes if dim in TAKEN]
        problems = named + [p for dim, label in baseline.items() for p in _problems(layout, dim, label)]
    if problems:
        raise InputError(problems)
    return Billing(tariff, baseline)


def _problems(layout: Layout, dim: str, label: float | str) -> list[str]:
    """A sentence if a study does not have a label."""
    dims = [name for name in layout.loop.sizes if name != "sample"]
    if dim not in dims:
        known = f"choose one of {', '.join(dims)}" if dims else "the study has no dimension of its own"
        return [f"baseline: {shown(dim)} is no dimension of the loops{nearest(dim, dims)}: {known}"]
    labels = layout.coordinates()[dim].values.tolist()
    if label not in labels:
        listed = ", ".join(map(str, labels[:_MOST_LABELS]))
        return [f"baseline: {dim} has no label {shown(label)}: choose one of {listed}"]
    return []


def asked_of_tuning(table: TuneTable, run: RunTable, loop: Loop, boundary: Boundary, folder: Path) -> Asked:
    """The tuning of the valves and days of a study; ``holdout`` is labels of days, or a table like ``[boundary]``."""
    if run.carry_over:
        raise InputError("every day is tried alone: leave [run] carry_over out, or tune in a study of its own")
    holdout: object = table.holdout
    if isinstance(holdout, dict):
        try:
            holdout = build_boundary(holdout, folder)
        except InputError as error:
            raise InputError([f"holdout: {p.removeprefix('[boundary] ')}" for p in error.problems]) from None
    elif holdout is not None and not isinstance(holdout, list):
        raise InputError(
            f"holdout = {shown(holdout)}: give days as in [boundary], such as {{ seed = [2, 3] }}, or labels of some "
            "days of it, such as [4, 5]"
        )
    return plan_tuning(
        loop,
        boundary,
        search=table.search,
        objective=table.objective,
        quantile=table.quantile,
        limits=table.limits,
        holdout=holdout,
        evaluations=table.evaluations,
        warm_up=run.warm_up,
        seed=run.seed,
        replicates=run.replicates,
    )


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
