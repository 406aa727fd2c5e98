"""Does a trend log of command and supply temperature tell the backlash?  Measured on valves and days never seen before.

Run with ``python -m studies diagnosis``.  It asks ``fastcoil.measured.diagnosis`` about the logs of
``diagnosis_logs.py``.  The thresholds there were chosen on valves and days of seeds 301 to 503; those here share none
of them.  Right means: within 20 % of the true backlash or 1 % of the stroke.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.measured.diagnosis.identify import GOOD, TOLERANCE, identify_backlash
from fastcoil.study.analysis.paired import share_of
from studies.common import write_table
from studies.days import STEPPED
from studies.diagnosis.logs import (
    DAYS_OF_KINDS,
    GOOD_VALVES,
    OTHERS,
    SIMULATED,
    STEPPED_HEATING,
    Logs,
    Population,
    logs,
)

SEED = 9211
VALVES, DAYS = 128, 3
OTHER_VALVES = 64
GOOD_ONES, GOOD_DAYS = 150, 4
HOURS = (8, 4, 2)
WITH_SET_POINT = "command, T_sup, T_set"
COLUMNS = {
    WITH_SET_POINT: ("T_set",),
    "command, T_sup": (),
    "with air flow and T_in": ("T_set", "m_a", "T_a_in"),
}


class Row(NamedTuple):
    """What the logs of one population, set of columns and length tell."""

    name: str
    columns: str
    hours: int
    found: xr.Dataset

    @property
    def wrong(self) -> float:
        """Share of what was claimed that is wrong."""
        claimed = self.found.identified > 0
        return float(1.0 - self.found.right.where(claimed).mean()) if claimed.any() else 0.0


def identified(of: Logs, hours: int, columns: tuple[str, ...]) -> xr.Dataset:
    """What the first hours of every log tell; of two valves in three the stroke time is known."""
    days, valves = of.signals["command"].shape[:2]
    found = np.empty((days, valves, 4))
    for v, every in enumerate(of.interval // SIMULATED):
        known = {"stroke_time": of.stroke_time[v] if v % 3 else None}
        if of.tells_sample_time:
            known["sample_time"] = of.sample_time[v]
        n = hours * 3600 // SIMULATED // every - abs(of.late)
        for d in range(days):
            seen = {name: s[d, v if s.shape[1] > 1 else 0, ::every] for name, s in of.signals.items()}
            command = seen["command"][max(of.late, 0) :][:n]
            seen = {name: series[max(-of.late, 0) :][:n] for name, series in seen.items()}
            one = identify_backlash(
                command, seen["T_measured"], float(of.interval[v]), seen["T_set"] if "T_set" in columns else None,
                tuple(seen[n] for n in columns if n != "T_set"), **known,
            )  # fmt: skip
            found[d, v] = one.backlash, one.low, one.high, one.identified
    names = ("backlash", "low", "high", "identified")
    ds = xr.Dataset({n: (("day", "sample"), found[..., i]) for i, n in enumerate(names)})
    true = xr.DataArray(of.backlash, dims="sample")
    least, most = (xr.DataArray(edge, dims="sample") for edge in (of.least, of.most))
    off = np.maximum(np.maximum(least - ds.backlash, ds.backlash - most), 0.0)
    ds["right"] = ds.backlash.notnull() & (off <= np.maximum(TOLERANCE * true, GOOD) + 1e-9)
    ds["covered"] = (ds.low <= most) & (least <= ds.high)
    return ds.assign_coords(true=true)


def share(holds: xr.DataArray, among: xr.DataArray | None = None) -> str:
    """A share with its interval, "none" if nothing counts."""
    return "none" if among is not None and not bool(among.any()) else share_of(holds, among).written(1)


def cells(row: Row) -> list[str]:
    """Wrong claims first, then the shares."""
    ds = row.found
    claimed, good = ds.identified > 0, (ds.true == 0.0).broadcast_like(ds.right)
    accused = (ds.backlash > GOOD + 1e-9) & claimed & good
    return [
        row.name, row.columns, f"{row.hours} h", f"{int((claimed & ~ds.right).sum())} of {int(claimed.sum())}",
        share(ds.right, claimed), f"{int(accused.sum())} of {int(good.sum())}", share(ds.covered), share(claimed),
        share(ds.right),
    ]  # fmt: skip


HEAD = ["day", "columns", "length", "wrong claims", "right of what is claimed", "good valves accused",
        "interval covers", "claimed", "right, claimed or not"]  # fmt: skip


def measured(
    populations: dict[str, Population], columns: list[str], valves: int, days: int, good_only: bool = False
) -> list[Row]:
    """What the logs of populations tell, the rows with the largest share of wrong claims first."""
    rows = []
    for k, (name, population) in enumerate(populations.items()):
        seeds = [10 * SEED + 5 * good_only + day for day in range(days)]
        simulated = logs(population, [SEED, k, int(good_only), valves], seeds, valves, good_only)
        for called in columns:
            if called == "command, T_sup" and population.kind != STEPPED:
                continue  # a set-point that stands still tells nothing
            rows += [Row(name, called, hours, identified(simulated, hours, COLUMNS[called])) for hours in HOURS]
        print(f"{name}: done", flush=True)
    return sorted(rows, key=lambda row: -row.wrong)


def main() -> None:
    """Measure on every kind of day, on other valves, loops and logs, and on good valves, and write the tables."""
    rows = measured(DAYS_OF_KINDS, list(COLUMNS), VALVES, DAYS)
    title = f"Backlash from trend logs: {VALVES} valves × {DAYS} days of each kind, logged every 10, 15 or 30 s"
    write_table("diagnosis/diagnosis", title, HEAD, map(cells, rows))
    rows = measured(OTHERS, [WITH_SET_POINT], OTHER_VALVES, DAYS)
    title = f"Other valves, loops and logs: {OTHER_VALVES} valves × {DAYS} days each"
    write_table("diagnosis/diagnosis_others", title, ["what is other", *HEAD[1:]], map(cells, rows))
    rows = measured(GOOD_VALVES, [WITH_SET_POINT], GOOD_ONES, GOOD_DAYS, good_only=True)
    stepped = {kind: DAYS_OF_KINDS[kind] for kind in (STEPPED, STEPPED_HEATING)}
    rows += measured(stepped, ["with air flow and T_in"], GOOD_ONES, GOOD_DAYS, good_only=True)
    accused = [
        [row.name, row.columns, f"{row.hours} h", f"{int((claim & worse).sum())} of {row.found.right.size}",
         share(claim & worse), share(claim & ~worse)]
        for row in rows
        for claim, worse in [(row.found.identified > 0, row.found.backlash > GOOD + 1e-9)]
    ]  # fmt: skip
    title = f"Good valves: {GOOD_ONES} × {GOOD_DAYS} days each"
    write_table(
        "diagnosis/diagnosis_good", title, ["day", "columns", "length", "accused", "share", "claimed as good"], accused
    )
