"""The text of a study file as tables of known shape, and the sentences for one of the wrong shape."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fastcoil.base.errors import InputError, collecting, nearest, shown
from fastcoil.design.tuning_plan import EVALUATIONS, OBJECTIVE, QUANTILE
from fastcoil.model.metric_table import TRACES, WARM_UP
from fastcoil.model.parameter_table import LARGEST, PARAMETERS, Parameter, check_name
from fastcoil.study.analysis.cost import COP, CURRENCY, PRICES

_DEEPEST = 20
"""Tables and lists inside each other: a study needs five."""
LONGEST_KEY = 200
"""Characters; keys are labels of axes too."""
_LARGEST_NUMBER = 8192
"""Bits; Python shows no number that is much longer."""
_FLATTEN = f"give at most {_DEEPEST}"


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The tables of a text; messages call it ``name``.

    ``InputError`` if it is not TOML; for tables in tables without end, keys and numbers too long to be shown, and the
    character NUL in a text, at which the files of results would end it.
    """
    try:
        tables = tomllib.loads(text.replace("\r\n", "\n"))
    except RecursionError:
        raise InputError(f"{name} has tables or lists inside each other without end: {_FLATTEN}") from None
    except ValueError as error:  # also of a number with more digits than Python reads
        raise InputError(f"{name} is not valid TOML: {_cut(str(error))}") from None
    problems = list(_problems(tables))
    if problems:
        raise InputError([f"{name}: {problem}" for problem in problems])
    return tables


def _cut(reason: str) -> str:
    return reason if len(reason) <= 300 else reason[:200] + " … " + reason[-60:]


def _problems(tables: dict[str, Any]) -> Iterator[str]:
    left: list[tuple[str, int, Any]] = [("", 0, tables)]
    while left:
        place, depth, value = left.pop()
        if isinstance(value, dict | list) and depth >= _DEEPEST:
            yield f"{place} has more than {_DEEPEST} tables or lists inside each other: {_FLATTEN}"
        elif isinstance(value, dict):
            for key, one in value.items():
                if len(key) > LONGEST_KEY:
                    yield f"{place}{shown(key)} is a key of {len(key):,} characters: give at most {LONGEST_KEY}"
                elif "\0" in key:
                    yield f"{place}{shown(key)} holds the character NUL: delete it"
                else:
                    left.append((f"{place}.{key}" if place else key, depth + 1, one))
        elif isinstance(value, list):
            left += [(place, depth + 1, one) for one in value]
        elif isinstance(value, str) and "\0" in value:
            yield f"{place} = {shown(value)} holds the character NUL: delete it"
        elif isinstance(value, int) and value.bit_length() > _LARGEST_NUMBER:
            yield f"{place} is a number of too many digits: give a smaller one"


Value = TypeVar("Value")

_MOST_HINTS = 20
"""Unknown names for which a similar one is suggested: it takes a millisecond each."""
_MOST_TRACES = 2 * len(TRACES)
_EXAMPLES = {"search": "{ kp = [0.005, 0.1], ti = [5, 600] }", **{n: f"{price:g}" for n, (_, price) in PRICES.items()}}
"""Of what a table must have."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class RunTable(_Strict):
    """``[run]``: how to run the study."""

    warm_up: int = WARM_UP
    seed: int = 0
    replicates: int = 1
    carry_over: bool = False
    traces: list[str] = Field(default_factory=list, max_length=_MOST_TRACES)
    trace_interval: int = 60
    reduce: str | None = None
    predict: bool = False


class TuneTable(_Strict):
    """``[tune]``: what `fastcoil tune` chooses for the valves and days of the study."""

    search: dict[str, Any]
    objective: str = OBJECTIVE
    quantile: float | str = QUANTILE
    limits: dict[str, Any] = Field(default_factory=dict)
    holdout: Any = None
    evaluations: int = EVALUATIONS


class TariffTable(_Strict):
    """``[tariff]``: prices, and with what the costs are compared; see ``fc.cost``."""

    electricity: float
    demand: float
    heat: float
    cop: float = COP
    electric_heat: bool = False
    currency: str = CURRENCY
    baseline: dict[str, float | str] = Field(default_factory=dict)


class StudyFile(_Strict):
    """The shape of a study file; ``Loop``, the boundary's function and ``prepare`` check the values."""

    title: str = ""
    question: str = ""
    loop: dict[str, Any]
    sweep: dict[str, Any] = Field(default_factory=dict)
    cases: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    sample: dict[str, Any] | None = None
    boundary: dict[str, Any] = Field(default_factory=dict)
    run: RunTable = Field(default_factory=RunTable)
    tune: TuneTable | None = None
    tariff: TariffTable | None = None


_MODELS: dict[str, type[BaseModel]] = {"": StudyFile, "run": RunTable, "tune": TuneTable, "tariff": TariffTable}
"""Those whose keys are known, by the name of the table; without a name: the file."""


def parse_tables(tables: dict[str, Any]) -> tuple[StudyFile, list[str]]:
    """Parse the file's tables.  Returns them without those of the wrong shape, and a sentence for each mistake."""
    try:
        return StudyFile.model_validate(tables), []
    except ValidationError as error:
        wrong = {str(detail["loc"][0]) for detail in error.errors()}
        rest = {name: table for name, table in tables.items() if name not in wrong}
        return StudyFile.model_validate({"loop": {}, **rest}), list(_sentences(error))


def with_hints(names: Iterable[str], known: Collection[str]) -> Iterator[tuple[str, str]]:
    """Each unknown name and a clause with the one that was probably meant; an empty one after the first names."""
    for k, name in enumerate(names):
        yield name, nearest(name, known) if k < _MOST_HINTS else ""


def first_of(sentences: list[str]) -> list[str]:
    """The sentence on the first of several wrong values, with how many more there are; nothing if there is none."""
    more = f" (and {len(sentences) - 1:,} more of its values)" if len(sentences) > 1 else ""
    return [sentence + more for sentence in sentences[:1]]


def known_parameters(
    table: Mapping[str, Value], problems: list[str], prefix: str = "", known: Mapping[str, Parameter] = PARAMETERS
) -> dict[str, Value]:
    """The entries of a table whose names are parameters; ``problems`` gets a sentence for each of the others."""
    unknown = [name for name in table if name not in known]
    for name in unknown[:_MOST_HINTS]:
        with collecting(problems, prefix):
            check_name(name, known)
    problems += [f"{prefix}{name} is not a parameter (see `fastcoil parameters`)" for name in unknown[_MOST_HINTS:]]
    return {name: value for name, value in table.items() if name in known}


def are_numbers(values: object, count: int) -> bool:
    """Whether ``values`` is a list of ``count`` finite numbers; TOML allows integers of any size."""
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(type(v) in (int, float) and -LARGEST <= v <= LARGEST for v in values)


def _sentences(error: ValidationError) -> Iterator[str]:
    """One sentence for each mistake in the shape of the file: place, value, cure."""
    details = error.errors()
    for table, model in _MODELS.items():
        unknown = [d["loc"] for d in details if d["type"] == "extra_forbidden"]
        known, of_table = (
            list(model.model_fields),
            [place for place in unknown if "".join(map(str, place[:-1])) == table],
        )
        for name, hint in with_hints((str(place[-1]) for place in of_table), known):
            yield f"{f'[{table}] ' if table else ''}{name} is unknown{hint}; known: {', '.join(known)}"
    either = set[str]()
    for detail in details:
        table, *keys = map(str, detail["loc"])
        if keys and keys[-1] in ("float", "str"):  # neither of the two types that the key may have
            name = ".".join(keys[:-1])
            if name not in either:
                yield f"[{table}] {name} = {shown(detail['input'])}: give a number, or a text in quotes"
            either.add(name)
            continue
        where = f"[{table}] {'.'.join(keys)}" if keys else table
        if detail["type"] == "extra_forbidden":
            continue
        if detail["type"] == "missing" and keys:
            yield f"{where} is missing: give it, such as {keys[-1]} = {_EXAMPLES[keys[-1]]}"
        elif detail["type"] == "missing":
            yield f"[{table}] is missing: a study needs this table, it may be empty"
        else:
            yield f"{where} = {shown(detail['input'])}: {_cure(detail['type'], str(detail['msg']))}"


def _cure(kind: str, message: str) -> str:
    for start, cure in (
        ("int", "give a whole number"),
        ("float", "give a number"),
        ("bool", "give true or false"),
        ("finite", "give a finite number"),
        ("string", "give a text in quotes"),
        ("bool", "give true or false"),
        ("too_long", f"give at most {_MOST_TRACES}, each once"),
        ("dict", "give a table"),
        ("model", "give a table"),
        ("list", "give a list"),
    ):
        if kind.startswith(start):
            return cure
    return message[0].lower() + message[1:]
