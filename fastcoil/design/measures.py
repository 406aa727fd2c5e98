"""Measures of a tuning over valves, days and noise realisations, and their intervals."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import (
    argument_checks,
    is_number,
    require_choice,
    require_mapping,
    require_number,
    to_builtin,
)
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, short_repr
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import METRICS

MEAN, NOW = "mean", "now"
_LIMIT_CURE = f'give a number, "{NOW}" for what the loop does now, or a pair such as (0.05, "{MEAN}")'
TRAVEL, HUNTS = "motor_travel", "hunts"
_EXAMPLE_GOALS = ("rmse", "share_off", "motor_travel", "reversals")  # examples of what less is better of
AMOUNT_METRICS = tuple(m.name for m in METRICS.values() if not m.flags)  # metrics that are amounts
HUNTING_INDEX = "hunting_index"  # the hunting index of the describing function, which may be limited like a metric
NOT_MINIMISED = frozenset(
    (
        "estimate_final", "estimate_settled", "estimate_first_down", "size_error", "half_periods",
        "half_period_spread", "hunting_period", "coil_energy", "coil_peak_power", "water_volume", "condensate",
    )
)  # fmt: skip
"""Metrics of which less is not better in itself: they may be limited, not sought."""


class Measure(NamedTuple):
    """A metric and the share of valves and days that it covers; ``quantile`` None: the mean of them."""

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
        """What a table calls it."""
        statistic = "largest" if self.quantile == 1.0 else f"{100 * (self.quantile or 0.0):.6g} % quantile"
        statistic = "mean" if self.quantile is None else statistic
        return f"{quantity(self.metric).axis}, {statistic}"

    @property
    def attrs(self) -> dict[str, str]:
        """Attributes of its variable in a result."""
        return {"long_name": self.words, "units": METRICS[self.metric].unit if self.metric in METRICS else "1"}

    def shown(self, value: float) -> str:
        """A value as tables and sentences give it."""
        return quantity(self.metric).number(value) if math.isfinite(value) else "–"

    def of(self, values: Array) -> Array:
        """The measure of (…, n) values: the least one that a share ``quantile`` of them does not exceed, or their mean.

        NaN, a failed scenario or something that never happened, counts as infinite; the order needs no arithmetic.
        """
        values = np.where(np.isnan(values), np.inf, values)
        if self.quantile is None:
            return np.asarray(values.mean(axis=-1))
        n = values.shape[-1]
        place = min(max(math.ceil(self.quantile * n - 1e-9) - 1, 0), n - 1)
        return np.asarray(np.partition(values, place, axis=-1)[..., place])


class Limit(NamedTuple):
    """An upper limit of a measure; ``as_now``: what the loop does now, infinite until that is known."""

    measure: Measure
    most: float
    as_now: bool = False


def parse_goal(objective: object, quantile: object) -> Measure:
    """The measure that the search makes small."""
    metric = require_choice("objective", objective, AMOUNT_METRICS)
    if metric in NOT_MINIMISED:
        raise InputError(
            f"objective = {short_repr(metric)}: less of it is not better; choose {' or '.join(_EXAMPLE_GOALS)}"
        )
    return Measure(metric, parse_quantile("quantile", quantile))


def parse_quantile(name: str, quantile: object) -> float | None:
    """A share of cases, above 0 and at most 1, or ``"mean"``: None."""
    cure = f'give a share of valves and days above 0 and up to 1, such as 0.95, or "{MEAN}"'
    if isinstance(to_builtin(quantile), str):
        if to_builtin(quantile) != MEAN:
            raise InputError(f"{name} = {short_repr(quantile)}: {cure}")
        return None
    return require_number(name, quantile, cure, least=math.nextafter(0.0, 1.0), most=1.0)


def parse_limits(limits: object, quantile: object) -> list[Limit]:
    """The limits from ``{metric: most}`` or ``{metric: (most, quantile)}``; alone, the quantile is the objective's."""
    cure = 'give upper limits by metric, such as {"motor_travel": 20.0} or {"hunts": (0.05, "mean")}'
    limit_by_metric: Mapping[str, Any] = require_mapping("limits", {} if limits is None else limits, cure)
    parsed = []
    with argument_checks() as check:
        for metric, value in limit_by_metric.items():
            check(require_choice, "limits: metric", metric, (*AMOUNT_METRICS, HUNTING_INDEX))
            has_quantile = isinstance(value, (list, tuple)) and len(value) == 2
            most, share = value if has_quantile else (value, quantile)
            if has_quantile:
                share = check(parse_quantile, f"limits: quantile of {metric}", share)
            else:  # a mistake in the quantile of the objective is reported there
                share = float(to_builtin(share)) if is_number(share) else None
            as_now = isinstance(to_builtin(most), str) and to_builtin(most) == NOW
            most = math.inf if as_now else check(require_number, f"limits: {metric}", most, _LIMIT_CURE)
            parsed.append(Limit(Measure(metric, share), most, as_now))
    return parsed


def reported_measures(goal: Measure, limits: Sequence[Limit]) -> list[Measure]:
    """Every measure that a result has: the goal, the limits, and always an error, the travel and who hunts."""
    error_measures = [] if goal.metric != TRAVEL else [Measure("rmse", goal.quantile)]
    measures = [goal, *error_measures, *(limit.measure for limit in limits)]
    always = (Measure(TRAVEL, goal.quantile), Measure(HUNTS, None))
    measures += [measure for measure in always if measure.metric not in [m.metric for m in measures]]
    return list(dict.fromkeys(measures))


def resolve_limits(limits: Sequence[Limit], current: Mapping[str, Array]) -> tuple[Limit, ...]:
    """The limits with what the loop does now, (1,) each, where that is the limit."""
    return tuple(
        limit._replace(most=float(current[limit.measure.name][0])) if limit.as_now else limit for limit in limits
    )


def violation(limits: Sequence[Limit], values: Mapping[str, Array]) -> Array:
    """By how much of each limit the measures exceed it, added up; 0 where all hold.  values: (n,) each."""
    total: Array = np.zeros(next(iter(values.values())).shape)
    for limit in limits:
        value = values[limit.measure.name]
        scale = abs(limit.most) or 1.0
        with np.errstate(invalid="ignore"):  # an infinite limit is kept by an infinite value
            total = total + np.where(value <= limit.most, 0.0, (value - limit.most) / scale)
    return total


EDGES = ("value", "low", "high")
CHANGE = "change"
_CONFIDENCE_LEVEL = 0.95
_N_BOOTSTRAP_DRAWS = 400


def with_intervals(
    cases: Mapping[str, Array], measures: Sequence[Measure], tunings: Sequence[str], seed: int
) -> xr.Dataset:
    """Measures along ``tuning`` and ``edge`` from metrics (tuning, day, valve, replicate).

    The interval is that of the bootstrap: valves and days are drawn anew, each on their own, since every valve meets
    every day (Owen 2007, doi:10.1214/07-AOAS122); all tunings get the same draws, so that ``change``, that of the first
    measure against the first tuning, is one of pairs.  A single day shows no scatter between days, and the interval
    then holds none; a single valve on a single day has no interval: NaN.
    """
    first_cases = next(iter(cases.values()))
    n, days, valves = first_cases.shape[:3]
    rng = np.random.default_rng([seed, 3])
    n_draws = 1 if days == valves == 1 else _N_BOOTSTRAP_DRAWS
    draws = [(rng.integers(0, days, days), rng.integers(0, valves, valves)) for _ in range(n_draws)]
    ds = xr.Dataset(coords={"tuning": list(tunings), "edge": list(EDGES)})
    resampled: dict[str, Array] = {}
    for measure in measures:
        values = cases[measure.metric]
        resampled[measure.name] = np.stack([measure.of(values[:, d][:, :, v].reshape(n, -1)) for d, v in draws], axis=1)
        edges = _value_and_interval(measure.of(values.reshape(n, -1)), resampled[measure.name])
        ds[measure.name] = (("tuning", "edge"), edges, measure.attrs)
    goal = measures[0]
    value = ds[goal.name].values[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):  # of something infinite or 0 there is no share
        change = _value_and_interval(value / value[0] - 1.0, resampled[goal.name] / resampled[goal.name][:1] - 1.0)
    change_text = f"{quantity(goal.metric).text} against that of {tunings[0]}, as a share"
    ds[CHANGE] = (("tuning", "edge"), change, {"long_name": change_text, "units": "1"})
    return ds


def _value_and_interval(value: Array, resampled: Array) -> Array:
    """Value and interval, (n, 3), from values (n,) and draws (n, n_draws), by order: some may be infinite."""
    tails = (0.5 - 0.5 * _CONFIDENCE_LEVEL, 0.5 + 0.5 * _CONFIDENCE_LEVEL)
    if resampled.shape[1] < _N_BOOTSTRAP_DRAWS:
        return np.stack([value, np.full_like(value, np.nan), np.full_like(value, np.nan)], axis=1)
    low, high = (np.quantile(resampled, tail, axis=1, method="nearest") for tail in tails)
    return np.stack([value, low, high], axis=1)
