"""The tables of a study file, and what is said when one has the wrong shape."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fastcoil.errors import nearest, shown
from fastcoil.outputs import WARM_UP
from fastcoil.parameter_table import LARGEST


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class RunTable(_Strict):
    """``[run]``: how to run, not what."""

    warm_up: int = WARM_UP
    seed: int = 0
    replicates: int = 1
    traces: list[str] = Field(default_factory=list)
    trace_interval: int = 60
    reduce: str | None = None


class StudyFile(_Strict):
    """The shape of a study file; the values are judged by ``Loop``, the boundary's function and ``prepare``."""

    title: str = ""
    question: str = ""
    loop: dict[str, Any]
    sweep: dict[str, Any] = Field(default_factory=dict)
    cases: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    sample: dict[str, Any] | None = None
    boundary: dict[str, Any] = Field(default_factory=dict)
    run: RunTable = Field(default_factory=RunTable)


def shaped(tables: dict[str, Any]) -> tuple[StudyFile, list[str]]:
    """The file's tables, and what is wrong with their shape; wrong ones are left out of what is returned."""
    try:
        return StudyFile.model_validate(tables), []
    except ValidationError as error:
        wrong = {str(detail["loc"][0]) for detail in error.errors()}
        rest = {name: table for name, table in tables.items() if name not in wrong}
        return StudyFile.model_validate({"loop": {}, **rest}), list(_sentences(error))


def are_numbers(values: object, count: int) -> bool:
    """Whether ``values`` is a list of ``count`` finite numbers; TOML has whole ones of any size."""
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(type(v) in (int, float) and -LARGEST <= v <= LARGEST for v in values)


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
            yield f"{where} = {shown(detail['input'])}: {_cure(detail['type'], str(detail['msg']))}"


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
