"""The strict reader of study files (TOML): it guesses nothing and reports all mistakes together."""

from __future__ import annotations

import hashlib
import inspect
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from fastcoil.base.arguments import collect_problems, raise_problems, require_choice, require_integer
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.base.files import read_text
from fastcoil.design.tuning_plan import TuningRequest, plan_tuning
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, design_day, heating_day, paper_day
from fastcoil.loops.boundary.weather import weather_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import Plan, check_memory, plan_simulation
from fastcoil.loops.presets import PRESETS
from fastcoil.loops.scenarios import Layout
from fastcoil.model.metric_table import METRICS
from fastcoil.study.analysis.precision import DEFAULT_MAX_BATCHES, MIN_BATCHES, Precision
from fastcoil.study.analysis.selected import list_first
from fastcoil.study.file.loop import build_loop, read_includes
from fastcoil.study.file.sample import MAX_SAMPLE_SIZE, SALTELLI, SAMPLE_DIM, design_size, sample_file_hashes
from fastcoil.study.file.tables import PrecisionTable, StudyFile, pair_with_hints, parse_tables, parse_toml
from fastcoil.study.file.user_code import Prepare, UserCode, find_function, find_rules, load_code

BOUNDARY_KINDS: dict[str, Callable[..., Boundary]] = {
    "paper_day": paper_day,
    "constant_day": constant_day,
    "design_day": design_day,
    "heating_day": heating_day,
    "csv": Boundary.from_csv,
    "weather": weather_day,
}


_MAX_DAYS = 1_000_000  # as many as an axis may have values


def build_boundary(table: Mapping[str, Any], folder: Path) -> Boundary:
    """Build the boundary of a study, by default ``paper_day()``; ``days = 80`` stands for the seeds 1 to 80."""
    arguments = dict(table)
    kind = require_choice("kind", arguments.pop("kind", "paper_day"), BOUNDARY_KINDS)
    make = BOUNDARY_KINDS[kind]
    parameters = inspect.signature(make).parameters
    if "days" in arguments and "seed" in parameters and "days" not in parameters:
        if "seed" in arguments:
            raise InputError("days and seed: give one of them, days = 80 means the seeds 1 to 80", "days", "conflict")
        cure = f"give a whole number from 1 to {_MAX_DAYS:,}: the seeds 1, 2, … are taken"
        n_days = require_integer("days", arguments.pop("days"), 1, _MAX_DAYS, cure)
        arguments["seed"] = list(range(1, n_days + 1))
    raise_problems(find_argument_problems(kind, arguments, parameters))
    if "path" in arguments:
        arguments["path"] = folder / str(arguments["path"])
    return make(**arguments)


def find_argument_problems(
    what: str, arguments: Mapping[str, Any], parameters: Mapping[str, inspect.Parameter]
) -> list[Problem]:
    """Find the keys of a table that its function does not take, and those that it needs."""
    unknown = pair_with_hints((name for name in arguments if name not in parameters), parameters)
    missing = [name for name, p in parameters.items() if p.default is p.empty and name not in arguments]
    takes = f"it takes {', '.join(parameters)}"
    problems = [Problem(f"{name} is not an argument of {what}{hint}; {takes}", name, "name") for name, hint in unknown]
    return problems + [Problem(f"{name} is missing: {what} needs it", name, "missing") for name in missing]


def require_memory(file: StudyFile, loop: Loop) -> None:
    """Refuse more scenarios than the memory suffices for, before their days are made."""
    given = [file.boundary.get(key) for key in ("seed", "days")]
    n_days = next((len(each) if isinstance(each, list) else each for each in given if isinstance(each, (int, list))), 1)
    replicates = min(max(1, file.run.replicates), 2**32)  # others are refused later
    n_scenarios = math.prod(loop.sizes.values()) * max(1, n_days) * replicates
    check_memory(3 * 8 * n_scenarios, n_scenarios)  # an index, and two copies of a metric: the others are on the disk


def _find_baseline_problems(baseline: Mapping[str, Any], layout: Layout) -> Iterator[Problem]:
    """Find dims and labels that the loops of a study do not have."""
    dims = [name for name in layout.loop.sizes if name != SAMPLE_DIM]
    for dim, label in baseline.items():
        if dim not in dims:
            known = f"choose one of {', '.join(dims)}" if dims else "the study has no dimension of its own"
            sentence = f"baseline: {short_repr(dim)} is not a dimension of the loops{did_you_mean(dim, dims)}: {known}"
            yield Problem(sentence, "baseline", "name")
        elif label not in (labels := layout.coordinates()[dim].values.tolist()):
            sentence = f"baseline: {dim} has no label {short_repr(label)}: choose one of {list_first(labels)}"
            yield Problem(sentence, "baseline", "choice")


def parse_precision(table: PrecisionTable, sample: Mapping[str, Any] | None) -> Precision:
    """Parse ``[run] precision``; of a wrong [sample], which is refused elsewhere, with a batch of one."""
    problems: list[str] = []
    with collect_problems(problems):
        require_choice("metric", table.metric, METRICS)
    if not table.half_width > 0.0:
        problems.append(Problem(f"half_width = {table.half_width:g}: must be above 0", "half_width", "value"))
    if sample is None:
        problems.append(Problem("[sample] is missing: give what is to be drawn", "sample", "missing"))
    elif sample.get("method") == SALTELLI:
        problems.append(Problem("saltelli draws for Sobol' indices: take another method", "method", "conflict"))
    size = design_size(sample or {})
    most = size * DEFAULT_MAX_BATCHES if table.most is None else table.most
    if not size * MIN_BATCHES <= most <= MAX_SAMPLE_SIZE:
        fewest = f"{size * MIN_BATCHES:,}, {MIN_BATCHES} batches of [sample] size"
        sentence = f"most = {most:,}: must be at least {fewest}, and at most {MAX_SAMPLE_SIZE:,}"
        problems.append(Problem(sentence, "most", "value"))
    raise_problems(problems)
    return Precision(table.metric, table.half_width, table.relative, dict(table.baseline), size, most)


def parse_tuning(study: Study) -> TuningRequest:
    """Parse ``[tune]`` for a study's valves and days; ``holdout`` is labels of days or a table like ``[boundary]``."""
    table, plan = study.tables["tune"], study.largest_plan or study.plan
    layout = plan.layout
    if plan.carry_over:
        sentence = "every day is tried alone: leave [run] carry_over out, or tune in a study of its own"
        raise InputError(sentence, "carry_over", "unsupported")
    holdout = table.get("holdout")
    if isinstance(holdout, dict):
        problems: list[str] = []
        with collect_problems(problems, "holdout: "):
            holdout = build_boundary(holdout, study.folder)
        raise_problems(problems)
    run_options = {"warm_up": plan.warm_up, "seed": plan.seed, "replicates": layout.sizes.get("replicate", 1)}
    keywords = inspect.signature(plan_tuning).parameters.items()
    parameters = {name: p for name, p in keywords if p.kind is p.KEYWORD_ONLY and name not in run_options}
    raise_problems(find_argument_problems("tune", table, parameters))
    return plan_tuning(layout.loop, layout.boundary, **{**table, "holdout": holdout}, **run_options)


MAX_STUDY_FILE_BYTES = 2**20  # no study written by hand is larger
Result = TypeVar("Result")
_TABLES_WITHOUT_EFFECT = ("title", "question", "tune")  # on which no scenario depends


@dataclass(frozen=True)
class Study:
    """A study that can be run: its text and tables, its question, and the validated plan."""

    text: str
    tables: Mapping[str, Any] = field(repr=False)
    title: str
    question: str
    plan: Plan
    folder: Path  # where its relative paths start
    reduction: UserCode | None  # of ``[run] reduce``
    included_parameters: Mapping[str, Any] = field(default_factory=dict)  # from the files in ``[loop] include``
    sample_file_hashes: Sequence[str] = ()  # of the files that ``[sample]`` names
    rules: Mapping[str, UserCode] = field(default_factory=dict)  # code of user-defined rules, by name
    precision: Precision | None = None  # of ``[run] precision``
    batches: int = 1  # of samples in ``plan``
    largest_plan: Plan | None = field(default=None, repr=False)  # that of the most samples that may be drawn

    @property
    def sha256(self) -> str:
        """Hash of all that decides the result: tables but ``[tune]``, included files, the boundary, the user's code."""
        decisive = {name: table for name, table in self.tables.items() if name not in _TABLES_WITHOUT_EFFECT}
        # TOML has dates and times, JSON does not: their text will do
        parts = [json.dumps(decisive, default=str), self.plan.layout.boundary.sha256]
        parts += [self.reduction.sha256] if self.reduction else []
        parts += [json.dumps(self.included_parameters)] if self.included_parameters else []
        parts += self.sample_file_hashes
        parts += [self.rules[name].sha256 for name in sorted(self.rules)]
        parts += [f"{self.batches} batches"] if self.precision else []
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def with_batches(self, batches: int) -> Study:
        """Return the study with its first batches of samples, where it has ``precision``."""
        if self.precision is None or self.largest_plan is None or batches == self.batches:
            return self
        layout, n = self.largest_plan.layout, batches * self.precision.size
        sampled = {name: values for name, values in layout.loop.swept.items() if SAMPLE_DIM in values.dims}
        loop = layout.loop.assign(**{name: values.isel({SAMPLE_DIM: slice(n)}) for name, values in sampled.items()})
        layout = Layout(loop, layout.boundary, layout.sizes.get("replicate", 1))
        return replace(self, plan=replace(self.largest_plan, layout=layout), batches=batches)

    def find_by_hash(self, sha256: str, n_samples: int | None = None) -> Study | None:
        """Return the study with the batches of that with this hash, or with at least ``n_samples``; None if another."""
        counts = self.precision.batch_counts if self.precision else [self.batches]
        matching = [n for n in counts if replace(self, batches=n).sha256 == sha256]
        if not matching and self.precision and n_samples is not None:
            matching = [n for n in counts if n * self.precision.size >= n_samples]
        return self.with_batches(matching[0]) if matching else None


def read_study(path: Path, folder: Path | None = None, *, prepare: Prepare | None = None) -> Study:
    """Read and validate a study file; ``InputError`` with one sentence for each mistake in it.

    folder: where relative paths and modules of the user's code start; the file's by default.  prepare: loads the user's
    code, called with its key (``reduce``, ``estimator`` …) and source; by default none of it is run.
    """
    cure = f'; for this preset, one with preset = "{path}" in [loop]' if str(path) in PRESETS else ""
    cure = f"a study file{cure or f', or make one with `fastcoil init {path}`'}"
    text = read_text(path, cure, MAX_STUDY_FILE_BYTES).replace("\r\n", "\n")
    tables = parse_toml(text, str(path))
    try:
        return _build_study(text, tables, path.stem, path.parent if folder is None else folder, prepare)
    except InputError as error:
        raise InputError([problem.with_prefix(f"{path}: ") for problem in error.problems]) from None


def read_tuning(path: Path, *, prepare: Prepare | None = None) -> TuningRequest:
    """Read a study file and its ``[tune]``, on which no scenario depends; raises as ``read_study`` does."""
    study, problems = read_study(path, prepare=prepare), list[str]()
    if "tune" not in study.tables:
        sentence = f"{path} has no table [tune]: add one, such as search = {{ kp = [0.005, 0.1] }}"
        raise InputError(sentence, "[tune]", "missing")
    with collect_problems(problems, f"{path}: [tune] "):
        return parse_tuning(study)
    raise InputError(problems)


def _build_study(text: str, tables: dict[str, Any], name: str, folder: Path, prepare: Prepare | None) -> Study:
    file, problems = parse_tables(tables)
    run = file.run
    precision: Precision | None = None
    try:
        if run.precision is not None:
            with collect_problems(problems, "[run] precision: "):
                precision = parse_precision(run.precision, file.sample)
        batches = precision.batch_counts[-1] if precision else 1
        file, sources, rules = find_rules(file, folder)
        if prepare is not None:
            load_code(rules, sources, prepare)
    except InputError as error:
        raise InputError([*problems, *error.problems]) from None

    def attempt(make: Callable[..., Result], *args: Any, prefix: str = "", **options: Any) -> Result | None:
        with collect_problems(problems, prefix):
            return make(*args, **options)
        return None

    cases = (parameters for labels in file.cases.values() for parameters in labels.values())
    given = {*file.sweep, *(file.sample or {}), *(name for parameters in cases for name in parameters)}
    included = attempt(read_includes, file.loop, folder, given, prefix="[loop] ") or {}
    loop = attempt(build_loop, file, included, rules, folder, batches)
    if loop is not None:
        require_memory(file, loop)
    boundary = attempt(build_boundary, file.boundary, folder, prefix="[boundary] ")
    plan = reduction = None
    if loop is not None and boundary is not None:
        options = run.model_dump(exclude={"reduce", "precision"})
        plan = attempt(plan_simulation, loop, boundary, **options, traces_on_disk=True)
    if run.reduce is not None:
        reduction = attempt(find_function, "reduce", run.reduce, folder, prefix="[run] ")
        if prepare is not None and reduction is not None:
            attempt(prepare, "reduce", reduction, prefix="[run] ")
        if not run.traces:
            cure = 'list the traces it needs, such as traces = ["T_sup"]'
            problems.append(Problem(f"[run] reduce = {run.reduce!r} without traces: {cure}", "traces", "missing"))
    if precision is not None and plan is not None:
        wrong = _find_baseline_problems(precision.baseline, plan.layout)
        problems += [problem.with_prefix("[run] precision: ") for problem in wrong]
    if problems or plan is None:
        raise InputError(problems)
    hashes = sample_file_hashes(file.sample, folder) if file.sample else []
    study = Study(
        text, tables, file.title or name, file.question, plan, folder, reduction, included, hashes, sources,
        precision, batches, plan,
    )  # fmt: skip
    return study.with_batches(MIN_BATCHES) if precision else study
