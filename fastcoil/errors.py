"""The errors that a user sees, and the exit codes of the command line."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

EXIT_BUG = 1
EXIT_INPUT = 2
EXIT_FAILED_SCENARIOS = 3
EXIT_STORAGE = 4
EXIT_LOCKED = 5
EXIT_INTEGRITY = 6
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143


class FastcoilError(Exception):
    """Base of every error fastcoil raises on purpose; its text is meant for the user."""

    exit_code = EXIT_BUG


class InputError(FastcoilError, ValueError):
    """Bad input.  ``problems`` holds one sentence for each mistake: field, value and cure."""

    exit_code = EXIT_INPUT

    def __init__(self, problems: str | Iterable[str]) -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        super().__init__("\n".join(self.problems))


class StorageError(FastcoilError):
    """A result could not be read or written."""

    exit_code = EXIT_STORAGE


class LockedError(FastcoilError):
    """Another run is writing to the same folder."""

    exit_code = EXIT_LOCKED


class IntegrityError(FastcoilError):
    """Files on the disk are not as they were written, or do not belong together."""

    exit_code = EXIT_INTEGRITY


def nearest(name: str, known: Iterable[str]) -> str:
    """A clause such as ``, did you mean 'backlash'?`` for an unknown name; empty if none is similar."""
    by_folded = {k.casefold(): k for k in known}
    match = difflib.get_close_matches(name.casefold(), list(by_folded), n=1, cutoff=0.6)
    return f", did you mean {by_folded[match[0]]!r}?" if match else ""


@contextmanager
def collecting(problems: list[str], prefix: str = "") -> Iterator[None]:
    """Add the sentences of an ``InputError`` to ``problems`` and continue."""
    try:
        yield
    except InputError as error:
        problems += [prefix + p for p in error.problems]


def shown(value: object) -> str:
    """A value as a message repeats it: cut short if it is long."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
