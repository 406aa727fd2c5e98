"""Parse the text of a study file into tables of known shape, and describe what has the wrong shape."""

import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fastcoil.base.arguments import raise_problems
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.model.metric_table import TRACES, WARM_UP_S
from fastcoil.model.parameter_table import LARGEST_FLOAT, PARAMETERS, Parameter

_MAX_NESTING = 20  # tables and lists inside each other: a study needs five
MAX_KEY_CHARACTERS = 200  # keys are labels of axes as well
_MAX_INTEGER_BITS = 8192  # Python shows no number that is much longer
_DEEPLY_DOTTED_KEY = re.compile(rf"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{_MAX_NESTING},}}""")


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse the tables of a text; messages call it ``name``.

    ``InputError`` if it is not TOML; for tables in tables without end, keys and numbers too long to be shown, and the
    character NUL in a text, at which the files of results would end it.
    """
    sentence = f"{name} has tables or lists inside each other without end: give at most {_MAX_NESTING}"
    if _DEEPLY_DOTTED_KEY.search(text):  # the parser takes memory by the square of the dots in a key
        raise InputError(sentence, name, "size")
    try:
        tables = tomllib.loads(text.replace("\r\n", "\n"))
    except RecursionError:
        raise InputError(sentence, name, "size") from None
    except ValueError as error:  # also of a number with more digits than Python reads
        reason = str(error)
        short = reason if len(reason) <= 300 else reason[:200] + " … " + reason[-60:]
        raise InputError(f"{name} is not valid TOML: {short}", name, "format") from None
    raise_problems([problem.with_prefix(f"{name}: ") for problem in _find_unusable_values(tables)])
    return tables


def _find_unusable_values(value: Any, place: str = "", depth: int = 0) -> Iterator[Problem]:
    """Find values that are nested too deeply, or cannot be shown or stored."""
    if isinstance(value, dict | list) and depth >= _MAX_NESTING:
        sentence = f"{place} has more than {_MAX_NESTING} tables or lists inside each other"
        yield Problem(f"{sentence}: give at most {_MAX_NESTING}", place, "size")
    elif isinstance(value, list):
        for item in value:
            yield from _find_unusable_values(item, place, depth + 1)
    elif isinstance(value, dict):
        for key, item in value.items():
            if len(key) > MAX_KEY_CHARACTERS or "\0" in key:
                sentence = f"give a key of at most {MAX_KEY_CHARACTERS} characters, without NUL"
                yield Problem(f"{place}{short_repr(key)}: {sentence}", place or key[:MAX_KEY_CHARACTERS], "name")
            else:
                yield from _find_unusable_values(item, f"{place}.{key}" if place else key, depth + 1)
    elif isinstance(value, str) and "\0" in value:
        yield Problem(f"{place} = {short_repr(value)} holds the character NUL: delete it", place, "value")
    elif isinstance(value, int) and value.bit_length() > _MAX_INTEGER_BITS:
        yield Problem(f"{place} is a number of too many digits: give a smaller one", place, "value")


Value = TypeVar("Value")

_MOST_TRACES = 2 * len(TRACES)


class _StrictTable(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class PrecisionTable(_StrictTable):
    """How precisely the mean of a metric is to be known."""

    metric: str = Field(..., examples=['"rmse"'])
    half_width: float = Field(..., examples=[0.01])
    relative: bool = False
    baseline: dict[str, float | str] = {}
    most: int | None = None


class RunTable(_StrictTable):
    """How to run, not what."""

    warm_up: int = WARM_UP_S
    seed: int = 0
    replicates: int = 1
    carry_over: bool = False
    traces: list[str] = Field(default=[], max_length=_MOST_TRACES)
    trace_interval: int = 60
    reduce: str | None = None
    precision: PrecisionTable | None = None


class StudyFile(_StrictTable):
    """Which loops are simulated on which days."""

    title: str = ""
    question: str = ""
    loop: dict[str, Any]
    sweep: dict[str, Any] = {}
    cases: dict[str, dict[str, dict[str, Any]]] = {}
    sample: dict[str, Any] | None = None
    boundary: dict[str, Any] = {}
    run: RunTable = RunTable()
    tune: dict[str, Any] | None = None


_TABLE_MODELS: dict[str, type[BaseModel]] = {"": StudyFile, "run": RunTable, "run.precision": PrecisionTable}
"""Tables whose keys are known, by name; without a name: the file."""


def parse_tables(tables: dict[str, Any]) -> tuple[StudyFile, list[str]]:
    """Parse the tables of a file.  Returns them without those of the wrong shape, and a sentence for each mistake."""
    try:
        return StudyFile.model_validate(tables), []
    except ValidationError as error:
        wrong_tables = {str(detail["loc"][0]) for detail in error.errors()}
        rest = {name: table for name, table in tables.items() if name not in wrong_tables}
        return StudyFile.model_validate({"loop": {}, **rest}), list(dict.fromkeys(_describe_errors(error)))


def pair_with_hints(names: Iterable[str], known: Collection[str]) -> Iterator[tuple[str, str]]:
    """Pair unknown names with a clause that suggests a known one; from the 21st on it is empty, to save time."""
    for k, name in enumerate(names):
        yield name, did_you_mean(name, known) if k < 20 else ""


def summarise_problems(problems: Sequence[Problem]) -> list[Problem]:
    """Return the first of several wrong values, with how many more there are; nothing if there is none."""
    if len(problems) < 2:
        return list(problems)
    first = problems[0]
    return [Problem(f"{first} (and {len(problems) - 1:,} more of its values)", first.field, first.code)]


def known_parameters(
    table: Mapping[str, Value], problems: list[str], prefix: str = "", known: Mapping[str, Parameter] = PARAMETERS
) -> dict[str, Value]:
    """Return the entries of a table whose names are parameters; add a problem for each of the others."""
    for name, hint in pair_with_hints((name for name in table if name not in known), known):
        sentence = f"{prefix}{name} is not a parameter{hint} (see `fastcoil parameters`)"
        problems.append(Problem(sentence, name, "name"))
    return {name: value for name, value in table.items() if name in known}


def sampled_names(table: Mapping[str, Any] | None) -> list[str]:
    """Return the names of the parameters in ``[sample]``; none if the table is absent."""
    return [name for name in table or {} if name not in ("method", "size", "seed", "correlation")]


def is_number_list(values: object, count: int) -> bool:
    """Whether ``values`` is a list of ``count`` finite numbers; TOML allows integers of any size."""
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(type(v) in (int, float) and -LARGEST_FLOAT <= v <= LARGEST_FLOAT for v in values)


_CURE_BY_ERROR_TYPE = {
    "int": "give a whole number",
    "float": "give a number",
    "string": "give a text in quotes",
    "bool": "give true or false",
    "too_long": f"give at most {_MOST_TRACES}, each once",
    "dict": "give a table",
    "model": "give a table",
    "list": "give a list",
}
"""By the beginning of pydantic's name of a mistake."""


def _describe_errors(error: ValidationError) -> Iterator[Problem]:
    details = error.errors()
    unknown = [detail["loc"] for detail in details if detail["type"] == "extra_forbidden"]
    for table, model in _TABLE_MODELS.items():
        unknown_keys = [str(key) for *parents, key in unknown if ".".join(map(str, parents)) == table]
        for name, hint in pair_with_hints(unknown_keys, model.model_fields):
            prefix = f"[{table}] " if table else ""
            sentence = f"{prefix}{name} is unknown{hint}; known: {', '.join(model.model_fields)}"
            if not table and name == "fit":
                sentence = "[fit] is a table of what was fitted to a log: include this file in [loop] of a study"
            yield Problem(sentence, name, "name")
    for detail in details:
        place = list(map(str, detail["loc"]))
        depth = 2 if ".".join(place[:2]) in _TABLE_MODELS else 1
        table, keys = ".".join(place[:depth]), place[depth:]
        kind, field, value = detail["type"], place[-1], short_repr(detail["input"])
        where = f"[{table}] {'.'.join(keys)}" if keys else table
        if kind == "missing" and keys:
            example = (_TABLE_MODELS[table].model_fields[field].examples or ["…"])[0]
            yield Problem(f"{where} is missing: give it, such as {field} = {example}", field, "missing")
        elif kind == "missing":
            yield Problem(f"[{table}] is missing: a study needs this table, it may be empty", table, "missing")
        elif keys and field in ("float", "str"):  # neither of the two types that the key may have
            sentence = f"[{table}] {'.'.join(keys[:-1])} = {value}: give a number, or a text in quotes"
            yield Problem(sentence, place[-2], "type")
        elif kind != "extra_forbidden":
            cure = next(cure for start, cure in _CURE_BY_ERROR_TYPE.items() if kind.startswith(start))
            yield Problem(f"{where} = {value}: {cure}", field, "size" if kind == "too_long" else "type")
