"""``report``: one HTML file that a client can open, of a study, the paper's figures, a diagnosis, a fit or a tuning."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from fastcoil.base.arguments import checking, path_of
from fastcoil.base.errors import InputError, WrongType
from fastcoil.base.files import exists, is_folder
from fastcoil.deliver.report.page import Page, require_page
from fastcoil.design.kept_tunings import KEPT
from fastcoil.study.folder.folder import require_no_archive
from fastcoil.study.folder.manifest import MANIFEST
from fastcoil.study.folder.result_files import RESULTS

REPORT = "report.html"
"""Name of the page in a folder."""
SCORECARD = "scorecard.json"
"""What `fastcoil paper` leaves in its folder."""
_PAGES = {"Fit": "fit_page", "Diagnosis": "diagnosis_page", "Tuning": "tuning_page", "Explanation": "explanation_page"}
"""Class of a result, and the function of ``results`` that makes its page."""
_CURE = (
    "give the folder of a study or of the paper's figures, or what fc.diagnose, fc.fit_valve, fc.fit_coil, "
    "fc.fit_loop, fc.tune or fc.explain returned"
)


def report(what: Any, path: str | os.PathLike[str] | None = None) -> Path:
    """Write a report: one HTML file that needs no other file, no script and no network.

    Parameters
    ----------
    what
        The folder of a finished study, as `run_study` writes it, or of ``fastcoil paper``; or the result of
        `diagnose`, `fit_valve`, `fit_coil`, `fit_loop`, `tune` or `explain`.
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
    of_folder = isinstance(what, (str, os.PathLike))
    with checking() as check:
        folder = check(path_of, "what", what, _CURE) if of_folder else None
        where = check.unless_none(path_of, "path", path, "give a file NAME.html")
        if not of_folder:
            check(_class_of, what)
            if path is None:
                check.problems.append("path is missing: give a file NAME.html, such as 'report.html'")
    if folder is not None:
        where = where or folder / REPORT
        require_folder(folder)
        require_page(where)
        return page_of_folder(folder).write(where)
    assert where is not None
    require_page(where)
    return page_of_result(what).write(where)


def require_folder(folder: Path) -> None:
    """Refuse anything but a folder of which there are reports; its files are not looked into."""
    require_no_archive(folder)
    if not is_folder(folder):
        raise InputError(f"{folder} is no folder: {_CURE}")
    if any(exists(folder / name) for name in (MANIFEST, RESULTS, SCORECARD)):
        return
    if exists(folder / KEPT):
        raise InputError(
            f"{folder} holds a tuning: `fastcoil tune STUDY.toml -o {folder} --report tuning.html` reports it without "
            "trying anything again"
        )
    raise InputError(f"{folder} holds no study and no figures of the paper: {_CURE}")


def page_of_folder(folder: Path) -> Page:
    """The page of what a folder holds."""
    if exists(folder / SCORECARD) and not exists(folder / MANIFEST):
        from fastcoil.deliver.report.paper import paper_page

        return paper_page(folder / SCORECARD)
    from fastcoil.deliver.report.study import study_page

    return study_page(folder)


def page_of_result(what: Any) -> Page:
    """The page of what a function returned."""
    from fastcoil.deliver.report import results

    made: Page = getattr(results, _PAGES[_class_of(what)])(what)
    return made


def _class_of(what: Any) -> str:
    """The class among those with a page that a result belongs to; found without importing them."""
    for each in type(what).__mro__:
        if each.__name__ in _PAGES and each.__module__.startswith("fastcoil."):
            return each.__name__
    raise InputError(WrongType(f"what is a {type(what).__name__}: {_CURE}"))
