"""The report of a study, from its results alone: they carry the text of the study, its settings and its versions."""

from __future__ import annotations

import shlex
from pathlib import Path

import xarray as xr

from fastcoil.base.errors import FastcoilError
from fastcoil.deliver.figures.study import standard_figures
from fastcoil.deliver.report.citation import bibtex, citation
from fastcoil.deliver.report.comparison import comparisons, failures
from fastcoil.deliver.report.computed import how, question, study_tables, versions
from fastcoil.deliver.report.page import Block, Code, Page, Section, Words
from fastcoil.deliver.report.pictures import study_picture
from fastcoil.deliver.report.single import answer as answer_of_one
from fastcoil.deliver.report.single import metrics
from fastcoil.model.metric_table import STATUS_CRASHED, STATUS_OK
from fastcoil.study.analysis.cost_summary import Billing
from fastcoil.study.analysis.summary import cautions, findings
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.results import open_finished


def study_page(folder: Path) -> Page:
    """The report of the finished study in a folder; raises as ``open_finished``."""
    ds = open_finished(folder)
    billing, unread = _billing(folder, ds)
    failed = failures(ds)
    n_failed = int((ds["status"].values != STATUS_OK).sum())
    warnings = [unread] if unread else []
    if n_failed:
        crashed = int((ds["status"].values == STATUS_CRASHED).sum())
        also = f", {crashed:,} of them for their worker crashed" if crashed else ""
        warnings.insert(
            0, f"{n_failed:,} of {ds['status'].size:,} scenarios failed{also}. They are in no number of this page."
        )
    title = str(ds.attrs["title"])
    sections = [Section("Failed scenarios", [failed] if failed else [])]
    answer = ["Every scenario failed: there is no answer."]
    if n_failed < ds["status"].size:
        warnings += cautions(ds)
        single = ds["status"].size == 1
        compared = comparisons(ds)
        said = [*findings(ds, billing), *(one.sentence for one in compared if one.sentence)]
        answer = answer_of_one(ds) if single else said
        sections += [
            Section("Figures", _pictures(ds, title)),
            Section("In numbers", [metrics(ds)] if single else [one.table for one in compared]),
        ]
    sections += [how(ds), versions(ds), _study(ds), _again(folder, ds), cited(ds)]
    return Page("Study", title, question(ds), warnings, answer, sections, str(ds.attrs["content_sha256"]))


def _billing(folder: Path, ds: xr.Dataset) -> tuple[Billing | None, str]:
    """What its ``[tariff]`` asks; and why that is not known, for the files of the study may be gone."""
    if "tariff" not in study_tables(ds):
        return None, ""
    store = StudyFolder(folder)
    try:
        return store.read_study(store.require_manifest()).billing, ""
    except FastcoilError as error:
        return None, f"Costs are left out, for the study can no longer be read: {error}"


def _pictures(ds: xr.Dataset, title: str) -> list[Block]:
    drawn = {name: draw() for name, draw in standard_figures(ds).items()}
    return [
        study_picture(figure, title, f"Figure {k}", f"{name} of the study")
        for k, (name, figure) in enumerate(drawn.items(), 1)
    ]


def _study(ds: xr.Dataset) -> Section:
    text = str(ds.attrs.get("study_toml", ""))
    return Section("The study file", [Code(text)] if text.strip() else [])


def _again(folder: Path, ds: xr.Dataset) -> Section:
    name = shlex.quote(folder.absolute().name or "study")
    lines = [
        f"python -m pip install fastcoil=={ds.attrs.get('fastcoil_version', '')}",
        f"fastcoil run study.toml -o results/{name}",
        f"fastcoil verify results/{name}",
        f"fastcoil report results/{name}",
    ]
    words = (
        "Save the study file above as study.toml, with the files that it names beside it.  On one kind of processor "
        "and with the same versions, content_sha256 is the same to the last digit."
    )
    return Section("Do it again", [Words([words]), Code("\n".join(lines))])


def cited(ds: xr.Dataset | None = None) -> Section:
    """How to cite the results, or fastcoil alone."""
    attrs = None if ds is None else {str(name): value for name, value in ds.attrs.items()}
    return Section("How to cite", [Words(citation(attrs)), Code("\n".join(bibtex(attrs)))])
