"""When a claim holds: for one tuning on one day, from the Datasets of the grid.

Every function reads a Dataset with the dims ``tuning``, ``case`` and, where there are days, ``kind`` and ``day``.  It
returns a boolean over the other dims, or numbers over them by name and unit.  In a failed scenario no claim holds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.paper.grid import RATIOS, case
from fastcoil.study.paper.runs import BACKLASH, STEP, THREE_HOURS

Holds = Callable[[xr.Dataset], xr.DataArray]
Numbers = Callable[[xr.Dataset], dict[str, xr.DataArray]]


def at(metric: str, *cases: str) -> Numbers:
    """Return a function that looks up a metric in these cases."""
    unit = {
        "rmse": "K",
        "rmse_settled": "K",
        "switch_frequency": "per 10 min",
        "swing": "K",
        "motor_travel": "strokes",
    }[metric]
    text = {
        "rmse": "RMSE",
        "rmse_settled": "settled RMSE",
        "switch_frequency": "switches",
        "swing": "peak to peak",
        "motor_travel": "motor travel",
    }
    return lambda ds: {f"{text[metric]}, {c} [{unit}]": ds[metric].sel(case=c, drop=True) for c in cases}


def _of(ds: xr.Dataset, metric: str, name: str) -> xr.DataArray:
    return ds[metric].sel(case=name, drop=True)


def hunts_with_backlash_only(ds: xr.Dataset) -> xr.DataArray:
    """The loop hunts on the quiet day with the backlash, and not without."""
    return ds["hunts"].sel(case="plain PI", drop=True) & ~ds["hunts"].sel(case="no backlash", drop=True)


def error_doubles(ds: xr.Dataset) -> xr.DataArray:
    """The settled error with the backlash is more than twice that without."""
    return _of(ds, "rmse_settled", "plain PI") > 2.0 * _of(ds, "rmse_settled", "no backlash")


def sixty_helps_but_not_enough(ds: xr.Dataset) -> xr.DataArray:
    """The settled error at 60 % lies between those of the plain PI and of the exact inverse."""
    none, sixty, exact = (_of(ds, "rmse_settled", c) for c in ("plain PI", "60 %", "100 %"))
    return (sixty < none) & (sixty > exact)


def ninety_five_is_almost_perfect(ds: xr.Dataset) -> xr.DataArray:
    """The inverse of 95 % leaves at most a tenth of what the backlash adds."""
    without, plain, inverse = (_of(ds, "rmse_settled", c) for c in ("no backlash", "plain PI", "95 %"))
    return inverse - without <= 0.1 * (plain - without)


def exact_inverse_is_unity(ds: xr.Dataset) -> xr.DataArray:
    """The settled error of the exact inverse is within 5 % of that without backlash."""
    without, exact = _of(ds, "rmse_settled", "no backlash"), _of(ds, "rmse_settled", "100 %")
    return abs(exact - without) <= 0.05 * without


def error_falls_up_to_the_backlash(ds: xr.Dataset) -> xr.DataArray:
    """Every step of the estimate towards the backlash lowers the error."""
    errors = ds["rmse"].sel(case=[case(r) for r in RATIOS if r in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)])
    return (errors.diff("case") < 0.0).all("case")


def lower_error(name: str, other: str) -> Holds:
    """Return the claim that the RMSE of one case is over 1 % lower than that of another."""
    return lambda ds: _of(ds, "rmse", name) < 0.99 * _of(ds, "rmse", other)


def error_and_travel(*cases: str) -> Numbers:
    """Return a function that looks up the RMSE and the motor travel in these cases."""
    return lambda ds: at("rmse", *cases)(ds) | at("motor_travel", *cases)(ds)


def rises_beyond(metric: str) -> Holds:
    """Return the claim that an error is over 1 % larger at 120 % than at 100 %."""
    return lambda ds: _of(ds, metric, "120 %") > 1.01 * _of(ds, metric, "100 %")


def best_estimate(ds: xr.Dataset) -> dict[str, xr.DataArray]:
    """Find the relative estimate with the lowest error."""
    best = ds["rmse"].sel(case=[case(r) for r in RATIOS]).fillna(np.inf).argmin("case")
    return {
        "estimate of the lowest RMSE [% of the backlash]": 100.0 * xr.DataArray(np.array(RATIOS), dims="case")[best]
    }


def best_at_or_just_below(ds: xr.Dataset) -> xr.DataArray:
    """Of all estimates, one from 90 to 100 % has the lowest error."""
    (best,) = best_estimate(ds).values()
    return (best >= 90.0) & (best <= 100.0) & ds["rmse"].notnull().all("case")


def switches_flat_below(ds: xr.Dataset) -> xr.DataArray:
    """Below the backlash the switch frequency varies by a factor of at most 1.5."""
    below = ds["switch_frequency"].sel(case=[case(r) for r in RATIOS if r <= 0.9])
    return below.max("case") <= 1.5 * below.min("case")


def switches_double_above(ds: xr.Dataset) -> xr.DataArray:
    """At 110 % the switch frequency is more than twice that at 10 %."""
    return _of(ds, "switch_frequency", "110 %") > 2.0 * _of(ds, "switch_frequency", "10 %")


def _ratio(metric: str) -> Holds:
    return lambda ds: _of(ds, metric, "plain PI") / _of(ds, metric, "no backlash")


heat_ratio, peak_ratio = _ratio("coil_energy"), _ratio("coil_peak_power")


def raises_heat(ds: xr.Dataset) -> xr.DataArray:
    """The backlash raises the heat that the coil takes by more than 1 %."""
    return heat_ratio(ds) > 1.01


def raises_peak(ds: xr.Dataset) -> xr.DataArray:
    """The backlash raises the peak of the coil's heat flow by more than 1 %."""
    return peak_ratio(ds) > 1.01


def finds(ds: xr.Dataset, step: float | xr.DataArray = STEP) -> xr.DataArray:
    """The first step down leads to the backlash, to within a step; without one (NaN) the rule does not find it."""
    return abs(ds["estimate_first_down"] - BACKLASH) <= 1.001 * step


def rule_finds(rule: str) -> Holds:
    """Return the claim that a rule finds the backlash."""
    return lambda ds: finds(ds.sel(case=rule, drop=True))


def rule_in_time(rule: str) -> Holds:
    """Return the claim that a rule finds the backlash and confirms it within three hours."""

    def holds(ds: xr.Dataset) -> xr.DataArray:
        of_rule = ds.sel(case=rule, drop=True)
        return finds(of_rule) & (of_rule["learn_time_confirmed"] <= THREE_HOURS)

    return holds


def rule_numbers(*rules: str) -> Numbers:
    """Return a function that looks up when rules reached and confirmed the backlash, and their estimate then."""

    def numbers(ds: xr.Dataset) -> dict[str, xr.DataArray]:
        found = {}
        for rule in rules:
            of_rule = ds.sel(case=rule, drop=True)
            found[f"reached, {rule} [h]"] = of_rule["learn_time_reached"].fillna(np.inf) / 3600
            found[f"confirmed, {rule} [h]"] = of_rule["learn_time_confirmed"].fillna(np.inf) / 3600
            found[f"after the first step down, {rule} [1]"] = of_rule["estimate_first_down"].fillna(np.inf)
        return found

    return numbers


def any_start_and_step(ds: xr.Dataset) -> xr.DataArray:
    """The rule finds the backlash from every initial guess with every step."""
    return finds(ds, ds["learning_step"]).all("case")


def start_numbers(ds: xr.Dataset) -> dict[str, xr.DataArray]:
    """Look up the estimate after the first step down, by initial guess and step."""
    return {
        f"after the first step down, {c} [1]": _of(ds, "estimate_first_down", c).fillna(np.inf)
        for c in ds["case"].values
    }


def noise_multiplies_switches(ds: xr.Dataset) -> xr.DataArray:
    """Noise more than doubles the switches of the inverse."""
    return _of(ds, "switch_frequency", "95 %, noise") > 2.0 * _of(ds, "switch_frequency", "95 %")


def buffer_cures_the_inverse(ds: xr.Dataset) -> xr.DataArray:
    """With a buffer there are about as few switches as without noise, and less error than with the plain PI."""
    calm = _of(ds, "switch_frequency", "95 %, noise, buffer") <= 1.5 * _of(ds, "switch_frequency", "95 %")
    return calm & (_of(ds, "rmse_settled", "95 %, noise, buffer") < _of(ds, "rmse_settled", "plain PI, noise"))


def noise_breaks_the_learner(ds: xr.Dataset) -> xr.DataArray:
    """The rule finds the backlash without noise, and does not with it."""
    return rule_finds("literal")(ds) & ~rule_finds("noise")(ds)


def eight_is_largest(ds: xr.Dataset) -> xr.DataArray:
    """The default number of control volumes is the largest stable one."""
    return ds["largest"] == float(str(PARAMETERS["n_volumes"].default))
