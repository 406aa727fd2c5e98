"""A boundary as a terminal and a notebook show it: how long, which days, and each series with its range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.results import Curves, Section, card
from fastcoil.loops.boundary.clock import Clock
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.boundary.source import Source, Stream
from fastcoil.loops.labels import unit_in_words

_POINTS = 110
"""Of a curve, one a pixel."""
_DAYS = 5
"""So many days are drawn one over the other, spread over all of them."""
_LABELS = 8
_Ranges = Mapping[str, tuple[float, float]]


def extent(source: Source, clock: Clock) -> str:
    """Length, days and start: ``24 h x 3 days from 2023-07-01 00:00:00 (UTC-08:00)``."""
    text = f"{source.n_steps / 3600:g} h" + (f" x {source.day.size} days" if source.has_day_dim else "")
    if clock.start is not None:
        text += f" from {str(clock.start[0]).replace('T', ' ')}" + (f" ({clock.time_zone})" if clock.time_zone else "")
    return text


def text_of(source: Source, clock: Clock) -> str:
    """For a terminal; of a stream whose days nobody has looked at only how many they are."""
    if not _is_known(source):
        # what it takes to make and hash a year of days is too much for a look at it
        return f"<fastcoil.Boundary {extent(source, clock)}, made day by day>"
    made = ", made day by day" if source.is_streamed else ""
    ranges = source.extremes
    lines = [
        f"  {name:<14} {_range(name, ranges[name]):<24} {BOUNDARY_SERIES[name].long_name}" for name in _own(ranges)
    ]
    return "\n".join([f"<fastcoil.Boundary {extent(source, clock)}{made}, sha256 {source.sha256[:8]}>", *lines])


def html_of(source: Source, clock: Clock) -> str:
    """For a notebook: a row for each series, with a small curve; of a stream nobody has looked at, of its first day."""
    known, n = _is_known(source), source.day.size
    shown = [0] if source.is_streamed else [int(k) for k in np.unique(np.linspace(0, n - 1, min(n, _DAYS)).round())]
    days = [source.of_day(k) for k in shown]
    ranges = source.extremes if known else {k: (float(v.min()), float(v.max())) for k, v in days[0].items()}
    words = "of the first day" if source.is_streamed and n > 1 else _of_days(len(shown), n)
    rows = []
    for name in _own(ranges):
        curves = Curves.of([_thinned(day[name]).tolist() for day in days], f"{name} over time {words}".rstrip())
        rows.append((name, curves, _range(name, ranges[name]), BOUNDARY_SERIES[name].long_name))
    usual = [f"{name} = {BOUNDARY_SERIES[name].default:g}" for name in BOUNDARY_SERIES if name not in _own(ranges)]
    lines = [f"made day by day; ranges {'of all days' if known else words}"] if source.is_streamed and n > 1 else []
    sections = [Section("series", rows, f"curves {words}" if words else "", is_open=True)]
    if usual:
        sections.append(Section("not given", text="\n".join(usual)))
    facts = [("samples", f"{n} x {source.n_steps:,}, one a second" if n > 1 else f"{source.n_steps:,}, one a second")]
    if source.has_day_dim:
        listed = ", ".join(map(str, source.day[:_LABELS].tolist()))
        facts.append(("day", listed + (f", … {source.day[-1]}" if n > _LABELS else "")))
    if clock.start is not None:
        facts.append(("start", str(clock.start[0]).replace("T", " ")))
        facts.append(("time zone", clock.time_zone or "unknown"))
    facts += [("sha256", source.sha256)] if known else []
    sections.append(Section("about", facts))
    return card("fastcoil.Boundary", extent(source, clock), lines, sections)


def _of_days(shown: int, of: int) -> str:
    return "" if of == 1 else f"of all {of} days" if shown == of else f"of {shown} of {of} days"


def _is_known(source: Source) -> bool:
    return not isinstance(source, Stream) or source.is_surveyed


def _own(ranges: _Ranges) -> list[str]:
    """The series that are not at their default throughout."""
    return [name for name, (low, high) in ranges.items() if not low == high == BOUNDARY_SERIES[name].default]


def _range(name: str, ends: tuple[float, float]) -> str:
    low, high = ends
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{span} {unit_in_words(BOUNDARY_SERIES[name].unit)}".rstrip()


def _thinned(values: Array) -> Array:
    """Values in as many equal pieces as a curve has points, their means; a step stays one."""
    if values.size <= _POINTS:
        return values
    edges = np.linspace(0, values.size, _POINTS, endpoint=False).astype(int)
    return np.asarray(np.add.reduceat(values, edges) / np.diff(np.append(edges, values.size)))
