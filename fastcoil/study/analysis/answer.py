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
from fastcoil.study.analysis.sobol import sobol_indices

from fastcoil.study.analysis.choices import (  # isort: skip
    CALM_ERROR, HUNTING_LIMIT, SIMILAR_ERROR, Choices, change_in_words, describe_choice, describe_labels_at,
    format_range, largest, make_table, recommended_buffer, shorten,
)  # fmt: skip


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
        word = "Or" if self.place else "Also"
        return lines + [f"{word}: {alternative}" for alternative in self.alternatives]

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
                frame = part.drop_vars({*map(str, part.coords)} - {dim}).to_dataframe().reset_index()
                rows[dim] = json.loads(frame.to_json(orient="records", double_precision=15))
        content = {
            "question": self.question, "recommend": dict(self.recommend), "advice": self.advice, "brings": self.brings,
            "costs": self.costs, "fails": list(self.fails), "alternatives": list(self.alternatives), "along": rows,
        }  # fmt: skip
        return json.dumps(content, ensure_ascii=False, indent=1) + "\n"


def answer(results: Any) -> Answer:
    """Answer what a study asked: what to do, what it brings, what it costs, and where it fails.

    The choice is the one of lowest RMS error, relative to the best one of each condition (every plant that was swept),
    among those with at most twice the motor travel of the best plain PI and at most 5 % of the scenarios of a condition
    that hunt.  Of choices whose errors differ by less than 5 % it takes the plain PI, then the one of least travel.
    Ratios in the sentences are medians over the conditions; brackets are their range.

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


def _labels_of(table: xr.Dataset, place: Mapping[str, int]) -> dict[str, Any]:
    return {d: to_builtin(table[d].values[k]) for d, k in place.items()}


def _mean_share(values: xr.DataArray) -> str:
    return format_share(float(values.mean()))


def _answer_choice(question: str, choices: Choices) -> Answer:
    table, best = choices.table, choices.best
    return Answer(
        question, _recommended_values(table, best), f"{describe_choice(choices, best)}.", _describe_gain(choices, best),
        _describe_costs(choices, best), tuple(_describe_failures(choices, best)),
        tuple(_describe_alternatives(choices, best)), table, _labels_of(table, best),
    )  # fmt: skip


def _answer_learning(question: str, choices: Choices, results: xr.Dataset) -> Answer:
    """Recommend the setting that finds the backlash most often without harm, or none."""
    table, over, comparators = choices.table, choices.over, learned.read_comparators(results)
    plain: Any = comparators.pop("plain PI", None)
    has_plain = plain is not None or "rmse_change" in table
    if "rmse_change" in table:
        error, travel = 1.0 + table["rmse_change"], table.get("travel_ratio", xr.DataArray(1.0))
    elif plain is not None:
        error, travel = table["rmse"] / plain["rmse"], table["motor_travel"] / plain["motor_travel"]
    else:
        error = travel = xr.ones_like(table["rmse"])
    right = table["share_right"].mean(over).where(~choices.is_plain, -np.inf)
    too_much = {
        f"is right on less than {format_share(learned.RIGHT_SHARE)}": right < learned.RIGHT_SHARE,
        f"is too high at the end on more than {format_share(learned.TOO_HIGH_SHARE)} of the days of a condition":
            table["share_too_high"].max(over) > learned.TOO_HIGH_SHARE,
        f"raises the error of a condition by more than {format_share(learned.HARMLESS_CHANGE)}":
            error.max(over) > 1.0 + learned.HARMLESS_CHANGE,
        f"moves the motor more than {learned.HARMLESS_TRAVEL:g} times as far as the plain PI":
            travel.median(over) > learned.HARMLESS_TRAVEL,
    }  # fmt: skip
    is_safe = ~np.logical_or.reduce(xr.broadcast(*too_much.values()))
    has_safe = bool(is_safe.any())
    # of settings that are right equally often, the fastest
    speed = 1.0 / (1.0 + table["time_median"].max(over))
    best = largest((right.round(2) + 1e-3 * speed).where(is_safe if has_safe else True, -np.inf))
    runs, n = learned.describe_runs(results), int(table["n"].isel(best).sum())
    cell, setting = table.isel(best, drop=True), describe_labels_at(table, best)
    identify: Any = comparators.get("identify" if "identify" not in _estimators(results) else "")
    if has_safe:
        is_beaten = learned.is_better(identify, plain, cell, error.isel(best), travel.isel(best))
        advice = f"prefer identify; of these settings take {setting}." if is_beaten else f"take {setting}."
        slow = 1e-9 * cell["time_median"].clip(max=1e8)  # of conditions with equal shares, the slowest is the worst
        worst_time = learned.describe_time(cell.isel(largest(slow - cell["share_right"])), n / slow.size)
        brings = f"the backlash is found on {_mean_share(cell['share_right'])} of the {runs}: {worst_time}"
        brings += ", in the worst condition." if cell["share_right"].ndim else "."
    else:
        advice = f"ship none of these settings: the one that is right most often, {setting}, is right on "
        advice += f"{_mean_share(cell['share_right'])} of the {runs}, too high at the end on "
        advice, brings = f"{advice}{_mean_share(cell['share_too_high'])}.", ""
    costs = f"{float(table['switch_frequency'].isel(best).median()):.1f} mode switches in 10 min"
    if has_plain:
        change, ratio = change_in_words(error.isel(best)), float(travel.isel(best).median())
        costs = f"RMS error {change} than with the plain PI, {ratio:.2g} times its travel, {costs}"
    fails = [f"it {' and '.join(n for n, is_so in too_much.items() if is_so.isel(best))}"] * (not has_safe)
    lowest = choices.unlimited
    if not bool(choices.is_plain.isel(lowest)) and right.isel(lowest) < right.isel(best):
        share_right = _mean_share(table["share_right"].isel(lowest))
        fails.append(f"the setting of least error, {describe_labels_at(table, lowest)}, is right on {share_right}")
    alternatives = [_describe_comparator(name, part, plain, runs) for name, part in comparators.items()]
    return Answer(
        question, _recommended_values(table, best) if has_safe else {}, advice, brings, f"while it learns: {costs}.",
        tuple(fails), tuple(alternatives), table, _labels_of(table, best),
    )  # fmt: skip


def _estimators(results: xr.Dataset) -> list[str]:
    """Return the estimators of a result."""
    stored = json.loads(results.attrs.get("parameters", "{}")).get("estimator", "none")
    return [str(name) for name in np.atleast_1d(results.coords.get("estimator", stored))]


def _describe_comparator(name: str, part: xr.Dataset, plain: xr.Dataset, runs: str) -> str:
    """Describe what identify or a fixed estimate did on the same days."""
    travel = float((part["motor_travel"] / plain["motor_travel"]).median())
    text = f"{name}: RMS error {change_in_words(part['rmse'] / plain['rmse'])}, {travel:.2g} times the travel"
    if name != "identify":
        return f"{text}."
    hours = float(part["time_median"].median()) / 3600.0
    within = f", half within {hours:.2g} h" if math.isfinite(hours) else ""
    return f"{text}, right on {_mean_share(part['share_right'])} of the {runs}{within}."


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
        advice += f"; {_mean_share(table['hunts'])} of the loops hunt"
    costs = ""
    if "motor_travel" in table:
        costs = f"the motor travels {float(table['motor_travel'].median()):.3g} strokes (median)."
    return Answer(question, {}, f"{advice}.", costs=costs, fails=tuple(_describe_worst(choices, {})), table=table)


_MOST_DRIVERS = 3  # named in a sentence
_MOST_INTERVAL = 0.3  # of an index, of a 95 % interval up to which numbers are quoted
_MOST_DRIVEN, _MOST_SHORT = 3, 2  # metrics, or cells of one, after the first, and drivers named there


def _answer_drivers(question: str, results: xr.Dataset) -> Answer:
    """Describe which sampled parameters drive the spread of each metric, by Sobol' indices."""
    metrics = [n for n in ("rmse", "motor_travel", "hunts") if n in results and bool(results[n].notnull().any())]
    if "hunts" in metrics and not HUNTING_LIMIT <= float(results["hunts"].mean()) <= 1.0 - HUNTING_LIMIT:
        metrics.remove("hunts")  # a handful of loops has no spread to share out
    table = sobol_indices(results, metrics, drop_failed=True)
    others = [str(d) for d in table["rmse"].dims if d not in ("parameter", "index", "edge")]
    lines: list[str] = []
    for name, place in product(metrics, np.ndindex(*(table.sizes[d] for d in others))):
        at = dict(zip(others, place, strict=True))
        indices = table[name].isel(at)
        if bool(indices.notnull().any()):
            words = describe_labels_at(results, {d: k for d, k in at.items() if table.sizes[d] > 1})
            of_what = quantity(name).text + (f" with {words}" if words else "")
            lines.append(f"{of_what}: {_describe_indices(indices, is_short=bool(lines))}")
    if not lines:
        return Answer(question, {}, "the sampled parameters do not change the RMS error.", table=table)
    n = int(table["rmse_n_samples"].min())
    width = table["rmse"].sel(edge="high", index="first_order") - table["rmse"].sel(edge="low", index="first_order")
    if width.max() > _MOST_INTERVAL:
        total = table["rmse"].sel(edge="value", index="total").median(others)
        strongest = [quantity(str(total["parameter"].values[k])).text for k in np.argsort(-total.values)[:_MOST_SHORT]]
        advice = f"{n:,} samples are too few to tell the parameters apart, draw {4 * n:,}; so far "
        advice += f"{shorten(' and '.join(strongest))} change the RMS error most."
        return Answer(question, {}, advice, table=table)
    advice = f"of the spread of the {lines[0]} (from {n:,} samples; brackets: 95 % intervals)."
    return Answer(question, {}, advice, alternatives=tuple(lines[1 : 1 + _MOST_DRIVEN]), table=table)


def _describe_indices(indices: xr.DataArray, is_short: bool) -> str:
    """Describe the largest first-order indices; in full with intervals, total indices, and what interactions add."""
    first, total = (indices.sel(index=i, edge="value") for i in ("first_order", "total"))
    parts = []
    for k in np.argsort(-total.fillna(0.0).values)[: _MOST_SHORT if is_short else _MOST_DRIVERS]:
        edges = np.clip(indices.isel(parameter=k).sel(index="first_order").values, 0.0, 1.0)
        words = shorten(quantity(str(indices["parameter"].values[k])).text)
        if is_short:
            parts.append(f"{words} {format_share(float(edges[0]))}")
        else:
            in_all = format_share(min(1.0, float(total[k])))
            parts.append(f"{words} explains {format_share(*edges)} alone, {in_all} in all")
    if is_short:
        return f"{', '.join(parts)} alone."
    return f"{'; '.join(parts)}; {format_share(max(0.0, 1.0 - float(first.sum())))} is interactions"


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
        change = change_in_words(1.0 + cell["rmse_change"])
        text += f", {change} than with the {plain_pi_label(table)} of the same loop (median), and lower in "
        text += _mean_share(cell["share_lower"])
    worst = largest(choices.error.where(np.isfinite(choices.error)))
    ratio = float((choices.rmse.isel(worst) / choices.rmse.isel(best)).median())
    return text + (f"; the worst choice has {ratio:.2g} times this error." if ratio > 1.05 else ".")


def _describe_costs(choices: Choices, best: Mapping[str, int]) -> str:
    cell, parts = choices.table.isel(best, drop=True), []
    if "motor_travel" in cell:
        parts.append(f"the motor travels {format_range(cell['motor_travel'], 'strokes')}")
        if dict(best) != choices.reference:
            calmest = describe_choice(choices, choices.reference)[5:]
            ratio = float(choices.travel.isel(best))
            parts[0] += f", {ratio:.2g} times as far as with {calmest}" if abs(ratio - 1.0) >= 0.05 else ""
    if "hunts" in cell:
        share = float(cell["hunts"].mean())
        parts.append(f"{format_share(share)} of the loops hunt" if share else "no loop hunts")
        if float(choices.hunting.min()) > HUNTING_LIMIT:
            parts[-1] += ", and no choice calms them: see fastcoil explain"
    return f"{'; '.join(parts)}." if parts else ""


def _describe_failures(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the conditions in which the choice does worst, and what a larger estimate would do."""
    table, cell, parts = choices.table, choices.table.isel(best, drop=True), _describe_worst(choices, best)
    if "rmse_change" in table and not bool(choices.is_plain.isel(best)):
        worse = 1.0 - cell["share_lower"]
        at = largest(worse)
        if at and float(worse.max()) > 0.5:
            share = format_share(float(worse.isel(at)))
            parts.append(f"at {describe_labels_at(table, at)} the error is not lower in {share} of the loops")
    for gain in [d for d in ("kp", "ti") if d in best and table.sizes.get(d, 1) > 2]:
        if best[gain] == table.sizes[gain] - 1:
            parts.append(f"{describe_labels_at(table, {gain: best[gain]})} is the largest value swept: sweep further")
    ratio = next((d for d in ("estimate_ratio", "backlash_estimate") if d in best), None)
    if ratio and best[ratio] and table[ratio].values[-1] > table[ratio].values[best[ratio]]:
        over = table.isel({**best, ratio: -1}, drop=True)
        wrong = coordinate_quantity(table, ratio).number(float(table[ratio].values[-1]))
        parts.append(f"with an estimate of {wrong} instead the error is {change_in_words(over['rmse'] / cell['rmse'])}")
        if "motor_travel" in table:
            parts[-1] += f" and the travel {float((over['motor_travel'] / cell['motor_travel']).median()):.2g} times"
    return parts


def _describe_worst(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the condition of the largest error, that of the most hunting, and where another choice is better."""
    cell = choices.table.isel(best, drop=True)
    if not choices.over:
        return []
    at = largest(cell["rmse"])
    where = f"at {describe_labels_at(cell, at)}"
    parts = [f"the error is largest {where}: {float(cell['rmse'].isel(at)):.3g} K"]
    if "hunts" in cell and float(cell["hunts"].max()) > HUNTING_LIMIT:
        at, share = largest(cell["hunts"]), format_share(float(cell["hunts"].max()))
        is_everywhere = float(cell["hunts"].min()) > float(cell["hunts"].max()) - 0.05
        hunts_where = "everywhere" if is_everywhere else f"at {describe_labels_at(cell, at)}"
        parts.append(f"{hunts_where} {share} of the loops hunt")
    regret = cell["rmse"] / choices.table["rmse"].min(choices.dims)
    if best and float(regret.max()) > CALM_ERROR:
        at = largest(regret)
        there = f"at {describe_labels_at(cell, at)}"
        other = largest(-choices.table["rmse"].isel(at))
        is_alternative = other == _costly_choice(choices, best)
        words = "the choice of lowest error" if is_alternative else describe_choice(choices, other)[5:]
        lower = change_in_words(1.0 / regret.max())
        parts.append(f"{'there' if there == where else there} {words} has an error {lower}")
    return parts


def _costly_choice(choices: Choices, best: Mapping[str, int]) -> dict[str, int]:
    """Return the choice of lowest error, where that is much lower than with the recommended one."""
    lowest = choices.unlimited
    return lowest if float(choices.error.isel(best) / choices.error.isel(lowest)) > SIMILAR_ERROR else {}


def _describe_alternatives(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the choice of lowest error, where it costs too much, and the best plain PI, where it is simpler."""
    lines, reference = [], choices.reference
    error = choices.rmse / choices.rmse.isel(best)
    if lowest := _costly_choice(choices, best):
        travel, hunting = choices.travel.isel(lowest) / choices.travel.isel(best), float(choices.hunting.isel(lowest))
        why = f"the motor travels {float(travel):.3g} times as far"
        if hunting > HUNTING_LIMIT:
            why += f", and up to {format_share(hunting)} of the loops hunt"
        if not bool(choices.is_plain.isel(lowest)) and plain_pi_label(choices.table) == "plain PI":
            why += f"; sweep buffer = {recommended_buffer(choices.table, lowest):.2g} too, which may lower that"
        change = change_in_words(error.isel(lowest))
        lines.append(f"{describe_choice(choices, lowest)}: the error is {change}, but {why}.")
    if bool(choices.is_plain.isel(reference)) and not bool(choices.is_plain.isel(best)):
        lines.append(f"{describe_choice(choices, reference)}: the error is {change_in_words(error.isel(reference))}.")
    return lines
