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
    FRESH,
    REAL,
    SEED,
    Sequence,
    days_of,
    growths,
    loops_of,
    rates,
    real_year,
)

METRICS = {
    "growth": "growth of the gap",
    "stem_travel": "travel of the stem",
    "motor_travel": "travel of the motor",
    "reversals": "reversals",
    "coil_energy": "heat at the coil",
}


def both(size: int | None = None) -> tuple[xr.Dataset, xr.Dataset]:
    """The year of 24 days and the whole one under plain PI, metrics summed by valve; ``size``: only so many valves."""
    sequence = Sequence(REAL, REAL, False, False, False, FRESH)
    loop, days = loops_of(sequence, size), days_of(sequence)
    rate = rates(growths(loop), fc.simulate(loop, days, carry_over=True, seed=SEED))
    share = DAYS / DAYS_OF_YEAR
    sampled = _summed(loop.assign(wear_rate=rate), days, 1.0 / share)
    return sampled, _summed(loop.assign(wear_rate=rate * share), real_year(FRESH), 1.0)


def _summed(loop: fc.Loop, days: fc.Boundary, times: float) -> xr.Dataset:
    ds = fc.simulate(loop, days, carry_over=True, seed=SEED).reset_coords(drop=True)
    found = ds[[name for name in METRICS if name in ds]].sum("day") * times
    return found.assign(growth=ds.backlash_final.isel(day=-1, drop=True) - xr.DataArray(loop["backlash"]))


def rows(sampled: xr.Dataset, whole: xr.Dataset) -> list[list[str]]:
    """Both years of the median valve, and what the whole one is of the sampled one."""
    table = []
    for name, words in METRICS.items():
        worn = sampled[name] > 1e-6
        low, middle, high = (whole[name] / sampled[name]).where(worn).quantile([0.05, 0.5, 0.95]).values
        scale, unit = (100.0, " % of stroke") if name == "growth" else (1.0, "")
        each = (f"{scale * float(of[name].where(worn).median()):,.4g}{unit}" for of in (sampled, whole))
        table.append([words, *each, f"× {middle:.2f} ({low:.2f} to {high:.2f})"])
    return table


def main(size: int | None = None) -> None:
    """Simulate both and write the table."""
    sampled, whole = both(size)
    write_table(
        "wear/wear_whole_year",
        f"{sampled.sizes['sample']} valves under plain PI in a year of weather: {DAYS} days that represent it, and "
        f"all {DAYS_OF_YEAR}; the median valve, and the ratio (5 to 95 % of the valves)",
        ["in the year", f"{DAYS} days", f"{DAYS_OF_YEAR} days", "ratio"],
        rows(sampled, whole),
    )
