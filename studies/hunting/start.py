"""Must hunting be started?  Loops that come to their set-point quietly, and are kicked or not."""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.analysis.paired import share_of
from studies.common import write_table
from studies.days import HEATING
from studies.hunting.backlash import SEEN, cycling
from studies.hunting.loops import OPERATING, SERIES, acting, conditions, joined, valves
from studies.hunting.plants import foreseen

RAMP, HOLD, KICK, AFTER = 6, 2, 1, 6
"""Hours: the set-point comes slowly from the temperature of the air, stands still, is elsewhere, and back."""
KICKS = (0.0, 0.1, 0.3, 1.0, 3.0)
"""K"""
BANDS = ((0.0, 0.8), (0.8, 0.9), (0.9, 1.0), (1.0, 1.2), (1.2, 2.0), (2.0, np.inf))


def kicked(kind: str, seed: int, days: int) -> tuple[fc.Boundary, fc.Boundary]:
    """Days with each kick, (condition × kick), and the conditions themselves.

    The set-point comes from the temperature of the entering air, with the valve closed, to that of the condition, so
    the valve moves one way only.  The kick asks for more load for a while.
    """
    still = conditions(kind, seed, days, 1)
    t = np.arange(3600 * (RAMP + HOLD + KICK + AFTER)) / 3600
    come, away = np.clip(t / RAMP, 0.0, 1.0), (t >= RAMP + HOLD) & (t < RAMP + HOLD + KICK)
    of_all = {name: np.repeat(still.series[name][:, 0], len(KICKS))[:, None] for name in SERIES}
    start, end = of_all["T_a_in"], of_all["T_set"]
    more = np.tile(KICKS, days)[:, None] * (1.0 if kind == HEATING else -1.0)
    series = {name: values * np.ones(t.size) for name, values in of_all.items()}
    return fc.Boundary(**{**series, "T_set": start + (end - start) * come + more * away}), still


def run(seed: int, size: int, days: int) -> xr.Dataset:
    """Whether each loop cycles in the end: (sample, day, kick); valves without backlash are left out."""
    parts = {}
    for kind in OPERATING:
        loop = acting(valves(seed, size), kind)
        of_kicks, still = kicked(kind, seed + 1, days)
        ds = fc.simulate(loop, of_kicks, traces=["T_sup"], trace_interval=SEEN)
        T = ds.T_sup.transpose("sample", "day", "elapsed_time").drop_vars("day")
        shape = (T.sizes["sample"], days, len(KICKS), T.sizes["elapsed_time"])
        folded = xr.DataArray(T.values.reshape(shape), dims=("sample", "day", "kick", "elapsed_time"))
        plant = foreseen(loop, still)
        late = folded.isel(elapsed_time=slice(-4 * (3600 * (AFTER - 1) // SEEN // 2), None))
        X = xr.DataArray(loop["backlash"], dims="sample").reset_coords(drop=True)
        found = cycling(late, 0.02 * X * plant.K.drop_vars("day")).assign(backlash=X)
        parts[kind] = xr.merge([plant.drop_vars("day"), found]).assign_coords(kick=list(KICKS), day=range(days))
    return joined(parts)


def write(ds: xr.Dataset) -> None:
    """Write the share that cycles by margin and kick."""
    ok, table = ds.reachable.astype(bool) & (ds.backlash > 0.0), []
    for low, high in BANDS:
        inside = ok & (ds.margin >= low) & (ds.margin < high)
        if not bool(inside.any()):
            continue
        cells = [str(share_of(ds.cycles.sel(kick=kick, drop=True), inside)) for kick in KICKS]
        table.append([f"{low:g} to {high:g}", f"{int(inside.sum()):,}", *cells])
    any_kick = ds.cycles.any("kick") & ok
    alone = str(share_of(ds.cycles.sel(kick=0.0, drop=True), any_kick))
    write_table(
        "hunting/hunting_start",
        f"Loops that come to their set-point in {RAMP} h without a turn of the valve, stand still, and are kicked by a "
        f"set-point elsewhere for an hour: share that cycles in the last of {AFTER} h "
        f"more; of those that cycle after any kick {alone} do without one",
        ["margin", "loops", *(f"kick {kick:g} K" if kick else "no kick" for kick in KICKS)],
        table,
    )
