"""Does the price of an inverse hold on other valves?  Error, travel and hunting on two populations of fresh valves.

``SIMC``: gains of SIMC from a step of each loop, as in ``remedies.py``.  ``DRAWN``: gains as somebody left them, mostly
slow.  The same valves, noise and days serve both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.file.spec import read_study
from studies.common import (
    compare_rows,
    drawn_loops,
    failures,
    mean_of,
    mixed_sizes,
    pooled,
    progress,
    share_of,
    signed,
    write_table,
)
from studies.days import HEATING, STEPPED, kinds
from studies.paper.grid import along as along_cases
from studies.remedies.runs import DRAWN, LEAST_TRAVEL, SIMC, STUDY, groups, on_days, picked
from studies.remedies.tables import LABELS
from studies.robustness.best_pi import simc_gains

SEED, VALVES = 20701, 384
DAYS = range(20711, 20721)
PI, NO_BUFFER, OVERESTIMATE = "pi", "inverse_95", "inverse_120_buffer"
SHOWN = (PI, "inverse_95_small_buffer", "inverse_95_noise_buffer", "inverse_95_buffer", OVERESTIMATE, NO_BUFFER)
STILL = "set-point stands still"


def valves(size: int, *, heating: bool) -> fc.Loop:
    """Fresh valves, all with a gap, behind each remedy that is shown."""
    draw = np.random.default_rng(SEED)
    drawn = drawn_loops(draw, size, heating=heating) | {"backlash": mixed_sizes(draw, size)}
    remedies = read_study(STUDY).tables["cases"]["controller"]
    cases = {name: {"estimate_ratio": 0.0, **remedies[name]} for name in SHOWN}
    return fc.Loop.preset("lbnl").assign(
        m_full=1.7,
        plant_gain=20.0,
        estimator="none",
        **{name: xr.DataArray(series, dims="sample") for name, series in drawn.items()},
        **along_cases("controller", cases),
    )


def ran(size: int = VALVES, some: Sequence[str] | None = None) -> dict[str, dict[str, xr.Dataset]]:
    """Population → kind of day, of ``some`` or all → metrics over controller, sample and day."""
    found: dict[str, dict[str, xr.Dataset]] = {SIMC: {}, DRAWN: {}}
    done = progress()
    for group in ([kind for kind in group if some is None or kind in some] for group in groups()):
        if not group:
            continue
        loop = valves(size, heating=group == [HEATING])
        simc = simc_gains(picked(loop, controller=0), group[0])
        for kind in group:
            found[SIMC][kind] = on_days(loop, simc, kind, DAYS)
            found[DRAWN][kind] = on_days(loop, simc[["plant_gain"]], kind, DAYS)
            done(kind)
    return found


def changed(ds: xr.Dataset, name: str, metric: str, least: float = 0.0) -> tuple[float, float, float]:
    """Geometric mean of a metric over that of the plain PI, with its 95 % interval over valves and days."""
    sizes = np.log(ds[metric].clip(least))
    middle, half = mean_of(sizes.sel(controller=name) - sizes.sel(controller=PI))
    return float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))


def cells(ds: xr.Dataset, name: str) -> list[str]:
    """Change of the error, of the travel, and the share of days on which the loop hunts."""
    error = signed(*(100.0 * (ratio - 1.0) for ratio in changed(ds, name, "rmse")))
    middle, low, high = changed(ds, name, "motor_travel", LEAST_TRAVEL)
    hunts = share_of(ds.hunts.sel(controller=name) > 0.0)
    return [error, f"× {middle:.2f} ({low:.2f} to {high:.2f})", f"{hunts}"]


HEAD = ("gains", "days", "remedy", "RMSE", "motor travel", "hunting")


def sample() -> None:
    """Days with set-point steps."""
    for gains, of_kinds in ran(some=[STEPPED]).items():
        rows = [[gains, STEPPED, LABELS[name], *cells(of_kinds[STEPPED], name)] for name in SHOWN[1:]]
        compare_rows("remedies/remedies_others", rows)


def main(size: int = VALVES) -> None:
    """Write the table."""
    found, rows = ran(size), []
    for gains, of_kinds in found.items():
        still = pooled({kind: ds for kind, ds in of_kinds.items() if kind not in (STEPPED, HEATING)})
        parts = {STEPPED: of_kinds[STEPPED], STILL: still, HEATING: of_kinds[HEATING]}
        rows += [[gains, days, LABELS[name], *cells(ds, name)] for days, ds in parts.items() for name in SHOWN[1:]]
        rows += [[gains, days, LABELS[PI], "0", "× 1.00", cells(ds, PI)[-1]] for days, ds in parts.items()]
    every = [ds for of_kinds in found.values() for ds in of_kinds.values()]
    write_table(
        "remedies/remedies_others",
        f"The price of an inverse on other valves: geometric mean over plain PI with the same gains (95 % over valves "
        f"and days); {size} valves × {len(DAYS)} days of each kind, cooling with a constant set-point pooled "
        f"({', '.join(kind for kind in kinds() if kind not in (STEPPED, HEATING))}; {failures(every)})",
        HEAD,
        rows,
    )
