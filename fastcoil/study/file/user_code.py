"""The user's code in a study, ``module:function``: a reduction of traces, an estimator, a control law or a plant.

Its source is read as text, hashed with the study and sent to other processes; what a rule declares is parsed from it.
The study may come from a stranger: only ``load_function`` and ``load_code`` run any of it.
"""

import ast
import functools
import hashlib
import importlib.util
import linecache
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import collect_problems, is_storable_text, raise_problems
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.files import TooLargeError, is_file, read_bytes, require_usable_path
from fastcoil.loops import netcdf
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, RESERVED_DIMS
from fastcoil.model.user_rules import RULE_KINDS, Rule, declared_parameters, is_built_in_rule, parameter
from fastcoil.study.file.tables import StudyFile

_MAX_SOURCE_BYTES = 2**18  # to parse a source as Python takes 500 times its memory
_MAX_MESSAGE_CHARACTERS = 300  # of an exception
_READABLE = "so that the study can be read without running it"  # end of messages


@dataclass(frozen=True)
class UserCode:
    """A function of the user: ``name`` is ``module:function``, ``source`` the text of the module, ``path`` its file."""

    name: str
    source: str = field(repr=False)
    path: Path = field(compare=False)

    @property
    def sha256(self) -> str:
        return hashlib.sha256(f"{self.name}\0{self.source}".encode()).hexdigest()


Prepare = Callable[[str, UserCode], object]  # loads a function, given its key (``reduce``, ``plant`` …) and source


def find_function(what: str, text: str, folder: Path) -> UserCode:
    """Find ``module:function``, the function in ``module.py`` in ``folder``; what: the key that names it."""
    module, _, function = text.partition(":")
    parts, setting = module.split("."), f"{what} = {text!r}"
    if not all(part.isidentifier() for part in (*parts, function)):
        cure = "give module:function, such as 'mine:overshoot' for the function overshoot in mine.py"
        raise InputError(f"{setting}: {cure}", what, "format")
    path = folder.joinpath(*parts).with_suffix(".py")
    require_usable_path(path, f"give {what} = {short_repr(text)} a shorter name")
    if not is_file(path):
        raise InputError(f"{setting}: there is no {path}: put {path.name} next to the study file", what, "path")
    try:
        source = importlib.util.decode_source(read_bytes(path, _MAX_SOURCE_BYTES))  # in the encoding that it declares
        source.encode()
    except TooLargeError as error:
        cure = "move what the function does not need elsewhere"
        raise InputError(f"{setting}: {path} {error}: {cure}", what, "size") from None
    except (OSError, SyntaxError, ValueError, LookupError) as error:
        sentence = f"{setting}: {path} cannot be read: {type(error).__name__}: {error}"
        raise InputError(sentence, what, "path") from None
    return UserCode(text, source, path)


def find_rules(file: StudyFile, folder: Path) -> tuple[StudyFile, dict[str, UserCode], dict[str, Rule]]:
    """Find the rules ``module:function`` of a file; return it with plain names, their sources, and the rules."""
    problems: list[str] = []
    source_by_word: dict[tuple[str, str], UserCode] = {}

    def replace_by_names(value: Any, kind: str = "") -> Any:
        """A table with the name of a rule in place of each ``module:function``."""
        if isinstance(value, dict):
            return {key: replace_by_names(part, key if key in RULE_KINDS else kind) for key, part in value.items()}
        if isinstance(value, list):
            return [replace_by_names(part, kind) for part in value]
        if not kind or not isinstance(value, str) or ":" not in value:
            return value
        with collect_problems(problems):
            source_by_word.setdefault((kind, value), find_function(kind, value, folder))
        return value.rpartition(":")[2]

    update = {table: replace_by_names(getattr(file, table)) for table in ("loop", "sweep", "cases", "sample")}
    sources: dict[str, UserCode] = {}
    rules: dict[str, Rule] = {}
    for (kind, word), source in sorted(source_by_word.items(), key=lambda item: list(RULE_KINDS).index(item[0][0])):
        name = word.rpartition(":")[2]
        if sources.setdefault(name, source) != source or rules.get(name, kind) != kind:
            problems.append(Problem(f"two rules are called {name}: rename one of them", kind, "duplicate"))
            continue
        with collect_problems(problems, f"{kind} = {word!r}: "):
            rules[name] = parse_rule(kind, name, source)
    raise_problems(list(dict.fromkeys(problems)))
    return file.model_copy(update=update), sources, rules


def parse_rule(kind: str, name: str, source: UserCode) -> Rule:
    """Parse the rule that a source declares by its decorator and the class of its parameters, with their defaults."""
    if is_built_in_rule(name):
        raise InputError(f"{name} is taken, call the function something else", kind, "duplicate")
    try:
        module = ast.parse(source.source)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{source.path} is not Python: {type(error).__name__}: {error}", kind, "code") from None
    functions = [node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == name]
    if not functions:
        raise InputError(f"{source.path} has no function {name}", kind, "name")
    calls = [d for d in functions[-1].decorator_list if isinstance(d, ast.Call) and _last_identifier(d.func) == kind]
    arguments = [*calls[0].args, *(k.value for k in calls[0].keywords if k.arg == "Parameters")] if calls else []
    names = [_last_identifier(node) for node in arguments[:1]]
    classes = [node for node in module.body if isinstance(node, ast.ClassDef) and node.name in names]
    if not classes:
        sentence = f"put @fc.{kind}(Parameters, Memory) before {name}, with classes of {source.path.name} itself"
        raise InputError(f"{sentence}, {_READABLE}", kind, "code")
    fields = dict(_read_fields(name, classes[-1]))
    parameters = declared_parameters(name, kind, fields)
    return Rule(kind, name, parameters, tuple(n for n in fields if n not in parameters), source.sha256)


def _last_identifier(node: ast.expr) -> str:
    """``estimator`` of ``fc.estimator``."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _read_fields(rule: str, cls: ast.ClassDef) -> Iterator[tuple[str, object]]:
    """Name and default of each field, ``None`` for one without."""
    for node in cls.body:
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        default, name = node.value, node.target.id
        try:
            if isinstance(default, ast.Call) and _last_identifier(default.func) == "parameter":
                options = {str(k.arg): ast.literal_eval(k.value) for k in default.keywords}
                yield name, parameter(*map(ast.literal_eval, default.args), **options)
            else:
                yield name, None if default is None else ast.literal_eval(default)
        except InputError:
            raise
        except (ValueError, TypeError, SyntaxError):
            sentence = f"{rule}: the default of {name} is not a number: write one"
            raise InputError(f"{sentence}, {_READABLE}", name, "code") from None


@functools.cache
def load_function(what: str, code: UserCode) -> Any:
    """Load the function that the key ``what`` names from a module that is run once in each process."""
    name, source = code.name, code.source
    function_name = name.partition(":")[2]
    module = ModuleType(f"own_code_{hashlib.sha256(source.encode()).hexdigest()}")
    # decorators such as dataclass look here for the module of their class
    sys.modules[module.__name__] = module
    with user_code_errors(what, f"= {name!r}: its module does not run:"):
        exec(compile(source, f"<{name}>", "exec", dont_inherit=True), module.__dict__)
        # tracebacks, and the export of a controller, read the source from here
        linecache.cache[f"<{name}>"] = (len(source), None, source.splitlines(keepends=True), f"<{name}>")
    function = getattr(module, function_name, None)
    if not callable(function):
        raise InputError(f"{what} = {name!r}: its module has no function {function_name}", what, "name")
    return function


def load_code(rules: Mapping[str, Rule], sources: Mapping[str, UserCode], prepare: Prepare = load_function) -> None:
    """Run the code of rules of which only the declarations were read; ``prepare`` loads a function."""
    for name, rule in rules.items():
        if not rule.is_loaded:
            rule.adopt_code(prepare(rule.kind, sources[name]))


@contextmanager
def user_code_errors(what: str, failure: str) -> Iterator[None]:
    """Turn all that the user's code raises, even SystemExit, into a sentence; numpy's error handling is restored."""
    try:
        with np.errstate():
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        text = " ".join(str(error).split())
        text = text if len(text) <= _MAX_MESSAGE_CHARACTERS else text[:_MAX_MESSAGE_CHARACTERS] + " …"
        sentence = f"{what} {failure} {type(error).__name__}: {text}".removesuffix(": ")
        raise InputError(sentence, what, "code") from error


SCENARIO_DIM = "scenario"  # the dimension along which the function gets the traces of a shard
_PUBLIC_NAMES = {*PARAMETERS, *METRICS, *TRACES, *netcdf.CLOCK_COORDINATES, "status", SCENARIO_DIM}
_TAKEN_NAMES = _PUBLIC_NAMES | set(RESERVED_DIMS)
_TAKEN_DIMS = _PUBLIC_NAMES | {"day", "replicate", "sample"}
_FLOAT_TYPES = (np.dtype(np.float32), np.dtype(np.float64))
_TEXT_ATTRIBUTES = ("units", "long_name", "standard_name", "description", "comment", "source", "references")
"""Attributes that are kept: text for a reader, nothing by which a decoder would change the numbers."""


def reduce_traces(reduction: UserCode, traces: xr.Dataset) -> xr.Dataset:
    """Reduce the traces of some scenarios with the user's function, which gets them read-only.

    traces: over (scenario, [volume,] elapsed_time), the swept parameters as coordinates along ``scenario``.  Returns
    numbers over (scenario, …), with labels of further dims and attributes in words.
    """
    traces = _make_read_only(traces)
    reduced = _call_reduction(reduction, traces)
    alone = _call_reduction(reduction, traces.isel({SCENARIO_DIM: slice(-1, None)}))
    variables, variables_alone = reduced.isel({SCENARIO_DIM: slice(-1, None)}).variables, alone.variables
    differing = []
    for name in {**variables, **variables_alone}:
        among_others, by_itself = variables.get(name), variables_alone.get(name)
        is_same_kind = among_others is not None and by_itself is not None and among_others.dtype == by_itself.dtype
        if not (is_same_kind and among_others.equals(by_itself)):  # type: ignore[union-attr]
            differing.append(str(name))
    if differing:
        sentence = f"reduce = {reduction.name!r} gives another {' and '.join(differing)} for a scenario alone"
        raise InputError(f"{sentence} than among others: treat each scenario alone, to the last bit", "reduce", "code")
    return reduced


def _call_reduction(reduction: UserCode, traces: xr.Dataset) -> xr.Dataset:
    function = load_function("reduce", reduction)
    with user_code_errors("reduce", f"= {reduction.name!r} raised"):
        answer = function(traces.copy())
    returned = f"reduce = {reduction.name!r} returned"
    raise_problems([Problem(f"{returned} {p}", "reduce", "code") for p in _find_answer_problems(answer, traces)])
    labels = {dim: _copy_variable(answer[dim].variable) for dim in _further_dims(answer) if dim in answer.coords}
    reduced = xr.Dataset(
        {n: _copy_variable(v.variable).transpose(SCENARIO_DIM, ...) for n, v in answer.data_vars.items()}, labels
    )
    are_names = all(str(name).isidentifier() for name in (*reduced.variables, *reduced.dims))
    with suppress(Exception):  # the libraries raise many things at what they cannot write
        if are_names and netcdf.load(bytes(netcdf.netcdf_bytes(reduced))).identical(reduced):
            return reduced
    cure = "use letters, digits and _ for names, numbers or words for labels"
    raise InputError(f"{returned} names or labels that no file gives back as they are: {cure}", "reduce", "code")


def _copy_variable(variable: xr.Variable) -> xr.Variable:
    """Copy the numbers or labels of a variable, in this machine's byte order, and its attributes that are text."""
    values = np.array(variable.values, order="C")
    texts = {name: variable.attrs.get(name) for name in _TEXT_ATTRIBUTES}
    attrs = {name: text for name, text in texts.items() if isinstance(text, str) and is_storable_text(text)}
    return xr.Variable(variable.dims, values.astype(values.dtype.newbyteorder("="), copy=False), attrs)


def _find_answer_problems(answer: Any, traces: xr.Dataset) -> Iterable[str]:
    """Check the answer of a reduction of ``traces``: the end of a sentence for each problem."""
    if not isinstance(answer, xr.Dataset):
        yield f"a {type(answer).__name__}: return an xarray.Dataset"
        return
    if not answer.data_vars:
        yield "an empty Dataset: return at least one variable"
    # labels of the scenarios come with the traces, so that these names are taken too
    scenario_names = {str(name) for name in traces.coords} - {"elapsed_time", "volume"}
    for name, array in answer.data_vars.items():
        if name in _TAKEN_NAMES | scenario_names:
            yield f"a variable {name}: the name is taken, choose another"
        if array.sizes.get(SCENARIO_DIM) != traces.sizes[SCENARIO_DIM]:
            yield f"{name} with sizes {dict(array.sizes)}: keep the dim {SCENARIO_DIM!r} with all of its scenarios"
        if array.dtype.kind not in "biu" and array.dtype not in _FLOAT_TYPES:
            yield f"{name} of type {array.dtype}: return numbers (float64, float32 or integers) or booleans"
    for dim in _further_dims(answer):
        if dim in _TAKEN_DIMS | scenario_names:
            yield f"a dim {dim}: the name is taken, choose another"


def _further_dims(answer: xr.Dataset) -> list[Any]:
    return list(dict.fromkeys(dim for array in answer.data_vars.values() for dim in array.dims if dim != SCENARIO_DIM))


def _make_read_only(traces: xr.Dataset) -> xr.Dataset:
    """The same values, read-only: a function that changed them would change the input of the next call."""
    protected = traces.copy()
    for name, variable in protected.variables.items():
        if name not in protected.indexes:
            values = variable.values.view()
            values.flags.writeable = False
            variable.data = values
    return protected
