"""What motor, sensor, controller and backlash do to the largest kp that keeps a loop calm: simulated and foreseen."""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.analysis.paired import mean_of
from studies.common import write_table
from studies.hunting.loops import OPERATING, acting, conditions, joined, valves
from studies.hunting.plants import foreseen

BASE = {"sensor_time_constant": 30.0, "stroke_time": 90.0, "sample_time": 10.0, "backlash": 0.05, "noise_std": 0.0}
CHANGES: dict[str, dict[str, float]] = {
    "as it is: sensor 30 s, stroke 90 s, sample 10 s, X 5 %": {},
    "sensor lag 5 s": {"sensor_time_constant": 5.0},
    "sensor lag 60 s": {"sensor_time_constant": 60.0},
    "sample time 1 s": {"sample_time": 1.0},
    "sample time 30 s": {"sample_time": 30.0},
    "sample time 60 s": {"sample_time": 60.0},
    "stroke 15 s": {"stroke_time": 15.0},
    "stroke 300 s": {"stroke_time": 300.0},
    "backlash 1 %": {"backlash": 0.01},
    "backlash 15 %": {"backlash": 0.15},
    "noise 0.05 K": {"noise_std": 0.05},
    "ti × 2": {"ti": 2.0},
    "ti × 4": {"ti": 4.0},
}
KP = np.geomspace(0.004, 0.4, 24)
TI = (6.0, 100.0)
HOURS, WARM_UP = 6, 2 * 3600


def run(seed: int, size: int, days: int) -> xr.Dataset:
    """Largest calm kp, simulated and foreseen: (change, sample, day)."""
    ti = np.exp(np.random.default_rng([seed, 3]).uniform(*np.log(TI), size))
    loop = valves(seed, size).assign(kp=1.0, ti=("sample", ti), **BASE)
    names = list(CHANGES)
    parts = {}
    for kind in OPERATING:
        day = conditions(kind, seed + 1, days, HOURS)
        found = []
        for change in CHANGES.values():
            given = {n: v * xr.DataArray(loop["ti"]) if n == "ti" else v for n, v in change.items()}
            one = acting(loop.assign(**given), kind)
            plant = foreseen(one, day)
            scale = xr.DataArray(one["kp"])
            hunts = fc.simulate(one.assign(kp=scale * xr.DataArray(KP, dims="kp_tried")), day, warm_up=WARM_UP).hunts
            hunts = hunts.reset_coords(drop=True) > 0
            simulated = xr.where(hunts.any("kp_tried"), scale * KP[0] * _first(hunts), np.nan)
            ok = plant.reachable.astype(bool) & ~hunts.isel(kp_tried=0, drop=True)
            found.append(xr.Dataset({"simulated": simulated, "foreseen": scale / plant.margin, "ok": ok}))
        parts[kind] = xr.concat(found, xr.DataArray(names, dims="change", name="change"))
    return joined(parts)


def _first(hunts: xr.DataArray) -> xr.DataArray:
    """First kp that hunts over the lowest kp tried."""
    return xr.DataArray(KP / KP[0], dims="kp_tried").isel(kp_tried=hunts.argmax("kp_tried"))


def change_of(of: xr.DataArray, ok: xr.DataArray) -> str:
    """Mean change of the logarithm with its interval over valves and conditions, as a percentage."""
    d = np.log(of).where(ok)
    middle, half = mean_of(d)
    value, low, high = (100.0 * np.expm1(x) for x in (middle, middle - half, middle + half))
    return f"{value:+.0f} % ({low:+.0f} to {high:+.0f})"


def write(ds: xr.Dataset) -> None:
    """Write the change of the largest calm kp with each part."""
    base, table = ds.isel(change=0, drop=True), []
    for name in list(CHANGES)[1:]:
        at = ds.sel(change=name, drop=True)
        simulated, foretold = at.simulated / base.simulated, at.foreseen / base.foreseen
        ok = at.ok & base.ok & simulated.notnull()
        ratio = (simulated / foretold).where(ok)
        table.append([name, f"{int(ok.sum()):,}", change_of(simulated, ok), change_of(foretold, ok),
                      f"{float(ratio.quantile(0.1)):.2f} to {float(ratio.quantile(0.9)):.2f}"])  # fmt: skip
    write_table(
        "hunting/hunting_parts",
        f"Change of the lowest kp at which a loop hunts, against {list(CHANGES)[0].removeprefix('as it is: ')}: "
        f"{ds.sizes['sample']} loops × {ds.sizes['day']} conditions, geometric mean (95 % over valves and conditions)",
        ["change", "loops", "simulated", "foreseen from the margin", "simulated over foreseen, 10 to 90 %"],
        table,
    )
