"""``answer``: what a study says to do, what that brings and costs, and where it fails.

Every sentence quotes ``Answer.table``: metrics over the swept axes, pooled over chance (days, drawn valves, noise)
alone.  A swept axis is a *choice*, which a controller is free to make, or a *condition*, which the plant sets; the
recommended choice is judged in every condition.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import to_builtin
from fastcoil.base.results import html_table
from fastcoil.base.text import format_share
from fastcoil.design.swing_verdict import LEAST_REGULARITY, SwingVerdict
from fastcoil.loops.labels import coordinate_quantity, is_parameter, plain_pi_label, quantity
from fastcoil.loops.scenarios import check_counted_result
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study.analysis import learned
from fastcoil.study.analysis.choices import (
    CALM_ERROR,
    HUNTING_LIMIT,
    SIMILAR_ERROR,
    Choices,
    describe_choice,
    describe_labels_at,
    format_change,
    format_range,
    make_table,
    recommended_buffer,
)  # fmt: skip
from fastcoil.study.analysis.sobol import sobol_indices


@dataclass(frozen=True)
class Answer:
    """The answer of a study, in sentences that quote one table.

    Attributes
    ----------
    question
        What the study asked, from its file; its title where the file has no question.
    recommend
        Parameter → value of the recommended choice; empty where there is none.
    advice, brings, costs
        What to do or what was found, what it brings, what it costs: a sentence each, empty where there is nothing
        to say.
    fails
        Where it fails.
    alternatives
        Other choices, with what they bring and cost.
    table
        Metrics over the swept axes, pooled over days, drawn valves and noise: medians, for ``hunts`` the share;
        ``rmse_q05`` and ``rmse_q95``; ``n``, the scenarios of each cell; with a plain PI among the choices
        ``rmse_change`` and ``travel_ratio``, medians of the pairs with the same loop under a plain PI, and
        ``share_lower``, the share of these pairs with less error.
    """

    question: str
    recommend: Mapping[str, Any]
    advice: str
    brings: str = ""
    costs: str = ""
    fails: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    table: xr.Dataset = field(default_factory=xr.Dataset, repr=False)
    place: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """Axis of the choices → label of the recommended choice."""

    def summary(self) -> list[str]:
        """Return the answer as lines of text."""
        head = "Do this" if self.recommend else "Found"
        lines = [f"{head}: {self.advice}"] + [f"It brings: {self.brings}"] * bool(self.brings)
        lines += [f"It costs: {self.costs}"] * bool(self.costs)
        lines += [f"It fails: {'; '.join(self.fails)}."] * bool(self.fails)
        return lines + [f"Or: {alternative}" for alternative in self.alternatives]

    def __repr__(self) -> str:
        return "\n".join(
            ["<fastcoil Answer>", *([f"Asked: {self.question}"] if self.question else []), *self.summary()]
        )

    def _repr_html_(self) -> str:
        return html_table([f"Asked: {self.question}", *self.summary()])

    def along(self, dim: str) -> xr.Dataset:
        """Return the table along one axis, at the recommended labels of the other choices."""
        others = {d: label for d, label in self.place.items() if d != dim}
        return self.table.sel(others, drop=True)

    def to_json(self) -> str:
        """Return the answer as JSON: the sentences, the recommended values, and the table along each axis."""
        rows = {}
        for dim in map(str, self.table.sizes):
            part = self.along(dim)
            if part["rmse"].dims == (dim,):
                names = [dim, *map(str, part.data_vars)]
                columns = [[_to_json_value(v) for v in part[n].values] for n in names]
                rows[dim] = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
        content = {
            "question": self.question, "recommend": dict(self.recommend), "advice": self.advice, "brings": self.brings,
            "costs": self.costs, "fails": list(self.fails), "alternatives": list(self.alternatives), "along": rows,
        }  # fmt: skip
        return json.dumps(content, ensure_ascii=False, indent=1) + "\n"


def _to_json_value(value: Any) -> Any:
    value = to_builtin(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def answer(results: Any) -> Answer:
    """Answer what a study asked: what to do, what it brings, what it costs, and where it fails.

    The choice is the one of lowest RMS error, relative to the best one of each condition (every plant that was swept),
    among those with at most twice the motor travel of the best plain PI and at most 5 % of the scenarios of a condition
    that hunt.  Of choices whose errors differ by less than 5 % it takes the plain PI, then the one of least travel.

    Parameters
    ----------
    results
        Dataset of ``run_study``, ``open_study`` or ``simulate``.

    Returns
    -------
    Answer
        Print it to read it; ``table`` holds the numbers that it quotes, ``along(dim)`` a part of it.

    Raises
    ------
    InputError
        For anything but a result, and for results with a label twice.

    Examples
    --------
    >>> import fastcoil as fc
    >>> day = fc.paper_day(hours=0.6, seed=[1, 2])
    >>> ds = fc.simulate(fc.Loop(backlash_estimate=[0.0, 0.0665]), day, warm_up=600, n_jobs=1)
    >>> dict(fc.answer(ds).table.sizes)
    {'backlash_estimate': 2}
    """
    check_counted_result(results, "results")
    return find_answer(results)


def find_answer(results: xr.Dataset) -> Answer:
    """Answer what the study of a result asked, without checks of the labels."""
    question = " ".join(str(results.attrs.get("summary") or results.attrs.get("title", "")).split())
    if not bool((results["status"] == STATUS_OK).any()) or "rmse" not in results:
        return Answer(question, {}, "every scenario failed: there is no answer.")
    if not bool(results["rmse"].notnull().any()):
        return Answer(question, {}, "no RMS error is known.")
    with warnings.catch_warnings():
        # a cell in which every scenario failed has no median
        warnings.filterwarnings("ignore", "All-NaN slice|Mean of empty slice|Degrees of freedom", RuntimeWarning)
        if "design" in results["status"].dims:
            return _answer_drivers(question, results)
        table = make_table(results)
        if learned.is_learning_result(results):
            return _answer_learning(question, Choices(table.merge(learned.describe_learning(results))), results)
        if results["status"].size == 1:
            return _answer_single(question, table)
        choices = Choices(table)
        return _answer_choice(question, choices) if choices.dims else _answer_spread(question, choices)


# --- in sentences -----------------------------------------------------------------------------------------------------


def _answer_choice(question: str, choices: Choices) -> Answer:
    table, best = choices.table, choices.best
    recommend = _recommended_values(table, best)
    place = {d: to_builtin(table[d].values[k]) for d, k in best.items()}
    return Answer(
        question, recommend, f"{describe_choice(choices, best)}.", _describe_gain(choices, best),
        _describe_costs(choices, best), tuple(_describe_failures(choices, best)),
        tuple(_describe_alternatives(choices, best)), table, place,
    )  # fmt: skip


def _answer_learning(question: str, choices: Choices, results: xr.Dataset) -> Answer:
    """Recommend the setting that finds the backlash most often without harm, or none."""
    table, over, comparators = choices.table, choices.over, learned.read_comparators(results)
    if "rmse_change" in table:
        change, travel = table["rmse_change"], table.get("travel_ratio", xr.DataArray(1.0))
    elif comparators:
        plain = comparators["plain PI"]
        change, travel = table["rmse"] / plain["rmse"] - 1.0, table["motor_travel"] / plain["motor_travel"]
    else:
        change, travel = xr.zeros_like(table["rmse"]), xr.ones_like(table["rmse"])
    right = table["share_right"].mean(over).where(~choices.is_plain, -np.inf)
    is_harmless = (change.max(over) <= learned.HARMLESS_CHANGE) & (
        table["share_too_high"].max(over) <= learned.TOO_HIGH_SHARE
    )
    is_harmless &= travel.median(over) <= learned.HARMLESS_TRAVEL
    is_safe = is_harmless & (right >= learned.RIGHT_SHARE)
    has_safe = bool(is_safe.any())
    # of settings that are right equally often, the fastest
    speed = 1.0 / (1.0 + table["time_median"].max(over))
    best = _largest((right.round(2) + 1e-3 * speed).where(is_safe if has_safe else True, -np.inf))
    runs, n = learned.describe_runs(results), int(table["n"].isel(best).sum())
    cell = table.isel(best, drop=True)

    def describe_harm(at: Mapping[str, int]) -> str:
        parts = [f"the RMS error is {format_change(float(change.isel(at).median()))} than with the plain PI"]
        parts.append(f"the motor travels {float(travel.isel(at).median()):.2g} times as far")
        parts.append(f"mode switches are {float(table['switch_frequency'].isel(at).median()):.1f} in 10 min")
        return ", ".join(parts if comparators or "rmse_change" in table else parts[2:])

    setting = describe_labels_at(table, best)
    if has_safe:
        advice = f"take {setting}."
        worst_time = cell.isel(_largest(-cell["share_right"]))
        brings = f"the backlash is found on {format_share(float(cell['share_right'].mean()))} of the {runs}: "
        brings += f"{learned.describe_time(worst_time, n / max(1, cell['share_right'].size), runs)}"
        brings += " in the condition where this is least often" * bool(cell["share_right"].ndim) + "."
    else:
        high = format_share(float(cell["share_too_high"].mean()))
        found = (
            f"right on {format_share(float(cell['share_right'].mean()))} of the {runs}, too high at the end on {high}"
        )
        advice, brings = f"ship none of these settings: the one that is right most often, {setting}, is {found}.", ""
    fails = []
    lowest = choices.unlimited
    if lowest != best and not bool(choices.is_plain.isel(lowest)):
        there = table.isel(lowest)
        words = f"the setting of least error, {describe_labels_at(table, lowest)}, is right on"
        right_there, high = (format_share(float(there[n].mean())) for n in ("share_right", "share_too_high"))
        fails.append(f"{words} {right_there} and too high on {high} of the {runs}")
    others = {name: part for name, part in comparators.items() if name != "plain PI"}
    alternatives = [_describe_comparator(name, part, comparators["plain PI"], runs) for name, part in others.items()]
    place = {d: to_builtin(table[d].values[k]) for d, k in best.items()}
    recommend = _recommended_values(table, best) if has_safe else {}
    costs = f"while it learns, {describe_harm(best)}."
    return Answer(question, recommend, advice, brings, costs, tuple(fails), tuple(alternatives), table, place)


def _describe_comparator(name: str, part: xr.Dataset, plain: xr.Dataset, runs: str) -> str:
    """Describe what identify or a fixed estimate did on the same days."""
    change = format_change(float((part["rmse"] / plain["rmse"]).median()) - 1.0)
    travel = float((part["motor_travel"] / plain["motor_travel"]).median())
    text = f"{name}: the RMS error is {change} than with the plain PI, at {travel:.2g} times its travel"
    if name != "identify":
        return f"{text}."
    hours = float(part["time_median"].median()) / 3600.0
    within = f", half of them within {hours:.2g} h" if math.isfinite(hours) else ""
    return f"{text}; it is right on {format_share(float(part['share_right'].mean()))} of the {runs}{within}."


def _answer_single(question: str, table: xr.Dataset) -> Answer:
    """Describe a single scenario: its error, whether it hunts, and the travel of the motor."""
    sentence = f"the RMS error is {float(table['rmse']):.3g} K"
    if "hunts" in table and "hunting_swing" in table:
        regularity, period = (float(table.get(name, math.nan)) for name in ("swing_regularity", "hunting_period"))
        is_own, is_regular = bool(table["hunts"] > 0.0), regularity >= LEAST_REGULARITY
        verdict = SwingVerdict(is_own, is_regular, float(table["hunting_swing"]), period)
        sentence += f"; the loop {verdict.clause}"
    costs = f"the motor travels {float(table['motor_travel']):.3g} strokes." if "motor_travel" in table else ""
    return Answer(question, {}, f"{sentence}.", costs=costs, table=table)


def _answer_spread(question: str, choices: Choices) -> Answer:
    """Describe results in which nothing can be chosen: the spread of the error, and along each condition."""
    table = choices.table
    low, middle, high = (float(table[n].median()) for n in ("rmse_q05", "rmse", "rmse_q95"))
    advice = f"the RMS error is {middle:.3g} K in the median"
    if int(table["n"].max()) > 1:
        advice += f", {low:.3g} to {high:.3g} K in 5 to 95 % of the {'loops of a cell' if choices.over else 'loops'}"
    if "hunts" in table:
        advice += f"; {format_share(float(table['hunts'].mean()))} of the loops hunt"
    costs = ""
    if "motor_travel" in table:
        costs = f"the motor travels {float(table['motor_travel'].median()):.3g} strokes (median)."
    return Answer(question, {}, f"{advice}.", costs=costs, fails=tuple(_describe_worst(choices, {})), table=table)


def _answer_drivers(question: str, results: xr.Dataset) -> Answer:
    """Describe which sampled parameters drive the spread of each metric, by Sobol' indices."""
    metrics = [n for n in ("rmse", "motor_travel", "hunts") if n in results and bool(results[n].notnull().any())]
    table = sobol_indices(results, metrics, drop_failed=True)
    others = [str(d) for d in table["rmse"].dims if d not in ("parameter", "index", "edge")]
    lines = []
    for name, place in product(metrics, np.ndindex(*(table.sizes[d] for d in others))):
        at = dict(zip(others, place, strict=True))
        indices = table[name].isel(at)
        if bool(indices.notnull().any()):
            where = f" with {describe_labels_at(results, at)}" if at else ""
            lines.append(f"of the spread of the {quantity(name).text}{where}, {_describe_indices(indices)}")
    n = int(table["rmse_n_samples"].min())
    few = f"from {n:,} samples; brackets: 95 % intervals"
    width = table["rmse"].sel(edge="high", index="first_order") - table["rmse"].sel(edge="low", index="first_order")
    fails = (f"{n:,} samples are too few to tell the parameters apart: draw {4 * n:,}",) if width.max() > 0.3 else ()
    if not lines:
        return Answer(question, {}, "the sampled parameters do not change the RMS error.", table=table)
    return Answer(
        question, {}, f"{lines[0]} ({few}).", fails=fails, alternatives=tuple(f"{x}." for x in lines[1:]), table=table
    )


_MOST_DRIVERS = 3  # named in a sentence


def _describe_indices(indices: xr.DataArray) -> str:
    """Describe the largest first-order indices, what interactions add, and which parameters do nothing."""
    first, total = (indices.sel(index=i, edge="value") for i in ("first_order", "total"))
    order = np.argsort(-total.fillna(0.0).values)[:_MOST_DRIVERS]
    parts = []
    for k in order:
        edges = np.clip(indices.isel(parameter=k).sel(index="first_order").values, 0.0, 1.0)
        words = quantity(str(indices["parameter"].values[k])).text
        parts.append(f"{words} explains {format_share(*edges)} alone, {format_share(min(1.0, float(total[k])))} in all")
    interactions = max(0.0, 1.0 - float(first.sum()))
    return f"{'; '.join(parts)}; {format_share(interactions)} is interactions"


def _recommended_values(table: xr.Dataset, place: Mapping[str, int]) -> dict[str, Any]:
    """Return the parameters that differ along the dims of the choices, at a place; a label that stands for none."""
    values: dict[str, Any] = {}
    for dim, k in place.items():
        along = {str(n): c for n, c in table.coords.items() if c.dims == (dim,) and is_parameter(table, n)}
        along = {n: c for n, c in along.items() if len(set(c.values.tolist())) > 1}
        values |= {n: to_builtin(c.values[k]) for n, c in along.items()} or {dim: to_builtin(table[dim].values[k])}
    return {n: v for n, v in values.items() if not (isinstance(v, float) and math.isnan(v))}


def _describe_gain(choices: Choices, best: Mapping[str, int]) -> str:
    """Describe the error of a choice, against the plain PI of the same loop and against the other choices."""
    table, cell = choices.table, choices.table.isel(best, drop=True)
    text = f"the RMS error is {format_range(cell['rmse'])}"
    if "rmse_change" in table and not bool(choices.is_plain.isel(best)):
        lower = format_share(float(cell["share_lower"].mean()))
        change = format_change(float(cell["rmse_change"].median()))
        text += f", {change} than with the {plain_pi_label(table)} of the same loop (median), and lower in {lower}"
    worst = choices.error.where(np.isfinite(choices.error)).argmax(choices.dims)
    ratio = float(choices.error.isel(worst) / choices.error.isel(best))
    words = describe_labels_at(table, {str(d): int(k) for d, k in worst.items()})
    return text + (f"; the worst choice, {words}, has {ratio:.2g} times this error." if ratio > 1.05 else ".")


def _describe_costs(choices: Choices, best: Mapping[str, int]) -> str:
    table, cell, parts = choices.table, choices.table.isel(best, drop=True), []
    if "motor_travel" in table:
        parts.append(f"the motor travels {format_range(cell['motor_travel'], 'strokes')}")
        if dict(best) != choices.reference:
            ratio = float(choices.travel.isel(best))
            parts[0] += f", {ratio:.2g} times as far as with {describe_choice(choices, choices.reference)[5:]}"
    if "hunts" in table:
        parts.append(f"{format_share(float(cell['hunts'].mean()))} of the loops hunt")
    return f"{'; '.join(parts)}." if parts else ""


def _describe_failures(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the conditions in which the choice does worst, and what a larger estimate would do."""
    table, cell, parts = choices.table, choices.table.isel(best, drop=True), _describe_worst(choices, best)
    if "rmse_change" in table and not bool(choices.is_plain.isel(best)):
        worse = 1.0 - cell["share_lower"]
        if float(worse.max()) > 0.5 and worse.ndim:
            at = {str(d): int(k) for d, k in worse.fillna(-np.inf).argmax([*worse.dims]).items()}
            share = format_share(float(worse.isel(at)))
            parts.append(f"at {describe_labels_at(table, at)} the error is not lower in {share} of the loops")
    ratio = next((d for d in ("estimate_ratio", "backlash_estimate") if d in best), None)
    if ratio and best[ratio] and table[ratio].values[-1] > table[ratio].values[best[ratio]]:
        over = table.isel({**best, ratio: -1}, drop=True)
        wrong = coordinate_quantity(table, ratio).number(float(table[ratio].values[-1]))
        error = format_change(float((over["rmse"] / cell["rmse"]).median()) - 1.0)
        parts.append(f"with an estimate of {wrong} instead the error is {error}")
        if "motor_travel" in table:
            parts[-1] += f" and the travel {float((over['motor_travel'] / cell['motor_travel']).median()):.2g} times"
    return parts


def _describe_worst(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the condition of the largest error, and that of the most hunting."""
    cell, parts = choices.table.isel(best, drop=True), []
    if not choices.over:
        return []
    at = _largest(cell["rmse"])
    parts.append(
        f"the error is largest at {describe_labels_at(cell, at)}: {float(cell['rmse'].isel(at)):.3g} K (median)"
    )
    if "hunts" in cell and float(cell["hunts"].max()) > HUNTING_LIMIT:
        at = _largest(cell["hunts"])
        share = format_share(float(cell["hunts"].isel(at)))
        parts.append(f"at {describe_labels_at(cell, at)} {share} of the loops hunt")
    regret = cell["rmse"] / choices.table["rmse"].min(choices.dims)
    if best and float(regret.max()) > CALM_ERROR:
        at = _largest(regret)
        there = choices.table["rmse"].isel(at)
        other = {str(d): int(k) for d, k in there.fillna(np.inf).argmin(choices.dims).items()}
        lower = format_change(1.0 / float(regret.max()) - 1.0)
        parts.append(f"at {describe_labels_at(cell, at)} {describe_choice(choices, other)[5:]} has an error {lower}")
    return parts


def _largest(values: xr.DataArray) -> dict[str, int]:
    if not values.ndim:
        return {}
    return {str(d): int(k) for d, k in values.fillna(-np.inf).argmax([*values.dims]).items()}


def _describe_alternatives(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the choice of lowest error, where it costs too much, and the best plain PI, where it is simpler."""
    lines, lowest, reference = [], choices.unlimited, choices.reference
    if float(choices.error.isel(best) / choices.error.isel(lowest)) > SIMILAR_ERROR:
        change = format_change(float(choices.error.isel(lowest) / choices.error.isel(best)) - 1.0)
        why = f"the motor travels {float(choices.travel.isel(lowest)):.3g} times as far as the best plain PI's"
        if float(choices.hunting.isel(lowest)) > HUNTING_LIMIT:
            why += f", and up to {format_share(float(choices.hunting.isel(lowest)))} of the loops hunt"
        line = f"{describe_choice(choices, lowest)}: the error is {change}, but {why}"
        if not bool(choices.is_plain.isel(lowest)) and plain_pi_label(choices.table) == "plain PI":
            size = recommended_buffer(choices.table, lowest)
            line += f"; a buffer of {100.0 * size:.2g} % of the stroke lowers that: sweep buffer = {size:.2g} too"
        lines.append(f"{line}.")
    if dict(best) != reference and bool(choices.is_plain.isel(reference)):
        change = format_change(float(choices.error.isel(reference) / choices.error.isel(best)) - 1.0)
        lines.append(f"{describe_choice(choices, reference)}: the error is {change}.")
    return lines
