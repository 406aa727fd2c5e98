"""Valve populations: how the benefit of an inverse is distributed, and what it depends on.

Run with ``python studies/population.py`` in the repository.  It runs ``valve_population.toml`` and
``valve_sensitivity.toml`` where they are not finished in ``results/``, and writes their tables.
"""

from __future__ import annotations

import xarray as xr
from learning import TOO_HIGH, TOO_LOW
from report import results, write_table

import fastcoil as fc

METRICS = {"rmse": "RMSE", "rmse_settled": "settled RMSE", "motor_travel": "motor travel"}


def benefit() -> None:
    """Every controller against the plain PI of the same valve, day and noise."""
    ds = results("valve_population")
    pairs = fc.compare(ds, baseline={"controller": "pi"}, over="sample")
    relative = ds[list(METRICS)] / ds[list(METRICS)].sel(controller="pi", drop=True) - 1.0
    failed = int((ds.status > 0).sum())
    write_table(
        "population",
        f"A population of {ds.sizes['sample']:,} valves and loops ({failed} of {ds.status.size:,} days failed)",
        ["controller", "RMSE, mean difference in K (95 % interval)", "RMSE: 5 %, median, 95 % of the valves",
         "settled RMSE, median", "lower RMSE in", "motor travel, median"],
        (
            [
                name,
                f"{float(p.sel(statistic='mean')):+.4f} ({float(p.sel(statistic='low')):+.4f} to "
                f"{float(p.sel(statistic='high')):+.4f})",
                ", ".join(f"{100 * float(relative.rmse.sel(controller=name).quantile(q)):+.0f} %"
                          for q in (0.05, 0.5, 0.95)),
                f"{100 * float(relative.rmse_settled.sel(controller=name).median()):+.0f} %",
                f"{100 * float(p.sel(statistic='share_lower')):.0f} %",
                f"× {1 + float(relative.motor_travel.sel(controller=name).median()):.2f}",
            ]
            for name in ds.controller.values[1:]
            for p in [pairs.rmse.sel(controller=name)]
        ),
    )  # fmt: skip
    meanings = ds.learning_status.attrs["flag_meanings"].split()
    rows = []
    for name in (str(c) for c in ds.controller.values if str(c).startswith("learner")):
        learner = ds.sel(controller=name)
        ended = {m: int((learner.learning_status == k).sum()) for k, m in enumerate(meanings)}
        learned = learner.estimate_final / learner.backlash
        rows.append(
            [
                name,
                ", ".join(f"{n:,} {m}" for m, n in ended.items() if n),
                ", ".join(f"{float(learned.quantile(q)):.2f}" for q in (0.05, 0.25, 0.5, 0.75, 0.95)),
                f"{100 * float(((learned >= TOO_LOW) & (learned <= TOO_HIGH)).mean()):.0f} %",
            ]
        )
    write_table(
        "population_learners",
        "What became of the learners, and learned over true backlash",
        ["controller", "valves", "5, 25, 50, 75, 95 % of the valves", "within 80 to 120 %"],
        rows,
    )


def dependence() -> None:
    """First-order and total indices of the relative change of RMSE against the plain PI."""
    ds = results("valve_sensitivity")
    benefit = (ds.rmse / ds.rmse.sel(controller="pi", drop=True) - 1.0).sel(controller=["fixed_95", "fixed_120"])
    given = xr.Dataset({"benefit": benefit, "status": ds.status.sel(controller=["fixed_95", "fixed_120"])})
    found = fc.sobol_indices(given, ["benefit"], drop_failed=True)
    n = int(found.benefit_n_samples.min())

    def cell(at: xr.DataArray) -> str:
        return "{:.2f} ({:.2f} to {:.2f})".format(*(float(at.sel(edge=e)) for e in ("value", "low", "high")))

    largest = found.benefit.sel(edge="value", index="total", controller="fixed_95")
    write_table(
        "sensitivity",
        f"What the change of RMSE depends on: Sobol' indices from {n:,} base samples",
        ["parameter", *(f"{c}, {i}" for c in ("95 %", "120 %") for i in ("first order", "total"))],
        (
            [str(name)]
            + [
                cell(found.benefit.sel(parameter=name, controller=c, index=i))
                for c in ("fixed_95", "fixed_120")
                for i in ("first_order", "total")
            ]
            for name in largest.sortby(-largest).parameter.values
        ),
    )


def main() -> None:
    """Write every table."""
    benefit()
    dependence()


if __name__ == "__main__":
    main()
