"""Why a loop hunts: error rates of the rules, the maps, and ``main``.

What is chosen is chosen on one set of valves and conditions and judged on others.  ``loops.py`` has valves, models and
rules, ``backlash.py`` what size, kicks and parts do, ``cures.py`` what a rule costs and which gain to change.
"""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import FuncFormatter, NullFormatter

from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from fastcoil.study.file.spec import read_study
from studies.common import STUDIES, progress, results, save_figure, share_of, write_table
from studies.days import kinds
from studies.hunting import backlash as hunting_backlash
from studies.hunting import cures
from studies.hunting import loops as hunting_loops
from studies.hunting.loops import (
    MISREAD,
    Rule,
    able,
    any_place,
    by_one_step,
    counted,
    errors,
    foreseen,
    hunting_of,
    misread,
    share_written,
    smallest,
)

SHOWN = ("hunting_index", "formula", "`fc.limit_cycle`")


def write_one_step(formula: Rule, limit: float, ds: xr.Dataset) -> None:
    """Write how good the formula is where the step was made elsewhere; limit: see ``cautious``."""
    given = {
        "where it works": ds,
        f"where it works, K, T and θ off by {MISREAD:.0%}": misread(ds),
        "anywhere": by_one_step(ds, any_place),
        "at the smallest opening": by_one_step(ds, smallest),
        "at the largest opening": by_one_step(ds, lambda of: -of.opening),
    }
    table = []
    for name, found in given.items():
        more = errors(found, formula._replace(limit=limit))
        table.append([name, *errors(found, formula), *more[1:]])
    write_table(
        "hunting/hunting_one_step",
        f"The formula with K, T and θ from a single step test of each valve, applied to all its other conditions: "
        f"{ds.sizes['sample']:,} fresh loops × {ds.sizes['day']} conditions",
        ["the step was made", f"limit {formula.limit:g}: right", "of those that hunt", "of the calm",
         f"limit {limit:g}: of those that hunt", "of the calm"],
        table,
    )  # fmt: skip


def write_errors(rules: list[Rule], found: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates of all rules; ``found``: fresh valves, and other plants."""
    (fresh, ds), *others = found.items()
    table = []
    for rule in rules:
        row = [rule.name, f"{rule.limit:g}", *errors(ds, rule)]
        row += [errors(other, rule)[0] for _, other in others]
        table.append(row)
    among = counted(ds)
    write_table(
        "hunting/hunting_rules",
        f"Rules for hunting on {fresh}: {ds.sizes['sample']:,} loops × {ds.sizes['day']} conditions, of which "
        f"{int(among.sum()):,} can hold their set-point and {share_of(ds.hunts > 0, among)} hunt; shares with 95 % "
        "intervals over valves and conditions",
        ["what it looks at", "hunts above", "predicted right", "of those that hunt", "of those that are calm",
         *(f"predicted right, {name}" for name, _ in others)],
        table,
    )  # fmt: skip


def write_by_backlash(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write how often the hunting index, the formula and ``fc.limit_cycle`` are right at each size of backlash."""
    table = []
    for size in np.unique(ds.backlash):
        part = ds.isel(sample=np.flatnonzero(ds.backlash.isel(day=0) == size))
        row = [f"{size:.0%}", share_of(part.hunts > 0, able(part)).written(0)]
        for rule in (*rules[:2], rules[-1]):
            row += errors(part, rule, able(part))[:2]
        table.append(row)
    of = [f"{name}: {what}" for name in SHOWN for what in ("right", "of those that hunt")]
    write_table(
        "hunting/hunting_by_backlash",
        f"Predictions of hunting by backlash: {ds.sizes['sample']:,} fresh loops × {ds.sizes['day']} conditions",
        ["backlash", "hunt", *of],
        table,
    )


def write_practice(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write what happens to those who obey a rule of thumb, and to those who do not."""
    formula = rules[1]
    of_two = rules[2]
    given = {
        "Ti ≥ T": ds.ti >= ds["T"],
        "Ti ≥ T / 2": ds.ti >= 0.5 * ds["T"],
        f"Ti ≥ kp K (T + 2 θ) / {of_two.safe:g}": of_two.of(ds) <= of_two.safe,
        f"Ti ≥ {formula.name.removesuffix(' / Ti')} / {formula.safe:g}": formula.of(ds) <= formula.safe,
        f"Ti ≥ {formula.name.removesuffix(' / Ti')} / {formula.limit:g}": formula.of(ds) <= formula.limit,
        f"hunting index ≤ {rules[0].safe:g}": ds.hunting_index <= rules[0].safe,
    }
    among, hunts, table = counted(ds), ds.hunts > 0.0, []
    for name, obeys in given.items():
        table.append(
            [
                name,
                share_written(obeys, among, 0),
                share_written(hunts, among & obeys),
                share_written(hunts, among & ~obeys, 0),
                share_written(~obeys, among & ~hunts, 0),
            ]
        )
    write_table(
        "hunting/hunting_practice",
        f"Rules of thumb, and how often the loops that meet them hunt; {ds.sizes['sample']:,} fresh loops × "
        f"{ds.sizes['day']} conditions",
        ["rule", "meet it", "hunt although they meet it", "hunt of those that do not", "calm loops that it forbids"],
        table,
    )


def write_days(rules: list[Rule], found: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates on days on which air, water and set-point move."""
    table = []
    for kind, ds in found.items():
        among = counted(ds)
        row = [kind, f"{int(among.sum()):,}", str(share_of(ds.hunts > 0, among))]
        for rule in (*rules[:2], rules[-1]):
            row += errors(ds, rule)
        table.append(row)
    of = [f"{name}: {what}" for name in SHOWN for what in ("right", "of those that hunt", "of the calm")]
    write_table(
        "hunting/hunting_days",
        "Rules for hunting on days with noise and with varying air, water and set-point: predictions from the mean "
        "conditions of the day",
        ["days", "loops × days", "hunt", *of],
        table,
    )


STUDY = STUDIES / "hunting" / "hunting.toml"
SWING = (0.1, 30.0)
"""K, peak to peak: the ends of the colours; below lies what does not hunt."""
DOTS = 2500
"""Loops in the panels without dimensions."""
PERIODS = (120, 200, 300, 500, 800)
"""s"""


def of_presets() -> xr.Dataset:
    """Metrics of the study ``hunting.toml``, and what is foreseen of its loops: (plant, kp, ti)."""
    layout = read_study(STUDY).plan.layout
    plant = foreseen(layout.loop, layout.boundary)
    ds = results("hunting")
    return xr.merge([hunting_of(ds), plant], compat="override", join="override").load()


def write_presets(ds: xr.Dataset, rules: list[Rule]) -> None:
    """Write how far the boundary on the maps is right."""
    table = []
    for plant in ds.plant.values:
        at = ds.sel(plant=plant)
        hunts, row = at.hunts > 0, [f"`{plant}`", f"{float((at.hunts > 0).mean()):.0%}"]
        for rule in rules[:2]:
            said = rule.of(at.assign(kp=at.kp, ti=at.ti)) > rule.limit
            row += [
                f"{float((said == hunts).mean()):.1%}",
                f"{int((said & ~hunts).sum())}, {int((~said & hunts).sum())}",
            ]
        table.append(row)
    heads = [f"{rule.name}: {what}" for rule in rules[:2] for what in ("right", "false alarms, missed")]
    write_table("hunting/hunting_presets", f"The maps of the presets, {ds.sizes['kp']} kp × {ds.sizes['ti']} ti each",
                ["plant", "hunt", *heads], table)  # fmt: skip


@apply_style(axes_grid=False)
def draw_presets(ds: xr.Dataset, rules: list[Rule]) -> None:
    """Draw a map for each plant: swing as colour, boundaries and periods as lines."""
    figure, panels = plt.subplots(2, 2, figsize=(9.0, 7.6), sharex=True, sharey=True, layout="constrained")
    mesh = None
    for panel, plant in zip(panels.flat, ds.plant.values, strict=True):
        at = ds.sel(plant=plant).transpose("kp", "ti")
        swing = at.swing.where(at.hunts > 0)
        mesh = panel.pcolormesh(at.ti, at.kp, swing, norm=LogNorm(*SWING), cmap="cividis_r", shading="nearest")
        mesh.set_rasterized(True)
        lines = panel.contour(at.ti, at.kp, at.period.where(at.regular > 0), levels=PERIODS, colors="white",
                              linewidths=0.9)  # fmt: skip
        panel.clabel(lines, fmt=lambda s: f"{s:g} s", fontsize=7)
        for rule, colour, style in zip(rules[:2], (RED, "black"), ("-", "--"), strict=True):
            panel.contour(at.ti, at.kp, rule.of(at).transpose("kp", "ti"), levels=[rule.limit], colors=[colour],
                          linestyles=[style], linewidths=1.8)  # fmt: skip
        T = float(at["T"].isel(kp=0, ti=0))
        panel.axvline(T, color="0.4", lw=1.0, ls=":")
        panel.annotate("Ti = T", (T, 0.0023), fontsize=7, color="0.3", rotation=90, xytext=(2, 0),
                       textcoords="offset points", va="bottom")  # fmt: skip
        panel.set(title=str(plant), xscale="log", yscale="log")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axis.set_minor_formatter(NullFormatter())
    for panel in panels[1]:
        panel.set_xlabel("Ti [s]")
    for panel in panels[:, 0]:
        panel.set_ylabel("kp [1/K]")
    bar = figure.colorbar(
        mesh, ax=panels, label="swing of the supply temperature, peak to peak [K]; white: calm", shrink=0.8
    )
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    handles = [plt.Line2D([], [], color=RED, lw=1.8), plt.Line2D([], [], color="black", ls="--", lw=1.8),
               plt.Line2D([], [], color="0.6", lw=0.9)]  # fmt: skip
    names = [f"hunting index {rules[0].limit:g}", f"{rules[1].name} = {rules[1].limit:g}", "period"]
    figure.legend(handles, names, loc="outside upper center", ncols=3)
    save_figure(figure, "hunting/hunting.png")


@apply_style()
def draw_population(ds: xr.Dataset, sizes: xr.Dataset, rules: list[Rule]) -> None:
    """Draw loops without dimensions: Ti/T × gain margin, the formula, and the swing over the hunting index."""
    figure, panels = plt.subplots(1, 3, figsize=(12.0, 4.3), layout="constrained")
    at = np.flatnonzero(counted(ds).transpose(*ds.hunts.dims).values.ravel())
    at = np.random.default_rng(1).choice(at, min(DOTS, at.size), replace=False)
    flat = {name: np.asarray(ds[name].transpose(*ds.hunts.dims).values).ravel()[at]
            for name in ("kp", "ti", "K", "T", "theta", "gain_margin", "hunts")}  # fmt: skip
    hunts = flat["hunts"] > 0
    gain = flat["kp"] * flat["K"]
    _two(panels[0], flat["ti"] / flat["T"], flat["gain_margin"], hunts)
    panels[0].set(xlabel="Ti / T", ylabel="gain margin", xlim=(0.02, 6), ylim=(0.3, 60))
    panels[0].axhline(1.0, color="0.4", ls=":")
    name = rules[1].name
    _two(panels[1], (flat["T"] + _delays(name) * flat["theta"]) / flat["ti"], gain, hunts)
    ratio = np.geomspace(0.2, 60, 50)
    panels[1].plot(ratio, (rules[1].limit / ratio) ** (1.0 / _power(name)), color="black", ls="--")
    panels[1].set(xlabel=f"(T + {_delays(name):g} θ) / Ti", ylabel="kp K", xlim=(0.2, 60), ylim=(0.03, 6))
    for size, colour, mark in ((0.01, "0.55", "s"), (0.03, YELLOW, "^"), (0.07, RED, "o"), (0.15, BLUE, "D")):
        at = sizes.sel(backlash=size)
        ok = at.cycles & at.reachable.astype(bool) & (at.gain_margin > 1.0)
        scaled = (at.swing / (size * at.K)).where(ok).values.ravel()
        panels[2].plot(
            at.hunting_index.values.ravel(), scaled, mark, color=colour, ms=3, alpha=0.7, mew=0, label=f"X = {size:.0%}"
        )
    panels[2].axvline(rules[0].limit, color=RED)
    panels[2].set(xlabel="hunting index, largest |L| |N|", ylabel="swing / (X K)", xlim=(0.5, 6), ylim=(0.03, 20))
    panels[2].legend(loc="lower right")
    for panel in panels:
        panel.set(xscale="log", yscale="log")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axis.set_minor_formatter(NullFormatter())
    panels[0].legend(loc="lower left", markerscale=2)
    save_figure(figure, "hunting/hunting_population.png")


def _two(panel: Axes, x: np.ndarray, y: np.ndarray, hunts: np.ndarray) -> None:
    for part, colour, mark, label in ((~hunts, BLUE, "o", "calm"), (hunts, RED, "x", "hunts")):
        panel.plot(x[part], y[part], mark, color=colour, ms=2.6, alpha=0.5, mew=0.7, label=label, rasterized=True)


def _power(name: str) -> float:
    return float(name.split("^")[1].split(" ", maxsplit=1)[0])


def _delays(name: str) -> float:
    return float(name.split("+ ")[1].split(" ", maxsplit=1)[0])


CHOICE, FRESH, WIDE, ON_DAYS, SIZES, START, PARTS, COST, CURES = range(15001, 15900, 100)
"""Seeds of the valves; those of the conditions are one more."""
OF_DAYS = range(15911, 15914)


def sample(size: int = 384, days: int = 6) -> None:
    """How hunting begins."""
    hunting_backlash.write_start(hunting_backlash.run_start(START, size // 2, max(days // 2, 2)))


def main(size: int = 384, days: int = 6) -> None:
    """Run everything, write the tables and draw the figures; ``size`` valves, ``days`` conditions of a kind."""
    done = progress()
    choice = hunting_loops.population(CHOICE, 2 * size, days)
    rules, shape = hunting_loops.chosen(choice)
    done(f"chose {', '.join(f'{rule.name}: {rule.limit:g}' for rule in rules)}")
    fresh = hunting_loops.population(FRESH, 2 * size, days + 2)
    wide = hunting_loops.population(WIDE, size, days, wide=True)
    write_errors(rules, {"fresh valves": fresh, "other plants": wide})
    write_by_backlash(rules, fresh)
    cautious = hunting_loops.cautious(rules[1], choice)
    write_one_step(rules[1], cautious, fresh)
    write_practice(rules, fresh)
    done("ran fresh valves and other plants")
    write_days(rules, {kind: hunting_loops.on_days(ON_DAYS, size, kind, OF_DAYS) for kind in kinds()})
    done("ran other days")
    sizes = hunting_backlash.run_backlash(SIZES, size // 2, max(days // 2, 2))
    hunting_backlash.write_backlash(sizes, rules[0].limit)
    hunting_backlash.write_bands(sizes)
    hunting_backlash.write_start(hunting_backlash.run_start(START, size // 2, max(days // 2, 2)))
    done("ran every backlash, and kicks")
    hunting_backlash.write_parts(hunting_backlash.run_parts(PARTS, size // 8, 2))
    done("ran other motors, sensors and controllers")
    hunting_index, formula, product, *_ = rules
    slow = Rule("Ti ≥ T", lambda ds: ds["T"] / ds.ti, 1.0, 1.0)
    obeyed = {f"{rule.name} ≤ {rule.limit:g}": rule for rule in (hunting_index, formula, product)}
    cures.write_cost(*cures.run_cost(COST, size // 4, {**obeyed, slow.name: slow}))
    cures.write_cures(*cures.run_cures(CURES, size, formula, shape, cautious))
    done("ran what rules cost")
    presets = of_presets()
    write_presets(presets, rules)
    draw_presets(presets, rules)
    draw_population(fresh, sizes, rules)
    done("drew")
