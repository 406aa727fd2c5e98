"""Shared by the studies: results, tables and figures, progress, comparison in pairs, and random valves."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import fastcoil as fc
from fastcoil.base.text import format_share
from fastcoil.study.analysis.paired import wilson_interval

STUDIES = Path(__file__).parent
RESULTS = STUDIES.parent / "results"
OUTPUT_FOLDER = STUDIES  # where tables and figures are written, each in the folder of its question
PAIRED_DIMS = ("sample", "day")  # every loop is compared with its own baseline, valve by valve and day by day
HEATING_GAIN = 0.3  # a kp is drawn for cooling; a loop with water of 40 °C responds about three times as much
BACKLASH_SIZES = (0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)  # sizes of backlash, fraction of stroke


def results(name: str) -> xr.Dataset:
    """Open the results of the study file called ``name``; run the study first if they are missing or incomplete."""
    return fc.run_study(study_file(name), RESULTS / name)


def study_file(name: str) -> Path:
    """Return the path of the study file called ``name``, in any folder."""
    (path,) = STUDIES.glob(f"*/{name}.toml")
    return path


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Format a table in Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *map(list, rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


class Replication(NamedTuple):
    """Comparison of a new run with the tables: number of cells compared, and a line for each change."""

    cell_counts: list[int]
    changes: list[str]
    is_sample: bool
    """Whether nothing is written."""


_replications = [Replication([], [], is_sample=False)]


@contextmanager
def compare_with_tables(*, is_sample: bool) -> Iterator[Replication]:
    """Compare what is written in this context with the existing tables; a sample does not overwrite them."""
    _replications.append(Replication([], [], is_sample))
    try:
        yield _replications[-1]
    finally:
        _replications.pop()


def write_table(name: str, title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Write the table ``FOLDER/NAME`` to ``FOLDER/tables/NAME.md``, from where ``make pages`` puts it into pages."""
    head, rows = list(head), [list(row) for row in rows]
    _compare_with_table(name, rows, title, head)
    if _replications[-1].is_sample:
        return
    text, path = f"**{title}**\n\n{markdown_table(head, rows)}", _table_path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(f"{path}  sha256 {hashlib.sha256(text.encode()).hexdigest()[:12]}")


def compare_rows(name: str, rows: Iterable[Iterable[str]]) -> None:
    """Compare some rows with those of the existing table ``FOLDER/NAME``."""
    _compare_with_table(name, [list(row) for row in rows])


def _table_path(name: str) -> Path:
    folder, table = name.split("/")
    return OUTPUT_FOLDER / folder / "tables" / f"{table}.md"


def _compare_with_table(
    name: str, rows: list[list[str]], title: str | None = None, head: list[str] | None = None
) -> None:
    """Record each cell that differs from the table, in the row whose first cells agree most."""
    path, (cell_counts, changes, is_sample) = _table_path(name), _replications[-1]
    if not path.is_file():
        changes.append(f"{name}: there was no such table")
        return
    title_line, _, *lines = path.read_text(encoding="utf-8").rstrip("\n").split("\n")
    old_head, _, *old_rows = ([cell.strip() for cell in line.strip("|").split(" | ")] for line in lines)
    is_part = title is None or (is_sample and len(rows) < len(old_rows))
    if (head or old_head) != old_head or not (is_part or len(rows) == len(old_rows)):
        changes.append(f"{name}: other columns, or {len(rows)} rows in place of {len(old_rows)}")
        return
    if not is_part and title != title_line.strip("*"):
        changes.append(f"{name}: title: {title_line.strip('*')} → {title}")
    for row in ([cell.strip() for cell in row] for row in rows):
        equal_cells = [len(list(takewhile(bool, map(str.__eq__, row, old_row)))) for old_row in old_rows]
        old_row = old_rows[int(np.argmax(equal_cells))]
        cell_counts.append(len(row))
        cells = zip(old_head, old_row, row, strict=True)
        changes += [f"{name}: {row[0]} | {column}: {a} → {b}" for column, a, b in cells if a != b]


def save_figure(figure: Figure, name: str, dpi: int = 150) -> None:
    """Write the figure ``FOLDER/NAME.png`` and close it."""
    if _replications[-1].is_sample:
        plt.close(figure)
        return
    path = OUTPUT_FOLDER / name
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    print(path)


def progress_printer() -> Callable[[str], None]:
    """Return a function that prints a finished stage and the seconds since this call."""
    start = time.monotonic()
    return lambda stage: print(f"{stage} after {time.monotonic() - start:.0f} s", flush=True)


def concat_along(dim: str, parts: Mapping[Any, Any], **options: Any) -> Any:
    """Concatenate parts along a new dim that is labelled with their keys."""
    return xr.concat(list(parts.values()), xr.DataArray(list(parts), dims=dim, name=dim), **options)


def pool_days(by_kind: Mapping[str, xr.Dataset], **options: Any) -> xr.Dataset:
    """Concatenate the days of all kinds along one dim."""
    parts = [ds.assign_coords(day=[f"{kind} {day}" for day in ds.day.values]) for kind, ds in by_kind.items()]
    return xr.concat(parts, "day", **options)


def failures_in_words(datasets: Iterable[xr.Dataset]) -> str:
    """Format how many of all simulated days failed."""
    status = [ds.status for ds in datasets]
    return f"{sum(int((s > 0).sum()) for s in status)} of {sum(s.size for s in status):,} days failed"


def mean_change(
    ds: xr.Dataset, name: str, baseline: str, dim: str = "controller", metric: str = "rmse"
) -> tuple[float, float, float]:
    """Mean change of a metric in pairs, per cent, and its 95 % interval over other valves and other days.

    Every valve meets every day: the variances of the means of valves and of the means of days add up, and the dim with
    fewer labels gives the degrees of freedom.
    """
    pair = ds[[metric, "status"]].sel({dim: [baseline, name]})
    over = [d for d in PAIRED_DIMS if d in ds.dims]
    comparison = fc.compare(pair, baseline={dim: baseline}, over=over, metrics=metric, relative=True)[metric]
    mean, low, high = (100 * float(comparison.sel({dim: name, "statistic": s})) for s in ("mean", "low", "high"))
    return mean, low, high


def change_in_words(ds: xr.Dataset, name: str, baseline: str, dim: str = "controller", metric: str = "rmse") -> str:
    """Format ``mean_change``."""
    return "0" if name == baseline else format_change(*mean_change(ds, name, baseline, dim, metric))


def format_change(value: float, low: float, high: float, digits: int = 0) -> str:
    """Format a change in per cent with its interval."""
    return f"{value:+.{digits}f} % ({low:+.{digits}f} to {high:+.{digits}f})"


def format_spread(ratio: xr.DataArray, quantiles: Sequence[float] = (0.05, 0.5, 0.95)) -> str:
    """Format quantiles of a ratio as changes in per cent."""
    return ", ".join(f"{100 * float(ratio.quantile(q)) - 100:+.0f} %" for q in quantiles)


def draw_loguniform(rng: np.random.Generator, low: float, high: float, size: int) -> np.ndarray:
    """Draw numbers whose logarithms are uniform."""
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def draw_backlash(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw the backlash of ``n`` valves: half have one of ``BACKLASH_SIZES``, half any from 0.5 to 15 %."""
    return np.where(np.arange(n) % 2, rng.choice(BACKLASH_SIZES, n), rng.uniform(0.005, 0.15, n))


def draw_loop_parameters(
    rng: np.random.Generator,
    n: int,
    *,
    heating: bool = False,
    authority: tuple[float, float] = (0.05, 0.9),
    kp: tuple[float, float] = (0.005, 0.06),
    ti: tuple[float, float] = (20.0, 300.0),
    sample_times: Sequence[float] = (5.0, 10.0, 15.0, 30.0),
) -> dict[str, np.ndarray]:
    """Draw parameters of ``n`` valves and loops as in buildings, without their backlash."""
    return {
        "rangeability": draw_loguniform(rng, 20, 100, n),
        "authority": draw_loguniform(rng, *authority, n),
        "C_w": rng.uniform(8.8, 14.0, n),
        "C_c": draw_loguniform(rng, 10, 30, n),
        "kp": draw_loguniform(rng, *kp, n) * (HEATING_GAIN if heating else 1.0),
        "ti": draw_loguniform(rng, *ti, n),
        "sample_time": rng.choice(sample_times, n),
        "noise_std": rng.uniform(0.0, 0.05, n),
        "sensor_time_constant": rng.uniform(5, 60, n),
        "stroke_time": rng.uniform(30, 150, n),
    }


Z_95 = 1.96
CROSSED_DIMS = ("sample", "day")  # every valve meets every day


class Share(NamedTuple):
    """A share and its interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return self.to_text(0)

    def to_text(self, decimals: int) -> str:
        """Format in per cent."""
        return format_share(*self, decimals=decimals)


def share_of(holds: xr.DataArray, among: xr.DataArray | None = None) -> Share:
    """Share of the valves, and days if any, in which ``holds`` is true, with its 95 % interval.

    The variance is that of the means of the valves and of the means of the days.

    among: the valves and days that count, all if None; of at least one.
    """
    values = holds.astype(float) if among is None else holds.astype(float).where(among.astype(bool))
    p, (variance, labels) = float(values.mean()), _crossed_variance(values)
    # the number of cases that would have the observed variance; where nothing varies, the number of labels
    n = min(int(values.count()), p * (1.0 - p) / variance) if variance > 0.0 else labels
    low, high = wilson_interval(np.array(p), n, Z_95)
    return Share(p, float(low), float(high))


def mean_of(values: xr.DataArray) -> tuple[float, float]:
    """The mean over valves and days, and half of its 95 % interval over others of both."""
    return float(values.mean()), Z_95 * float(np.sqrt(_crossed_variance(values)[0]))


def _crossed_variance(values: xr.DataArray) -> tuple[float, int]:
    """The variance of the mean, of the means of valves and of those of days, and the larger number of them."""
    dims = [dim for dim in CROSSED_DIMS if dim in values.dims]
    means = [values.mean([other_dim for other_dim in dims if other_dim != dim]).dropna(dim) for dim in dims]
    variance = sum((float(m.var(ddof=1)) / m.size for m in means if m.size > 1), 0.0)
    return variance, max(m.size for m in means)
