"""The figures of ``hunting.py``: kp × ti of the presets, and what the plants of a population have in common."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import FuncFormatter, NullFormatter

from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from fastcoil.study.file.spec import read_study
from studies.common import STUDIES, results, save_figure, write_table
from studies.hunting.loops import hunting
from studies.hunting.plants import foreseen
from studies.hunting.rules import Rule, counted

STUDY = STUDIES / "hunting" / "hunting.toml"
SWING = (0.1, 30.0)
"""K, peak to peak: the ends of the colours; below lies what does not hunt."""
SHOWN = 2500
"""Loops in the panels without dimensions."""
PERIODS = (120, 200, 300, 500, 800)
"""s"""


def of_presets() -> xr.Dataset:
    """Metrics of the study ``hunting.toml``, and what is foreseen of its loops: (plant, kp, ti)."""
    layout = read_study(STUDY).plan.layout
    plant = foreseen(layout.loop, layout.boundary)
    ds = results("hunting")
    return xr.merge([hunting(ds), plant], compat="override", join="override").load()


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
    names = [f"margin {rules[0].limit:g}", f"{rules[1].name} = {rules[1].limit:g}", "period"]
    figure.legend(handles, names, loc="outside upper center", ncols=3)
    save_figure(figure, "hunting/hunting.png")


@apply_style()
def draw_population(ds: xr.Dataset, sizes: xr.Dataset, rules: list[Rule]) -> None:
    """Draw loops without dimensions: Ti/T × gain margin, the formula, and the swing over the margin."""
    figure, panels = plt.subplots(1, 3, figsize=(12.0, 4.3), layout="constrained")
    at = np.flatnonzero(counted(ds).transpose(*ds.hunts.dims).values.ravel())
    at = np.random.default_rng(1).choice(at, min(SHOWN, at.size), replace=False)
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
            at.margin.values.ravel(), scaled, mark, color=colour, ms=3, alpha=0.7, mew=0, label=f"X = {size:.0%}"
        )
    panels[2].axvline(rules[0].limit, color=RED)
    panels[2].set(xlabel="margin, largest |L| |N|", ylabel="swing / (X K)", xlim=(0.5, 6), ylim=(0.03, 20))
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
