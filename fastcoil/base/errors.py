"""Exceptions shown to users, and the exit codes of the command line."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Collection, Iterable

from fastcoil.base.text import printable

EXIT_BUG = 1
EXIT_INPUT = 2
EXIT_FAILED_SCENARIOS = 3
EXIT_STORAGE = 4
EXIT_LOCKED = 5
EXIT_INTEGRITY = 6
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_LONGEST = 60  # characters of a value quoted in a message
_MOST_SENTENCES = 20  # sentences printed in full, the rest are counted


class FastcoilError(Exception):
    """Base class of all errors that fastcoil raises on purpose; the text is meant for the user.

    ``str(error)`` escapes control characters and truncates long lists; ``args`` holds the full text.
    """

    exit_code = EXIT_BUG
    _noun = "line"

    def __str__(self) -> str:
        sentences = self._sentences()
        more = len(sentences) - _MOST_SENTENCES
        cut = [f"… and {more:,} more {self._noun}{'s' if more > 1 else ''}"] if more > 0 else []
        return "\n".join([*map(printable, sentences[:_MOST_SENTENCES]), *cut])

    def _sentences(self) -> list[str]:
        return str(self.args[0]).split("\n") if self.args else []


class WrongType(str):
    """A message about an argument of the wrong type."""

    __slots__ = ()


class InputError(FastcoilError, ValueError):
    """Bad input.  ``problems`` holds one sentence for each mistake: field, value and cure.

    If one of them is a ``WrongType``, the exception becomes an ``InputTypeError``.
    """

    exit_code = EXIT_INPUT
    _noun = "mistake"

    def __new__(cls, problems: str | Collection[str] = ()) -> InputError:
        # libraries that pickle errors between processes construct them without arguments
        sentences = [problems] if isinstance(problems, str) else problems
        of_type = cls is InputError and any(isinstance(one, WrongType) for one in sentences)
        return super().__new__(InputTypeError if of_type else cls)

    def __init__(self, problems: str | Collection[str]) -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        super().__init__("\n".join(self.problems))

    def _sentences(self) -> list[str]:
        return self.problems


class InputTypeError(InputError, TypeError):
    """An argument of the wrong type, possibly along with other mistakes in the call."""


class StorageError(FastcoilError, OSError):
    """A result could not be read or written.  ``errno`` is the operating system's reason, if it gave one."""

    exit_code = EXIT_STORAGE


def out_of_memory(what: str) -> StorageError:
    """Error for work that ran out of memory; ``what``: what cannot be done."""
    found = StorageError(
        f"{what}: the memory ran out; finished scenarios are kept: use fewer workers with -j, --backend loky, or fewer "
        "traces, and run the same command again"
    )
    found.errno = errno.ENOMEM
    return found


class LockedError(FastcoilError):
    """Another run holds the lock of the folder."""

    exit_code = EXIT_LOCKED


class IntegrityError(FastcoilError):
    """Files on disk are damaged, changed, or do not belong together."""

    exit_code = EXIT_INTEGRITY


def missing_extra(what: str, packages: str, extra: str) -> InputError:
    """Error for missing optional packages: what needs them, and the extra that installs them."""
    some = "packages" if " and " in packages else "package"
    return InputError(f"{what} needs the {some} {packages}: pip install 'fastcoil[{extra}]'")


def nearest(name: str, known: Iterable[str]) -> str:
    """Clause such as ``, did you mean 'backlash'?`` for an unknown name; empty if no known name is similar."""
    by_folded = {k.casefold(): k for k in known}
    match = difflib.get_close_matches(name.casefold(), list(by_folded), n=1, cutoff=0.6)
    return f", did you mean {by_folded[match[0]]!r}?" if match else ""


def shown(value: object) -> str:
    """A value quoted in a message: on one line, truncated."""
    text = repr(value[:_LONGEST] if isinstance(value, (str, bytes, list, tuple)) else value)
    if not text.isprintable():
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
