"""Exceptions shown to users, and the exit codes of the command line."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import Self

from fastcoil.base.text import escape_control_characters

EXIT_BUG = 1  # exit codes of the command line
EXIT_INPUT = 2
EXIT_FAILED_SCENARIOS = 3
EXIT_STORAGE = 4
EXIT_LOCKED = 5
EXIT_INTEGRITY = 6
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_MAX_REPR_CHARACTERS = 60  # of a value quoted in a message
_MAX_SENTENCES = 20  # of an error that are printed, the rest are counted


class FastcoilError(Exception):
    """Base class of all errors that fastcoil raises on purpose; the text is meant for the user.

    ``str(error)`` escapes control characters and truncates long lists; ``args`` holds the full text.  ``code`` says
    which kind of error it is, for programs: "storage", "locked", "integrity", or of an `InputError` one of ``CODES``.
    """

    exit_code = EXIT_BUG
    code = "bug"
    """The kind of error, for programs."""
    field = ""
    """The argument, parameter, key, column or option to change, as the user writes it; blank if there is none."""
    _item_noun = "line"

    def __str__(self) -> str:
        sentences = self._sentences()
        lines = [*map(escape_control_characters, sentences[:_MAX_SENTENCES])]
        if (n_hidden := len(sentences) - _MAX_SENTENCES) > 0:
            lines.append(f"… and {n_hidden:,} more {self._item_noun}{'s' if n_hidden > 1 else ''}")
        return "\n".join(lines)

    def _sentences(self) -> list[str]:
        return str(self.args[0]).split("\n") if self.args else []


CODES = {
    "type": "an argument of the wrong type",
    "value": "a number or text outside what is allowed",
    "choice": "a word that is not one of the choices",
    "name": "an unknown name of a parameter, key, column, dim, option or function",
    "missing": "something needed that was not given",
    "conflict": "two things given that exclude or contradict each other",
    "duplicate": "something given twice",
    "shape": "lengths, dims or labels that do not fit together",
    "unit": "a unit that is missing, unknown or contradicted by the numbers",
    "time": "times out of order, off the clock, or of another zone or step",
    "format": "a file or text that cannot be parsed",
    "data": "numbers that do not suffice, or that the model or the log contradicts",
    "path": "a file or folder that cannot be used",
    "size": "more than fits into memory, a file or a limit",
    "package": "an optional package that is not installed",
    "unsupported": "a combination that fastcoil does not compute",
    "code": "an error in the user's own function or file of code",
}
"""What ``InputError.code`` may be, and what it means."""


class Problem(str):
    """One mistake: a sentence, a code of ``CODES``, and the argument, key, option or file to change."""

    field: str
    code: str
    is_argument = True  # not so where a file says it: only an argument of the wrong type is a ``TypeError``

    def __new__(cls, sentence: str, field: str = "", code: str = "") -> Self:
        self = super().__new__(cls, sentence)
        self.field, self.code = field, code
        return self

    def __getnewargs__(self) -> tuple[str, str, str]:  # type: ignore[override]
        return str(self), self.field, self.code

    def with_prefix(self, prefix: str) -> Problem:
        """Return the problem with words before its sentence, as one that a file has, not an argument."""
        problem = Problem(prefix + self, self.field, self.code)
        problem.is_argument = False
        return problem


class InputError(FastcoilError, ValueError):
    """Bad input: ``problems`` holds one sentence for each mistake, with field, value and cure.

    ``field`` and ``code`` are those of the first problem.  If the code of one is "type", the exception becomes an
    ``InputTypeError``.

    Parameters
    ----------
    problems
        A sentence, or several of them, each a str or a `Problem`.
    field, code
        Of the sentences that are no `Problem`.
    """

    exit_code = EXIT_INPUT
    _item_noun = "mistake"

    def __new__(cls, problems: str | Collection[str] = (), field: str = "", code: str = "") -> InputError:
        # libraries that pickle errors between processes construct them without arguments
        is_wrong_type = any(p.code == "type" and p.is_argument for p in _to_problems(problems, field, code))
        return super().__new__(InputTypeError if cls is InputError and is_wrong_type else cls)

    def __init__(self, problems: str | Collection[str], field: str = "", code: str = "") -> None:
        self.problems = _to_problems(problems, field, code)
        first = self.problems[0] if self.problems else Problem("")
        self.field, self.code = first.field, first.code
        super().__init__("\n".join(self.problems))

    def _sentences(self) -> list[str]:
        return list(self.problems)


def _to_problems(problems: str | Collection[str], field: str, code: str) -> list[Problem]:
    """Convert one sentence or several to problems; field, code: of those that are none yet."""
    sentences = [problems] if isinstance(problems, str) else problems
    return [s if isinstance(s, Problem) else Problem(s, field, code) for s in sentences]


class InputTypeError(InputError, TypeError):
    """An argument of the wrong type, possibly along with other mistakes in the call."""


class StorageError(FastcoilError, OSError):
    """A result could not be read or written.  ``errno`` is the operating system's reason, if it gave one."""

    exit_code = EXIT_STORAGE
    code = "storage"


def out_of_memory_error(failure: str) -> StorageError:
    """Return the error for work that ran out of memory; ``failure``: what cannot be done."""
    cure = "use fewer workers with -j, --backend loky, or fewer traces, and run the same command again"
    error = StorageError(f"{failure}: the memory ran out; finished scenarios are kept: {cure}")
    error.errno = errno.ENOMEM
    return error


class LockedError(FastcoilError):
    """Another run holds the lock of the folder."""

    exit_code = EXIT_LOCKED
    code = "locked"


class IntegrityError(FastcoilError):
    """Files on disk are damaged, changed, or do not belong together."""

    exit_code = EXIT_INTEGRITY
    code = "integrity"


def missing_extra_error(feature: str, packages: str, extra: str) -> InputError:
    """Return the error that a feature needs optional packages, which an extra of fastcoil installs."""
    noun = "packages" if " and " in packages else "package"
    return InputError(f"{feature} needs the {noun} {packages}: pip install 'fastcoil[{extra}]'", packages, "package")


@contextmanager
def settings_errors(package: str, cure: str) -> Iterator[None]:
    """Turn what an import raises because of the settings of this machine into an ``InputError``."""
    try:
        yield
    except ImportError:
        raise
    except Exception as error:
        raise InputError(f"{package} refuses its settings here ({error}): {cure}", package, "value") from None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a clause such as ``, did you mean 'backlash'?`` for an unknown name; empty if no known name is similar."""
    by_folded = {k.casefold(): k for k in known}
    match = difflib.get_close_matches(name.casefold(), list(by_folded), n=1, cutoff=0.6)
    return f", did you mean {by_folded[match[0]]!r}?" if match else ""


def short_repr(value: object) -> str:
    """Return the repr of a value for a message: on one line, truncated."""
    text = repr(value[:_MAX_REPR_CHARACTERS] if isinstance(value, (str, bytes, list, tuple)) else value)
    if not text.isprintable():
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    return text if len(text) <= _MAX_REPR_CHARACTERS else text[: _MAX_REPR_CHARACTERS - 3] + "..."
