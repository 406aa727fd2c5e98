"""What backlash costs in a year of weather, what its wear adds, and what an estimator gives back: tables and a figure.

The loops are those of year.toml, the days those of ``operation``.  Every loop is compared with itself with a sound
valve under the same controller, and under plain PI.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.dates import DateFormatter, MonthLocator

import fastcoil as fc
from fastcoil.base.figures import COLOURS, apply_style
from fastcoil.study.analysis.paired import MedianSummary, summarise_median
from fastcoil.study.file.spec import read_study
from studies.common import save_figure, share_of, study_file, write_table
from studies.days import WEATHER_FILE
from studies.year.operation import weather_year

NO_SAMPLE = "each row summarises a whole year of all loops, from a weather file"
PI, SOUND = "pi", "sound"
CONTROLLER_LABELS = {"pi": "plain PI", "hagglund": "Hägglund", "identify": "identify"}
LEAST_ERROR = 0.01
"""Fraction of stroke by which an estimate may always be wrong, and the rise of an error that counts as harm."""
YEAR = 2023  # whose days of the week count
LAST_QUARTER = 91  # days at the end of the year that are counted apart
TARIFF = {"electricity": 0.13, "demand": 15.0, "heat": 0.05}
"""USD per kWh of electricity, per kW of the highest 15-min mean of a month, per kWh of reheat."""
COST_PARTS = {"coil": "coil_cost", "demand": "demand_cost", "reheat": "reheat_cost", "recooling": "recool_cost"}


def simulate_year(
    weather: Path = WEATHER_FILE, days: Sequence[int] | None = None, study: Path | None = None
) -> xr.Dataset:
    """Simulate the loops of year.toml through a year of weather, every day from the end of the one before."""
    loop = read_study(study or study_file("year")).plan.layout.loop
    year = weather_year(weather, year=YEAR, days=days, set_point="trim_and_respond")
    return fc.simulate(loop, year, carry_over=True)


def format_money(summary: MedianSummary) -> str:
    """A median and its 95 % interval over the loops."""
    return f"{summary.median:+.1f} ({summary.low:+.1f} to {summary.high:+.1f})"


def cost_rows(ds: xr.Dataset) -> list[list[str]]:
    """What each valve and controller costs more than the sound valve under plain PI, a year."""
    costs = fc.cost(ds, **TARIFF)
    base = costs.sel(valve=SOUND, controller=PI, drop=True)
    rows = []
    for valve in costs["valve"].values:
        for controller in costs["controller"].values:
            if valve == SOUND and controller == PI:
                continue
            extra_costs = costs.sel(valve=valve, controller=controller, drop=True) - base
            share = 100.0 * extra_costs["yearly_cost"] / base["yearly_cost"]
            extra_summary = summarise_median(extra_costs["yearly_cost"])
            parts = [f"{float(extra_costs[f'yearly_{name}'].mean()):+.1f}" for name in COST_PARTS.values()]
            rows.append(
                [
                    valve,
                    CONTROLLER_LABELS[controller],
                    format_money(extra_summary),
                    f"{extra_summary.q05:+.1f} to {extra_summary.q95:+.1f}",
                ]
                + [f"{float(share.median()):+.1f} %", *parts]
            )
    return rows


def valve_rows(ds: xr.Dataset) -> list[list[str]]:
    """Rows of gap, estimate, temperature and motor travel over the year."""
    is_on = ds["rmse"].notnull()
    rows = []
    for valve in ds["valve"].values:
        for controller in ds["controller"].values:
            lane = {"valve": valve, "controller": controller}
            part, part_is_on = ds.sel(lane), is_on.sel(lane)
            last = part.isel(day=-1)
            gap = 100.0 * last["backlash_final"]
            estimate = "" if controller == PI else f"{100.0 * float(last['estimate_final'].median()):.1f} %"
            error = np.sqrt((part["rmse_settled"] ** 2).mean("day"))
            travel = part["motor_travel"].sum("day")
            share_of_hunting = part["hunts"].where(part_is_on).mean("day")
            rows.append(
                [
                    valve,
                    CONTROLLER_LABELS[controller],
                    f"{float(gap.median()):.1f} % (to {float(gap.max()):.1f} %)",
                    estimate,
                ]
                + [f"{float(error.median()):.3f} K", f"{100 * float(part['share_off'].mean('day').median()):.0f} %"]
                + [f"{float(travel.median()):,.0f}", f"{100.0 * float(share_of_hunting.mean()):.0f} %"]
            )
    return rows


def estimate_rows(ds: xr.Dataset) -> list[list[str]]:
    """How often each estimator is right on the days of operation, and what it does to the error of a loop."""
    is_on = ds["rmse"].notnull()
    error = np.sqrt((ds["rmse"] ** 2).mean("day"))
    rows = []
    for valve in ds["valve"].values:
        for controller in ds["controller"].values:
            if controller == PI:
                continue
            part, part_is_on = ds.sel(valve=valve, controller=controller), is_on.sel(valve=valve, controller=controller)
            gap = part["backlash_final"]
            is_wrong = abs(part["estimate_final"] - gap) > np.maximum(0.2 * gap, LEAST_ERROR)
            is_in_last_quarter = part_is_on & xr.DataArray(
                np.arange(part_is_on["day"].size) >= part_is_on["day"].size - LAST_QUARTER, dims="day"
            )
            change = error.sel(valve=valve, controller=controller) / error.sel(valve=valve, controller=PI) - 1.0
            rows.append(
                [
                    valve,
                    CONTROLLER_LABELS[controller],
                    str(share_of(is_wrong, part_is_on)),
                    str(share_of(is_wrong, is_in_last_quarter)),
                ]
                + [f"{int((is_wrong & part_is_on).any('day').sum())} of {change.size}"]
                + [f"{100.0 * float(change.median()):+.1f} %", str(share_of(change > LEAST_ERROR))]
            )
    return rows


@apply_style()
def draw_figure(ds: xr.Dataset) -> None:
    """Draw gap and estimate over the year, and what the gap costs by month."""
    costs = fc.cost(ds, **TARIFF)
    valves = [v for v in ds["valve"].values if v != SOUND]
    fig, axes = plt.subplots(2, len(valves), figsize=(7.2, 4.6), sharey="row", layout="constrained")
    start = ds["start"].values
    for column, valve in zip(axes.T, valves, strict=True):
        top, bottom = column
        for k, controller in enumerate(ds["controller"].values):
            part = ds.sel(valve=valve, controller=controller)
            label, color = CONTROLLER_LABELS[controller], COLOURS[k]
            gap = 100.0 * part["backlash_final"].median("sample")
            top.plot(start, gap, color=color, lw=1.2, label=f"gap, {label}")
            if controller != PI:
                low, middle, high = (100.0 * part["estimate_final"]).quantile([0.1, 0.5, 0.9], "sample").values
                top.plot(start, middle, color=color, lw=1.2, ls="--", label=f"estimate, {label}")
                top.fill_between(start, low, high, color=color, alpha=0.15, lw=0)
            month = costs["cost"].sel(valve=valve, controller=controller)
            extra_cost = (month - costs["cost"].sel(valve=SOUND, controller=PI)).mean("sample")
            bottom.plot(np.arange(1, extra_cost.size + 1), extra_cost.cumsum(), color=color, label=label)
        top.set_title(f"{valve}, {100 * float(ds['backlash'].sel(valve=valve)):g} % in January")
        top.xaxis.set_major_locator(MonthLocator((1, 5, 9)))
        top.xaxis.set_major_formatter(DateFormatter("%b"))
        bottom.set_xticks([1, 5, 9])
        bottom.set_xlabel("month")
    axes[0, 0].set_ylabel("backlash, % of stroke")
    axes[1, 0].set_ylabel("paid more than with a\nsound valve so far, USD")
    axes[0, 0].legend(fontsize=6)
    axes[1, 0].legend(fontsize=6)
    save_figure(fig, "year/year.png")


def main() -> None:
    """Write the tables and the figure."""
    ds = simulate_year()
    write_table(
        "year/year_cost",
        "Extra cost of a loop per year, compared with the same loop with a sound valve under plain PI, USD: median "
        "(its 95 % interval), 5th to 95th percentile of the loops, share of the bill, and mean of each component",
        ["valve", "controller", "more", "5 to 95 %", "of the bill", *COST_PARTS],
        cost_rows(ds),
    )
    write_table(
        "year/year_valve",
        "A year of each loop: gap at the end of the year (median, largest), estimate then (median), settled RMS error "
        "and time off the set-point (medians of the loops), motor travel in the year (median), days on which they hunt",
        ["valve", "controller", "gap", "estimate", "settled error", "off by 0.5 K", "strokes", "hunts"],
        valve_rows(ds),
    )
    write_table(
        "year/year_estimate",
        "Wrong estimates (off by more than 20 % of the gap and 1 % of stroke at the end of an operating day): share of "
        "all operating days, share of those in the last quarter, number of loops with at least one such day; RMS error "
        "over the year relative to plain PI: median of the loops, and loops in which it is more than 1 % higher (95 % "
        "intervals)",
        ["valve", "controller", "wrong", "at last", "loops ever wrong", "RMS error", "harmed"],
        estimate_rows(ds),
    )
    draw_figure(ds)
