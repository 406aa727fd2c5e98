"""The result of a tuning: settings, measures, notes, table, figure and TOML."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, DOTTED_LINE, LINE_GREY, RED, YELLOW, apply_style, wrap_text
from fastcoil.base.results import Result, toml_document, toml_table
from fastcoil.base.text import align_columns, format_count, format_share
from fastcoil.design.advice import Option, advise
from fastcoil.design.measures import CHANGE, HUNTS, SHARE_THAT_HUNTS, Limit, Measure
from fastcoil.design.tuning_plan import HELD_OUT_ONE_IN, TuningRequest
from fastcoil.loops.labels import quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure


NOW = "now"
CHOSEN = "chosen"
SIMC = "simc"


def _broken_limits(limits: Sequence[Limit], held_out: xr.Dataset) -> Iterator[tuple[Limit, float, float]]:
    """Yield the limits that the choice breaks on the hold-out, with its value and the most that is allowed."""
    for limit in limits:
        value, current = (float(held_out[limit.measure.name].sel(tuning=t, edge="value")) for t in (CHOSEN, NOW))
        most = current if limit.as_now else limit.most
        if not value <= most:
            yield limit, value, most


def _hunts_in_many_cases(measures: xr.Dataset) -> bool:
    """Whether a population hunts: more than 5 % of its valves and days do.  measures: of one tuning."""
    return any(float(value) > 0.05 for name, value in measures.data_vars.items() if str(name).startswith(HUNTS))


def contradiction_by_converged_march(limits: Sequence[Limit], held_out: xr.Dataset, converged: xr.Dataset) -> str:
    """Sentence where the chosen settings stand otherwise with the converged march, in ``converged``; else empty."""
    chosen_pair = [ds.sel(tuning=CHOSEN, edge="value") for ds in (held_out, converged)]
    hunts, hunts_converged = map(_hunts_in_many_cases, chosen_pair)
    broken, broken_converged = (bool(list(_broken_limits(limits, ds))) for ds in (held_out, converged))
    is_worse, is_worse_converged = (float(measures[CHANGE]) > 0.0 for measures in chosen_pair)
    clauses = [
        f"more than 5 % of the cases hunt{'' if hunts_converged else ' no longer'}" * (hunts != hunts_converged),
        f"a limit is {'broken' if broken_converged else 'kept'}" * (broken != broken_converged),
        f"the objective changes by {float(chosen_pair[1][CHANGE]):+.0%} against now" * (is_worse != is_worse_converged),
    ]
    clauses = list(filter(None, clauses))
    return f"The converged march says otherwise: {', '.join(clauses)}.  Tune with converged = true." * bool(clauses)


def collect_notes(
    request: TuningRequest, parameters: Mapping[str, float], meets_limits: bool, held_out: xr.Dataset
) -> tuple[str, ...]:
    """List failures first, then bounds that the search reached, then what the population lacks."""
    notes = []
    if not meets_limits:
        cure = "widen the ranges, raise a limit, or repair the valves"
        notes.append(f"No tuning in these ranges keeps every limit: {cure}.")
    for limit, value, most in _broken_limits(request.limits, held_out):
        excess = f"{limit.measure.format_value(value)} there, above {limit.measure.format_value(most)}"
        excess += ", what it is there now" * limit.as_now
        notes.append(f"The hold-out breaks a limit: {limit.measure.words}, is {excess}.")
    low, high = (float(held_out[CHANGE].sel(tuning=CHOSEN, edge=edge)) for edge in ("low", "high"))
    if low > 0.0:
        notes.append("On the hold-out the objective is worse than now.")
    elif high >= 0.0:
        notes.append("On the hold-out the objective does not differ from now beyond chance.")
    for axis in request.axes:
        value, end = parameters[axis.name], axis.end(parameters[axis.name])
        if end:
            notes.append(f"{axis.name} = {value:g} lies at the {end} end of its range: the best may lie beyond.")
    training, holdout = request.training, request.holdout
    if not any(np.any(np.asarray(group.loop["backlash"]) == 0.0) for group in (training, holdout)):
        cure = "add some with backlash = 0, or the chosen settings may make a good valve worse"
        notes.append(f"No valve of the population is without backlash: {cure}.")
    n = len(holdout.members)
    quantiles = [measure.quantile for measure in request.measures if measure.quantile not in (None, 1.0)]
    # three valves above a quantile, or it is little more than the worst of them
    needed = max([20, *(math.ceil(3.0 / (1.0 - q) - 1e-9) for q in quantiles if q)])
    if training.members == holdout.members:
        doubt = "so none is held out, only days: results on other valves are unknown"
        notes.append(f"The population has {format_count(n, 'valve')}, {doubt}.")
    elif n < needed:
        n_drawn = HELD_OUT_ONE_IN * needed
        valves = "One valve held out is" if n == 1 else f"{n} valves held out are"
        notes.append(f"{valves} few for these quantiles: draw {n_drawn} or more in all.")
    if holdout.boundary.n_days == 1:
        doubt = "the intervals hold no scatter between days: give more with holdout"
        notes.append(f"The hold-out has a single day, so that {doubt}.")
    return tuple(notes)


def table_rows(ds: xr.Dataset, limits: tuple[Limit, ...]) -> list[list[str]]:
    """Rows of a table of every measure of every tuning and its limit, the heads first."""
    tunings, limit_of = ds["tuning"].values.tolist(), {limit.measure.name: limit for limit in limits}
    rows = [["", *(_TUNING_LOOKS[name][2] for name in tunings), *["limit"] * bool(limits)]]
    for name, variable in ds.drop_vars(CHANGE).data_vars.items():
        factor = quantity(str(name).rpartition("_")[0]).factor
        cells = [variable.attrs["long_name"]]
        for value, low, high in factor * variable.transpose("tuning", "edge").values:
            cells.append(f"{value:.3g}" + (f" ({low:.3g} to {high:.3g})" if not math.isnan(low) else ""))
        limit = limit_of.get(str(name))
        if limit is not None:
            cells.append(limit.measure.format_value(float(variable[0, 0]) if limit.as_now else limit.most))
        rows.append([*cells, *[""] * (len(rows[0]) - len(cells))])
    return rows


_TUNING_LOOKS = {NOW: ("s", "black", "now"), CHOSEN: ("o", RED, "chosen"), SIMC: ("^", YELLOW, "SIMC")}


@dataclass(frozen=True, repr=False)
class Tuning(Result):
    """Result of a search of settings for the valves and days of a population.

    Attributes
    ----------
    parameters
        The chosen values by name.
    meets_limits
        Whether a tuning keeps every limit on the valves and days of the search.  If not, ``parameters`` break them
        least, and are no recommendation.
    held_out, trained
        Datasets over ``tuning`` (``now``, the loop as given, ``chosen``, and ``simc`` where kp and ti were searched)
        and ``edge`` (value, low, high: 95 % by bootstrap over valves and days): the objective, every limited metric,
        motor travel and share that hunts; ``change`` of the objective against now.  ``held_out``: on valves and days
        that the search never saw, which is the result; ``trained``: on those of the search.
    front
        Dataset over ``point``: the tunings of which no other has both a lower objective and less motor travel on the
        valves and days of the search, with the same measures on those held out (``held_out_…``).
    evaluations
        Dataset over ``evaluation``: every tuning that was tried.
    objective, limits
        The goal and the limits of the search.
    axes
        Measures of error and travel along the front.
    advice
        What to do, in a sentence.
    contradiction
        Sentence that says where the converged march turns the advice round; empty where it does not.
    notes
        Warnings: a limit broken on the hold-out, an end of a range reached, what the population lacks.
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
    contradiction: str

    @property
    def advice(self) -> str:
        """What to do, in a sentence, and in another one where the converged march says otherwise."""
        return f"{self._advice_as_given}  {self.contradiction}".rstrip()

    @property
    def leaves_settings(self) -> bool:
        """Whether the advice is to leave the present settings."""
        return self._advice_as_given.startswith("Leave it")

    @property
    def _advice_as_given(self) -> str:
        """Leave it, unless the choice keeps its limits and is better beyond chance."""
        may_be_chance = float(self.held_out[CHANGE].sel(tuning=CHOSEN, edge="high")) >= 0.0
        if not self.meets_limits or may_be_chance or any(_broken_limits(self.limits, self.held_out)):
            return f"Leave it: {self.notes[0][0].lower()}{self.notes[0][1:]}"
        options = []
        for name, words in ((NOW, "as it is"), (CHOSEN, self._settings)):
            measures = self.held_out.sel(tuning=name, edge="value")
            error, travel = (float(measures[measure.name]) for measure in (self.objective, self.axes[1]))
            options.append(Option(name, words, error, travel, _hunts_in_many_cases(measures)))
        return advise(options, error_name=self.objective.words, format_error=self.objective.format_value).text

    @property
    def _settings(self) -> str:
        units = {name: quantity(name).unit.removesuffix("%") for name in self.parameters}
        return ", ".join(f"{name} = {value!r} {units[name]}".rstrip() for name, value in self.parameters.items())

    def summary(self) -> list[str]:
        """Lines of a summary: the tuning in words, and tables of the current and the chosen settings."""
        head = "Chosen" if self.meets_limits else "No tuning keeps the limits; nearest to them"
        lines = [f"{head}: {self._settings} ({self.evaluations.sizes['evaluation']:,} tunings tried)", ""]
        for title, ds in (("Held out", self.held_out), ("Searched on", self.trained)):
            rows = align_columns(table_rows(ds, self.limits))
            lines += [f"{title}: {ds.attrs['group']}", *(f"  {row}" for row in rows), ""]
        value, low, high = self.held_out[CHANGE].sel(tuning=CHOSEN).values
        goal = next(iter(self.held_out.data_vars.values())).attrs["long_name"]
        interval = "" if math.isnan(low) else f" ({low:+.0%} to {high:+.0%} for other valves and days)"
        shares = (
            format_share(float(self.held_out[SHARE_THAT_HUNTS.name].sel(tuning=t, edge="value"))) for t in (CHOSEN, NOW)
        )
        hunting = "{} of these loops hunt, now {}".format(*shares)
        return [*lines, f"Held out, {goal}: {value:+.0%} against now{interval}; {hunting}", self.advice, *self.notes]

    @apply_style()
    def plot(self) -> Figure:
        """Draw the front where it was searched and on the hold-out; return a matplotlib ``Figure``."""
        from matplotlib.figure import Figure
        from matplotlib.ticker import LogLocator

        fig = Figure(figsize=(6.5, 4.6), layout="constrained")
        axes = fig.add_subplot()
        measures = self.axes[::-1]  # travel below, error on the left

        def scale_values(values: Array, measure: Measure) -> Array:
            values = values * quantity(measure.metric).factor
            return np.where(np.isfinite(values), values, np.nan)

        searched = [scale_values(self.front[m.name].values, m) for m in measures]
        held_out = [scale_values(self.front[f"held_out_{m.name}"].values, m) for m in measures]
        axes.plot([searched[0], held_out[0]], [searched[1], held_out[1]], color=LINE_GREY, lw=0.6, zorder=1)
        axes.plot(*searched, "o-", color=BLUE, ms=3, label="front where it was searched")
        axes.plot(*held_out, "o", color=BLUE, ms=4, mfc="white", label="the same tunings, held out")
        for name in self.held_out["tuning"].values:
            marker, colour, words = _TUNING_LOOKS[str(name)]
            edges = [scale_values(self.held_out[m.name].sel(tuning=name).values, m) for m in measures]
            if np.isfinite([value for value, *_ in edges]).all():
                bars = [np.abs([[value - low], [high - value]]) for value, low, high in edges]
                look: dict[str, Any] = {"color": colour, "ms": 6, "lw": 1.0, "capsize": 2, "zorder": 3}
                look |= {"xerr": bars[0], "yerr": bars[1]} if np.isfinite(bars).all() else {}
                axes.errorbar(edges[0][0], edges[1][0], fmt=marker, label=f"{words}, held out", **look)
        for limit in self.limits:
            if limit.measure in measures:
                draw_line = axes.axvline if limit.measure == measures[0] else axes.axhline
                most = limit.most * quantity(limit.measure.metric).factor
                draw_line(most, color="black", lw=1.0, ls=DOTTED_LINE, label="limit")
        axes.set(xlabel=measures[0].words, ylabel=measures[1].words, xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        groups = f"Searched on {self.trained.attrs['group']}, held out {self.held_out.attrs['group']}."
        # 5.6 inches: the axes are narrower than the figure
        axes.set_title(wrap_text(f"{groups}  Bars: 95 % for other valves and days.", 5.6, 9), loc="left")
        axes.legend(frameon=False)
        return fig

    def to_toml(self, path: str | Path | None = None) -> str:
        """Return the chosen values as TOML for ``include`` in ``[loop]`` of a study file; write it to ``path``, if any.

        ``[loop]`` is empty where no tuning keeps the limits; ``[fit]`` is for readers.
        """
        lines = ["# settings chosen by fastcoil tune", *(f"# {line}".rstrip() for line in self.summary())]
        lines += toml_table("loop", self.parameters if self.meets_limits else {})
        facts = {"kind": "tuning", "objective": self.objective.name, "meets_limits": self.meets_limits}
        lines += toml_table("fit", facts | {"notes": self.notes})
        for name, ds in (("held_out", self.held_out), ("trained", self.trained)):
            edges = {str(key): variable.values.tolist() for key, variable in ds.sel(tuning=CHOSEN).data_vars.items()}
            lines += toml_table(f"fit.{name}", edges)
        return toml_document(lines, path)
