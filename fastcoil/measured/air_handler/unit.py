"""Result of an inspection: the findings of an air handler, each valve's diagnosis, as text, a figure and TOML."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.base.figures import BLUE, LINE_GREY, RED, SHADE_GREY, YELLOW, apply_style, wrap_text
from fastcoil.base.results import Result, toml_document, toml_table
from fastcoil.logs.air_handler import AirHandlerPoints, valve_log
from fastcoil.logs.log import Log
from fastcoil.measured.air_handler.finding import Finding
from fastcoil.measured.air_handler.series import MET_ERROR_K, SHUT, AirHandlerSeries
from fastcoil.measured.diagnose import diagnose
from fastcoil.measured.diagnosis import Diagnosis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST_CALLED_H = 1.0
_PAGE_WIDTH_INCHES = 7.5
_COIL_COLOURS = {"cooling": BLUE, "heating": RED, "preheat": YELLOW}


@dataclass(frozen=True, repr=False)
class AirHandler(Result):
    """What the log of an air handler shows, of all its valves together.

    Attributes
    ----------
    source
        Name of the log.
    findings
        List of `Finding`, the worst first: ``component``, ``kind``, ``windows``, ``size``, ``unit``, ``hours``,
        ``text``, ``action``, ``cause``.
    valves
        Mapping of ``cooling``, ``heating`` and ``preheat`` to the `Diagnosis` of that valve, made when it is first
        asked for; a valve whose log cannot be diagnosed is missing.
    points
        Headers and units with which the log was read.
    notes
        What was proposed, assumed, and left out of the log.
    """

    source: str
    findings: list[Finding]
    points: AirHandlerPoints
    notes: list[str]
    series: AirHandlerSeries = field(repr=False)
    logs: list[Log] = field(repr=False)

    @cached_property
    def valves(self) -> Mapping[str, Diagnosis]:
        diagnoses = {}
        for coil in self.points.coils:
            with suppress(InputError):  # a valve that never moves, say: the findings are about it
                diagnoses[coil] = diagnose([valve_log(log, self.points, coil) for log in self.logs])
        return diagnoses

    @property
    def headline(self) -> str:
        """The worst finding, or how much of the time each loop was in control."""
        if self.findings and self.findings[0].kind != "unoccupied":
            return str(self.findings[0])
        return " ".join([self._describe_nothing(), *map(str, self.findings), *self.describe_control()])

    def _describe_nothing(self) -> str:
        """Describe that there is no finding: the plant ran without a fault, or too little to judge it."""
        series = self.series
        if not series.days.size:
            return "Nothing can be judged: the plant is on for less than an hour of a day."
        called = np.any([series.on & (series.command(coil) > SHUT) for coil in series.coils], axis=0)
        if series.hours(called) < _LEAST_CALLED_H and series.hours(series.all_rest) < _LEAST_CALLED_H:
            return "Nothing can be judged: no valve is called, or rests shut, for an hour."
        return "No fault of valves, loops or sensors found."

    def describe_control(self) -> list[str]:
        """Describe for each valve how long it was called, and how much of that time it was in control."""
        series, lines = self.series, []
        for coil in series.coils:
            called = series.on & (series.command(coil) > SHUT)
            hours = f"{coil} called in {series.hours(called):.0f} of {series.hours(series.on):.0f} h"
            error = np.abs(series.T_sup - series.T_set(coil))
            known = called & np.isfinite(error)
            calm = error <= MET_ERROR_K
            for finding in self.findings:
                if finding.kind == "hunt" and finding.component.startswith(coil):
                    calm &= ~series.mask_of(finding.windows)
            if known.any():
                hours += f", in control (within 1 K and calm) in {100 * float(np.mean(calm[known])):.0f} % of that time"
            lines.append(f"{hours[0].upper()}{hours[1:]}.")
        return lines

    def summary(self) -> list[str]:
        """Return the inspection as lines of text, the worst finding first."""
        series = self.series
        days = f"{series.days.size} day{'s' if series.days.size != 1 else ''}"
        head = f"{self.source}: {' and '.join(series.coils)} valve{'s' if len(series.coils) > 1 else ''}, {days}, "
        lines = [f"{head}{series.hours(series.on):.0f} h of operation, a sample every {series.interval:.4g} s"]
        if not self.findings or self.findings[0].kind == "unoccupied":
            lines.append(self._describe_nothing())
        lines += [f"{k}. {finding}" for k, finding in enumerate(self.findings, 1)]
        return lines + self.describe_control() + [f"Note: {note}" for note in self.notes]

    @apply_style()
    def plot(self) -> Figure:
        """Plot temperatures, commands and findings over clock time on one page."""
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
        from matplotlib.figure import Figure

        series, n = self.series, max(len(self.findings), 1)
        fig = Figure(figsize=(_PAGE_WIDTH_INCHES, 4.6 + 0.28 * n), layout="constrained")
        upper, middle, lower = fig.subplots(3, 1, sharex=True, height_ratios=(2.0, 1.1, 0.28 * n + 0.1))
        times = series.times()
        upper.fill_between(times, *(np.where(series.on, T, np.nan) for T in series.T_entering), color=SHADE_GREY, lw=0)
        upper.plot(times, series.T_entering[0], color=LINE_GREY, lw=0.8, label="entering air")
        for coil in series.coils:
            label = f"set-point, {coil}" if f"T_set_{coil}" in series.grid.values else "set-point"
            if np.isfinite(series.T_set(coil)).any() and label not in [li.get_label() for li in upper.lines]:
                upper.plot(times, series.T_set(coil), color=_COIL_COLOURS[coil], ls=":", lw=0.9, label=label)
            command = np.where(series.grid.on, series.command(coil), np.nan)
            middle.plot(times, 100.0 * command, color=_COIL_COLOURS[coil], lw=0.8, label=f"{coil} valve")
        upper.plot(times, series.T_sup, color="black", lw=0.8, label="supply air")
        upper.set(ylabel="temperature [°C]", ylim=_temperature_limits(series))
        middle.set(ylabel="command [%]", ylim=(-4, 104))
        for axes in (upper, middle):
            axes.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, borderaxespad=0.2)
        self._draw_findings(lower)
        if series.start is not None:
            locator = AutoDateLocator(maxticks=10)  # type: ignore[no-untyped-call]
            lower.xaxis.set_major_locator(locator)
            lower.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        else:
            lower.set_xlabel("time [h]")
        fig.suptitle(wrap_text(f"{self.source}. {self.headline}", _PAGE_WIDTH_INCHES, 9), x=0.01, ha="left", fontsize=9)
        return fig

    def _draw_findings(self, axes: Axes) -> None:
        """Draw a row of bars for each finding, the worst at the top."""
        axes.grid(visible=False, axis="y")
        if not self.findings:
            axes.set(yticks=[])
            axes.text(0.01, 0.5, self._describe_nothing(), transform=axes.transAxes, va="center", fontsize=8)
            return
        for row, finding in enumerate(self.findings):
            colour = next((c for coil, c in _COIL_COLOURS.items() if finding.component.startswith(coil)), "0.4")
            for first, last in finding.windows:
                left, right = (self.series.on_axis(moment) for moment in (first, last))
                axes.barh(row, right - left, left=left, height=0.6, color=colour)
        labels = [finding.label for finding in self.findings]
        axes.set_yticks(range(len(labels)), labels, fontsize=8)
        axes.set_ylim(len(labels) - 0.5, -0.5)

    def to_toml(self, path: str | Path | None = None) -> str:
        """Return columns, units and findings as TOML; write it to ``path`` if given.

        `inspect` takes the file as ``answers`` for the log of another unit.
        """
        lines = [f"# air handler inspected in {self.source} by fastcoil diagnose"]
        lines += [f"# {line}" for line in self.summary()[1:]]
        lines += toml_table("columns", self.points.headers)
        lines += toml_table("units", {**self.points.units, **self.logs[0].options.units})
        for finding in self.findings:
            values = {name: getattr(finding, name) for name in ("component", "kind", "size", "unit", "hours", "cause")}
            values["windows"] = [[str(first), str(last)] for first, last in finding.windows]
            table = toml_table("findings", values | {"text": finding.text, "action": finding.action})
            lines += ["", "[[findings]]", *table[2:]]
        return toml_document(lines, path)


def _temperature_limits(series: AirHandlerSeries) -> tuple[float, float]:
    """Return limits of the temperature axis that set-points of a plant at rest do not stretch."""
    T = np.concatenate([series.T_sup, series.T_entering[0]])[np.tile(series.on if series.on.any() else True, 2)]
    low, high = np.quantile(T[np.isfinite(T)], (0.001, 0.999)) if np.isfinite(T).any() else (0.0, 40.0)
    return float(low) - 2.0, float(high) + 2.0
