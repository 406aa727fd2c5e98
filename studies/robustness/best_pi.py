"""The best plain PI of each plant: what a remedy has to beat.

A preset or a tuning found in the field says little about a PI.  This script looks for the best gains of each preset's
plant on a grid, on some days, and tries the choice on fresh days; beside it stand the gains that SIMC gives from a step
of the open loop.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import along, change_in_words, write_table
from studies.days import HEATING, HEATING_SET, T_SET, kinds, of_kind, settings

PRESETS = ("paper_like", "paper_like_fast", "lbnl", "g36")
SEARCH_DAYS, FRESH_DAYS = range(3101, 3106), range(3201, 3206)
KP, TI = np.geomspace(0.002, 0.4, 18), np.geomspace(5.0, 600.0, 14)
NOISE = 0.02
"""Measurement noise, K: without any, the fastest gains look better than they are."""
STEP = 0.1
"""Size of the open-loop step, fraction of stroke."""
REST, RESPONSE = 3600, 1800
"""Seconds at rest before the step, and of the response."""
LEAST_GAIN = 0.2
"""Smallest plant gain that a step is taken to show, K per stroke: 0.1 K over it, a buffer, must stay below 1."""
SEEN = 2
"""Seconds between the samples of the response."""


def best_gains(loop: fc.Loop, some: Sequence[str], seeds: Sequence[int] = SEARCH_DAYS) -> xr.Dataset:
    """kp and ti for every scenario of ``loop`` with the lowest cost on the search days of these kinds.

    The cost is the mean, over the kinds, of the RMSE relative to the lowest one of that kind.  Gains that are best on
    one kind of day alone may lie at the edge of what another kind makes unstable.
    """
    cost: xr.DataArray | float = 0.0
    for kind in some:
        swept = loop.assign(kp=("kp", KP), ti=("ti", TI), **settings(kind))
        error = fc.simulate(swept, of_kind(kind, seeds)).rmse.mean("day").reset_coords(drop=True).fillna(np.inf)
        cost = cost + error / error.min(["kp", "ti"])
    stacked = xr.DataArray(cost).stack(gains=("kp", "ti"))
    others = [d for d in stacked.dims if d != "gains"]
    pairs = np.array(list(stacked.gains.values))[stacked.argmin("gains").values]
    return xr.Dataset({"kp": (others, pairs[..., 0]), "ti": (others, pairs[..., 1])})


def first_order(loop: fc.Loop, kind: str) -> xr.Dataset:
    """Gain (K per stroke), time constant and dead time (s) of the plant, from a step of the command upwards.

    The step starts where the valve, coming from below, holds the set-point most nearly; so the gap of the gears is
    closed.  Two points of the response, at 35.3 and 85.3 % of its end, give the model: Sundaresan and Krishnaswamy
    (1978).  Half a sample time counts as dead time, since a sampled controller acts that much later on average.
    """
    heating, T_set = kind == HEATING, HEATING_SET if kind == HEATING else T_SET
    quiet = loop.assign(noise_std=0.0, **settings(kind))
    levels = np.linspace(0.05, 0.85, 17)
    found = [_response(quiet, kind, level) for level in levels]
    start = xr.concat([T.isel(elapsed_time=0, drop=True) for T in found], "level")
    T = xr.concat(found, "level").isel(level=abs(start - T_set).argmin("level"))
    change = (T - T.isel(elapsed_time=0, drop=True)) * (1.0 if heating else -1.0)
    end = change.isel(elapsed_time=-1, drop=True)

    def reached(share: float) -> xr.DataArray:
        return float(SEEN) * (change >= share * end).argmax("elapsed_time")

    t1, t2 = reached(0.353), reached(0.853)
    tau, theta = 0.67 * (t2 - t1), np.maximum(1.3 * t1 - 0.29 * t2, 0.0)
    theta = np.maximum(theta + 0.5 * _of(loop, "sample_time"), 1.0)
    return xr.Dataset({"gain": end / STEP, "tau": np.maximum(tau, 1.0), "theta": theta})


def _response(loop: fc.Loop, kind: str, level: float) -> xr.DataArray:
    """Measured temperature from the second of a step from ``level`` on, with constant air and water."""
    command = np.full(REST + RESPONSE, level)
    command[REST:] += STEP
    day = of_kind(kind, [0])
    mean = {name: float(day.series[name].mean()) for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    still = fc.Boundary(**mean, T_set=np.full(command.size, T_SET))
    ds = fc.simulate(loop, still, command=command, traces=["T_measured"], trace_interval=SEEN, warm_up=0)
    late = ds.T_measured.isel(elapsed_time=slice(REST // SEEN, None)).drop_attrs()  # arithmetic would keep the unit
    return late.assign_coords(elapsed_time=late.elapsed_time - REST).reset_coords(drop=True)


def simc_gains(loop: fc.Loop, kind: str) -> xr.Dataset:
    """kp and ti after SIMC with the closed-loop time constant equal to the dead time: Skogestad (2003); and the gain.

    plant_gain: K per stroke, of the same step.
    kp = tau / (K (tau_c + theta)), ti = min(tau, 4 (tau_c + theta)), tau_c = theta; J. Process Control 13, 291-309.
    """
    return gains_of(first_order(loop, kind))


def gains_of(model: xr.Dataset) -> xr.Dataset:
    """The gains that ``simc_gains`` takes from a model of ``first_order``."""
    kp = model.tau / (model.gain * 2.0 * model.theta)
    gain = model.gain.clip(LEAST_GAIN)  # a valve that changes nothing still needs a number
    ti = np.minimum(model.tau, 8.0 * model.theta)
    return xr.Dataset({"kp": kp.clip(1e-4, 1.0), "ti": ti, "plant_gain": gain})


def _of(loop: fc.Loop, name: str) -> xr.DataArray:
    return xr.DataArray(loop[name])


def along_tuning(loop: fc.Loop, kind: str, best: xr.Dataset) -> fc.Loop:
    """The loop with its own gains, the best and those of SIMC, along a dim ``tuning``."""
    own = xr.Dataset({"kp": _of(loop, "kp"), "ti": _of(loop, "ti")})
    tunings = {"preset": own, "best": best, "SIMC": simc_gains(loop, kind)}
    gains = along("tuning", tunings, coords="minimal", compat="override")
    return loop.assign(kp=gains.kp, ti=gains.ti, **settings(kind))


def rows(preset: str) -> list[list[str]]:
    """A row for each kind of day and tuning of a preset's plant: one tuning for cooling, one for heating."""
    loop, found = fc.Loop.preset(preset).assign(noise_std=NOISE), []
    for group in ([k for k in kinds() if k != HEATING], [HEATING]):
        best = best_gains(loop, group)
        for kind in group:
            found += _on_fresh_days(preset, along_tuning(loop, kind, best), kind)
    return found


def _on_fresh_days(preset: str, loop: fc.Loop, kind: str) -> list[list[str]]:
    ds = fc.simulate(loop, of_kind(kind, FRESH_DAYS))
    found = []
    for name in ds.tuning.values:
        d = ds.sel(tuning=name)
        found.append(
            [
                f"`{preset}`",
                kind,
                str(name),
                f"{float(d.kp):.3g}, {float(d.ti):.3g}",
                f"{float(d.rmse.mean()):.3f}",
                "—" if name == "preset" else change_in_words(ds, name, "preset", "tuning"),
                f"{float(d.rmse_settled.mean()):.3f}",
                f"{float(d.motor_travel.mean()):.1f}",
                f"{float(d.reversals.mean()):.0f}",
                f"{float(d.hunts.mean()):.0%}",
            ]
        )
    return found


def main() -> None:
    """Write the table."""
    write_table(
        "robustness/best_pi",
        f"The plain PI of each preset: its own gains, the best of {KP.size * TI.size} pairs on {len(SEARCH_DAYS)} "
        f"other days, and SIMC gains; {len(FRESH_DAYS)} fresh days, backlash 7 %, noise {NOISE:g} K",
        ["plant", "days", "tuning", "kp in 1/K, ti in s", "RMSE, K", "change of RMSE (95 % over days)",
         "settled RMSE, K", "motor travel, strokes", "reversals", "hunting"],
        (row for preset in PRESETS for row in rows(preset)),
    )  # fmt: skip
