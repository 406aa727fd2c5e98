"""Exceptions shown to users, and the exit codes of the command line."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Collection, Iterable

from fastcoil.base.text import escape_control_characters

EXIT_BUG = 1
EXIT_INPUT = 2
EXIT_FAILED_SCENARIOS = 3
EXIT_STORAGE = 4
EXIT_LOCKED = 5
EXIT_INTEGRITY = 6
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_MAX_REPR_CHARACTERS = 60  # characters of a value quoted in a message
_MAX_SENTENCES = 20  # sentences printed in full, the rest are counted


class FastcoilError(Exception):
    """Base class of all errors that fastcoil raises on purpose; the text is meant for the user.

    ``str(error)`` escapes control characters and truncates long lists; ``args`` holds the full text.
    """

    exit_code = EXIT_BUG
    _item_noun = "line"

    def __str__(self) -> str:
        sentences = self._sentences()
        n_hidden = len(sentences) - _MAX_SENTENCES
        hidden_note = (
            [f"… and {n_hidden:,} more {self._item_noun}{'s' if n_hidden > 1 else ''}"] if n_hidden > 0 else []
        )
        return "\n".join([*map(escape_control_characters, sentences[:_MAX_SENTENCES]), *hidden_note])

    def _sentences(self) -> list[str]:
        return str(self.args[0]).split("\n") if self.args else []


class WrongTypeMessage(str):
    """A message about an argument of the wrong type."""

    __slots__ = ()


class InputError(FastcoilError, ValueError):
    """Bad input.  ``problems`` holds one sentence for each mistake: field, value and cure.

    If one of them is a ``WrongTypeMessage``, the exception becomes an ``InputTypeError``.
    """

    exit_code = EXIT_INPUT
    _item_noun = "mistake"

    def __new__(cls, problems: str | Collection[str] = ()) -> InputError:
        # libraries that pickle errors between processes construct them without arguments
        sentences = [problems] if isinstance(problems, str) else problems
        is_type_error = cls is InputError and any(isinstance(sentence, WrongTypeMessage) for sentence in sentences)
        return super().__new__(InputTypeError if is_type_error else cls)

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


def out_of_memory_error(failure: str) -> StorageError:
    """Error for work that ran out of memory; ``failure``: what cannot be done."""
    error = StorageError(
        f"{failure}: the memory ran out; finished scenarios are kept: use fewer workers with -j, --backend loky, or fewer "
        "traces, and run the same command again"
    )
    error.errno = errno.ENOMEM
    return error


class LockedError(FastcoilError):
    """Another run holds the lock of the folder."""

    exit_code = EXIT_LOCKED


class IntegrityError(FastcoilError):
    """Files on disk are damaged, changed, or do not belong together."""

    exit_code = EXIT_INTEGRITY


def missing_extra_error(feature: str, packages: str, extra: str) -> InputError:
    """Error for missing optional packages: what needs them, and the extra that installs them."""
    noun = "packages" if " and " in packages else "package"
    return InputError(f"{feature} needs the {noun} {packages}: pip install 'fastcoil[{extra}]'")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Clause such as ``, did you mean 'backlash'?`` for an unknown name; empty if no known name is similar."""
    by_folded = {k.casefold(): k for k in known}
    match = difflib.get_close_matches(name.casefold(), list(by_folded), n=1, cutoff=0.6)
    return f", did you mean {by_folded[match[0]]!r}?" if match else ""


def short_repr(value: object) -> str:
    """A value quoted in a message: on one line, truncated."""
    text = repr(value[:_MAX_REPR_CHARACTERS] if isinstance(value, (str, bytes, list, tuple)) else value)
    if not text.isprintable():
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    return text if len(text) <= _MAX_REPR_CHARACTERS else text[: _MAX_REPR_CHARACTERS - 3] + "..."
