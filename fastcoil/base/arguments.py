"""Checks of the arguments of public functions.

``require_...(name, value, ...)`` converts a value to a plain Python type or raises an `InputError` about the field
``name``, of one sentence: name, value, cure.  ``argument_checks`` raises the errors of several checks together.
"""

import math
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

from fastcoil.base.errors import InputError, did_you_mean, short_repr
from fastcoil.base.files import require_usable_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

MAX_ARRAY_VALUES = 50_000_000  # upper limit of the size of an array argument, such as 1-s samples over all days
_MAX_FLOAT = sys.float_info.max
_BUILTIN_BY_DTYPE_KIND: Mapping[str, Callable[[Any], object]] = {"b": bool, "i": int, "u": int, "f": float, "U": str}
"""Python type by the kind of a numpy dtype."""


def raise_problems(problems: Collection[str]) -> None:
    """Raise one ``InputError`` with all of these mistakes, a sentence each; do nothing if there are none."""
    if problems:
        raise InputError(problems)


@contextmanager
def collect_problems(problems: list[str], prefix: str = "") -> Iterator[None]:
    """Add the sentences of an ``InputError`` to ``problems`` and continue."""
    try:
        yield
    except InputError as error:
        problems += [p.with_prefix(prefix) if prefix else p for p in error.problems]


class Checks:
    """Runs checks one after another and collects the messages of those that fail."""

    def __init__(self) -> None:
        self.problems: list[str] = []

    def __call__(self, check: Callable[P, R], *args: P.args, **options: P.kwargs) -> R:
        """Return the result of ``check``, or None if it fails: the whole call is refused afterwards."""
        with collect_problems(self.problems):
            return check(*args, **options)
        return cast(R, None)

    def unless_none(self, check: Callable[..., R], name: str, value: object, *args: Any, **options: Any) -> R | None:
        """Run a check of an argument, and return its result, unless the value is None, which passes."""
        return None if value is None else self(check, name, value, *args, **options)


@contextmanager
def argument_checks() -> Iterator[Checks]:
    """Collect the errors of all checks in the block and raise them as one `InputError` at its end."""
    checks = Checks()
    yield checks
    raise_problems(checks.problems)


def to_builtin(value: Any) -> Any:
    """Convert a numpy scalar or a 0-d array to a plain Python number, bool or str; return anything else unchanged."""
    numpy = sys.modules.get("numpy")
    if numpy is None:
        return value
    if type(value) is numpy.ndarray and value.ndim == 0:
        value = value[()]
    # a subclass may have a unit
    dtype_kind = value.dtype.kind if isinstance(value, numpy.generic) and type(value).__module__ == "numpy" else ""
    return _BUILTIN_BY_DTYPE_KIND[dtype_kind](value) if dtype_kind in _BUILTIN_BY_DTYPE_KIND else value


_UNIT_KEY = re.compile(r"(eng(ineering)?)?units?(ofmeasure(ment)?|text|name|symbol|code)?|uom")
"""Matches a key of ``attrs`` that names a unit, in small letters without separators."""
_BARE_TYPES = (int, float, complex, bool, str, bytes, type(None))


def carried_unit(name: str, value: Any) -> str | None:
    """Return the unit beside the numbers of a value, whichever library made it; None for bare numbers.

    It is an attribute ``units`` or ``unit`` of the value, of its dtype, data or items, or stands in its ``attrs`` or,
    in brackets, in its name.
    """
    if len(texts := sorted({*_carried_units(name, value)})) > 1:
        raise InputError(f"{name} has the units {' and '.join(map(short_repr, texts))}: give one", name, "unit")
    return texts[0] if texts else None


def _carried_units(name: str, value: Any) -> Iterator[str]:
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if isinstance(value, type) or type(value) in _BARE_TYPES or kind in ("m", "M") or hasattr(value, "isoformat"):
        return  # durations and dates have a unit too, that of their clock
    attrs = getattr(value, "attrs", None)  # of xarray and pandas, whose attributes may be labels
    parts: Any = (getattr(value, "data", None), value.dtype) if kind and attrs is not None else ()
    if isinstance(value, (list, tuple)) or kind == "O":
        parts = value if isinstance(value, (list, tuple)) else getattr(value, "values", value).ravel()
    for part in (part for part in parts if type(part) not in _BARE_TYPES):
        yield from _carried_units(name, part)
    units = attrs if isinstance(attrs, Mapping) else {key: getattr(value, key, None) for key in ("units", "unit")}
    texts = [unit for key, unit in units.items() if _UNIT_KEY.fullmatch(re.sub(r"[\W_]", "", str(key).casefold()))]
    in_name = re.search(r"\[\s*(.*?)\s*\]\s*$", str(getattr(value, "name", ""))) if attrs is not None else None
    for unit in texts or ([in_name[1]] if in_name else []):
        if attrs is not None and not isinstance(unit, str):
            raise InputError(f"{name} has units = {short_repr(unit)}: give a text, such as 'K'", name, "type")
        if unit is not None and not callable(unit):
            yield str(unit)


def require_no_unit(name: str, value: Any, cure: str) -> None:
    """Refuse numbers with a unit, where none is known."""
    if (unit := carried_unit(name, value)) not in (None, "", "1", "dimensionless"):
        raise InputError(f"{name} has the unit {short_repr(unit)}: {cure}, without a unit", name, "unit")


def is_number(value: Any) -> bool:
    """Whether ``value`` is one real number, of Python or numpy, without a unit; booleans are not numbers."""
    value = to_builtin(value)
    # a numpy duration is a Real with a dtype
    is_bare = isinstance(value, Real) and not hasattr(value, "dtype") and carried_unit("", value) is None
    return is_bare and not isinstance(value, bool)


def require_number(name: str, value: object, cure: str, *, least: float = -math.inf, most: float = _MAX_FLOAT) -> float:
    """Require a finite number from ``least`` to ``most``, both included."""
    if not is_number(value):
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "type")
    number = to_builtin(value)
    if not max(least, -_MAX_FLOAT) <= number <= most:
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "value")
    return float(number)


def require_integer(name: str, value: object, least: int, most: int | None = None, cure: str | None = None) -> int:
    """Require a whole number from ``least`` to ``most``."""
    number = to_builtin(value)
    if not isinstance(number, Integral) or not is_number(number):
        raise InputError(f"{name} = {short_repr(value)}: {cure or 'give a whole number'}", name, "type")
    if int(number) < least or (most is not None and int(number) > most):
        limits = f"must be at least {least}" + (f" and at most {most}" if most is not None else "")
        raise InputError(f"{name} = {short_repr(number)}: {cure or limits}", name, "value")
    return int(number)


def require_flag(name: str, value: object) -> bool:
    """Require True or False, of Python or numpy."""
    flag = to_builtin(value)
    if not isinstance(flag, bool):
        raise InputError(f"{name} = {short_repr(value)}: give True or False", name, "type")
    return flag


def require_choice(name: str, value: object, choices: Collection[str]) -> str:
    """Require a word that is one of ``choices``; the error suggests the most similar one."""
    word = to_builtin(value)
    cure = f"choose {_join_with_or(choices)}" if choices else "leave it out, there is none to choose"
    if not isinstance(word, str):
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "type")
    if word not in choices:
        raise InputError(f"{name} = {short_repr(word)}{did_you_mean(word, choices)}: {cure}", name, "choice")
    return word


def require_path(name: str, value: object, cure: str = "give a path") -> Path:
    """Require a path that the file system accepts; it need not exist."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"{name} is a {type(value).__name__}: {cure}", name, "type")
    text = os.fspath(value)
    if not isinstance(text, str):
        raise InputError(f"{name} = {short_repr(value)}: {cure} as text", name, "type")
    if not text:
        raise InputError(f"{name} is empty: {cure}", name, "path")
    require_usable_path(Path(text), cure, name)
    return Path(text)


def require_text(name: str, value: object) -> str:
    """Require a text that can be stored as UTF-8."""
    text = to_builtin(value)
    if not isinstance(text, str):
        raise InputError(f"{name} = {short_repr(value)}: give a text", name, "type")
    if not is_storable_text(text):
        sentence = f"{name} = {short_repr(text)}: it has characters that cannot be stored as UTF-8, remove them"
        raise InputError(sentence, name, "value")
    return text


def is_storable_text(text: str) -> bool:
    """Whether the text survives storage as UTF-8: no unpaired surrogate, no NUL."""
    try:
        return b"\0" not in text.encode()
    except UnicodeEncodeError:
        return False


def require_instance(name: str, value: object, kind: type[T], cure: str) -> T:
    """Require an instance of the class ``kind``; cure: end of the message otherwise."""
    if not isinstance(value, kind):
        raise InputError(f"{name} is a {type(value).__name__}: {cure}", name, "type")
    return value


def require_array(name: str, value: Any, cure: str, kinds: str = "iuf") -> "NDArray[Any]":
    """Convert an array-like to an array whose dtype has one of these kinds; masked values to NaN."""
    import numpy as np

    if isinstance(value, range) and len(value) > MAX_ARRAY_VALUES:
        sentence = f"{name} = {short_repr(value)}: more than {MAX_ARRAY_VALUES:,} values, give fewer"
        raise InputError(sentence, name, "size")
    require_no_unit(name, value, cure)
    try:
        if isinstance(value, np.ma.MaskedArray):
            value = np.ma.filled(value.astype(np.float64), np.nan)
        array = np.asarray(value)
    except Exception as error:  # a user's class may raise anything
        if isinstance(error, ValueError) and isinstance(value, (list, tuple)):
            raise InputError(f"{name} has rows of different length: give one length", name, "shape") from None
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "type") from None
    if array.dtype.kind not in kinds:
        kind = "text" if array.dtype.kind in "US" else array.dtype.name  # the name of text has its length in bits
        raise InputError(f"{name} = {short_repr(value)} is of type {kind}: {cure}", name, "type")
    return array


def require_mapping(name: str, value: object, cure: str, *, to_text: bool = False) -> Mapping[str, Any]:
    """Require a mapping with text keys, and text values if ``to_text``."""
    texts = [*value, *(value.values() if to_text else ())] if isinstance(value, Mapping) else [None]
    if not all(isinstance(text, str) for text in texts):
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "type")
    return cast("Mapping[str, Any]", value)


def require_names(argument: str, value: object) -> list[str]:
    """Require a name or an iterable of different names; return them as a list."""
    value = to_builtin(value)
    is_0d = getattr(value, "ndim", None) == 0  # of xarray: it has __iter__, which raises
    items: Iterable[object] = [value] if isinstance(value, str) or is_0d or not isinstance(value, Iterable) else value
    names: list[str] = []
    for name in map(to_builtin, items):
        if not isinstance(name, str):  # of a range of millions the first is enough
            raise InputError(f"{argument} = {short_repr(value)}: must be a name or a list of names", argument, "type")
        names.append(name)
    if not names:
        raise InputError(f"{argument} is empty: give at least one name", argument, "missing")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if sentences := [f"{argument}: {short_repr(name)} is given more than once: give it once" for name in repeated]:
        raise InputError(sentences, argument, "duplicate")
    return names


def require_confidence_level(level: object) -> float:
    """Require the confidence level of an interval, between 0 and 1."""
    cure = "must be a number between 0 and 1, such as 0.95"
    return require_number("level", level, cure, least=math.nextafter(0.0, 1.0), most=math.nextafter(1.0, 0.0))


def _join_with_or(choices: Iterable[str]) -> str:
    *others, last = map(repr, choices)
    return f"{', '.join(others)} or {last}" if others else last
