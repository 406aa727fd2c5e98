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
    draw_backlash,
    draw_loop_parameters,
    failures_in_words,
    format_change,
    mean_of,
    pool_days,
    progress_printer,
    share_of,
    write_table,
)
from studies.days import HEATING, STEPPED, kinds
from studies.paper.grid import cases_along
from studies.remedies.runs import AS_FOUND, LEAST_TRAVEL, SIMC, STUDY, kind_groups, select_loop, simulate_days
from studies.remedies.tables import REMEDY_LABELS
from studies.robustness.best_pi import simc_gains

SEED, VALVES = 20701, 384
DAYS = range(20711, 20721)
PI, NO_BUFFER, OVERESTIMATE = "pi", "inverse_95", "inverse_120_buffer"
SHOWN_REMEDIES = (
    PI,
    "inverse_95_small_buffer",
    "inverse_95_noise_buffer",
    "inverse_95_buffer",
    OVERESTIMATE,
    NO_BUFFER,
)
STILL_LABEL = "set-point stands still"


def valves(size: int, *, heating: bool) -> fc.Loop:
    """Fresh valves, all with a gap, behind each remedy that is shown."""
    rng = np.random.default_rng(SEED)
    parameters = draw_loop_parameters(rng, size, heating=heating) | {"backlash": draw_backlash(rng, size)}
    remedies = read_study(STUDY).tables["cases"]["controller"]
    cases = {name: {"estimate_ratio": 0.0, **remedies[name]} for name in SHOWN_REMEDIES}
    return fc.Loop.preset("lbnl").assign(
        m_full=1.7,
        plant_gain=20.0,
        estimator="none",
        **{name: xr.DataArray(series, dims="sample") for name, series in parameters.items()},
        **cases_along("controller", cases),
    )


def run_populations(size: int = VALVES, day_kinds: Sequence[str] | None = None) -> dict[str, dict[str, xr.Dataset]]:
    """Return gains → kind of day, of ``day_kinds`` or all → metrics over controller, sample and day."""
    by_gains: dict[str, dict[str, xr.Dataset]] = {SIMC: {}, AS_FOUND: {}}
    report = progress_printer()
    for group in ([kind for kind in group if day_kinds is None or kind in day_kinds] for group in kind_groups()):
        if not group:
            continue
        loop = valves(size, heating=group == [HEATING])
        simc = simc_gains(select_loop(loop, controller=0), group[0])
        for kind in group:
            by_gains[SIMC][kind] = simulate_days(loop, simc, kind, DAYS)
            by_gains[AS_FOUND][kind] = simulate_days(loop, simc[["plant_gain"]], kind, DAYS)
            report(kind)
    return by_gains


def geometric_mean_ratio(ds: xr.Dataset, name: str, metric: str, floor: float = 0.0) -> tuple[float, float, float]:
    """Geometric mean of a metric over that of the plain PI, with its 95 % interval over valves and days."""
    logarithms = np.log(ds[metric].clip(floor))
    middle, half = mean_of(logarithms.sel(controller=name) - logarithms.sel(controller=PI))
    return float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))


def remedy_cells(ds: xr.Dataset, name: str) -> list[str]:
    """Change of the error, of the travel, and the share of days on which the loop hunts."""
    error = format_change(*(100.0 * (ratio - 1.0) for ratio in geometric_mean_ratio(ds, name, "rmse")))
    middle, low, high = geometric_mean_ratio(ds, name, "motor_travel", LEAST_TRAVEL)
    hunts = share_of(ds.hunts.sel(controller=name) > 0.0)
    return [error, f"× {middle:.2f} ({low:.2f} to {high:.2f})", f"{hunts}"]


HEAD = ("gains", "days", "remedy", "RMSE", "motor travel", "hunting")


def sample() -> None:
    """Run a sample of the study: days with set-point steps."""
    for gains, by_kind in run_populations(day_kinds=[STEPPED]).items():
        rows = [
            [gains, STEPPED, REMEDY_LABELS[name], *remedy_cells(by_kind[STEPPED], name)] for name in SHOWN_REMEDIES[1:]
        ]
        compare_rows("remedies/remedies_others", rows)


def main(size: int = VALVES) -> None:
    """Write the table."""
    by_gains, rows = run_populations(size), []
    for gains, by_kind in by_gains.items():
        still_ds = pool_days({kind: ds for kind, ds in by_kind.items() if kind not in (STEPPED, HEATING)})
        parts = {STEPPED: by_kind[STEPPED], STILL_LABEL: still_ds, HEATING: by_kind[HEATING]}
        rows += [
            [gains, days, REMEDY_LABELS[name], *remedy_cells(ds, name)]
            for days, ds in parts.items()
            for name in SHOWN_REMEDIES[1:]
        ]
        rows += [
            [gains, days, REMEDY_LABELS[PI], "0", "× 1.00", remedy_cells(ds, PI)[-1]] for days, ds in parts.items()
        ]
    datasets = [ds for by_kind in by_gains.values() for ds in by_kind.values()]
    write_table(
        "remedies/remedies_others",
        f"The price of an inverse on other valves: geometric mean over plain PI with the same gains (95 % over valves "
        f"and days); {size} valves × {len(DAYS)} days of each kind, cooling with a constant set-point pooled "
        f"({', '.join(kind for kind in kinds() if kind not in (STEPPED, HEATING))}; {failures_in_words(datasets)})",
        HEAD,
        rows,
    )
