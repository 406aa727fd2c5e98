"""Remedies for backlash against the best plain PI of the same valve: error, travel and harm, on every kind of day.

Run with ``python studies/remedies.py``.  The valves, loops and remedies are those of ``remedies.toml``: one row there
is one remedy here.  Every valve gets its own best gains, sought around those of SIMC on days of their own.  All
remedies then run with these gains, and once more with those of SIMC, on the same fresh days and with the same noise.
The gains as they were drawn run as plain PI, too.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from best_pi import simc_gains
from kinds import HEATING, kinds, of_kind, settings
from report import HERE, write_table

import fastcoil as fc
from fastcoil.study.file.spec import read_study

STUDY = HERE / "remedies.toml"
SEARCH_DAYS, FRESH_DAYS = range(4101, 4103), range(4201, 4206)
KP_FACTORS, TI_FACTORS = (0.4, 0.7, 1.0, 1.5, 2.2, 3.2), (0.5, 1.0, 2.0, 4.0)
"""Gains that are tried, as multiples of SIMC's."""
HEATING_GAIN = 0.3
"""The drawn kp is for cooling; a loop with water of 40 °C responds about three times as much."""
BASELINE, DRAWN, SIMC = "best PI", "PI as found", "PI by SIMC"
METRICS = ("rmse", "rmse_settled", "motor_travel", "reversals", "share_off", "hunts")
NO_CHANGE = 0.01
"""Share of the error, above which a remedy counts as harm."""


def population(size: int | None = None) -> fc.Loop:
    """The valves and loops of the study along ``sample``, with all its remedies along ``controller``."""
    loop = read_study(STUDY).plan.layout.loop
    return loop if size is None else picked(loop, sample=slice(0, size))


def picked(loop: fc.Loop, **at: int | slice) -> fc.Loop:
    """A part of a loop's dims."""
    values = {name: xr.DataArray(loop[name]) for name in fc.parameters() if loop[name] is not None}
    return fc.Loop(**{n: v.isel(at, missing_dims="ignore", drop=True) for n, v in values.items()})


def tuned(loop: fc.Loop, some: Sequence[str]) -> tuple[xr.Dataset, xr.Dataset]:
    """Gains of SIMC and the best gains of every valve on days of these kinds.

    Best is the lowest mean, over the kinds, of the RMSE relative to the best of that kind.
    """
    simc = simc_gains(loop, some[0])
    tried = {"kp": KP_FACTORS, "ti": TI_FACTORS}
    factors = {name: xr.DataArray(list(values), dims=f"{name}_factor") for name, values in tried.items()}
    swept = loop.assign(kp=simc.kp * factors["kp"], ti=simc.ti * factors["ti"])
    cost = 0.0
    for kind in some:
        error = (
            fc.simulate(swept.assign(**settings(kind)), of_kind(kind, SEARCH_DAYS))
            .rmse.mean("day")
            .reset_coords(drop=True)
        )
        error = error.fillna(np.inf)
        cost = cost + error / error.min(["kp_factor", "ti_factor"])
    at = cost.argmin(["kp_factor", "ti_factor"])
    best = xr.Dataset({name: (simc[name] * factors[name].isel(at, missing_dims="ignore")) for name in ("kp", "ti")})
    return simc, best.reset_coords(drop=True)


def remedies(loop: fc.Loop, kind: str, simc: xr.Dataset, best: xr.Dataset) -> xr.Dataset:
    """Every remedy with the best gains and with those of SIMC, and plain PI as found, on fresh days of a kind."""
    plain = picked(loop, controller=0)
    drawn = xr.DataArray(plain["kp"]) * (HEATING_GAIN if kind == HEATING else 1.0)
    day = of_kind(kind, FRESH_DAYS)
    found = [_kept(fc.simulate(plain.assign(kp=drawn, **settings(kind)), day)).expand_dims(controller=[DRAWN])]
    for gains, plain_name, ending in ((simc, SIMC, ", SIMC gains"), (best, BASELINE, "")):
        ds = _kept(fc.simulate(loop.assign(kp=gains.kp, ti=gains.ti, **settings(kind)), day))
        names = [plain_name if n == "pi" else f"{n}{ending}" for n in ds.controller.values]
        found.append(ds.assign_coords(controller=names))
    return xr.concat(found, "controller")


def _kept(ds: xr.Dataset) -> xr.Dataset:
    return ds[[*METRICS, "size_error", "status"]].reset_coords(drop=True)


def rows(ds: xr.Dataset, kind: str) -> list[list[str]]:
    """A row for each remedy: changes against the best PI.

    The intervals are those of ``fc.compare`` over valves and days, which are crossed: every valve meets every day.  The
    variances of the means of valves and of the means of days add up, and the days give the degrees of freedom.
    """
    paired = fc.compare(ds, baseline={"controller": BASELINE}, over=["sample", "day"], metrics="rmse", relative=True)
    base = ds.sel(controller=BASELINE)
    found = []
    for name in ds.controller.values:
        d, p = ds.sel(controller=name), paired.rmse.sel(controller=name)
        by_valve, settled = (d[m].mean("day") / base[m].mean("day") - 1.0 for m in ("rmse", "rmse_settled"))
        mean, low, high = (100 * float(p.sel(statistic=s)) for s in ("mean", "low", "high"))
        found.append(
            [
                kind,
                str(name),
                f"{mean:+.0f} % ({low:+.0f} to {high:+.0f})",
                ", ".join(f"{100 * float(by_valve.quantile(q)):+.0f} %" for q in (0.05, 0.5, 0.95)),
                f"{100 * float(settled.median()):+.0f} %",
                f"{float((by_valve > NO_CHANGE).mean()):.0%}",
                f"× {float((d.motor_travel.mean('day') / base.motor_travel.mean('day')).median()):.2f}",
                f"× {float(d.reversals.sum() / base.reversals.sum()):.2f}",
                f"{float(d.share_off.mean()):.1%}",
                f"{float(d.hunts.mean()):.1%}",
            ]
        )
    return found


def rows_by_backlash(found: dict[str, xr.Dataset], backlash: xr.DataArray) -> list[list[str]]:
    """Median change of RMSE against the best PI by true backlash, over all kinds of days; 0 shows the harm."""
    error = xr.concat([ds.rmse.mean("day") for ds in found.values()], "kind")
    change = error / error.sel(controller=BASELINE) - 1.0
    table = []
    for name in change.controller.values:
        of_remedy = change.sel(controller=name)
        cells = (of_remedy.isel(sample=(backlash == x).values) for x in np.unique(backlash))
        table.append([str(name), *(f"{100 * float(cell.median()):+.0f} %" for cell in cells)])
    return table


def pareto(found: dict[str, xr.Dataset]) -> None:
    """Draw error against travel of the median valve, both relative to the best PI, a panel for each kind of days.

    A remedy has one colour and one mark: full with the best gains, hollow with those of SIMC.
    """
    figure, axes = plt.subplots(1, len(found), figsize=(3.4 * len(found), 4.0), sharey=True, layout="constrained")
    panels = list(np.atleast_1d(axes))
    for panel, (kind, ds) in zip(panels, found.items(), strict=True):
        base = ds.sel(controller=BASELINE)
        shown: list[str] = []
        for name in map(str, ds.controller.values):
            remedy = BASELINE if name == SIMC else name.removesuffix(", SIMC gains")
            shown += [] if remedy in shown else [remedy]
            k, hollow = shown.index(remedy), name != remedy
            x, y = (
                float((ds[metric].sel(controller=name).mean("day") / base[metric].mean("day")).median())
                for metric in ("motor_travel", "rmse")
            )
            panel.plot(
                x, y, "os^vDPX<>*"[k % 10], color=f"C{k % 10}", fillstyle="none" if hollow else "full", label=name
            )
        panel.set(title=kind, xscale="log", xlim=(0.05, 8.0), xlabel="motor travel / best PI")
        panel.set_xticks([0.1, 0.2, 0.5, 1.0, 2.0, 5.0], ["0.1", "0.2", "0.5", "1", "2", "5"])
        panel.minorticks_off()
        panel.axhline(1.0, color="0.8", zorder=0)
        panel.axvline(1.0, color="0.8", zorder=0)
    panels[0].set_ylabel("RMSE / best PI")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    path = HERE.parent / "results" / "remedies.png"
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)
    print(path)


def main(size: int | None = None) -> dict[str, xr.Dataset]:
    """Run everything, write the tables and draw the figure; ``size``: only the first valves."""
    loop = population(size)
    plain = picked(loop, controller=0)
    found: dict[str, xr.Dataset] = {}
    started = time.monotonic()
    for group in ([k for k in kinds() if k != HEATING], [HEATING]):
        simc, best = tuned(plain, group)
        print(f"tuned for {', '.join(group)} after {time.monotonic() - started:.0f} s", flush=True)
        found |= {kind: remedies(loop, kind, simc, best) for kind in group}
        print(f"ran after {time.monotonic() - started:.0f} s", flush=True)
    backlash = xr.DataArray(plain["backlash"])
    first = found[next(iter(found))]
    failed = sum(int((ds.status > 0).sum()) for ds in found.values())
    days = sum(ds.status.size for ds in found.values())
    write_table(
        "remedies",
        f"Remedies on {backlash.size:,} valves and loops, {first.sizes['day']} days of each kind, against the best "
        f"plain PI of the same valve ({failed} of {days:,} days failed)",
        ["days", "remedy", "RMSE, mean change (95 % over valves and days)", "RMSE: 5 %, median, 95 % of the valves",
         "settled RMSE, median", "RMSE over 1 % worse in", "motor travel, median", "reversals", "time beyond 0.5 K",
         "hunting"],
        (row for kind, ds in found.items() for row in rows(ds, kind)),
    )  # fmt: skip
    write_table(
        "remedies_by_backlash",
        "Median change of RMSE against the best plain PI by true backlash, over all kinds of days",
        ["remedy", *(f"{x:.0%}" for x in np.unique(backlash))],
        rows_by_backlash(found, backlash),
    )
    pareto(found)
    return found


if __name__ == "__main__":
    main()
