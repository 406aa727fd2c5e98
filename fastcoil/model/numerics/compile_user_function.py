"""Compile a function of the user with the functions that it calls; refuse one that cannot run in the kernel.

Code in the loop over lanes may neither allocate nor raise: both are visible in the machine code.  Indices of arrays and
bytes are not checked, so both are refused; a table is a tuple.
"""

import dis
import hashlib
import math
import re
from collections.abc import Iterator
from pathlib import Path
from types import CellType, CodeType, FunctionType
from typing import Any

import numpy as np
from numba import types
from numba.core.dispatcher import Dispatcher

from fastcoil.base.errors import InputError, short_repr
from fastcoil.model.numerics.jit import JIT_ENABLED, exact

_ALLOWED_OBJECTS = (math, np, int, float, bool, abs, min, max, round, range, len)
"""Objects of other modules that a function may use; the attributes of the modules are constant."""
_MAX_TABLE_NUMBERS = 256  # in a tuple: compiling 1000 takes a minute
_ALLOWED_IN_RULES = (
    "a rule works with numbers, if, loops, math, scalar numpy functions, other such functions and tuples of up to "
    f"{_MAX_TABLE_NUMBERS} numbers, whose index it limits with min and max"
)


class UserFunction:
    """A function of the user with all that it calls, for the compiler, and a hash of what decides what it does."""

    def __init__(self, name: str, function: Any, memory: Any) -> None:
        self._name, self._memory = name, memory
        # id → the object, which keeps its id, and its replacement
        self._replacements: dict[int, tuple[Any, Any]] = {}
        self._digest = hashlib.sha256()
        self.function = exact(self._prepare(function))
        self.sha256 = self._digest.hexdigest()

    def check(self, now: Any, parameters: Any) -> None:
        """Compile the function for these classes of named tuples, or raise `InputError`."""
        if not JIT_ENABLED:
            return
        arguments = tuple(
            types.NamedUniTuple(types.float64, len(c._fields), c) for c in (now, parameters, self._memory)
        )
        try:
            self.function.compile(arguments)
        except Exception as error:  # most are of one class, but not all
            raise self._refusal(f"does not compile{_place_and_reason(error)}") from None
        compiled = self.function.overloads[arguments]
        return_type: Any = compiled.signature.return_type
        is_pair = isinstance(return_type, types.BaseTuple) and len(return_type) == 2
        is_number = is_pair and isinstance(return_type[0], (types.Float, types.Integer, types.Boolean))
        if not is_number or return_type[1] != arguments[2]:
            memory = self._memory.__name__
            sentence = f"{self._name}: return a number and {memory}(…) with a number for each field"
            raise InputError(sentence, self._name, "code")
        self._check_machine_code(compiled)

    def _check_machine_code(self, compiled: Any) -> None:
        name = re.escape(compiled.fndesc.mangled_name)
        body = re.search(rf'define [^\n]*@"?{name}"?\(.*?\n}}', compiled.library.get_llvm_str(), re.DOTALL)
        assert body is not None
        return_codes = re.findall(r"ret i32 (\S+)", body[0])
        if "NRT_" in body[0]:
            raise self._refusal("makes an array, a list or a text")
        if "random_state" in body[0]:
            raise self._refusal("draws random numbers")
        if not return_codes or any(code != "0" for code in return_codes):
            raise self._refusal("may raise an error, print or never return")

    def _refusal(self, reason: str) -> InputError:
        return InputError(f"{self._name} {reason}: {_ALLOWED_IN_RULES}", self._name, "code")

    def _prepare(self, function: Any) -> Any:
        """Return the function with compiled helpers and nothing else of its module."""
        code = function.__code__
        defaults = function.__defaults__ or ()
        for argument, default in zip(code.co_varnames[code.co_argcount - len(defaults) :], defaults, strict=False):
            self._resolve(argument, default)
        names = set()
        for part in _nested_code(code):
            constants = [constant for constant in part.co_consts if not isinstance(constant, CodeType)]
            if any(isinstance(constant, bytes) for constant in constants):
                raise self._refusal("uses bytes")
            names_of_part = repr((part.co_names, part.co_varnames, part.co_freevars, part.co_cellvars))
            self._add_to_hash(part.co_code.hex(), names_of_part, *map(_exact_text, constants))
            names |= {i.argval for i in dis.get_instructions(part) if i.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
        scope = {"__name__": __name__, "__builtins__": __builtins__}
        for name in sorted(names & function.__globals__.keys()):
            scope[name] = self._resolve(name, function.__globals__[name])
        cells = []
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                content = cell.cell_contents
            except ValueError:
                raise self._refusal(f"uses {name}, which has no value yet") from None
            cells.append(CellType(self._resolve(name, content)))
        return FunctionType(code, scope, function.__name__, function.__defaults__, tuple(cells))

    def _resolve(self, name: str, value: Any) -> Any:
        """Return the value of a name of the user's module in a form for the compiler."""
        self._add_to_hash(name)
        if _is_constant(value) and _count_numbers(value) <= _MAX_TABLE_NUMBERS:
            self._add_to_hash(_exact_text(value))
            return value
        if id(value) in self._replacements:
            self._add_to_hash(f"known {list(self._replacements).index(id(value))}")
            replacement = self._replacements[id(value)][1]
            if replacement is None:
                raise self._refusal(f"uses {name}, which calls itself")
            return replacement
        function = value.py_func if isinstance(value, Dispatcher) else value
        if isinstance(function, FunctionType):
            self._replacements[id(value)] = value, None
            replacement = exact(self._prepare(function))
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_field_defaults"):
            named_tuple: Any = value
            defaults = (f"{n} {_exact_text(default)}" for n, default in named_tuple._field_defaults.items())
            self._add_to_hash(named_tuple.__name__, *named_tuple._fields, *defaults)
            replacement = _make_constructor(value) if value is self._memory else value
        elif any(value is allowed for allowed in _ALLOWED_OBJECTS):
            self._add_to_hash(value.__name__)
            replacement = value
        else:
            raise self._refusal(f"uses {name}, {short_repr(value)}")
        self._replacements[id(value)] = value, replacement
        return replacement

    def _add_to_hash(self, *words: str) -> None:
        for word in words:
            self._digest.update(f"{len(word)} {word}\n".encode())


def _nested_code(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of a function and of the functions nested in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _nested_code(constant)


def _exact_text(constant: Any) -> str:
    """Write a constant as text: the same text in every process, another one for every other constant."""
    type_name = type(constant).__name__
    if isinstance(constant, (tuple, frozenset)):
        parts = [_exact_text(part) for part in constant]
        return f"{type_name} ({', '.join(parts if isinstance(constant, tuple) else sorted(parts))})"
    if isinstance(constant, np.generic):
        return f"{type_name} {constant.item()!r}"
    if isinstance(constant, int):  # hexadecimal, because Python limits the digits of decimal numbers
        return f"{type_name} {int(constant):x}"
    return f"{type_name} {float.__repr__(constant) if isinstance(constant, float) else repr(constant)}"


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    if isinstance(value, int):
        return -(2**63) <= value < 2**64  # int64 or uint64
    return value is None or isinstance(value, (float, str, np.number, np.bool_))


def _count_numbers(constant: Any) -> int:
    return sum(map(_count_numbers, constant)) if isinstance(constant, tuple) else 1


def _place_and_reason(error: Exception) -> str:
    """Extract the line of the rule, if there is one, and the useful line from a message of the compiler."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))  # colours, where colorama is installed
    headings = ("Failed in ", "During: ")
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith(headings)]
    place = re.findall(r'[("]([^"\n(]+?)"?,? (?:line |\()(\d+)[):]', text)
    location = f", line {place[-1][1]} of {Path(place[-1][0]).name}" if place else ""
    return f"{location}: {lines[0] if lines else type(error).__name__}"


def _make_constructor(memory: Any) -> Any:
    """Return a constructor of the memory that converts all numbers to floats, so that its type is always the same."""
    defaults = memory._field_defaults
    arguments = ", ".join(f"{n}={float(defaults[n])!r}" if n in defaults else n for n in memory._fields)
    # no field begins like these
    scope: dict[str, Any] = {"_memory": memory, "nan": math.nan, "inf": math.inf}
    exec(f"def make({arguments}):\n    return _memory({', '.join(f'1.0 * {n}' for n in memory._fields)})", scope)
    return exact(scope["make"])
