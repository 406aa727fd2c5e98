"""A study's own code, ``module:function``: a reduction of traces, an estimator or a control law.

Its source, next to the study file, is read as text, hashed with the study and sent to other processes; what an
estimator or law declares is parsed from it.  The study may come from a stranger: only ``load`` and ``load_rules`` run
any of it, as freely as a module that is imported.
"""

import ast
import functools
import hashlib
import importlib.util
import linecache
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.base.arguments import collecting
from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import TooLargeError, is_file, read_bytes, require_usable
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
        """Hash of the name and the text."""
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
    if problems:
        raise InputError(list(dict.fromkeys(problems)))
    return file.model_copy(update=update), sources, rules


def declared(kind: str, name: str, source: Source) -> Rule:
    """The rule that a source declares: its decorator, and the class of its parameters, with numbers as defaults."""
    if is_word(name):
        raise InputError(f"{name} is taken, call the function something else")
    try:
        module = ast.parse(source.source)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{source.path} is no Python: {type(error).__name__}: {error}") from None
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
                f"{rule}: the default of {name} is no number: write one, so that the study can be read without "
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
