"""Whether 24 days stand for a year: the same valves through all 365, hour by hour, with the wear as it is.

Run with ``python -m studies wear_whole`` where there is a weather file.  The days are made when they are needed.
"""

from __future__ import annotations

import xarray as xr

import fastcoil as fc
from studies.common import write_table
from studies.wear.runs import (
    DAYS,
    DAYS_OF_YEAR,
    FRESH_FIRST_DAY,
    REAL_WEATHER,
    SEED,
    Sequence,
    sequence_days,
    sequence_loops,
    target_growths,
    wear_rates,
    weather_year,
)

NO_SAMPLE = "the table is one simulation of a whole year, from a weather file"
METRIC_LABELS = {
    "growth": "growth of the gap",
    "stem_travel": "travel of the stem",
    "motor_travel": "travel of the motor",
    "reversals": "reversals",
    "coil_energy": "heat at the coil",
}


def simulate_both_years(size: int | None = None) -> tuple[xr.Dataset, xr.Dataset]:
    """The year of 24 days and the whole one under plain PI, metrics summed by valve; ``size``: only so many valves."""
    sequence = Sequence(REAL_WEATHER, REAL_WEATHER, False, False, False, FRESH_FIRST_DAY)
    loop, days = sequence_loops(sequence, size), sequence_days(sequence)
    rate = wear_rates(target_growths(loop), fc.simulate(loop, days, carry_over=True, seed=SEED))
    share = DAYS / DAYS_OF_YEAR
    sampled = _sum_metrics(loop.assign(wear_rate=rate), days, 1.0 / share)
    return sampled, _sum_metrics(loop.assign(wear_rate=rate * share), weather_year(FRESH_FIRST_DAY), 1.0)


def _sum_metrics(loop: fc.Loop, days: fc.Boundary, factor: float) -> xr.Dataset:
    ds = fc.simulate(loop, days, carry_over=True, seed=SEED).reset_coords(drop=True)
    sums = ds[[name for name in METRIC_LABELS if name in ds]].sum("day") * factor
    return sums.assign(growth=ds.backlash_final.isel(day=-1, drop=True) - xr.DataArray(loop["backlash"]))


def ratio_rows(sampled: xr.Dataset, whole: xr.Dataset) -> list[list[str]]:
    """Both years of the median valve, and what the whole one is of the sampled one."""
    table = []
    for name, label in METRIC_LABELS.items():
        is_worn = sampled[name] > 1e-6
        low, middle, high = (whole[name] / sampled[name]).where(is_worn).quantile([0.05, 0.5, 0.95]).values
        scale, unit = (100.0, " % of stroke") if name == "growth" else (1.0, "")
        year_medians = (
            f"{scale * float(year_sums[name].where(is_worn).median()):,.4g}{unit}" for year_sums in (sampled, whole)
        )
        table.append([label, *year_medians, f"× {middle:.2f} ({low:.2f} to {high:.2f})"])
    return table


def main(size: int | None = None) -> None:
    """Simulate both and write the table."""
    sampled, whole = simulate_both_years(size)
    write_table(
        "wear/wear_whole_year",
        f"{sampled.sizes['sample']} valves under plain PI in a year of weather: {DAYS} days that represent it, and "
        f"all {DAYS_OF_YEAR}; the median valve, and the ratio (5 to 95 % of the valves)",
        ["in the year", f"{DAYS} days", f"{DAYS_OF_YEAR} days", "ratio"],
        ratio_rows(sampled, whole),
    )
