"""``answer``: what a study says to do, what that brings and costs, and where it fails.

Every sentence quotes ``Answer.table``: metrics over the swept axes, pooled over chance (days, drawn valves, noise)
alone.  A swept axis is a *choice*, which a controller is free to make, or a *condition*, which the plant sets; the
recommended choice is judged in every condition.
"""

from __future__ import annotations

import json
import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import to_builtin
from fastcoil.base.text import format_share
from fastcoil.loops.labels import coordinate_quantity, is_parameter, label_in_words, plain_pi_label, quantity
from fastcoil.loops.scenarios import check_counted_result
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import CHANCE_DIMS, PARAMETERS
from fastcoil.study.analysis.compare import mask_off_days
from fastcoil.study.analysis.paired import paired_change
from fastcoil.study.analysis.selected import mask_dataset
from fastcoil.study.analysis.sobol import sobol_indices

TRAVEL_LIMIT = 2.0  # motor travel over that of the best plain PI up to which a choice is recommended
HUNTING_LIMIT = 0.05  # share of the scenarios of a condition that may hunt with a recommended choice
SIMILAR_ERROR = 1.05  # RMSE over the lowest up to which the simpler choice, or the one of less travel, is recommended
LEAST_GAIN = 0.01  # a smaller change of the RMS error is none
CALM_ERROR = 1.25  # RMSE over the lowest up to which a plain PI of little travel sets the limit of travel
BUFFER_PER_NOISE = 6.0  # of a buffer over kp times noise, docs/findings/remedies.md
LEAST_BUFFER = 0.01  # of the stroke, where the noise asks for less

PLANT_GROUPS = ("coil", "valve", "actuator", "sensor")  # of parameters that a controller cannot choose
PLAIN_PI_VALUES: Mapping[str, Any] = {
    "estimate_ratio": 0.0, "backlash_estimate": 0.0, "learning_step": 0.0, "estimator": "none", "law": "pi",
}  # fmt: skip
"""What makes a controller a plain PI, where it varies."""
TABLE_METRICS = ("rmse", "hunts", "hunting_swing", "motor_travel", "switch_frequency")


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
        from html import escape

        heads = [line.split(": ", 1) for line in [f"Asked: {self.question}", *self.summary()]]
        rows = "".join(f"<tr><th>{escape(head)}</th><td>{escape(text)}</td></tr>" for head, text in heads if text)
        return f"<table>{rows}</table>"

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


# --- the table --------------------------------------------------------------------------------------------------------


def swept_dims(ds: xr.Dataset) -> list[str]:
    """Return the dims that were swept, with at least two labels; not those of chance."""
    return [str(d) for d in ds["status"].dims if ds.sizes[d] > 1 and d not in CHANCE_DIMS and d in ds.coords]


def condition_dims(ds: xr.Dataset) -> set[Hashable]:
    """Return the dims along which the plant differs."""
    return {d for n in ds.coords if n in PARAMETERS and PARAMETERS[str(n)].group in PLANT_GROUPS for d in ds[n].dims}


def mask_plain_pi(ds: xr.Dataset) -> xr.DataArray:
    """Mark the plain PIs, over the dims along which only some controllers are one; a scalar where none differ."""
    is_plain, stored = xr.DataArray(True), json.loads(ds.attrs.get("parameters", "{}"))
    varied = [n for n in PLAIN_PI_VALUES if n in ds.coords and ds[n].ndim and not {*ds[n].dims} & {*CHANCE_DIMS}]
    for name in varied:
        is_plain = is_plain & (ds[name] == PLAIN_PI_VALUES[name])
    replaced = {"estimate_ratio": "backlash_estimate", "backlash_estimate": "estimate_ratio"}
    for name, value in PLAIN_PI_VALUES.items():
        given = ds[name].values.item() if name in ds.coords and ds[name].ndim == 0 else stored.get(name)
        if name not in varied and replaced.get(name) not in varied and given not in (None, value):
            is_plain = is_plain & False
    return is_plain.reset_coords(drop=True)


def make_table(ds: xr.Dataset) -> xr.Dataset:
    """Pool metrics over chance, and compare each cell with its partners under a plain PI."""
    dims = swept_dims(ds)
    chance = [d for d in ds["status"].dims if d not in dims]
    ds = mask_off_days(ds[[n for n in (*TABLE_METRICS, "status") if n in ds]])
    ds = mask_dataset(ds.drop_vars("status"), ds["status"] == STATUS_OK).assign_attrs(ds.attrs)
    pooled = {n: v.mean(chance) if n == "hunts" else v.median(chance) for n, v in ds.data_vars.items()}
    for name, q in (("rmse_q05", 0.05), ("rmse_q95", 0.95)):
        pooled[name] = ds["rmse"].quantile(q, chance).drop_vars("quantile")
    pooled["n"] = ds["rmse"].notnull().sum(chance)
    at = plain_place(ds)
    if at:
        partner = ds.isel(at, drop=True)
        change = paired_change(ds["rmse"], partner["rmse"])
        pooled["rmse_change"] = change.median(chance)
        pooled["share_lower"] = (change < 0.0).where(change.notnull()).mean(chance)
        if "motor_travel" in ds:
            ratio = ds["motor_travel"] / partner["motor_travel"].where(partner["motor_travel"] > 0.0)
            pooled["travel_ratio"] = ratio.median(chance)
    coords = {n: c for n, c in ds.coords.items() if {*c.dims} <= {*dims}}
    table = xr.Dataset({n: v.transpose(*dims) for n, v in pooled.items()}, coords=coords)
    for name in table.data_vars:
        table[name].attrs = dict(ds[name].attrs) if name in ds else {}
    return table.assign_attrs({n: ds.attrs[n] for n in ("title", "summary", "parameters") if n in ds.attrs})


def plain_place(ds: xr.Dataset) -> dict[str, int]:
    """Return the place of the plain PI along the dims of the controllers; empty where there is none, or several."""
    is_plain = mask_plain_pi(ds)
    if is_plain.ndim == 0 or int(is_plain.sum()) != 1:
        return {}
    return {str(d): int(k) for d, k in zip(is_plain.dims, np.argwhere(is_plain.values)[0], strict=True)}


# --- the choice -------------------------------------------------------------------------------------------------------


class Choices:
    """The choices of a study and how they do: relative error, travel and hunting, over the conditions together."""

    def __init__(self, table: xr.Dataset) -> None:
        self.table, self.conditions = table, condition_dims(table)
        self.dims = [str(d) for d in table["rmse"].dims if d not in self.conditions]
        self.over = [d for d in table["rmse"].dims if d in self.conditions]
        rmse = table["rmse"]
        # relative to the best choice of each condition, so that every condition counts alike
        self.error = (rmse / rmse.min(self.dims)).mean(self.over).fillna(np.inf)
        hunts = table["hunts"] if "hunts" in table else xr.zeros_like(rmse)
        self.hunting = hunts.max(self.over).fillna(np.inf)
        self.is_plain = mask_plain_pi(table).broadcast_like(self.error)
        self.reference = self._find_reference()
        self.travel = self._travel_ratio()

    def _find_reference(self) -> dict[str, int]:
        """Find the plain PI with the least travel of those whose error is near the best; without one, of all."""
        candidates = self._calm(self.is_plain if bool(self.is_plain.any()) else xr.ones_like(self.is_plain))
        lowest = self.error.where(candidates).min()
        near = candidates & (self.error <= CALM_ERROR * lowest)
        if "motor_travel" not in self.table:
            return self._lowest(self.error, near)
        return self._lowest(self.table["motor_travel"].median(self.over), near)

    def _calm(self, mask: xr.DataArray) -> xr.DataArray:
        least = float(self.hunting.where(mask).min())
        return mask & (self.hunting <= max(HUNTING_LIMIT, least + HUNTING_LIMIT))

    def _travel_ratio(self) -> xr.DataArray:
        if "motor_travel" not in self.table:
            return xr.ones_like(self.error)
        travel = self.table["motor_travel"]
        reference = travel.isel(self.reference, drop=True)
        return (travel / reference.where(reference > 0.0)).median(self.over).fillna(np.inf)

    def _lowest(self, values: xr.DataArray, mask: xr.DataArray) -> dict[str, int]:
        place = values.where(mask, np.inf).argmin(self.dims)
        return {str(d): int(k) for d, k in place.items()}

    @property
    def best(self) -> dict[str, int]:
        """The lowest error within the limits of travel and hunting; of similar ones a plain PI, then least travel."""
        allowed = self._calm(self.travel <= TRAVEL_LIMIT)
        near = allowed & (self.error <= SIMILAR_ERROR * self.error.where(allowed).min())
        plain = near & self.is_plain
        return self._lowest(self.travel, plain if bool(plain.any()) else near)

    @property
    def unlimited(self) -> dict[str, int]:
        """The lowest error of all."""
        return self._lowest(self.error, xr.ones_like(self.is_plain))


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

    See Also
    --------
    compare : differences within pairs, with intervals.
    sobol_indices : which parameters drive the spread.

    Examples
    --------
    >>> import fastcoil as fc
    >>> day = fc.paper_day(hours=0.6, seed=[1, 2])
    >>> ds = fc.simulate(fc.Loop(backlash_estimate=[0.0, 0.0665]), day, warm_up=600, n_jobs=1)
    >>> dict(fc.answer(ds).table.sizes)
    {'backlash_estimate': 2}
    """
    check_counted_result(results)
    question = " ".join(str(results.attrs.get("summary") or results.attrs.get("title", "")).split())
    if not bool((results["status"] == STATUS_OK).any()) or "rmse" not in results:
        return Answer(question, {}, "every scenario failed: there is no answer.")
    if not bool(results["rmse"].notnull().any()):
        return Answer(question, {}, "no RMS error is known.")
    if "design" in results["status"].dims:
        return _answer_drivers(question, results)
    table = make_table(results)
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


def _answer_single(question: str, table: xr.Dataset) -> Answer:
    """Describe a single scenario: its error, whether it hunts, and the travel of the motor."""
    sentence = f"the RMS error is {float(table['rmse']):.3g} K"
    if "hunts" in table and "hunting_swing" in table:
        swing = f"{float(table['hunting_swing']):.2g} K peak to peak"
        sentence += f"; the loop hunts, {swing}" if float(table["hunts"]) else "; the loop does not hunt"
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
    travel = f"the motor travels {float(table['motor_travel'].median()):.3g} strokes (median)."
    costs = travel if "motor_travel" in table else ""
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
    values = {}
    for dim, k in place.items():
        along = {str(n): c for n, c in table.coords.items() if c.dims == (dim,) and is_parameter(table, n)}
        along = {n: c for n, c in along.items() if len(set(c.values.tolist())) > 1}
        values |= {n: to_builtin(c.values[k]) for n, c in along.items()} or {dim: to_builtin(table[dim].values[k])}
    return {n: v for n, v in values.items() if not (isinstance(v, float) and math.isnan(v))}


def describe_choice(choices: Choices, place: Mapping[str, int]) -> str:
    """Describe a choice in words: gains, then the inverse or the plain PI."""
    table, inverse, rest = choices.table, "", dict(place)
    for dim in ("estimate_ratio", "backlash_estimate"):
        if dim in rest and choices.is_plain.ndim:
            k = rest.pop(dim)
            of_what = " of the backlash" if dim == "estimate_ratio" else ""
            size = f"{coordinate_quantity(table, dim).number(float(table[dim].values[k]))}{of_what}"
            inverse = (
                f"an inverse with an estimate of {size}" if table[dim].values[k] else f"the {plain_pi_label(table)}"
            )
    words = ", ".join(filter(None, [describe_labels_at(table, rest)]))
    return f"take {' and '.join(filter(None, [words, inverse]))}"


def describe_labels_at(ds: xr.Dataset | xr.DataArray, at: Mapping[str, int]) -> str:
    """Describe labels in words: named alternatives by the parameters that differ, where all of these are numbers."""
    words = []
    for dim, k in at.items():
        along = {str(n): c.values for n, c in ds.coords.items() if c.dims == (dim,) and n in PARAMETERS}
        along = {n: v for n, v in along.items() if np.unique(v).size > 1 and (n != "error_dead_band" or v[k] > 0.0)}
        if along and all(values.dtype.kind in "if" for values in along.values()):
            words += [coordinate_quantity(ds, n).equals(float(values[k])) for n, values in along.items()]
        else:
            words.append(label_in_words(ds, dim, k))
    return ", ".join(words)


def _describe_gain(choices: Choices, best: Mapping[str, int]) -> str:
    """Describe the error of a choice, against the plain PI of the same loop and against the other choices."""
    table, cell = choices.table, choices.table.isel(best, drop=True)
    text = f"the RMS error is {_format_range(cell['rmse'])}"
    if "rmse_change" in table and not bool(choices.is_plain.isel(best)):
        lower = format_share(float(cell["share_lower"].mean()))
        change = _format_change(float(cell["rmse_change"].median()))
        text += f", {change} than with the {plain_pi_label(table)} of the same loop (median), and lower in {lower}"
    worst = choices.error.where(np.isfinite(choices.error)).argmax(choices.dims)
    ratio = float(choices.error.isel(worst) / choices.error.isel(best))
    words = describe_labels_at(table, {str(d): int(k) for d, k in worst.items()})
    return text + (f"; the worst choice, {words}, has {ratio:.2g} times this error." if ratio > 1.05 else ".")


def _describe_costs(choices: Choices, best: Mapping[str, int]) -> str:
    table, cell, parts = choices.table, choices.table.isel(best, drop=True), []
    if "motor_travel" in table:
        parts.append(f"the motor travels {_format_range(cell['motor_travel'], 'strokes')}")
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
        error = _format_change(float((over["rmse"] / cell["rmse"]).median()) - 1.0)
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
        lower = _format_change(1.0 / float(regret.max()) - 1.0)
        parts.append(f"at {describe_labels_at(cell, at)} {describe_choice(choices, other)[5:]} has an error {lower}")
    return parts


def _largest(values: xr.DataArray) -> dict[str, int]:
    return {str(d): int(k) for d, k in values.fillna(-np.inf).argmax([*values.dims]).items()}


def _describe_alternatives(choices: Choices, best: Mapping[str, int]) -> list[str]:
    """Describe the choice of lowest error, where it costs too much, and the best plain PI, where it is simpler."""
    lines, lowest, reference = [], choices.unlimited, choices.reference
    if float(choices.error.isel(best) / choices.error.isel(lowest)) > SIMILAR_ERROR:
        change = _format_change(float(choices.error.isel(lowest) / choices.error.isel(best)) - 1.0)
        why = f"the motor travels {float(choices.travel.isel(lowest)):.3g} times as far as the best plain PI's"
        if float(choices.hunting.isel(lowest)) > HUNTING_LIMIT:
            why += f", and up to {format_share(float(choices.hunting.isel(lowest)))} of the loops hunt"
        line = f"{describe_choice(choices, lowest)}: the error is {change}, but {why}"
        if not bool(choices.is_plain.isel(lowest)) and plain_pi_label(choices.table) == "plain PI":
            size = _buffer_size(choices.table, lowest)
            line += f"; a buffer of {100.0 * size:.2g} % of the stroke lowers that: sweep buffer = {size:.2g} too"
        lines.append(f"{line}.")
    if dict(best) != reference and bool(choices.is_plain.isel(reference)):
        change = _format_change(float(choices.error.isel(reference) / choices.error.isel(best)) - 1.0)
        lines.append(f"{describe_choice(choices, reference)}: the error is {change}.")
    return lines


def _buffer_size(table: xr.Dataset, place: Mapping[str, int]) -> float:
    """Return the buffer that noise asks for, docs/findings/remedies.md; the largest of the choice."""
    stored = json.loads(table.attrs.get("parameters", "{}"))
    values = [table.coords[n] if n in table.coords else xr.DataArray(stored.get(n, 0.0)) for n in ("kp", "noise_std")]
    kp, noise = (float(v.isel({d: k for d, k in place.items() if d in v.dims}).max()) for v in values)
    return float(f"{max(BUFFER_PER_NOISE * kp * noise, LEAST_BUFFER):.2g}")


def _format_range(values: xr.DataArray, unit: str = "K") -> str:
    """Format a median, and its range over the conditions where it varies."""
    low, middle, high = (float(v) for v in (values.min(), values.median(), values.max()))
    over = f" ({low:.3g} to {high:.3g} over the conditions)" if values.ndim and f"{low:.3g}" != f"{high:.3g}" else ""
    return f"{middle:.3g} {unit}{over}"


def _format_change(change: float) -> str:
    return f"{100.0 * abs(change):.0f} % {'lower' if change < 0.0 else 'higher'}"
