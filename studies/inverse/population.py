"""Valve populations: how the benefit of an inverse is distributed, and what it depends on.

It runs ``valve_population.toml`` and
``valve_sensitivity.toml`` where they are not finished in ``results/``, and writes their tables.
"""

from __future__ import annotations

import xarray as xr
from scipy.stats import t

import fastcoil as fc
from studies.common import failures_in_words, format_change, format_spread, results, write_table
from studies.learning.learning import TOO_HIGH, TOO_LOW

PAIRED_DIMS = ["sample", "day"]
"""Every controller is compared with the plain PI of the same valve on the same day, with the same noise."""
CONFIDENCE = 0.95


def share_with_t_interval(holds: xr.DataArray) -> str:
    """The share of valves and days in which something holds, with its interval over other valves and days.

    Valves and days are crossed, as in ``fc.compare``: the variances of the valves' means and of the days' means add up,
    and the dim with fewer labels gives the degrees of freedom.
    """
    shares = [holds.mean([d for d in PAIRED_DIMS if d != dim]) for dim in PAIRED_DIMS]
    error = sum(float(s.var(ddof=1)) / s.size for s in shares) ** 0.5
    half = float(t.ppf(0.5 + 0.5 * CONFIDENCE, min(s.size for s in shares) - 1)) * error
    middle = float(holds.mean())
    low, high = max(middle - half, 0.0), min(middle + half, 1.0)
    return f"{100 * middle:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def write_benefit() -> None:
    """Write every controller against the plain PI of the same valve, days and noise."""
    ds = results("valve_population").load()
    pairs = fc.compare(ds, baseline={"controller": "pi"}, over=PAIRED_DIMS, metrics="rmse", relative=True).rmse
    valve_means = ds[["rmse", "rmse_settled", "motor_travel"]].mean("day")
    relative = valve_means / valve_means.sel(controller="pi", drop=True) - 1.0
    write_table(
        "inverse/population",
        f"A population of {ds.sizes['sample']:,} valves and loops on {ds.sizes['day']} days, against the plain PI of "
        f"the same valve ({failures_in_words([ds])})",
        ["controller", "RMSE, mean change (95 % over valves and days)", "RMSE: 5 %, median, 95 % of the valves",
         "settled RMSE, median", "lower RMSE on", "motor travel, median"],
        (
            [
                name,
                format_change(*(100 * float(p.sel(statistic=s)) for s in ("mean", "low", "high")), digits=1),
                format_spread(1.0 + relative.rmse.sel(controller=name)),
                f"{100 * float(relative.rmse_settled.sel(controller=name).median()):+.0f} %",
                f"{100 * float(p.sel(statistic='share_lower')):.0f} %",
                f"× {1 + float(relative.motor_travel.sel(controller=name).median()):.2f}",
            ]
            for name in map(str, ds.controller.values[1:])
            for p in [pairs.sel(controller=name)]
        ),
    )  # fmt: skip
    meanings = ds.learning_status.attrs["flag_meanings"].split()
    rows = []
    for name in (str(c) for c in ds.controller.values if str(c).startswith("learner")):
        learner = ds.sel(controller=name)
        status_counts = {m: int((learner.learning_status == k).sum()) for k, m in enumerate(meanings)}
        estimate_ratio = learner.estimate_final / learner.backlash
        rows.append(
            [
                name,
                ", ".join(f"{n:,} {m}" for m, n in status_counts.items() if n),
                ", ".join(f"{float(estimate_ratio.quantile(q)):.2f}" for q in (0.05, 0.25, 0.5, 0.75, 0.95)),
                share_with_t_interval((estimate_ratio >= TOO_LOW) & (estimate_ratio <= TOO_HIGH)),
            ]
        )
    write_table(
        "inverse/population_learners",
        "Final status of the learners, and final estimates relative to the true backlash",
        [
            "controller",
            "valves × days",
            "5, 25, 50, 75, 95 % of them",
            "within 80 to 120 % (95 % over valves and days)",
        ],
        rows,
    )


def write_dependence() -> None:
    """Write first-order and total Sobol' indices of the relative change of RMSE against the plain PI."""
    ds = results("valve_sensitivity")
    benefit = (ds.rmse / ds.rmse.sel(controller="pi", drop=True) - 1.0).sel(controller=["fixed_95", "fixed_120"])
    relative_changes = xr.Dataset({"benefit": benefit, "status": ds.status.sel(controller=["fixed_95", "fixed_120"])})
    indices = fc.sobol_indices(relative_changes, ["benefit"], drop_failed=True)
    n = int(indices.benefit_n_samples.min())

    def cell(index_values: xr.DataArray) -> str:
        return "{:.2f} ({:.2f} to {:.2f})".format(*(float(index_values.sel(edge=e)) for e in ("value", "low", "high")))

    largest = indices.benefit.sel(edge="value", index="total", controller="fixed_95")
    write_table(
        "inverse/sensitivity",
        f"What the change of RMSE depends on: Sobol' indices from {n:,} base samples",
        ["parameter", *(f"{c}, {i}" for c in ("95 %", "120 %") for i in ("first order", "total"))],
        (
            [str(name)]
            + [
                cell(indices.benefit.sel(parameter=name, controller=c, index=i))
                for c in ("fixed_95", "fixed_120")
                for i in ("first_order", "total")
            ]
            for name in largest.sortby(-largest).parameter.values
        ),
    )


def sample() -> None:
    """Run a sample of the study: what the benefit depends on."""
    write_dependence()


def main() -> None:
    """Write every table."""
    write_benefit()
    write_dependence()
