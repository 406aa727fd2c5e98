"""The report of a study, from its results: every estimate against the plain PI, every gap against the sound valve.

A change is that within a pair of scenarios that differ in nothing else.  Its interval is by bootstrap over drawn
valves or days, where the study has several; swept values were chosen, so they get a range instead of an interval.
"""

import math
import shlex
import tomllib
from collections import Counter
from pathlib import Path

import xarray as xr

from fastcoil.base.text import percent
from fastcoil.deliver.figures.swept import standard_figures
from fastcoil.deliver.report import page
from fastcoil.loops.labels import is_parameter, plain_pi, quantity, quantity_of, quantity_of_values
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS, STATUS_OK
from fastcoil.study.analysis.compare import change_of, middle_of, without_off_days
from fastcoil.study.analysis.selected import all_where, own_metrics
from fastcoil.study.analysis.summary import cautions, comparable, estimate_dim, findings, recommended
from fastcoil.study.file.spec import billing_of
from fastcoil.study.folder.results import open_finished

_UNITS = {"sample": "drawn valves", "day": "days", "replicate": "noise realisations"}
"""Dims that are chance, the first of them is what an interval is over."""
_HEADS = {
    "rmse_settled": "settled RMS error [K]",
    "hunts": "share that hunts",
    "motor_travel": "motor travel [strokes]",
    "switch_frequency": "mode switches per 10 min",
}
_SHOWN = ("rmse", *_HEADS)
_MOST_NAMES = 40


def comparisons(ds: xr.Dataset) -> list[page.Table]:
    """A table for every dimension with labels."""
    ratio, pi = estimate_dim(ds), plain_pi(ds)
    ds = without_off_days(ds[[name for name in (*_SHOWN, *own_metrics(ds), "status") if name in ds]])
    ds = all_where(ds.drop_vars("status"), ds["status"] == STATUS_OK)
    dims = [str(d) for d in ds["rmse"].dims if ds.sizes[d] > 1 and d not in _UNITS and d in ds.coords]
    plain, only = (ds, "") if ratio is None else (ds.sel({ratio: 0.0}, drop=True), f" with the {pi}")
    found = []
    for dim in dims:
        labels = ds[dim].values
        zero = int((labels == 0.0).argmax())
        if dim == ratio:
            seen = comparable(ds)
            chosen = int((labels == recommended(seen, dim)).argmax())
            found.append(_table(seen, dim, "", zero, f"the {pi} of the same loop", chosen))
        elif dim == "backlash" and labels[zero] == 0.0:
            found.append(_table(plain, dim, only, zero, "the sound valve"))
        elif labels.dtype.kind in "OUST" and labels.size <= _MOST_NAMES:
            found.append(_table(plain, dim, only, 0, f"{labels[0]}, the first"))
        elif is_parameter(ds, dim):
            found.append(_table(plain, dim, only))
    return found


def _table(
    ds: xr.Dataset, dim: str, only: str, at: int | None = None, words: str = "", chosen: int | None = None
) -> page.Table:
    """A row for every label, or some of many values, with medians over all else.

    at: label of the baseline, ``words``; every scenario is compared with its partner there.  chosen: a label to keep.
    only: of which loops.
    """
    unit = next((unit for unit in _UNITS if ds.sizes.get(unit, 1) > 1), "") if at is not None else ""
    base, n, has_names = ds.isel({dim: at or 0}, drop=True), ds.sizes[dim], ds[dim].dtype.kind in "OUST"
    best = ds["rmse"].median([d for d in ds["rmse"].dims if d != dim]).fillna(math.inf)
    keep = [k for k in (at, chosen, int(best.values.argmin())) if k is not None]
    shown = page.picked(n, tuple(keep), _MOST_NAMES if has_names else page.MOST_ROWS)
    rows = []
    for k in shown:
        one, label = ds.isel({dim: k}, drop=True), ds[dim].values[k]
        cells = [str(label) if isinstance(label, str) else quantity_of(ds, dim).number(float(label))]
        cells.append(page.number(float(one["rmse"].median())))
        if at is None:
            cells.append(" to ".join(page.number(float(one["rmse"].quantile(q))) for q in (0.05, 0.95)))
        elif k == at:
            cells += ["baseline", *[""] * (2 + bool(unit))]
        else:
            middle = middle_of(change_of(one["rmse"], base["rmse"]).rename("rmse"), unit)
            pair = one["rmse"].notnull() & base["rmse"].notnull()
            lower = (one["rmse"] < base["rmse"]) + 0.5 * (one["rmse"] == base["rmse"])
            cells += [page.change(middle.median), *([page.span(middle.low, middle.high)] if unit else [])]
            cells += [page.span(middle.q05, middle.q95), percent(float(lower.where(pair).mean()))]
        for name in (name for name in one.data_vars if name != "rmse"):
            values = one[name]
            typical = quantity_of_values(values).factor * float(values.median())
            cells.append(percent(float(values.mean())) if name == "hunts" else page.number(typical))
        rows.append(cells)
    of = quantity_of(ds, dim).text
    others = [_HEADS.get(str(name)) or quantity_of_values(ds[name]).axis for name in ds.data_vars if name != "rmse"]
    rest = page.left_out(n, len(rows), "names" if has_names else "values")
    spread = ["change", *(["95 % interval"] if unit else []), "5 to 95 % of pairs", "lower in"]
    head = [of, "RMS error [K]", *(["5 to 95 % of scenarios"] if at is None else spread), *others]
    if at is None:
        return page.Table(f"Along {of}", head, rows, f"Medians{only} over everything else.  {rest}".strip())
    note = (
        f"RMS error: median{only}.  Change: median within pairs that differ in nothing else.  "
        f"{f'95 % interval: of the median change, over {ds.sizes[unit]} {_UNITS[unit]}.  ' if unit else ''}"
        f"5 to 95 % of pairs: how much the change differs from loop to loop.  Lower in: share of pairs with less "
        f"error, ties half.  {rest}"
    ).strip()
    return page.Table(f"{of.capitalize()}: against {words}", head, rows, note)


def metrics(ds: xr.Dataset) -> page.Table:
    """Every metric of a single scenario that is known, with its unit."""
    rows = []
    for name, output in METRICS.items():
        if name in ds and name != "hunts" and not output.flags and bool(ds[name].notnull().any()):
            value, of = float(ds[name].max()), quantity(name)
            is_count = name in ("reversals", "half_periods")
            text = f"{value:.0f}" if is_count else f"{page.number(value * of.factor)} {of.unit}"
            rows.append([output.long_name, text.rstrip(), name])
    for name in own_metrics(ds):
        of = quantity_of_values(ds[name])
        rows.append([of.text, f"{page.number(float(ds[name].max()))} {of.unit}".rstrip(), name])
    return page.Table("Every metric", ["metric", "value", "name in results.nc"], rows)


def study_page(folder: Path) -> page.Page:
    """The report of the finished study in a folder; raises as ``open_finished``."""
    ds = open_finished(folder)
    tariff, warnings = tomllib.loads(ds.attrs["study_toml"]).get("tariff"), []
    counts = Counter(ds["status"].values[ds["status"].values != STATUS_OK].tolist())
    n_failed = counts.total()
    if n_failed:
        why = ", ".join(f"{n:,} {STATUS_MEANINGS[code]}" for code, n in sorted(counts.items()))
        failed = f"{n_failed:,} of {ds['status'].size:,} scenarios failed ({why})"
        warnings.append(f"{failed}. They are in no number of this page; status in results.nc says which they are.")
    title = str(ds.attrs["title"])
    sections: list[page.Section] = []
    answer = ["Every scenario failed: there is no answer."]
    if n_failed < ds["status"].size:
        warnings += cautions(ds)
        answer = findings(ds, None if tariff is None else billing_of(tariff, None))
        numbers = [metrics(ds)] if ds["status"].size == 1 else comparisons(ds)
        sections += [page.Section("Figures", _pictures(ds, title)), page.Section("In numbers", numbers)]
    file = page.Section("The study file", [page.Code(ds.attrs["study_toml"])])
    sections += [page.how(ds), page.versions(ds.attrs), file, _again(folder, ds), page.cited(ds)]
    question, origin = str(ds.attrs.get("summary", "")).strip(), str(ds.attrs["content_sha256"])
    return page.Page("Study", title, question, warnings, answer, sections, origin)


def _pictures(ds: xr.Dataset, title: str) -> list[page.Block]:
    """The standard figures; their heads, the title and what the marks mean, become captions."""
    found: list[page.Block] = []
    for k, (name, draw) in enumerate(standard_figures(ds).items(), 1):
        figure = draw()
        words = " ".join(figure.get_suptitle().split()).removeprefix(" ".join(title.split())).strip()
        found.append(page.picture(figure, f"Figure {k}.  {words}.", f"{name} of the study"))
    return found


def _again(folder: Path, ds: xr.Dataset) -> page.Section:
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
    return page.Section("Do it again", [page.Words([words]), page.Code("\n".join(lines))])
