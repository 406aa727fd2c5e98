"""The result of a tuning: settings, measures, notes, table, figure and TOML."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, DOTTED, GREY, RED, YELLOW, apply_style, mark_logarithms, wrapped
from fastcoil.base.results import Result, as_toml, in_toml
from fastcoil.design.measures import CHANGE, Limit, Measure
from fastcoil.design.tuning_plan import ONE_OF, Asked, has_good_valve
from fastcoil.loops.labels import quantity
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FEW_VALVES, _FEW_DAYS = 20, 3
_IN_THE_TAIL = 3  # valves held out that should lie above a quantile, or it is little more than the worst of them


def notes_on(
    asked: Asked, parameters: Mapping[str, float], meets_limits: bool, held_out: xr.Dataset
) -> tuple[str, ...]:
    """Failures first, then what the search ran into, then what the population lacks."""
    return (*_failures(asked, parameters, meets_limits, held_out), *_lacks(asked))


def _failures(asked: Asked, parameters: Mapping[str, float], meets_limits: bool, held_out: xr.Dataset) -> Iterator[str]:
    if not meets_limits:
        yield "No tuning in these ranges keeps every limit: widen the ranges, raise a limit, or mend the valves."
    for limit in asked.limits:
        there = held_out[limit.measure.name].sel(edge="value")
        value, now = float(there.sel(tuning=CHOSEN)), float(there.sel(tuning=NOW))
        most = now if limit.as_now else limit.most
        if not value <= most:
            words = ", what it is there now" if limit.as_now else ""
            yield (
                f"The hold-out breaks a limit: {limit.measure.words}, is {limit.measure.shown(value)} there, above "
                f"{limit.measure.shown(most)}{words}."
            )
    low, high = (float(held_out[CHANGE].sel(tuning=CHOSEN, edge=edge)) for edge in ("low", "high"))
    if low > 0.0:
        yield "On the hold-out the objective is worse than now."
    elif high >= 0.0:
        yield "On the hold-out the objective does not differ from now beyond chance."
    for axis in asked.space.axes:
        name = axis.parameter.name
        end = axis.end(parameters[name])
        if end:
            yield f"{name} = {parameters[name]:g} lies at the {end} end of its range: the best may lie beyond."


def _needed(measure: Measure) -> int:
    """Valves held out that a measure needs."""
    if measure.quantile is None or measure.quantile == 1.0:
        return _FEW_VALVES
    return max(_FEW_VALVES, math.ceil(_IN_THE_TAIL / (1.0 - measure.quantile) - 1e-9))


def _lacks(asked: Asked) -> Iterator[str]:
    training, tried = asked.training, asked.holdout
    valves, shared = len(set(training.members) | set(tried.members)), training.members == tried.members
    if not (has_good_valve(training.loop) or has_good_valve(tried.loop)):
        yield (
            "No valve of the population is without backlash: add some with backlash = 0, or what was chosen may make a "
            "good valve worse."
        )
    if shared:
        yield (
            f"The population has {valves} valve{'s' * (valves > 1)}, so none is held out, only days: nothing says how "
            "the tuning does on another valve."
        )
    elif len(tried.members) < (needed := max(map(_needed, asked.measures))):
        yield (
            f"{len(tried.members)} valves held out are few for these quantiles: draw {ONE_OF * needed} or more in all."
        )
    if tried.boundary.n_days < _FEW_DAYS:
        days = tried.boundary.n_days
        yield (
            f"The hold-out has {days} day{'s' * (days > 1)}, so that the intervals hold "
            + ("no" if days == 1 else "little of the")
            + " scatter between days: give more with holdout."
        )


NOW, CHOSEN, SIMC = "now", "chosen", "simc"


def value_of(name: str, value: float) -> str:
    """A value as a study file takes it."""
    return repr(int(value)) if name in PARAMETERS and PARAMETERS[name].whole else repr(float(value))


def table_rows(ds: xr.Dataset, limits: tuple[Limit, ...]) -> list[list[str]]:
    """Every measure of every tuning and its limit as cells, the heads first."""
    limit = {}
    for each in limits:
        now = float(ds[each.measure.name].sel(tuning=NOW, edge="value"))
        limit[each.measure.name] = each.measure.shown(now if each.as_now else each.most)
    tunings = [str(t) for t in ds["tuning"].values]
    rows = [["", *(_LOOKS[t][2] for t in tunings), *(["limit"] if limit else [])]]
    for name, variable in ds.data_vars.items():
        if name == CHANGE:
            continue
        cells = [_cell(str(name).rpartition("_")[0], variable.sel(tuning=t).values) for t in tunings]
        rows.append([variable.attrs["long_name"], *cells, *([limit.get(str(name), "")] if limit else [])])
    return rows


def _cell(metric: str, edges: object) -> str:
    factor = quantity(metric).factor
    value, low, high = (f"{factor * float(x):.3g}" for x in edges)  # type: ignore[attr-defined]
    return value if low == "nan" else f"{value} ({low} to {high})"


_SIZE = (6.5, 4.6)
_TITLE = 5.6  # inches: the axes are narrower than the figure
_LOOKS = {NOW: ("s", "black", "now"), CHOSEN: ("o", RED, "chosen"), SIMC: ("^", YELLOW, "SIMC")}


@apply_style()
def draw_front(tuning: Tuning) -> Figure:
    """Draw the front where it was found, and the same tunings on the hold-out."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=_SIZE, layout="constrained")
    axes = fig.add_subplot()
    error, travel = tuning.axes
    there, here = (_places(tuning.front, prefix, travel, error) for prefix in ("", "held_out_"))
    for k in range(there[0].size):
        axes.plot([there[0][k], here[0][k]], [there[1][k], here[1][k]], color=GREY, lw=0.6, zorder=1)
    axes.plot(*there, "o-", color=BLUE, ms=3, label="front where it was searched")
    axes.plot(*here, "o", color=BLUE, ms=4, mfc="white", label="the same tunings, held out")
    for name in tuning.held_out["tuning"].values:
        _point(axes, tuning.held_out.sel(tuning=name), _LOOKS[str(name)], travel, error)
    for limit in tuning.limits:
        if limit.measure in (error, travel):
            at = limit.most * quantity(limit.measure.metric).factor
            line = axes.axvline if limit.measure == travel else axes.axhline
            line(at, color="black", lw=1.0, ls=DOTTED, label="limit")
    axes.set(xlabel=travel.words, ylabel=error.words)
    for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
        scale("log")
        mark_logarithms(axis)
    groups = f"Searched on {tuning.trained.attrs['group']}, held out {tuning.held_out.attrs['group']}."
    words = f"{groups}  Bars: 95 % for other valves and days."
    axes.set_title(wrapped(words, _TITLE, 9), loc="left")
    axes.legend(frameon=False)
    return fig


def _places(front: xr.Dataset, prefix: str, *measures: Measure) -> list[Array]:
    found = [front[prefix + measure.name].values * quantity(measure.metric).factor for measure in measures]
    return [np.where(np.isfinite(values), values, np.nan) for values in found]


def _point(axes: Axes, one: xr.Dataset, look: tuple[str, str, str], *measures: Measure) -> None:
    """A tuning on the hold-out with its intervals."""
    marker, colour, words = look
    x, y = (one[measure.name].values * quantity(measure.metric).factor for measure in measures)
    if not (np.isfinite(x[0]) and np.isfinite(y[0])):
        return
    known = np.isfinite(x).all() and np.isfinite(y).all()
    bars: dict[str, Any] = {"xerr": _bars(x), "yerr": _bars(y)} if known else {}
    axes.errorbar(
        x[0], y[0], **bars, fmt=marker, color=colour, ms=6, lw=1.0, capsize=2, zorder=3, label=f"{words}, held out"
    )  # fmt: skip


def _bars(edges: Array) -> Array:
    return np.maximum([[edges[0] - edges[1]], [edges[2] - edges[0]]], 0.0)


@dataclass(frozen=True, repr=False)
class Tuning(Result):
    """What a search found for the valves and days of a population.

    Attributes
    ----------
    parameters
        The values that were chosen, by name.
    meets_limits
        Whether a tuning was found that keeps every limit on the valves and days of the search.  If not, ``parameters``
        break them least, and are no recommendation.
    held_out, trained
        Datasets over ``tuning`` (``now``, the loop as it came, ``chosen``, and ``simc`` where kp and ti were searched)
        and ``edge`` (value, low, high: 95 % by bootstrap over valves and days): the objective, every limited
        metric, motor travel and share that hunts; ``change`` of the objective against now.  ``held_out``: on valves
        and days that the search never saw, which is the result; ``trained``: on its own.
    front
        Dataset over ``point``: the tunings of which no other has both a lower objective and less motor travel on the
        valves and days of the search, with the same measures on those held out (``held_out_…``).
    evaluations
        Dataset over ``evaluation``: every tuning that was tried.
    objective, limits
        What was sought, what was limited.
    axes
        Error and travel that the front is made of.
    notes
        What to mind: a limit broken on the hold-out, an end of a range reached, what the population lacks.
    """

    parameters: Mapping[str, float]
    meets_limits: bool
    held_out: xr.Dataset
    trained: xr.Dataset
    front: xr.Dataset
    evaluations: xr.Dataset
    objective: Measure
    limits: tuple[Limit, ...]
    notes: tuple[str, ...]
    axes: tuple[Measure, Measure]

    def summary(self) -> list[str]:
        """The tuning in words, and a table of now and chosen, line by line."""
        chosen = ", ".join(
            f"{name} = {value_of(name, value)} {quantity(name).unit.removesuffix('%')}".rstrip()
            for name, value in self.parameters.items()
        )
        head = "Chosen" if self.meets_limits else "No tuning keeps the limits; nearest to them"
        lines = [f"{head}: {chosen} ({self.evaluations.sizes['evaluation']:,} tunings tried)", ""]
        for title, ds in (("Held out", self.held_out), ("Searched on", self.trained)):
            rows = table_rows(ds, self.limits)
            widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
            lines.append(f"{title}: {ds.attrs['group']}")
            for row in rows:
                cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
                lines.append("  " + "  ".join(cells).rstrip())
            lines.append("")
        value, low, high = self.held_out[CHANGE].sel(tuning=CHOSEN).values
        goal = next(iter(self.held_out.data_vars.values())).attrs["long_name"]
        interval = "" if math.isnan(low) else f" ({low:+.0%} to {high:+.0%} for other valves and days)"
        return [*lines, f"Held out, {goal}: {value:+.0%} against now{interval}", *self.notes]

    def plot(self) -> Figure:
        """The front and what the hold-out makes of it, as a matplotlib ``Figure``."""
        return draw_front(self)

    def to_toml(self, path: str | Path | None = None) -> str:
        """The chosen values as TOML, written to ``path`` if given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` has nothing where no tuning keeps the limits; ``[fit]`` is for readers.
        """
        lines = ["# settings chosen by fastcoil tune", *(f"# {line}".rstrip() for line in self.summary())]
        chosen = self.parameters if self.meets_limits else {}
        lines += ["", "[loop]", *(f"{name} = {value_of(name, value)}" for name, value in chosen.items())]
        lines += ["", "[fit]", 'kind = "tuning"', f"objective = {in_toml(self.objective.name)}"]
        lines += [f"meets_limits = {in_toml(self.meets_limits)}"]
        lines += [f"notes = {in_toml(self.notes)}"]
        for name, ds in (("held_out", self.held_out), ("trained", self.trained)):
            chosen_there = ds.sel(tuning="chosen")
            lines += ["", f"[fit.{name}]"]
            lines += [f"{variable} = {in_toml(chosen_there[variable].values.tolist())}" for variable in ds.data_vars]
        return as_toml(lines, path)
