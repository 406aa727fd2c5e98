"""Measures of a tuning over valves, days and noise realisations, and their intervals."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base import arguments
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import METRICS
from fastcoil.model.parameter_table import LARGEST_FLOAT

MEAN = "mean"
NOW = "now"
TRAVEL = "motor_travel"
HUNTS = "hunts"
HUNTING_INDEX = "hunting_index"  # of the describing function; it may be limited like a metric
CHANGE = "change"  # name of the variable with the change of the goal
AMOUNT_METRICS = tuple(m.name for m in METRICS.values() if not m.flags)
NOT_MINIMISED = {
    "estimate_final", "estimate_largest", "estimate_settled", "estimate_first_down", "size_error", "half_periods",
    "half_period_spread", "hunting_period", "swing_regularity", "coil_energy", "coil_peak_power", "water_volume",
    "condensate",
}  # fmt: skip
"""Metrics of which less is not better in itself: they may be limited, not minimised."""


class Measure(NamedTuple):
    """A metric and its quantile over valves and days; None for the mean."""

    metric: str
    quantile: float | None

    @property
    def name(self) -> str:
        """Name of the variable in a result, such as ``rmse_p95`` or ``hunts_mean``."""
        if self.quantile is None:
            return f"{self.metric}_mean"
        return f"{self.metric}_p{100 * self.quantile:.6g}".replace(".", "_").replace("-", "_")

    @property
    def words(self) -> str:
        """Label in tables."""
        statistic = "largest" if self.quantile == 1.0 else f"{100 * (self.quantile or 0.0):.6g} % quantile"
        statistic = "mean" if self.quantile is None else statistic
        return f"{quantity(self.metric).axis}, {statistic}"

    @property
    def attrs(self) -> dict[str, str]:
        """Attributes of its variable in a result."""
        return {"long_name": self.words, "units": METRICS[self.metric].unit if self.metric in METRICS else "1"}

    def format_value(self, value: float) -> str:
        """Format a value for tables and sentences."""
        return quantity(self.metric).number(value) if math.isfinite(value) else "–"

    def evaluate(self, values: Array) -> Array:
        """Return the least values that a share ``quantile`` of (…, n) does not exceed, or the mean; NaN is infinite."""
        values = np.where(np.isnan(values), np.inf, values)
        if self.quantile is None:
            return np.asarray(values.mean(axis=-1))
        n = values.shape[-1]
        place = min(max(math.ceil(self.quantile * n - 1e-9) - 1, 0), n - 1)
        return np.asarray(np.partition(values, place, axis=-1)[..., place])


SHARE_THAT_HUNTS = Measure(HUNTS, None)


class Limit(NamedTuple):
    """An upper limit of a measure; as_now: that of the loop as it is, infinite until it is known."""

    measure: Measure
    most: float
    as_now: bool = False


def parse_goal(objective: object, quantile: object) -> Measure:
    """Convert the goal of a search to a measure."""
    metric = arguments.require_choice("objective", objective, AMOUNT_METRICS)
    if metric in NOT_MINIMISED:
        cure = "less of it is not better; choose rmse or share_off or motor_travel or reversals"
        raise InputError(f"objective = {short_repr(metric)}: {cure}", "objective", "choice")
    return Measure(metric, parse_quantile("quantile", quantile))


def parse_quantile(name: str, quantile: object) -> float | None:
    """Convert a share of cases above 0 and at most 1; None for ``"mean"``."""
    cure = f'give a share of valves and days above 0 and up to 1, such as 0.95, or "{MEAN}"'
    if isinstance(arguments.to_builtin(quantile), str):
        if arguments.to_builtin(quantile) != MEAN:
            raise InputError(f"{name} = {short_repr(quantile)}: {cure}", name, "choice")
        return None
    return arguments.require_number(name, quantile, cure, least=math.nextafter(0.0, 1.0), most=1.0)


def parse_limits(limits: object, quantile: object) -> list[Limit]:
    """Convert ``{metric: most}`` or ``{metric: (most, quantile)}``; the default quantile is the objective's."""
    cure = 'give upper limits by metric, such as {"motor_travel": 20.0} or {"hunts": (0.05, "mean")}'
    items: Mapping[str, Any] = arguments.require_mapping("limits", {} if limits is None else limits, cure)
    cure = f'give a number, "{NOW}" for what the loop does now, or a pair such as (0.05, "{MEAN}")'
    parsed = []
    with arguments.argument_checks() as check:
        for metric, value in items.items():
            check(arguments.require_choice, "limits: metric", metric, (*AMOUNT_METRICS, HUNTING_INDEX))
            has_quantile = isinstance(value, (list, tuple)) and len(value) == 2
            most, share = value if has_quantile else (value, quantile)
            if has_quantile:
                share = check(parse_quantile, f"limits: quantile of {metric}", share)
            else:  # a mistake in the quantile of the objective is reported there
                share = float(arguments.to_builtin(share)) if arguments.is_number(share) else None
            as_now = isinstance(arguments.to_builtin(most), str) and arguments.to_builtin(most) == NOW
            is_share = metric in METRICS and quantity(metric).factor == 100.0  # shown in per cent
            words, high = (f"{cure}; a share is at most 1: 5 % is 0.05", 1.0) if is_share else (cure, LARGEST_FLOAT)
            most = math.inf if as_now else check(arguments.require_number, f"limits: {metric}", most, words, most=high)
            parsed.append(Limit(Measure(metric, share), most, as_now))
        check.problems = [Problem(p, p.field.rpartition(" ")[2], p.code) for p in InputError(check.problems).problems]
    return parsed


def reported_measures(goal: Measure, limits: Sequence[Limit]) -> list[Measure]:
    """List the measures of a result: the goal, the limits, and always an error, the travel and the share that hunts."""
    error = [] if goal.metric != TRAVEL else [Measure("rmse", goal.quantile)]
    measures = [goal, *error, *(limit.measure for limit in limits)]
    travel = [] if TRAVEL in [m.metric for m in measures] else [Measure(TRAVEL, goal.quantile)]
    return list(dict.fromkeys([*measures, *travel, SHARE_THAT_HUNTS]))


def resolve_limits(limits: Sequence[Limit], current: Mapping[str, Array]) -> tuple[Limit, ...]:
    """Fill in the values of the loop as it is, (1,) each, in the limits that are those."""
    return tuple(each._replace(most=float(current[each.measure.name][0])) if each.as_now else each for each in limits)


def violation(limits: Sequence[Limit], values: Mapping[str, Array]) -> Array:
    """Sum of the excesses of the measures over their limits, relative to these; 0 where all hold; values: (n,)."""
    total: Array = np.zeros(next(iter(values.values())).shape)
    for limit in limits:
        value = values[limit.measure.name]
        with np.errstate(invalid="ignore"):  # an infinite limit is kept by an infinite value
            total = total + np.where(value <= limit.most, 0.0, (value - limit.most) / (abs(limit.most) or 1.0))
    return total


def with_intervals(cases: Mapping[str, Array], measures: Sequence[Measure], labels: list[str], seed: int) -> xr.Dataset:
    """Return measures along ``tuning`` and ``edge`` from metrics (tuning, day, valve, replicate).

    The 95 % interval is by bootstrap over valves and days independently (Owen 2007, doi:10.1214/07-AOAS122); all
    tunings get the same draws, so that ``change`` against the first is one of pairs.  A single day shows no scatter
    between days; a single valve on a single day has no interval: NaN.
    """
    n, days, valves = next(iter(cases.values())).shape[:3]
    rng = np.random.default_rng([seed, 3])
    n_draws = 0 if days == valves == 1 else 400
    draws = [(rng.integers(0, days, days), rng.integers(0, valves, valves)) for _ in range(n_draws)]
    ds = xr.Dataset(coords={"tuning": labels, "edge": ["value", "low", "high"]})
    resampled: dict[str, Array] = {}
    for measure in measures:
        values = cases[measure.metric]
        of_draws = [measure.evaluate(values[:, d][:, :, v].reshape(n, -1)) for d, v in draws]
        resampled[measure.name] = np.stack(of_draws, axis=1) if draws else np.empty((n, 0))
        edges = _value_and_interval(measure.evaluate(values.reshape(n, -1)), resampled[measure.name])
        ds[measure.name] = (("tuning", "edge"), edges, measure.attrs)
    goal = measures[0]
    value = ds[goal.name].values[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):  # of something infinite or 0 there is no share
        change = _value_and_interval(value / value[0] - 1.0, resampled[goal.name] / resampled[goal.name][:1] - 1.0)
    words = f"{quantity(goal.metric).text} against that of {labels[0]}, as a share"
    ds[CHANGE] = (("tuning", "edge"), change, {"long_name": words, "units": "1"})
    return ds


def _value_and_interval(value: Array, resampled: Array) -> Array:
    """Value and 95 % interval, (n, 3), from values (n,) and draws (n, n_draws), by order: some may be infinite."""
    if not resampled.shape[1]:
        return np.stack([value, np.full_like(value, np.nan), np.full_like(value, np.nan)], axis=1)
    # as 0.5 ± 0.5 * 0.95 in binary
    low, high = (np.quantile(resampled, tail, axis=1, method="nearest") for tail in (0.5 - 0.475, 0.5 + 0.475))
    return np.stack([value, low, high], axis=1)
