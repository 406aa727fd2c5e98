"""In what a study differs from the one in its folder, and a worker from those that computed the rest: in words."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.manifest import Environment

_LONGEST_DIFFERENCE = 10
"""Lines."""


def warn_of_difference(folder: Path, environment: Environment, others: Sequence[Environment]) -> None:
    """Warn if other scenarios were computed where bits may differ; one that nobody recorded may be this one."""
    for other in filter(None, others):
        differs = [
            f"{name} {other.get(name, 'unknown')}, now {environment.get(name, 'unknown')}"
            for name in sorted({*other, *environment})
            if other.get(name) != environment.get(name)
        ]
        warnings.warn(
            f"a part of {folder} was computed elsewhere ({'; '.join(differs)}): the last digits of results may depend "
            "on that, in a loop that hunts also the first; to have all from one place, run the study in another folder",
            stacklevel=3,
        )


def refuse_other_study(store: StudyFolder, study: Study) -> NoReturn:
    """Refuse to replace the study in a folder by another one, and say in what they differ.

    Raises
    ------
    InputError
        If their texts differ.
    IntegrityError
        If a file that they read does, or the text in the folder is lost.
    """
    text = store.read_text()
    if text is None:
        raise IntegrityError(
            f"{store.path}: study.toml is missing or damaged, and the run in this folder was of another study: restore "
            "the file, or choose another folder with -o"
        )
    changes = [
        line
        for line in difflib.unified_diff(text.splitlines(), study.text.splitlines(), lineterm="")
        if line[:1] in "+-" and line[:3] not in ("+++", "---")
    ]
    if not changes:
        raise IntegrityError(
            f"{store.path}: a file that the study reads changed since the run was started: restore it, or choose "
            "another folder with -o; if an extension of it was killed, add --extend to go on"
        )
    shown = changes[:_LONGEST_DIFFERENCE] + ["…"] * (len(changes) > _LONGEST_DIFFERENCE)
    raise InputError(
        [
            f"{store.path} holds another study, or another version of this one: add --extend if only values were "
            "added, otherwise choose another folder with -o.  The differences:",
            *shown,
        ]
    )
