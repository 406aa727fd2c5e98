"""What the time step, the number of volumes and the air march of the coil do to results: which claims survive.

"As printed" is Eq (3) as the paper has it, with lagged air; "converged" is ``converged = true``, one step a second with
quasistatic air.  ``integrators.py`` has what that step was chosen from.  All that is written here comes from days and
valves on which nothing was chosen.  This file has the presets; ``populations.py`` has populations of valves and loops,
and the coil at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import t

import fastcoil as fc
from fastcoil.model.moist_air import enthalpy
from studies.common import write_table
from studies.days import HEATING, WEATHER_FILE, kinds, make_days
from studies.learning.identify_online import IDENTIFY_SETTINGS
from studies.numerics import populations as numerics_populations
from studies.robustness.best_pi import PRESETS as COOLING

DAYS = range(9411, 9419)
BACKLASH = (0.0, 0.07, 0.15)
HUMIDITY, OPENINGS = (0.004, 0.008, 0.012, 0.016), (0.3, 0.6)
"""Of the energy balance: kg/kg, and commands of a valve that is held."""
HEAT_CAPACITY_OF_WATER = 4.186  # kJ/(kg K); condensate drains at the temperature of the metal
MARCHES = ("lagged", "quasistatic")
SUBSTEPS = (1, 2, 4, 8, 16, 32)
FINEST = ("quasistatic", 32)
WAYS = (("lagged", 1), ("quasistatic", 1), FINEST)  # march and substeps: as printed, converged, and finer
SHOWN_WAYS = (*(("lagged", n) for n in (1, 2, 8, 32)), *(("quasistatic", n) for n in (1, 2, 4, 8, 16)))
VOLUMES = (8, 16, 32, 64)
METRICS = ("rmse", "hunting_swing", "motor_travel", "coil_energy", "condensate")
CONTROLLERS: dict[str, dict[str, Any]] = {
    "plain PI": {},
    "60 %": {"backlash_estimate": 0.042},
    "95 %": {"backlash_estimate": 0.0665},
    "120 %": {"backlash_estimate": 0.084},
    "learning rule": {"estimator": "learner", "learning_step": 0.007, "backlash_estimate": 0.007},
    "identify": IDENTIFY_SETTINGS,
}
CONTROLLER_PARAMETERS = tuple(dict.fromkeys(name for given in CONTROLLERS.values() for name in given))
KEPT_METRICS = (*METRICS, "hunting_period", "hunts", "switch_frequency")


def presets(names: Sequence[str] = COOLING) -> fc.Loop:
    """Presets along ``preset``, as a plain PI; all of them cool, or all heat."""
    loops = {name: fc.Loop.preset(name) for name in names}
    defaults, varied_names = dict(fc.Loop().items()), dict[str, None]()
    for loop in loops.values():
        varied_names |= {n: None for n, value in loop.items() if value != defaults.get(n)}

    def preset_values(name: str) -> xr.DataArray:
        return xr.DataArray([loop[name] for loop in loops.values()], {"preset": list(loops)}, "preset")

    return fc.Loop(**{name: preset_values(name) for name in varied_names})


def simulate_steps(days: range = DAYS) -> xr.Dataset:
    """Simulate the presets, each on days of its own kind, with every march, number of substeps and backlash."""
    parts = []
    for names, day in ((COOLING, fc.paper_day), (("heating",), fc.heating_day), (("heating_45",), _cooler_heating_day)):
        loop = presets(names).assign(air_march=list(MARCHES), substeps=list(SUBSTEPS), backlash=list(BACKLASH))
        ds = fc.simulate(loop, day(hours=8, seed=list(days)))
        parts.append(ds[list(KEPT_METRICS)].reset_coords(drop=True))
    return xr.concat(parts, "preset")


def _cooler_heating_day(hours: int, seed: list[int]) -> fc.Boundary:
    return fc.heating_day(hours=hours, seed=seed, T_w_in=45.0)


def simulate_volumes(days: range = DAYS) -> xr.Dataset:
    """Simulate the presets, converged in time, with more and more volumes."""
    loop = presets().assign(converged=True, substeps=8, n_volumes=list(VOLUMES), backlash=list(BACKLASH[:2]))
    return fc.simulate(loop, fc.paper_day(hours=8, seed=list(days)))


def simulate_kinds(days: range = DAYS, weather: Path = WEATHER_FILE) -> dict[str, xr.Dataset]:
    """Simulate the presets on each kind of cooling day, as printed, converged, finest: (way, backlash, preset, day)."""
    ways = {"air_march": [march for march, _ in WAYS], "substeps": [n for _, n in WAYS]}
    loop = presets().assign(backlash=list(BACKLASH), **{name: ("way", values) for name, values in ways.items()})
    return {kind: fc.simulate(loop, make_days(kind, list(days), weather)) for kind in kinds(weather) if kind != HEATING}


def simulate_claims(days: range = DAYS) -> xr.Dataset:
    """Simulate the presets with 7 % backlash and every controller, both ways: (way, controller, preset, day)."""
    loop = presets().assign(**{name: ("controller", _controller_values(name)) for name in CONTROLLER_PARAMETERS})
    day = fc.paper_day(hours=8, seed=list(days))
    parts = [fc.simulate(loop.assign(air_march=march, substeps=n), day) for march, n in WAYS[:2]]
    kept_metrics = ["rmse", "switch_frequency", "estimate_settled"]
    ds = xr.concat([part[kept_metrics].reset_coords(drop=True) for part in parts], "way")
    return ds.assign_coords(controller=list(CONTROLLERS))


def _controller_values(name: str) -> list[Any]:
    default = "none" if name == "estimator" else fc.Loop()[name]
    return [{"plant_gain": 20.0, **parameters}.get(name, default) for parameters in CONTROLLERS.values()]


def format_change(now: xr.DataArray, before: xr.DataArray) -> str:
    """Change of the mean over days in per cent, and half its 95 % interval over days."""
    relative = (now / float(before.mean()) - before / float(before.mean())).values
    n, middle = relative.size, 100.0 * float(relative.mean())
    half = 100.0 * float(t.ppf(0.975, n - 1)) * float(relative.std(ddof=1)) / np.sqrt(n)
    return f"{middle:+.1f} ± {half:.1f} %" if max(abs(middle), half) >= 0.05 else "0.0 %"


def change_row(now: xr.Dataset, before: xr.Dataset) -> list[str]:
    """Format the change of every metric as a row."""
    return [format_change(now[name], before[name]) for name in METRICS]


def write_steps(ds: xr.Dataset) -> None:
    """Write how far each march and number of substeps is from the finest."""
    finest = _select_way(ds, FINEST)
    write_table(
        "numerics/convergence_steps",
        f"Change against the quasistatic march in {FINEST[1]} substeps, at 7 % backlash: means of {ds.sizes['day']} "
        "days with set-point steps, and half their 95 % interval",
        ["preset", "air march", "substeps", *(name.replace("_", " ") for name in METRICS)],
        (
            [
                name,
                march,
                str(n),
                *change_row(*(d.sel(preset=name, backlash=0.07) for d in (_select_way(ds, (march, n)), finest))),
            ]
            for name in map(str, ds.preset.values)
            for march, n in SHOWN_WAYS
        ),
    )


def write_backlash(ds: xr.Dataset) -> None:
    """Write what becomes of each preset and backlash, as printed and converged."""
    ways = [_select_way(ds, way) for way in WAYS]
    forms = {"rmse": "{:.3f}", "hunting_swing": "{:.3f}", "hunting_period": "{:.0f}", "hunts": "{:.0%}",
             "switch_frequency": "{:.1f}", "motor_travel": "{:.1f}"}  # fmt: skip
    write_table(
        "numerics/convergence_backlash",
        f"As printed → converged → in {FINEST[1]} substeps: means of {ds.sizes['day']} days with set-point steps",
        ["preset", "backlash", "RMSE, K", "hunting swing, K", "period, s", "days on which it hunts",
         "switches per 10 min", "motor travel, strokes"],
        (
            [name, f"{x:.0%}"]
            + [" → ".join(form.format(float(way[metric].sel(preset=name, backlash=x).mean())) for way in ways)
               .replace("nan", "–")
               for metric, form in forms.items()]
            for name in map(str, ds.preset.values)
            for x in BACKLASH
        ),
    )  # fmt: skip


def write_kinds(by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write whether each preset hunts on each kind of day."""
    rows = []
    for kind, ds in by_kind.items():
        for name in map(str, ds.preset.values):
            cells = []
            for x in BACKLASH:
                preset_ds = ds.sel(preset=name, backlash=x)
                counts = [int(preset_ds.hunts.isel(way=k).sum()) for k in range(len(WAYS))]
                swings = [float(preset_ds.hunting_swing.isel(way=k).mean()) for k in range(len(WAYS))]
                cells += [" → ".join(map(str, counts)), " → ".join(f"{swing:.2f}" for swing in swings)]
            rows.append([kind, name, *cells])
    first_ds = next(iter(by_kind.values()))
    write_table(
        "numerics/convergence_kinds",
        f"Number of days, of {first_ds.sizes['day']}, on which each preset hunts, and mean swing, K, as printed → "
        "converged "
        f"→ in {FINEST[1]} substeps",
        ["days", "preset", *(f"{description}, X = {x:.0%}" for x in BACKLASH for description in ("hunts", "swing"))],
        rows,
    )


def write_claims(ds: xr.Dataset) -> None:
    """Write what the paper says of its loop, as printed and converged."""
    plain, mean = ds.rmse.sel(controller="plain PI"), ds.mean("day")

    def join_with_arrows(values: xr.DataArray, form: str) -> str:
        return " → ".join(form.format(float(value)) for value in values)

    rows = []
    for name in map(str, ds.preset.values):
        gains = [
            join_with_arrows(100 * (ds.rmse.sel(controller=c) / plain - 1.0).sel(preset=name).mean("day"), "{:+.0f}")
            + " %"
            for c in ("60 %", "95 %", "120 %")
        ]
        switches = [
            join_with_arrows(mean.switch_frequency.sel(controller=c, preset=name), "{:.1f}")
            for c in ("plain PI", "95 %", "120 %")
        ]
        estimates = [
            join_with_arrows(100 * mean.estimate_settled.sel(controller=c, preset=name), "{:.1f}") + " %"
            for c in ("learning rule", "identify")
        ]
        rows.append([name, *gains, *switches, *estimates])
    write_table(
        "numerics/convergence_claims",
        "With 7 % backlash, as printed → converged: change of RMSE by an inverse, mode switches per 10 min, and "
        f"settled estimate; means of {ds.sizes['day']} days with set-point steps",
        ["preset", *(f"RMSE, inverse of {c}" for c in ("60 %", "95 %", "120 %")),
         *(f"switches, {c}" for c in ("plain PI", "95 %", "120 %")), "learning rule of the paper", "identify"],
        rows,
    )  # fmt: skip


def write_volumes(ds: xr.Dataset) -> None:
    """Write how far each number of volumes is from eight."""
    write_table(
        "numerics/convergence_volumes",
        "Change against 8 volumes, both converged in time, with C and β scaled by 8/N: means of "
        f"{ds.sizes['day']} days with set-point steps, and half their 95 % interval",
        ["preset", "backlash", "N", *(name.replace("_", " ") for name in METRICS)],
        (
            [name, f"{x:.0%}", str(n), *change_row(*(ds.sel(preset=name, backlash=x, n_volumes=k) for k in (n, 8)))]
            for name in map(str, ds.preset.values)
            for x in map(float, ds.backlash.values)
            for n in VOLUMES[1:]
        ),
    )


def energy_balance_rows() -> list[list[str]]:
    """Heat that the water takes at rest, against the enthalpy that the air loses: a row each humidity and opening."""
    rows = []
    for W in HUMIDITY:
        day = fc.constant_day(hours=2, W_a_in=W)
        T_a, m_a = (float(day.series[name].flat[-1]) for name in ("T_a_in", "m_a"))
        for opening in OPENINGS:
            command = np.full(day.n_steps, opening)
            traces = ["T_sup", "W_sup", "wet_volumes", "power", "T_c", "W_a"]
            ds = fc.simulate(fc.Loop(), day, command=command, traces=traces).squeeze(drop=True)
            T, W_out, wet, water = (float(ds[name][-1]) for name in ("T_sup", "W_sup", "wet_volumes", "power"))
            air = m_a * float(enthalpy(T_a, W) - enthalpy(T, W_out))
            T_c, W_a = (ds[name].isel(elapsed_time=-1).values for name in ("T_c", "W_a"))
            # the air enters the last volume
            condensate = m_a * HEAT_CAPACITY_OF_WATER * float((-np.diff(W_a[::-1], prepend=W) * T_c[::-1]).sum())
            rows.append([f"{1000 * W:g}", f"{opening:g}", f"{wet:.0f}", f"{water:.2f}", f"{air:.2f}",
                         f"{100 * (water / air - 1.0):+.2f} %", f"{100 * condensate / water:.2f} %"])  # fmt: skip
    return rows


def write_closure() -> None:
    """Write the energy balance: c_p,a of Eq (4) is constant, that of moist air is not."""
    write_table(
        "numerics/closure",
        "Energy balance in steady state, c_p,a 1.02 kJ/(kg K): heat taken up by the water compared with the enthalpy "
        "lost by the air",
        ["humidity ratio, g/kg", "command", "wet volumes", "water, kW", "air, kW", "water over air",
         "left out: condensate, of the water's heat"],
        energy_balance_rows(),
    )  # fmt: skip


def _select_way(ds: xr.Dataset, way: tuple[str, int]) -> xr.Dataset:
    return ds.sel(air_march=way[0], substeps=way[1], drop=True)


def sample() -> None:
    """Run a sample of the study: numbers of control volumes, and the energy balance."""
    write_volumes(simulate_volumes(DAYS))
    write_closure()


def main(days: range = DAYS, weather: Path = WEATHER_FILE, **size: Any) -> None:
    """Run everything and write every table; size: of the populations."""
    steps_ds = simulate_steps(days)
    write_steps(steps_ds)
    write_backlash(steps_ds)
    write_kinds(simulate_kinds(days, weather))
    write_claims(simulate_claims(days))
    write_volumes(simulate_volumes(days))
    write_closure()
    numerics_populations.main(weather=weather, **size)
