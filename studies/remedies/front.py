"""Gains tuned for each remedy itself, and which remedy to choose: on valves and days of their own.

A remedy behind gains that were tuned for the plain PI is not the best it can do.  Here the main remedies get gains of
their own, valve by valve, once for the error alone and then with a rising price of motor travel, which gives a curve of
error over travel.  The choice of the page is made here; its numbers come from other valves and days.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

import fastcoil as fc
from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from fastcoil.study.file.sample import sample_values
from fastcoil.study.file.spec import read_study
from studies.common import change_in_words, pool_days, save_figure, write_table
from studies.days import STEPPED
from studies.remedies.runs import (
    BASELINE,
    NO_PRICE,
    SIMC,
    SOME_PRICE,
    STUDY,
    kind_groups,
    population,
    rename_plain_pi,
    run_every_remedy,
    run_faster_pi,
    select_loop,
    select_remedies,
    simulate_days,
    tune_gains,
)
from studies.remedies.tables import REMEDY_LABELS
from studies.robustness.best_pi import simc_gains

VALVES, SEED = 256, 20261123
DAYS = range(4301, 4306)
PRICES = (NO_PRICE, SOME_PRICE, 0.2, 0.3, 0.4, 0.5)
SHOWN_PRICES = (NO_PRICE, SOME_PRICE, 0.3)  # prices of the table; the curves of the figure have all
OWN_GRID = {"kp": (0.25, 0.4, 0.63, 1.0, 1.6, 2.5, 4.0, 6.3, 10.0), "ti": (1.0, 2.0, 4.0, 8.0)}
MAIN_REMEDIES = (
    "pi",
    "dead_band_025",
    "inverse_80_buffer",
    "inverse_95_small_buffer",
    "inverse_95_buffer",
    "inverse_95_noise_buffer",
    "additive_95",
    "learner_growing",
)
REMEDIES_BY_NEED = {
    "nothing": ("pi", "faster", "half_kp", "dead_band_025", "dead_band_050"),
    "the size, to 20 %": ("inverse_80_buffer",),
    "the size, to 5 %": (
        "inverse_95",
        "inverse_95_small_buffer",
        "inverse_95_buffer",
        "inverse_95_noise_buffer",
        "inverse_95_dead_band",
        "additive_95",
        "smooth_95",
    ),
    "a rule that finds it": ("hagglund_additive", "hagglund_inverse", "gradient", "learner_growing", "own_rule"),
}
"""What one must know of a valve for a remedy."""


def other_valves(size: int = VALVES) -> fc.Loop:
    """Draw other valves from the distributions of the study."""
    table = read_study(STUDY).tables["sample"]
    return population().assign(**sample_values({**table, "size": size, "seed": SEED}))


def run_front(size: int) -> tuple[dict[str, xr.Dataset], dict[str, xr.Dataset]]:
    """Results by kind of day: the main remedies with gains of their own at each price, and all with those of SIMC."""
    loop = other_valves(size)
    plain, main_loop = select_loop(loop, controller=0), select_remedies(loop, MAIN_REMEDIES)
    by_own_gains: dict[str, xr.Dataset] = {}
    by_simc: dict[str, xr.Dataset] = {}
    for group in kind_groups():
        simc = simc_gains(plain, group[0])
        best = tune_gains(main_loop, simc, group, OWN_GRID, PRICES)
        print(f"tuned the main remedies for {', '.join(group)}", flush=True)
        for kind in group:
            by_own_gains[kind] = simulate_days(main_loop, best, kind, DAYS)
            simc_ds = rename_plain_pi(run_every_remedy(loop, simc, kind, DAYS), SIMC)
            by_simc[kind] = xr.concat([simc_ds, run_faster_pi(loop, simc, kind, DAYS)], "controller")
    return by_own_gains, by_simc


def against_best_pi(by_own_gains: dict[str, xr.Dataset]) -> xr.Dataset:
    """All kinds of days as one dim of days; the prices along ``controller``, plain PI without a price as baseline."""
    ds = pool_days(by_own_gains).stack(tuning=("controller", "price"))
    names = [BASELINE if t == ("pi", NO_PRICE) else f"{t[0]} {t[1]:g}" for t in ds.tuning.values]
    return ds.drop_vars(["tuning", "controller", "price"]).rename(tuning="controller").assign_coords(controller=names)


def tuned_rows(by_own_gains: dict[str, xr.Dataset]) -> list[list[str]]:
    """Each main remedy at each price, against the best PI and against plain PI at the same price."""
    ds = against_best_pi(by_own_gains)
    table = []
    for name in MAIN_REMEDIES:
        for price in SHOWN_PRICES:
            label = BASELINE if (name, price) == ("pi", NO_PRICE) else f"{name} {price:g}"
            peer = BASELINE if price == NO_PRICE else f"pi {price:g}"
            remedy_ds, peer_ds = ds.sel(controller=label), ds.sel(controller=peer)
            travel = remedy_ds.motor_travel.mean("day") / peer_ds.motor_travel.mean("day")
            table.append(
                [
                    REMEDY_LABELS[name],
                    f"{price:g}",
                    change_in_words(ds, label, BASELINE),
                    f"× {_travel_ratio(ds, label, BASELINE):.2f}",
                    change_in_words(ds, label, peer),
                    f"× {float(travel.median()):.2f}",
                    f"{float(remedy_ds.hunts.mean()):.1%}",
                ]
            )
    return table


def _travel_ratio(ds: xr.Dataset, name: str, base: str) -> float:
    travel, base_travel = (ds.motor_travel.sel(controller=n).mean("day") for n in (name, base))
    return float((travel / base_travel).median())


def price_front(by_own_gains: dict[str, xr.Dataset], day_kinds: list[str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Median travel and mean change of RMSE against the best PI at each price, on these kinds of days, by remedy."""
    ds = against_best_pi({kind: by_own_gains[kind] for kind in day_kinds})
    base = ds.sel(controller=BASELINE)
    by_remedy = {}
    for name in MAIN_REMEDIES:
        names = [BASELINE if (name, p) == ("pi", NO_PRICE) else f"{name} {p:g}" for p in PRICES]
        of_remedy = ds.sel(controller=names)
        travel = (of_remedy.motor_travel.mean("day") / base.motor_travel.mean("day")).median("sample")
        change = (of_remedy.rmse / base.rmse - 1.0).mean(["sample", "day"])
        by_remedy[name] = (travel.values, change.values)
    return by_remedy


def remedies_with_simc(
    by_own_gains: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset], day_kinds: list[str]
) -> dict[str, tuple[float, float]]:
    """Median travel and mean change of RMSE against the best PI of every remedy with the gains of SIMC."""
    base = against_best_pi({kind: by_own_gains[kind] for kind in day_kinds}).sel(controller=BASELINE)
    ds = pool_days({kind: by_simc[kind] for kind in day_kinds})
    travel = (ds.motor_travel.mean("day") / base.motor_travel.mean("day")).median("sample")
    change = (ds.rmse / base.rmse - 1.0).mean(["sample", "day"])
    return {str(n): (float(travel.sel(controller=n)), float(change.sel(controller=n))) for n in ds.controller.values}


def choice_rows(by_simc: dict[str, xr.Dataset]) -> list[list[str]]:
    """For each thing one may know, the remedies with the gains of SIMC by their cost at both prices."""
    ds = pool_days(by_simc)
    cost = {p: np.log(ds.rmse) + p * np.log(ds.motor_travel.clip(0.1)) for p in (NO_PRICE, SOME_PRICE)}
    table = []
    for needs, names in REMEDIES_BY_NEED.items():
        for name in names:
            label = SIMC if name == "pi" else name
            changes = (np.expm1(c.sel(controller=label) - c.sel(controller=SIMC)) for c in cost.values())
            means = [100 * float(change.mean()) for change in changes]
            table.append([needs, REMEDY_LABELS[name], *(f"{m:+.0f} %" for m in means)])
    return table


def write_front(by_own_gains: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset]) -> None:
    """Write the tables of gains tuned for each remedy, and of the choice."""
    first = next(iter(by_own_gains.values()))
    days_text = f"{first.sizes['sample']} other valves, {first.sizes['day']} other days of each kind"
    write_table(
        "remedies/remedies_tuned",
        f"Gains tuned for each remedy itself, {days_text}: RMSE and motor travel of the median valve",
        ["remedy", "price of travel", "RMSE against the best PI (95 %)", "travel", "RMSE against PI at the same price",
         "travel", "hunting"],
        tuned_rows(by_own_gains),
    )  # fmt: skip
    write_table(
        "remedies/remedies_choice",
        f"The choice, {days_text}, gains of SIMC: mean change of the cost against plain PI",
        ["one must know", "remedy", "RMSE alone", "RMSE and travel, price 0.1"],
        choice_rows(by_simc),
    )


PALE_RED = "#EE99AA"
CURVES = {
    "pi": (BLUE, "-", "o"),
    "dead_band_025": ("black", "--", "s"),
    "inverse_80_buffer": (YELLOW, "-", "^"),
    "inverse_95_noise_buffer": (RED, "-", "D"),
    "inverse_95_small_buffer": (PALE_RED, "--", "D"),
    "learner_growing": ("0.5", ":", "v"),
}
"""Colour, line and mark of remedies with gains of their own."""
NUMBERED_REMEDIES = (
    SIMC,
    "faster",
    "half_kp",
    "dead_band_025",
    "inverse_80_buffer",
    "inverse_95_noise_buffer",
    "hagglund_inverse",
    "gradient",
    "learner_growing",
    "own_rule",
)
"""Remedies that are shown with the gains of SIMC, as numbers."""
TICKS = (5, 10, 20, 50, 100, 200)
LOWEST_CHANGE, HIGHEST_CHANGE = -45, 175
"""Changes of RMSE that are shown, %."""


@apply_style()
def draw(by_own_gains: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset]) -> None:
    """Draw days whose set-point stands still and days on which it steps side by side."""
    still_kinds = [kind for kind in by_own_gains if kind != STEPPED]
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 6.0), sharey=True, layout="constrained")
    for panel, day_kinds, title in (
        (panels[0], still_kinds, "set-point stands still"),
        (panels[1], [STEPPED], "set-point steps"),
    ):
        _draw_curves(panel, by_own_gains, day_kinds)
        _draw_points(panel, by_own_gains, by_simc, day_kinds)
        panel.axhline(0.0, color="0.8", zorder=0)
        panel.axvline(100.0, color="0.8", zorder=0)
        panel.set(
            title=title,
            xscale="log",
            xlim=(2.5, 400),
            ylim=(LOWEST_CHANGE, HIGHEST_CHANGE),
            xlabel="motor travel [% of the best PI]",
        )
        panel.set_xticks(TICKS, [f"{tick}" for tick in TICKS])
        panel.xaxis.set_minor_formatter(NullFormatter())
    key = "\n".join(f"{number:>2}  {REMEDY_LABELS[name]}" for number, name in enumerate(NUMBERED_REMEDIES, start=1))
    panels[1].text(0.97, 0.96, f"gains of SIMC\n{key}", transform=panels[1].transAxes, fontsize=8, ha="right", va="top",
                   ma="left", bbox={"facecolor": "white", "edgecolor": "0.8"})  # fmt: skip
    panels[0].set_ylabel("RMSE, mean change against the best PI [%]")
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:+.0f}" if y else "0"))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save_figure(figure, "remedies/remedies.png")


def _draw_curves(panel: Axes, by_own_gains: dict[str, xr.Dataset], day_kinds: list[str]) -> None:
    by_remedy = price_front(by_own_gains, day_kinds)
    for name, (colour, line, mark) in CURVES.items():
        travel, change = by_remedy[name]
        panel.plot(100 * travel, 100 * change, line, marker=mark, color=colour, ms=4.5, zorder=3,
                   label=f"{REMEDY_LABELS[name]}, own gains")  # fmt: skip


def _draw_points(
    panel: Axes, by_own_gains: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset], day_kinds: list[str]
) -> None:
    by_remedy = remedies_with_simc(by_own_gains, by_simc, day_kinds)
    for number, name in enumerate(NUMBERED_REMEDIES, start=1):
        travel, change = by_remedy[name]
        panel.plot(100 * travel, 100 * change, "o", mfc="white", mec="black", mew=0.8, ms=10, zorder=4)
        panel.annotate(str(number), (100 * travel, 100 * change), fontsize=7, ha="center", va="center", zorder=5)
