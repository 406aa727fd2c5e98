"""``report``: one HTML file that a client can open, of a study, a diagnosis, a fit or a tuning."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fastcoil.base.arguments import path_of
from fastcoil.base.errors import InputError, WrongType
from fastcoil.deliver.report.page import Page, require_page
from fastcoil.study.folder.folder import StudyFolder

REPORT = "report.html"
"""Name of the page in a folder."""
_CURE = (
    "give the folder of a study, or what fc.diagnose, fc.fit_valve, fc.fit_coil, fc.fit_loop, fc.tune or fc.explain "
    "returned"
)
_FILE = "give a file NAME.html, such as 'report.html'"


def report(what: Any, path: str | os.PathLike[str] | None = None) -> Path:
    """Write a report: one HTML file that needs no other file, no script and no network.

    Parameters
    ----------
    what
        The folder of a finished study, as `run_study` writes it; or the result of `diagnose`, `fit_valve`, `fit_coil`,
        `fit_loop`, `tune` or `explain`.
    path
        The file to write, NAME.html.  For a folder ``report.html`` in it by default.

    Returns
    -------
    pathlib.Path
        The file.  The same results give the same bytes.

    Raises
    ------
    InputError
        If ``what`` is nothing of the kind, the study is unfinished, or ``path`` cannot be written.
    StorageError, IntegrityError
        If a file cannot be read or written; if results are damaged.  Nothing half-written is left behind.
    """
    make: Callable[[Any], Page] | None
    if isinstance(what, (str, os.PathLike)):
        from fastcoil.deliver.report.study import study_page

        what, make = path_of("what", what, _CURE), study_page
        StudyFolder(what).require_manifest()
        path = what / REPORT if path is None else path
    else:
        from fastcoil.deliver.report.results import PAGES

        make = next((page for kind, page in PAGES.items() if isinstance(what, kind)), None)
    if make is None:
        raise InputError(WrongType(f"what is a {type(what).__name__}: {_CURE}"))
    if path is None:
        raise InputError(f"path is missing: {_FILE}")
    where = path_of("path", path, _FILE)
    require_page(where)
    return make(what).write(where)
