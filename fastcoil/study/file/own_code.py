"""A study's own code, ``module:function``: a reduction of traces, an estimator or a control law; the reduction is run.

Its source, next to the study file, is read as text, hashed with the study and sent to other processes; what an
estimator or law declares is parsed from it.  The study may come from a stranger: only ``load`` and ``load_rules`` run
any of it, as freely as a module that is imported.  What a reduction answers is copied: numbers, labels and words,
nothing else of its objects.
"""

import ast
import functools
import hashlib
import importlib.util
import linecache
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import collecting, is_text, refuse
from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import TooLargeError, is_file, read_bytes, require_usable
from fastcoil.loops import netcdf
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, RESERVED_DIMS
from fastcoil.model.user_rules import KINDS, Rule, is_word, own_parameters, parameter
from fastcoil.study.file.tables import StudyFile

_LARGEST = 2**18  # bytes of source: to read one as Python takes 500 times its memory
_LONGEST_MESSAGE = 300  # characters of an exception's text


@dataclass(frozen=True)
class Source:
    """A function of the user: ``name`` is ``module:function``, ``source`` the text of the module, ``path`` its file."""

    name: str
    source: str = field(repr=False)
    path: Path = field(compare=False)

    @property
    def sha256(self) -> str:
        return hashlib.sha256(f"{self.name}\0{self.source}".encode()).hexdigest()


def find_source(what: str, text: str, folder: Path) -> Source:
    """Find ``module:function``, the function in ``module.py`` in ``folder``.

    what: the word of the study file that names it.
    """
    module, _, function = text.partition(":")
    parts, given = module.split("."), f"{what} = {text!r}"
    if not all(part.isidentifier() for part in (*parts, function)):
        raise InputError(
            f"{given}: give module:function, such as 'mine:overshoot' for the function overshoot in mine.py"
        )
    path = folder.joinpath(*parts).with_suffix(".py")
    require_usable(path, f"give {what} = {shown(text)} a shorter name")
    if not is_file(path):
        raise InputError(f"{given}: there is no {path}: put {path.name} next to the study file")
    try:
        source = importlib.util.decode_source(read_bytes(path, _LARGEST))  # in the encoding that it declares
        source.encode()
    except TooLargeError as error:
        raise InputError(f"{given}: {path} {error}: move what the function does not need elsewhere") from None
    except (OSError, SyntaxError, ValueError, LookupError) as error:
        raise InputError(f"{given}: {path} cannot be read: {type(error).__name__}: {error}") from None
    return Source(text, source, path)


def find_rules(file: StudyFile, folder: Path) -> tuple[StudyFile, dict[str, Source], dict[str, Rule]]:
    """Find the rules that ``estimator`` or ``law`` name as ``module:function`` anywhere in a study file.

    Returns the file with the names of the rules in place of these words, and by name their sources and themselves,
    without their code.
    """
    problems: list[str] = []
    named: dict[tuple[str, str], Source] = {}

    def renamed(value: Any, kind: str = "") -> Any:
        """A table with the name of a rule in place of each ``module:function``."""
        if isinstance(value, dict):
            return {key: renamed(part, key if key in KINDS else kind) for key, part in value.items()}
        if isinstance(value, list):
            return [renamed(part, kind) for part in value]
        if not kind or not isinstance(value, str) or ":" not in value:
            return value
        with collecting(problems):
            named.setdefault((kind, value), find_source(kind, value, folder))
        return value.rpartition(":")[2]

    update = {table: renamed(getattr(file, table)) for table in ("loop", "sweep", "cases", "sample")}
    sources: dict[str, Source] = {}
    rules: dict[str, Rule] = {}
    for (kind, word), source in sorted(named.items(), key=lambda one: list(KINDS).index(one[0][0])):
        name = word.rpartition(":")[2]
        if sources.setdefault(name, source) != source or rules.get(name, kind) != kind:
            problems.append(f"two rules are called {name}: rename one of them")
            continue
        with collecting(problems, f"{kind} = {word!r}: "):
            rules[name] = declared(kind, name, source)
    refuse(list(dict.fromkeys(problems)))
    return file.model_copy(update=update), sources, rules


def declared(kind: str, name: str, source: Source) -> Rule:
    """The rule that a source declares: its decorator, and the class of its parameters, with numbers as defaults."""
    if is_word(name):
        raise InputError(f"{name} is taken, call the function something else")
    try:
        module = ast.parse(source.source)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{source.path} is not Python: {type(error).__name__}: {error}") from None
    functions = [node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == name]
    if not functions:
        raise InputError(f"{source.path} has no function {name}")
    calls = [d for d in functions[-1].decorator_list if isinstance(d, ast.Call) and _last(d.func) == kind]
    given = [*calls[0].args, *(k.value for k in calls[0].keywords if k.arg == "Parameters")] if calls else []
    classes = [n for n in module.body if isinstance(n, ast.ClassDef) and given and n.name == _last(given[0])]
    if not classes:
        raise InputError(
            f"put @fc.{kind}(Parameters, Memory) before {name}, with classes of {source.path.name} itself, so that the "
            "study can be read without running it"
        )
    fields = dict(_fields(name, classes[-1]))
    own = own_parameters(name, fields)
    return Rule(kind, name, own, tuple(n for n in fields if n not in own), source.sha256)


def _last(node: ast.expr) -> str:
    """``estimator`` of ``fc.estimator``."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _fields(rule: str, cls: ast.ClassDef) -> Iterator[tuple[str, object]]:
    """Name and default of each field, ``None`` for one without."""
    for node in cls.body:
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        default, name = node.value, node.target.id
        try:
            if isinstance(default, ast.Call) and _last(default.func) == "parameter":
                words = {str(k.arg): ast.literal_eval(k.value) for k in default.keywords}
                yield name, parameter(*map(ast.literal_eval, default.args), **words)
            else:
                yield name, None if default is None else ast.literal_eval(default)
        except InputError:
            raise
        except (ValueError, TypeError, SyntaxError):
            raise InputError(
                f"{rule}: the default of {name} is not a number: write one, so that the study can be read without "
                "running it"
            ) from None


def load_rules(rules: Mapping[str, Rule], sources: Mapping[str, Source]) -> None:
    """Give the rules of a study, of which only the declarations were read, their code.

    ``InputError`` if a source does not run, or makes another rule than it declares.
    """
    for name, rule in rules.items():
        if not rule.is_loaded:
            rule.adopt(load(rule.kind, sources[name]))


@functools.cache
def load(what: str, code: Source) -> Any:
    """The function itself, from a module of its own that is run once in each process.

    what: the word of the study file that names it.  ``InputError`` if the source does not run, or has no such function.
    """
    name, source = code.name, code.source
    wanted = name.partition(":")[2]
    module = ModuleType(f"own_code_{hashlib.sha256(source.encode()).hexdigest()}")
    # decorators such as dataclass look here for the module of their class
    sys.modules[module.__name__] = module
    with its_errors(f"{what} = {name!r}: its module does not run:"):
        exec(compile(source, f"<{name}>", "exec", dont_inherit=True), module.__dict__)
        # tracebacks, and the export of a controller, read the source from here
        linecache.cache[f"<{name}>"] = (len(source), None, source.splitlines(keepends=True), f"<{name}>")
    function = getattr(module, wanted, None)
    if not callable(function):
        raise InputError(f"{what} = {name!r}: its module has no function {wanted}")
    return function


@contextmanager
def its_errors(what: str) -> Iterator[None]:
    """Turn whatever the user's code raises, even SystemExit, into a sentence; numpy's error handling is restored."""
    try:
        with np.errstate():
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        text = " ".join(str(error).split())
        text = text if len(text) <= _LONGEST_MESSAGE else text[:_LONGEST_MESSAGE] + " …"
        raise InputError(f"{what} {type(error).__name__}: {text}".removesuffix(": ")) from error


SCENARIO = "scenario"  # the dimension along which the function gets the traces of a shard
_TAKEN = {*PARAMETERS, *METRICS, *PREDICTIONS, *TRACES, *netcdf.CLOCK, "status", SCENARIO}
_TAKEN_NAMES = _TAKEN | set(RESERVED_DIMS)
_TAKEN_DIMS = _TAKEN | {"day", "replicate", "sample"}
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))
_WORDS = ("units", "long_name", "standard_name", "description", "comment", "source", "references")
"""Attributes that are kept: words for a reader, nothing by which a decoder would change the numbers."""


def reduce(reduction: Source, traces: xr.Dataset) -> xr.Dataset:
    """Reduce the traces of some scenarios.

    traces: over (scenario, [volume,] elapsed_time), the swept parameters as coordinates along ``scenario``; the
    function ``reduction`` gets them read-only.  Returns what it returns: numbers over (scenario, …), with the labels of
    the further dimensions and those attributes that describe a number in words.
    """
    traces = _protect(traces)
    reduced = _call(reduction, traces)
    alone = _call(reduction, traces.isel({SCENARIO: slice(-1, None)}))
    one, other = reduced.isel({SCENARIO: slice(-1, None)}).variables, alone.variables
    same = {n for n in one if n in other and one[n].dtype == other[n].dtype and one[n].equals(other[n])}  # type: ignore[no-untyped-call]
    differing = [str(n) for n in {**one, **other} if n not in same]
    if differing:
        raise InputError(
            f"reduce = {reduction.name!r} gives another {' and '.join(differing)} for a scenario alone than among "
            "others: treat each scenario alone, to the last bit"
        )
    return reduced


def _call(reduction: Source, traces: xr.Dataset) -> xr.Dataset:
    function = load("reduce", reduction)
    with its_errors(f"reduce = {reduction.name!r} raised"):
        found = function(traces.copy())
    problems = list(_problems(found, traces))
    refuse([f"reduce = {reduction.name!r} returned {problem}" for problem in problems])
    labels = {dim: _copy(found[dim].variable) for dim in _dims(found) if dim in found.coords}
    made = xr.Dataset({n: _copy(v.variable).transpose(SCENARIO, ...) for n, v in found.data_vars.items()}, labels)
    are_names = all(str(name).isidentifier() for name in (*made.variables, *made.dims))
    with suppress(Exception):  # the libraries raise many things at what they cannot write
        if are_names and netcdf.load(bytes(netcdf.netcdf_bytes(made))).identical(made):
            return made
    raise InputError(
        f"reduce = {reduction.name!r} returned names or labels that no file gives back as they are: use letters, "
        "digits and _ for names, numbers or words for labels"
    )


def _copy(variable: xr.Variable) -> xr.Variable:
    """The numbers or labels of a variable, in this machine's byte order, and its words."""
    values = np.array(variable.values, order="C")
    attrs = {word: said for word in _WORDS if isinstance(said := variable.attrs.get(word), str) and is_text(said)}
    return xr.Variable(variable.dims, values.astype(values.dtype.newbyteorder("="), copy=False), attrs)


def _problems(found: Any, traces: xr.Dataset) -> Iterable[str]:
    """What is wrong with the answer of a reduction of ``traces``, a sentence each."""
    if not isinstance(found, xr.Dataset):
        yield f"a {type(found).__name__}: return an xarray.Dataset"
        return
    if not found.data_vars:
        yield "an empty Dataset: return at least one variable"
    # labels of the scenarios come with the traces, so that these names are taken too
    taken = {str(name) for name in traces.coords} - {"elapsed_time", "volume"}
    for name, array in found.data_vars.items():
        if name in _TAKEN_NAMES | taken:
            yield f"a variable {name}: the name is taken, choose another"
        if array.sizes.get(SCENARIO) != traces.sizes[SCENARIO]:
            yield f"{name} with sizes {dict(array.sizes)}: keep the dim {SCENARIO!r} with all of its scenarios"
        if array.dtype.kind not in "biu" and array.dtype not in _FLOATS:
            yield f"{name} of type {array.dtype}: return numbers (float64, float32 or integers) or booleans"
    for dim in _dims(found):
        if dim in _TAKEN_DIMS | taken:
            yield f"a dim {dim}: the name is taken, choose another"


def _dims(found: xr.Dataset) -> list[Any]:
    return list(dict.fromkeys(dim for array in found.data_vars.values() for dim in array.dims if dim != SCENARIO))


def _protect(traces: xr.Dataset) -> xr.Dataset:
    """The same values, read-only: a function that changed them would change the input of the next call."""
    protected = traces.copy()
    for name, variable in protected.variables.items():
        if name not in protected.indexes:
            values = variable.values.view()
            values.flags.writeable = False
            variable.data = values
    return protected
