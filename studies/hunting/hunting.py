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
from studies.common import STUDIES, progress_printer, results, save_figure, share_of, write_table
from studies.days import kinds
from studies.hunting import backlash as hunting_backlash
from studies.hunting import cures
from studies.hunting import loops as hunting_loops
from studies.hunting.loops import (
    MODEL_ERROR,
    Rule,
    error_shares,
    first_condition,
    hunting_metrics,
    is_counted,
    is_usable,
    loop_properties,
    predict_from_one_step,
    share_or_dash,
    smallest_opening,
    with_model_errors,
)

SHOWN_RULES = ("hunting index", "formula", "`fc.limit_cycle`")


def write_one_step(formula: Rule, limit: float, ds: xr.Dataset) -> None:
    """Write how good the formula is where the step was made elsewhere; limit: see ``cautious_limit``."""
    by_step = {
        "where it works": ds,
        f"where it works, K, T and θ off by {MODEL_ERROR:.0%}": with_model_errors(ds),
        "anywhere": predict_from_one_step(ds, first_condition),
        "at the smallest opening": predict_from_one_step(ds, smallest_opening),
        "at the largest opening": predict_from_one_step(ds, lambda population_words: -population_words.opening),
    }
    table = []
    for name, predictions in by_step.items():
        with_limit = error_shares(predictions, formula._replace(limit=limit))
        table.append([name, *error_shares(predictions, formula), *with_limit[1:]])
    write_table(
        "hunting/hunting_one_step",
        f"The formula with K, T and θ from a single step test of each valve, applied to all its other conditions: "
        f"{ds.sizes['sample']:,} fresh loops × {ds.sizes['day']} conditions",
        ["the step was made", f"limit {formula.limit:g}: right", "of those that hunt", "of the calm",
         f"limit {limit:g}: of those that hunt", "of the calm"],
        table,
    )  # fmt: skip


def write_errors(rules: list[Rule], by_population: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates of all rules; ``by_population``: fresh valves, and other plants."""
    (fresh, ds), *other_plants = by_population.items()
    table = []
    for rule in rules:
        row = [rule.name, f"{rule.limit:g}", *error_shares(ds, rule)]
        row += [error_shares(plant_ds, rule)[0] for _, plant_ds in other_plants]
        table.append(row)
    among = is_counted(ds)
    write_table(
        "hunting/hunting_rules",
        f"Rules for hunting on {fresh}: {ds.sizes['sample']:,} loops × {ds.sizes['day']} conditions, of which "
        f"{int(among.sum()):,} can hold their set-point and {share_of(ds.hunts > 0, among)} hunt; shares with 95 % "
        "intervals over valves and conditions",
        ["what it looks at", "hunts above", "predicted right", "of those that hunt", "of those that are calm",
         *(f"predicted right, {name}" for name, _ in other_plants)],
        table,
    )  # fmt: skip


def write_by_backlash(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write how often the hunting index, the formula and ``fc.limit_cycle`` are right at each size of backlash."""
    table = []
    for size in np.unique(ds.backlash):
        part = ds.isel(sample=np.flatnonzero(ds.backlash.isel(day=0) == size))
        row = [f"{size:.0%}", share_of(part.hunts > 0, is_usable(part)).to_text(0)]
        for rule in (*rules[:2], rules[-1]):
            row += error_shares(part, rule, is_usable(part))[:2]
        table.append(row)
    heads = [f"{name}: {case_words}" for name in SHOWN_RULES for case_words in ("right", "of those that hunt")]
    write_table(
        "hunting/hunting_by_backlash",
        f"Predictions of hunting by backlash: {ds.sizes['sample']:,} fresh loops × {ds.sizes['day']} conditions",
        ["backlash", "hunt", *heads],
        table,
    )


def write_practice(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write how many loops hunt that meet a rule of thumb, and that do not."""
    formula = rules[1]
    two_delays_rule = rules[2]
    rules_of_thumb = {
        "Ti ≥ T": ds.ti >= ds["T"],
        "Ti ≥ T / 2": ds.ti >= 0.5 * ds["T"],
        f"Ti ≥ kp K (T + 2 θ) / {two_delays_rule.safe:g}": two_delays_rule.indicator(ds) <= two_delays_rule.safe,
        f"Ti ≥ {formula.name.removesuffix(' / Ti')} / {formula.safe:g}": formula.indicator(ds) <= formula.safe,
        f"Ti ≥ {formula.name.removesuffix(' / Ti')} / {formula.limit:g}": formula.indicator(ds) <= formula.limit,
        f"hunting index ≤ {rules[0].safe:g}": ds.hunting_index <= rules[0].safe,
    }
    among, hunts, table = is_counted(ds), ds.hunts > 0.0, []
    for name, obeys in rules_of_thumb.items():
        table.append(
            [
                name,
                share_or_dash(obeys, among, 0),
                share_or_dash(hunts, among & obeys),
                share_or_dash(hunts, among & ~obeys, 0),
                share_or_dash(~obeys, among & ~hunts, 0),
            ]
        )
    write_table(
        "hunting/hunting_practice",
        f"Rules of thumb, and how often the loops that meet them hunt; {ds.sizes['sample']:,} fresh loops × "
        f"{ds.sizes['day']} conditions",
        ["rule", "meet it", "hunt although they meet it", "hunt of those that do not", "calm loops that it forbids"],
        table,
    )


def write_days(rules: list[Rule], by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates on days on which air, water and set-point move."""
    table = []
    for kind, ds in by_kind.items():
        among = is_counted(ds)
        row = [kind, f"{int(among.sum()):,}", str(share_of(ds.hunts > 0, among))]
        for rule in (*rules[:2], rules[-1]):
            row += error_shares(ds, rule)
        table.append(row)
    heads = [f"{name}: {what}" for name in SHOWN_RULES for what in ("right", "of those that hunt", "of the calm")]
    write_table(
        "hunting/hunting_days",
        "Rules for hunting on days with noise and with varying air, water and set-point: predictions from the mean "
        "conditions of the day",
        ["days", "loops × days", "hunt", *heads],
        table,
    )


STUDY = STUDIES / "hunting" / "hunting.toml"
SWING_LIMITS = (0.1, 30.0)  # K, peak to peak: the ends of the colours; below lies what does not hunt
MAX_DOTS = 2500  # largest number of loops in the panels without dimensions
PERIOD_LEVELS = (120, 200, 300, 500, 800)  # of the lines of equal period on the maps, s


def preset_results() -> xr.Dataset:
    """Results of the study ``hunting.toml``, and properties of its loops: (plant, kp, ti)."""
    layout = read_study(STUDY).plan.layout
    plant = loop_properties(layout.loop, layout.boundary)
    ds = results("hunting")
    return xr.merge([hunting_metrics(ds), plant], compat="override", join="override").load()


def write_presets(ds: xr.Dataset, rules: list[Rule]) -> None:
    """Write how far the boundary on the maps is right."""
    table = []
    for coil in ds.coil.values:
        plant_ds = ds.sel(coil=coil)
        hunts, row = plant_ds.hunts > 0, [f"`{coil}`", f"{float((plant_ds.hunts > 0).mean()):.0%}"]
        for rule in rules[:2]:
            is_predicted = rule.indicator(plant_ds.assign(kp=plant_ds.kp, ti=plant_ds.ti)) > rule.limit
            row += [
                f"{float((is_predicted == hunts).mean()):.1%}",
                f"{int((is_predicted & ~hunts).sum())}, {int((~is_predicted & hunts).sum())}",
            ]
        table.append(row)
    heads = [f"{rule.name}: {case_words}" for rule in rules[:2] for case_words in ("right", "false alarms, missed")]
    write_table("hunting/hunting_presets", f"The maps of the presets, {ds.sizes['kp']} kp × {ds.sizes['ti']} ti each",
                ["coil", "hunt", *heads], table)  # fmt: skip


@apply_style(axes_grid=False)
def draw_presets(ds: xr.Dataset, rules: list[Rule]) -> None:
    """Draw a map for each plant: swing as colour, boundaries and periods as lines."""
    figure, panels = plt.subplots(2, 2, figsize=(9.0, 7.6), sharex=True, sharey=True, layout="constrained")
    mesh = None
    for panel, coil in zip(panels.flat, ds.coil.values, strict=True):
        plant_ds = ds.sel(coil=coil).transpose("kp", "ti")
        swing = plant_ds.swing.where(plant_ds.hunts > 0)
        mesh = panel.pcolormesh(
            plant_ds.ti, plant_ds.kp, swing, norm=LogNorm(*SWING_LIMITS), cmap="cividis", shading="nearest"
        )
        mesh.set_rasterized(True)
        lines = panel.contour(plant_ds.ti, plant_ds.kp, plant_ds.period.where(plant_ds.regular > 0),
                              levels=PERIOD_LEVELS, colors="white",
                              linewidths=0.9)  # fmt: skip
        panel.clabel(lines, fmt=lambda s: f"{s:g} s", fontsize=7)
        for rule, colour, style in zip(rules[:2], (RED, "black"), ("-", "--"), strict=True):
            panel.contour(plant_ds.ti, plant_ds.kp, rule.indicator(plant_ds).transpose("kp", "ti"), levels=[rule.limit],
                          colors=[colour],
                          linestyles=[style], linewidths=1.8)  # fmt: skip
        T = float(plant_ds["T"].isel(kp=0, ti=0))
        panel.axvline(T, color="0.4", lw=1.0, ls=":")
        panel.annotate("Ti = T", (T, 0.0023), fontsize=7, color="0.3", rotation=90, xytext=(2, 0),
                       textcoords="offset points", va="bottom")  # fmt: skip
        panel.set(title=str(coil), xscale="log", yscale="log")
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
    x_at = np.flatnonzero(is_counted(ds).transpose(*ds.hunts.dims).values.ravel())
    x_at = np.random.default_rng(1).choice(x_at, min(MAX_DOTS, x_at.size), replace=False)
    flat = {name: np.asarray(ds[name].transpose(*ds.hunts.dims).values).ravel()[x_at]
            for name in ("kp", "ti", "K", "T", "theta", "gain_margin", "hunts")}  # fmt: skip
    hunts = flat["hunts"] > 0
    gain = flat["kp"] * flat["K"]
    _draw_hunting_dots(panels[0], flat["ti"] / flat["T"], flat["gain_margin"], hunts)
    panels[0].set(xlabel="Ti / T", ylabel="gain margin", xlim=(0.02, 6), ylim=(0.3, 60))
    panels[0].axhline(1.0, color="0.4", ls=":")
    name = rules[1].name
    _draw_hunting_dots(panels[1], (flat["T"] + _parse_delays(name) * flat["theta"]) / flat["ti"], gain, hunts)
    ratio = np.geomspace(0.2, 60, 50)
    panels[1].plot(ratio, (rules[1].limit / ratio) ** (1.0 / _parse_power(name)), color="black", ls="--")
    panels[1].set(xlabel=f"(T + {_parse_delays(name):g} θ) / Ti", ylabel="kp K", xlim=(0.2, 60), ylim=(0.03, 6))
    for size, colour, marker in ((0.01, "0.55", "s"), (0.03, YELLOW, "^"), (0.07, RED, "o"), (0.15, BLUE, "D")):
        size_ds = sizes.sel(backlash=size)
        is_drawn = size_ds.cycles & size_ds.reachable.astype(bool) & (size_ds.gain_margin > 1.0)
        swing_per_gap = (size_ds.swing / (size * size_ds.K)).where(is_drawn).values.ravel()
        panels[2].plot(
            size_ds.hunting_index.values.ravel(),
            swing_per_gap,
            marker,
            color=colour,
            ms=3,
            alpha=0.7,
            mew=0,
            label=f"X = {size:.0%}",
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


def _draw_hunting_dots(panel: Axes, x: np.ndarray, y: np.ndarray, hunts: np.ndarray) -> None:
    for part, colour, mark, label in ((~hunts, BLUE, "o", "calm"), (hunts, RED, "x", "hunts")):
        panel.plot(x[part], y[part], mark, color=colour, ms=2.6, alpha=0.5, mew=0.7, label=label, rasterized=True)


def _parse_power(name: str) -> float:
    return float(name.split("^")[1].split(" ", maxsplit=1)[0])


def _parse_delays(name: str) -> float:
    return float(name.split("+ ")[1].split(" ", maxsplit=1)[0])


CHOICE_SEED, FRESH_SEED, WIDE_SEED, DAYS_SEED, SIZES_SEED, START_SEED, PARTS_SEED, COST_SEED, CURES_SEED = range(
    15001, 15900, 100
)
"""Seeds of the valves; those of the conditions are one more."""
DAY_SEEDS = range(15911, 15914)


def sample(size: int = 384, days: int = 6) -> None:
    """Write the table of how hunting begins."""
    hunting_backlash.write_start(hunting_backlash.run_start(START_SEED, size // 2, max(days // 2, 2)))


def main(size: int = 384, days: int = 6) -> None:
    """Run everything, write the tables and draw the figures; ``size`` valves, ``days`` conditions of a kind."""
    report = progress_printer()
    choice = hunting_loops.population(CHOICE_SEED, 2 * size, days)
    rules, shape = hunting_loops.choose_rules(choice)
    report(f"chose {', '.join(f'{rule.name}: {rule.limit:g}' for rule in rules)}")
    fresh = hunting_loops.population(FRESH_SEED, 2 * size, days + 2)
    wide = hunting_loops.population(WIDE_SEED, size, days, wide=True)
    write_errors(rules, {"fresh valves": fresh, "other plants": wide})
    write_by_backlash(rules, fresh)
    cautious_limit = hunting_loops.cautious_limit(rules[1], choice)
    write_one_step(rules[1], cautious_limit, fresh)
    write_practice(rules, fresh)
    report("ran fresh valves and other plants")
    write_days(rules, {kind: hunting_loops.population_on_days(DAYS_SEED, size, kind, DAY_SEEDS) for kind in kinds()})
    report("ran other days")
    sizes = hunting_backlash.run_backlash(SIZES_SEED, size // 2, max(days // 2, 2))
    hunting_backlash.write_backlash(sizes, rules[0].limit)
    hunting_backlash.write_bands(sizes)
    hunting_backlash.write_start(hunting_backlash.run_start(START_SEED, size // 2, max(days // 2, 2)))
    report("ran every backlash, and kicks")
    hunting_backlash.write_parts(hunting_backlash.run_parts(PARTS_SEED, size // 8, 2))
    report("ran other motors, sensors and controllers")
    index_rule, formula, product_rule, *_ = rules
    slow_rule = Rule("Ti ≥ T", lambda ds: ds["T"] / ds.ti, 1.0, 1.0)
    rules_with_limits = {f"{rule.name} ≤ {rule.limit:g}": rule for rule in (index_rule, formula, product_rule)}
    cures.write_cost(*cures.run_cost(COST_SEED, size // 4, {**rules_with_limits, slow_rule.name: slow_rule}))
    cures.write_cures(*cures.run_cures(CURES_SEED, size, formula, shape, cautious_limit))
    report("ran what rules cost")
    presets = preset_results()
    write_presets(presets, rules)
    draw_presets(presets, rules)
    draw_population(fresh, sizes, rules)
    report("drew")
