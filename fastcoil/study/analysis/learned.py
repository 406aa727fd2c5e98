"""What a study of learning settings found: how often, how fast and how harmlessly they learn the backlash.

A setting is judged by what it does to the loops, not by their error alone: an estimate that is too high chatters long
before the error rises.  Where no setting is safe, what else there is was simulated on the same days: the plain PI,
``identify`` and a fixed estimate.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.loops.labels import sizes_in_words
from fastcoil.loops.loop import Loop, remove_rules
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import CHANCE_DIMS, ESTIMATOR_GROUPS, PARAMETERS
from fastcoil.study.analysis.selected import mask_dataset, swept_dims
from fastcoil.study.analysis.survival import time_quantiles

RIGHT_SHARE = 0.8  # of the days on which a recommended setting has to find the backlash
TOO_HIGH_SHARE = 0.05  # of the days on which its estimate may be too high at the end, in each condition
HARMLESS_CHANGE = 0.01  # of the median RMSE against the plain PI
HARMLESS_TRAVEL = 2.0  # motor travel over that of the plain PI
RELATIVE_TOLERANCE = 0.2  # of the backlash, to which an estimate is right, as time_identified has it
TOLERANCE = 0.01  # of the stroke, to which it is right as well
FIXED_SHARE = 0.95  # of the backlash, which a fixed estimate assumes
LEARNED_METRICS = ("time_identified", "estimate_settled", "backlash_final")
TIME_QUANTILES = {"time_q25": 0.25, "time_median": 0.5, "time_q75": 0.75}
_ESTIMATOR_PARAMETERS = [p.name for p in PARAMETERS.values() if p.group in ("estimator", *ESTIMATOR_GROUPS)]


def is_learning_study(loop: Loop) -> bool:
    """Whether settings of an estimator are swept."""
    return any(
        isinstance(loop[name], xr.DataArray) and not {*loop[name].dims} & {*CHANCE_DIMS}  # type: ignore[union-attr]
        for name in _ESTIMATOR_PARAMETERS
    )


def is_learning_result(ds: xr.Dataset) -> bool:
    """Whether a result is of such a study."""
    swept = {*swept_dims(ds)}
    names = [n for n in _ESTIMATOR_PARAMETERS if n in ds.coords and swept & {*ds[n].dims}]
    return bool(names) and {*LEARNED_METRICS} <= {*ds.data_vars}


def comparator_loops(loop: Loop) -> dict[str, Loop]:
    """Return the loops of a study without their estimator: with none, with ``identify``, with a fixed estimate."""
    defaults = {n: PARAMETERS[n].default for n in _ESTIMATOR_PARAMETERS if PARAMETERS[n].default is not None}
    changes: Any = {**defaults, "estimator": "none", "backlash_estimate": 0.0}
    rules = [name for name, rule in loop.rules.items() if rule.kind == "estimator"]
    plain = remove_rules(loop.assign(**changes), rules)
    return {
        "plain PI": plain,
        "identify": plain.assign(estimator="identify", estimate_share=FIXED_SHARE),
        f"a fixed estimate of {100 * FIXED_SHARE:.0f} % of the backlash": plain.assign(estimate_ratio=FIXED_SHARE),
    }


def describe_learning(ds: xr.Dataset) -> xr.Dataset:
    """Pool over chance how estimates did: shares that were right, too high and never right, times, the final error."""
    dims = swept_dims(ds)
    chance = [str(d) for d in ds["status"].dims if d not in dims]
    ok = ds["status"] == STATUS_OK
    values = mask_dataset(ds[[n for n in (*LEARNED_METRICS, "estimate_largest") if n in ds]], ok)
    true, final = values["backlash_final"], values["estimate_settled"]
    tolerance = np.maximum(RELATIVE_TOLERANCE * true, TOLERANCE)
    n = ok.sum(chance)
    is_right = values["time_identified"].notnull()
    table = {
        "share_right": is_right.sum(chance) / n,
        # the mean of the last hour may be too high although the end is right
        "share_too_high": ((final > true + tolerance) & ~is_right).sum(chance) / n,
        "final_error": abs(final - true).median(chance),
    }
    if "estimate_largest" in values:
        table["share_ever_too_high"] = (values["estimate_largest"] > true + tolerance).sum(chance) / n
    times = values["time_identified"]  # of a scenario that failed, never
    quantiles = time_quantiles(times, list(TIME_QUANTILES.values()), over=chance) if chance else None
    for k, name in enumerate(TIME_QUANTILES):
        table[name] = times.fillna(np.inf) if quantiles is None else quantiles.isel(quantile=k, drop=True)
        table[name].attrs = {"units": "s"}
    return xr.Dataset({name: v.transpose(*dims) for name, v in table.items()})


def format_comparators(simulate_loop: Callable[[Loop], xr.Dataset], loop: Loop) -> str:
    """Simulate the comparators of a study; return JSON of how they did in each condition, for its attributes."""
    results = {name: simulate_loop(each) for name, each in comparator_loops(loop).items()}
    parts = {}
    for name, ds in results.items():
        table = describe_learning(ds)
        chance = [d for d in ds["status"].dims if d not in swept_dims(ds)]
        for metric in ("rmse", "motor_travel"):
            table[metric] = ds[metric].where(ds["status"] == STATUS_OK).median(chance)
        parts[name] = table.to_dict()
    return json.dumps(parts)


def read_comparators(ds: xr.Dataset) -> dict[str, xr.Dataset]:
    """Return the comparators of a result over its conditions; none where it has none."""
    stored: Mapping[str, Any] = json.loads(ds.attrs.get("comparators", "{}"))
    return {name: xr.Dataset.from_dict(part) for name, part in stored.items()}


def is_better(
    comparator: xr.Dataset | None, plain: xr.Dataset | None, cell: xr.Dataset, error: xr.DataArray, travel: xr.DataArray
) -> bool:
    """Whether a comparator is right as often as a setting, at no more error and no more travel, over the plain PI."""
    if comparator is None or plain is None:
        return False
    own_error, own_travel = ((comparator[n] / plain[n]).median() for n in ("rmse", "motor_travel"))
    is_right_as_often = comparator["share_right"].mean() >= cell["share_right"].mean()
    return bool(is_right_as_often and own_error <= error.median() and own_travel <= travel.median())


def describe_time(table: xr.Dataset, n: float) -> str:
    """Describe when the estimates were right: ``half within 4.5 h; 2 of 10 never``."""
    median, never = float(table["time_median"]), round(n * (1.0 - float(table["share_right"])))
    text = f"half within {median / 3600.0:.2g} h" if np.isfinite(median) else "not half of them"
    return f"{text}; {never:,} of {round(n):,} never" if never else text


def describe_runs(ds: xr.Dataset) -> str:
    """Describe what the shares are of: ``days``, or ``days × replicates`` of chance."""
    sizes = {d: n for d, n in ds["status"].sizes.items() if d in CHANCE_DIMS and n > 1}
    return "days" if [*sizes] in ([], ["day"]) else sizes_in_words(sizes)
