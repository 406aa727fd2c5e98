"""The strict reader of study files (TOML): every mistake is reported, all at once, and nothing is guessed.

A study has the tables ``[loop]`` (constants, ``preset``), ``[sweep]`` (a parameter on its own axis),
``[cases.NAME]`` (named alternatives along a dimension NAME), ``[boundary]`` (``kind`` and its arguments) and
``[run]``; all but ``[loop]`` may be absent.
"""

from __future__ import annotations

import hashlib
import inspect
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fastcoil.boundary import Boundary
from fastcoil.boundary.days import constant_day, design_day, paper_day
from fastcoil.boundary.trends import read_trend_log
from fastcoil.boundary.weather import weather_day
from fastcoil.errors import InputError, nearest
from fastcoil.outputs import WARM_UP
from fastcoil.parameter_table import PARAMETERS
from fastcoil.plan import Plan, prepare
from fastcoil.scenario import Loop

LARGEST_FILE = 2**20
"""Bytes: nobody writes a larger study by hand."""

LONGEST_AXIS = 10_000_000
_SPACINGS: dict[str, Callable[..., Any]] = {"linspace": np.linspace, "geomspace": np.geomspace}

BOUNDARY_KINDS: dict[str, Callable[..., Boundary]] = {
    "paper_day": paper_day,
    "constant_day": constant_day,
    "design_day": design_day,
    "csv": read_trend_log,
    "weather": weather_day,
}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class RunTable(_Strict):
    """``[run]``: how to run, not what."""

    warm_up: int = WARM_UP
    seed: int = 0
    replicates: int = 1
    traces: list[str] = Field(default_factory=list)
    trace_interval: int = 60


class StudyFile(_Strict):
    """The shape of a study file; the values are judged by ``Loop``, the boundary's function and ``prepare``."""

    title: str = ""
    question: str = ""
    loop: dict[str, Any]
    sweep: dict[str, Any] = Field(default_factory=dict)
    cases: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    boundary: dict[str, Any] = Field(default_factory=dict)
    run: RunTable = Field(default_factory=RunTable)


@dataclass(frozen=True)
class Study:
    """A study that can be run: its text, what it asks, and the validated plan."""

    text: str
    title: str
    question: str
    plan: Plan
    folder: Path = Path()
    reduction: Any = None
    sample_method: Any = None

    @property
    def sha256(self) -> str:
        """Hash of everything that decides the result: the text and the boundary's samples."""
        return hashlib.sha256(f"{self.text}\0{self.plan.layout.boundary.sha256}".encode()).hexdigest()


def read_study(path: Path, folder: Path | None = None) -> Study:
    """Read and validate a study file.  Relative paths in ``[boundary]`` start from the file's folder.

    Raises
    ------
    InputError
        With one sentence for each mistake in the file.
    """
    text = _text(path)
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path} is not valid TOML: {error}") from None
    file, problems = _shaped(tables)
    loop = boundary = plan = None
    with _collecting(problems):
        loop = study_loop(file)
    with _collecting(problems):
        boundary = study_boundary(file.boundary, folder or path.parent)
    if loop is not None and boundary is not None:
        with _collecting(problems):
            plan = prepare(loop, boundary, **file.run.model_dump(), traces_on_disk=True)
    if problems or plan is None:
        raise InputError([f"{path}: {problem}" for problem in problems])
    return Study(text, file.title or path.stem, file.question, plan, path.parent)


def _shaped(tables: dict[str, Any]) -> tuple[StudyFile, list[str]]:
    """The file's tables, and what is wrong with their shape; wrong ones are left out of what is returned."""
    try:
        return StudyFile.model_validate(tables), []
    except ValidationError as error:
        wrong = {str(detail["loc"][0]) for detail in error.errors()}
        rest = {name: table for name, table in tables.items() if name not in wrong}
        return StudyFile.model_validate({"loop": {}, **rest}), list(_sentences(error))


def study_loop(file: StudyFile) -> Loop:
    """Build the loop of a study: preset, constants, swept axes, named cases."""
    problems: list[str] = []
    constants = dict(file.loop)
    preset = str(constants.pop("preset", "paper_like"))
    loop, axes = Loop(), {}
    with _collecting(problems, "[loop] "):
        loop = Loop.preset(preset)
    with _collecting(problems, "[loop] "):
        loop = loop.assign(**constants)
    for name, axis in file.sweep.items():
        with _collecting(problems, "[sweep] "):
            axes[name] = axis_values(name, axis)
    with _collecting(problems, "[sweep] "):
        loop = loop.assign(**axes)
    problems += [f"{n} stands in [loop] and in [sweep]: leave one out" for n in file.sweep if n in constants]
    taken = dict.fromkeys(file.sweep, "[sweep]")
    for place, names in [(f"[cases.{dim}]", _names(cases)) for dim, cases in file.cases.items()]:
        problems += [f"{n} stands in {taken[n]} and in {place}: leave one out" for n in names if n in taken]
        taken |= dict.fromkeys(names, place)
    for dim, cases in file.cases.items():
        with _collecting(problems, f"[cases.{dim}] "):
            loop = loop.assign(**_zipped(dim, cases, loop))
    if problems:
        raise InputError(problems)
    return loop


def _names(cases: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Every parameter that one of the cases gives."""
    return list(dict.fromkeys(name for case in cases.values() for name in case))


def axis_values(name: str, axis: object) -> list[Any]:
    """Values of a swept axis: a list, ``{ linspace = [first, last, count] }`` or ``{ geomspace = […] }``."""
    if isinstance(axis, list):
        return axis
    kind = next(iter(axis), None) if isinstance(axis, dict) and len(axis) == 1 else None
    if kind not in _SPACINGS or not isinstance(axis, dict):
        raise InputError(
            f"{name} = {_shown(axis)}: give a list of values, {{ linspace = [first, last, count] }} "
            "or { geomspace = [first, last, count] }"
        )
    spec = axis[kind]
    numbers = (
        isinstance(spec, list) and len(spec) == 3 and all(type(v) in (int, float) and np.isfinite(v) for v in spec)
    )
    if not numbers or type(spec[2]) is not int or not 1 <= spec[2] <= LONGEST_AXIS:
        raise InputError(
            f"{name} = {{ {kind} = {_shown(spec)} }}: give [first, last, count], two finite numbers and a whole "
            f"number from 1 to {LONGEST_AXIS:,}"
        )
    if kind == "geomspace" and min(spec[:2]) <= 0.0:
        raise InputError(f"{name} = {{ geomspace = {spec} }}: first and last must be above 0")
    return list(_SPACINGS[kind](*spec).tolist())


def _zipped(dim: str, cases: Mapping[str, Mapping[str, float | str]], loop: Loop) -> dict[str, xr.DataArray]:
    """The parameters of named cases along the dimension ``dim``; one that a case leaves out is the loop's."""
    if not cases:
        raise InputError("no case: give at least one, such as fast = { kp = 0.05, ti = 5 }")
    if dim in PARAMETERS:
        raise InputError(f"{dim} is a parameter: give the dimension another name, such as tuning or controller")
    zipped, problems = {}, []
    for name in _names(cases):
        try:
            default = loop[name]
        except InputError as error:
            problems += error.problems
            continue
        without = [label for label, case in cases.items() if name not in case]
        if without and (default is None or isinstance(default, xr.DataArray)):
            problems.append(f"{name} is missing in {', '.join(without)}: give it in every case")
            continue
        values = [case.get(name, default) for case in cases.values()]
        wrong = [p for p in map(PARAMETERS[name].problem, values) if p]
        if wrong:
            problems += wrong
            continue
        zipped[name] = xr.DataArray(values, dims=dim, coords={dim: list(cases)})
    if problems:
        raise InputError(problems)
    if not zipped:
        raise InputError("its cases are empty: give each the parameters that make it differ")
    return zipped


def study_boundary(table: Mapping[str, Any], folder: Path) -> Boundary:
    """Build the boundary of a study; ``paper_day`` of 8 h with seed 1 where the table is absent."""
    arguments = dict(table)
    kind = arguments.pop("kind", "paper_day")
    if kind not in BOUNDARY_KINDS:
        raise InputError(
            f"[boundary] kind = {kind!r}: unknown{nearest(str(kind), BOUNDARY_KINDS)}; "
            f"choose one of {', '.join(BOUNDARY_KINDS)}"
        )
    make = BOUNDARY_KINDS[kind]
    signature = inspect.signature(make).parameters
    problems = [
        f"[boundary] {name} is not an argument of {kind}{nearest(name, signature)}; it takes {', '.join(signature)}"
        for name in arguments
        if name not in signature
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


@contextmanager
def _collecting(problems: list[str], prefix: str = "") -> Iterator[None]:
    """Add the sentences of a refusal to ``problems`` and go on."""
    try:
        yield
    except InputError as error:
        problems += [prefix + p for p in error.problems]


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


def _sentences(error: ValidationError) -> Iterator[str]:
    """One sentence for each mistake in the shape of the file: place, value, cure."""
    for detail in error.errors():
        table, *keys = map(str, detail["loc"])
        where = f"[{table}] {'.'.join(keys)}" if keys else table
        if detail["type"] == "extra_forbidden":
            known = list(RunTable.model_fields if keys else StudyFile.model_fields)
            yield f"{where} is unknown{nearest((keys or [table])[-1], known)}; known: {', '.join(known)}"
        elif detail["type"] == "missing":
            yield f"[{table}] is missing: a study needs this table, it may be empty"
        else:
            yield f"{where} = {_shown(detail['input'])}: {_cure(detail['type'], str(detail['msg']))}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _cure(kind: str, message: str) -> str:
    for start, cure in (
        ("int", "give a whole number"),
        ("float", "give a number"),
        ("finite", "give a finite number"),
        ("string", "give a text in quotes"),
        ("dict", "give a table"),
        ("model", "give a table"),
        ("list", "give a list"),
    ):
        if kind.startswith(start):
            return cure
    return message[0].lower() + message[1:]
