"""A user's own function, compiled: with the functions that it calls, and refused where it would not run like ours.

What runs in the loop over lanes may neither allocate nor raise.  Both show in the machine code, so that nobody needs
to guess from the source.  A table is a tuple: an index past its end raises an error, so that a rule that runs has none.
Indices of arrays are not looked at, so that arrays are refused.
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

from fastcoil.base.errors import InputError, shown
from fastcoil.model.numerics.jit import JIT_ENABLED, exact

_AS_IT_IS = (math, np, int, float, bool, abs, min, max, round, range, len)
"""What a function may use besides its own: nobody changes the attributes of the modules."""
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_HEADING = ("Failed in ", "During: ")
_LEAST, _MOST = -(2**63), 2**64 - 1  # whole numbers of the machine
_LONGEST_TABLE = 256  # numbers of a tuple: to compile 1000 takes a minute
ALLOWED = (
    "a rule works with numbers, if, loops, math, scalar numpy functions, functions of its own and tuples of up to "
    f"{_LONGEST_TABLE} numbers, whose index it limits with min and max"
)


class UserFunction:
    """A function of the user with all that it calls, ready to be compiled.

    function: as the compiler takes it.  sha256: of all that decides what it does.
    """

    def __init__(self, name: str, function: Any, memory: Any) -> None:
        self._name, self._memory = name, memory
        self._found: dict[int, tuple[Any, Any]] = {}  # id → what has it, so that it lives as long, and what it becomes
        self._digest = hashlib.sha256()
        self.function = exact(self._ready(function))
        self.sha256 = self._digest.hexdigest()

    def check(self, now: Any, parameters: Any) -> None:
        """Compile the function for these classes of named tuples; refused where it would not run like ours."""
        if not JIT_ENABLED:
            return
        arguments = tuple(
            types.NamedUniTuple(types.float64, len(c._fields), c) for c in (now, parameters, self._memory)
        )
        try:
            self.function.compile(arguments)
        except Exception as error:  # most are of one class, but not all
            raise self._refused(f"does not compile{_place_and_reason(error)}") from None
        compiled = self.function.overloads[arguments]
        returned: Any = compiled.signature.return_type
        is_pair = isinstance(returned, types.BaseTuple) and len(returned) == 2
        is_number = is_pair and isinstance(returned[0], (types.Float, types.Integer, types.Boolean))
        if not is_number or returned[1] != arguments[2]:
            memory = self._memory.__name__
            raise InputError(f"{self._name}: return a number and {memory}(…) with a number for each field")
        self._check_machine_code(compiled)

    def _check_machine_code(self, compiled: Any) -> None:
        name = re.escape(compiled.fndesc.mangled_name)
        body = re.search(rf'define [^\n]*@"?{name}"?\(.*?\n}}', compiled.library.get_llvm_str(), re.DOTALL)
        assert body is not None
        codes = re.findall(r"ret i32 (\S+)", body[0])
        if "NRT_" in body[0]:
            raise self._refused("makes an array, a list or a text")
        if "random_state" in body[0]:
            raise self._refused("draws random numbers")
        if not codes or any(code != "0" for code in codes):
            raise self._refused("may raise an error, print or never return")

    def _refused(self, why: str) -> InputError:
        return InputError(f"{self._name} {why}: {ALLOWED}")

    def _ready(self, function: Any) -> Any:
        """The function with its helpers compiled, too, and with nothing else of its module."""
        code = function.__code__
        defaults = function.__defaults__ or ()
        for place, default in zip(code.co_varnames[code.co_argcount - len(defaults) :], defaults, strict=False):
            self._value(place, default)
        names = set()
        for part in _parts(code):
            constants = [constant for constant in part.co_consts if not isinstance(constant, CodeType)]
            if any(isinstance(constant, bytes) for constant in constants):  # nobody looks at their indices
                raise self._refused("uses bytes")
            self._note(part.co_code.hex(), repr((part.co_names, part.co_varnames, part.co_freevars, part.co_cellvars)))
            self._note(*map(_exactly, constants))
            names |= {i.argval for i in dis.get_instructions(part) if i.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
        scope = {"__name__": __name__, "__builtins__": __builtins__}
        for name in sorted(names & function.__globals__.keys()):
            scope[name] = self._value(name, function.__globals__[name])
        cells = []
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                content = cell.cell_contents
            except ValueError:
                raise self._refused(f"uses {name}, which has no value yet") from None
            cells.append(CellType(self._value(name, content)))
        return FunctionType(code, scope, function.__name__, function.__defaults__, tuple(cells))

    def _value(self, name: str, value: Any) -> Any:
        """What a name of the user's module stands for, as the compiler takes it."""
        self._note(name)
        if _is_constant(value) and _size(value) <= _LONGEST_TABLE:
            self._note(_exactly(value))
            return value
        if id(value) in self._found:
            self._note(f"known {list(self._found).index(id(value))}")
            made = self._found[id(value)][1]
            if made is None:
                raise self._refused(f"uses {name}, which calls itself")
            return made
        python = value.py_func if isinstance(value, Dispatcher) else value
        if isinstance(python, FunctionType):
            self._found[id(value)] = value, None
            made = exact(self._ready(python))
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_field_defaults"):
            named: Any = value
            defaults = (f"{n} {_exactly(default)}" for n, default in named._field_defaults.items())
            self._note(named.__name__, *named._fields, *defaults)
            made = _maker(value) if value is self._memory else value
        elif any(value is known for known in _AS_IT_IS):
            self._note(value.__name__)
            made = value
        else:
            raise self._refused(f"uses {name}, {shown(value)}")
        self._found[id(value)] = value, made
        return made

    def _note(self, *words: str) -> None:
        for word in words:
            self._digest.update(f"{len(word)} {word}\n".encode())


def _parts(code: CodeType) -> Iterator[CodeType]:
    """The code of a function and of those that are written inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _parts(constant)


def _exactly(constant: Any) -> str:
    """A constant in words: the same in every process, others for every other constant."""
    kind = type(constant).__name__
    if isinstance(constant, (tuple, frozenset)):
        parts = [_exactly(part) for part in constant]
        return f"{kind} ({', '.join(parts if isinstance(constant, tuple) else sorted(parts))})"
    if isinstance(constant, np.generic):
        return f"{kind} {constant.item()!r}"
    if isinstance(constant, int):  # in hexadecimal numbers, of which Python writes as many as there are
        return f"{kind} {int(constant):x}"
    return f"{kind} {float.__repr__(constant) if isinstance(constant, float) else repr(constant)}"


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    if isinstance(value, int):
        return _LEAST <= value <= _MOST
    return value is None or isinstance(value, (float, str, np.number, np.bool_))


def _size(constant: Any) -> int:
    return sum(map(_size, constant)) if isinstance(constant, tuple) else 1


def _place_and_reason(error: Exception) -> str:
    """The useful line of the compiler's message, and the line of the rule that it is about, if it says one."""
    text = _COLOUR.sub("", str(error))  # written where colorama is installed
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith(_HEADING)]
    place = re.findall(r'[("]([^"\n(]+?)"?,? (?:line |\()(\d+)[):]', text)
    where = f", line {place[-1][1]} of {Path(place[-1][0]).name}" if place else ""
    return f"{where}: {lines[0] if lines else type(error).__name__}"


def _maker(memory: Any) -> Any:
    """What stands for the class of the memory: one type, whatever kind of numbers it is given."""
    defaults = memory._field_defaults
    takes = ", ".join(f"{n}={float(defaults[n])!r}" if n in defaults else n for n in memory._fields)
    # no field begins like these
    scope: dict[str, Any] = {"_memory": memory, "nan": math.nan, "inf": math.inf}
    exec(f"def make({takes}):\n    return _memory({', '.join(f'1.0 * {n}' for n in memory._fields)})", scope)
    return exact(scope["make"])
