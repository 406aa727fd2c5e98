"""``fastcoil export`` of results: the table of a study as CSV, Parquet or LaTeX."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fastcoil.base.arguments import checking
from fastcoil.base.errors import InputError
from fastcoil.base.files import exists, is_folder, may_be_file
from fastcoil.cli.labels import all_labels_of
from fastcoil.cli.terminal import say
from fastcoil.model.metric_table import STATUS_NOT_RUN

if TYPE_CHECKING:
    import xarray as xr

SUFFIXES = {"csv": ".csv", "latex": ".tex", "parquet": ".parquet"}
_SAID_WITHIN = 2**16
"""Bytes of the beginning of a text, and of the end of a Parquet file, that say what it is of."""


def export_table(
    path: Path,
    formats: Sequence[str],
    metrics: tuple[str, ...],
    at: Sequence[str],
    by: tuple[str, ...],
    out: Path | None,
) -> None:
    """Write the results at ``path``, the folder of a study or a NetCDF file, in the one format that is asked for.

    by: drawn parameters whose groups are the rows of a LaTeX table.
    """
    from fastcoil.deliver.tables.tidy import check_metrics
    from fastcoil.study.analysis.binned import binned
    from fastcoil.study.analysis.selected import in_words, selected
    from fastcoil.study.folder.one_file import open_results

    format, labels = _format(formats, by), all_labels_of(at)
    target = _target(path, format, out)
    ds = open_results(path)
    with checking() as check:
        check(check_metrics, ds, metrics)
        part = check(selected, ds, labels)
    if labels:
        part = part.assign_attrs(title=f"{ds.attrs.get('title', '')} at {in_words(part, labels)}".strip())
    left = int((part["status"].values == STATUS_NOT_RUN).sum())
    if left:
        say(f"Unfinished: {left:,} of {part['status'].size:,} scenarios have not run; their status says so.", err=True)
    say(f"Written: {target} ({_write(format, binned(part, by) if by else part, target, metrics)})")


def _target(path: Path, format: str, out: Path | None) -> Path:
    """The file to write: here, in the folder, or the one that is named."""
    suffix = SUFFIXES[format]
    if out is None or is_folder(out):
        name = path.resolve().name
        target = (out or Path()) / ((name.removesuffix(".nc") or "results") + suffix)
        if exists(target) and not _is_table_of_ours(target):
            raise InputError(f"{target} exists, and fastcoil did not write it: name another file with -o, or delete it")
        return target
    if out.suffix.lower() != suffix or not may_be_file(out):
        raise InputError(f"-o {out}: give a file NAME{suffix} in a folder that exists, or such a folder")
    return out


def _is_table_of_ours(path: Path) -> bool:
    """Whether a file says by which version of fastcoil it was written; what cannot be read does not."""
    try:
        with path.open("rb") as file:
            head = file.read(_SAID_WITHIN)
            file.seek(max(0, file.seek(0, 2) - _SAID_WITHIN))
            return b"fastcoil_version" in head + file.read()
    except OSError:
        return False


def _format(formats: Sequence[str], by: Sequence[str]) -> str:
    """The one format."""
    if len(formats) != 1:
        given = " and ".join(f"--{format}" for format in formats)
        raise InputError(
            f"{given + ' are given' if given else 'no format is given'}: give one of --csv, --latex, --parquet"
        )
    (format,) = formats
    if by and format != "latex":
        raise InputError(
            f"--by groups the rows of a LaTeX table; --{format} has {' and '.join(by)} as a column: leave it out"
        )
    return format


def _write(format: str, ds: xr.Dataset, target: Path, metrics: tuple[str, ...]) -> str:
    """Write the file; what is in it, in words."""
    from fastcoil.deliver.tables.csv import write_csv
    from fastcoil.deliver.tables.latex import write_latex
    from fastcoil.deliver.tables.parquet import write_parquet
    from fastcoil.deliver.tables.tidy import Tidy

    if format == "latex":
        write_latex(ds, target, metrics)
        return "medians and their scatter; a comment in it says over what"
    table = Tidy(ds, metrics)
    (write_csv if format == "csv" else write_parquet)(table, target)
    return f"{table.n_rows:,} scenario-day{'s' * (table.n_rows != 1)}, {len(table.columns)} columns"
