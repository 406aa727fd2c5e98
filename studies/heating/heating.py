"""Heating coils: how the presets are sized and tuned, whether they ring, and what backlash does to them.

The gains are chosen on some conditions, without backlash; every number of the tables is of others.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

import fastcoil as fc
from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from studies.common import compare_rows, save_figure, share_of, write_table
from studies.heating.backlash import PRESETS, write_backlash

COLOURS = {"heating": BLUE, "heating_45": RED}
STYLES = {"heating": "-", "heating_45": "--"}
BACKLASH, SEED = 0.07, 16301
SECONDS_BEFORE, SECONDS_AFTER = 600, 2400
"""Seconds shown around the step."""


def _draw_rest(panel: Axes) -> None:
    """Draw the supply air over the opening at the design load, and the presets' design points."""
    for name, colour in COLOURS.items():
        loop, water = fc.Loop.preset(name).assign(backlash=0.0), fc.presets()[name].day["T_w_in"]
        set_points = np.linspace(9.0, 30.2, 60)
        day = fc.Boundary(
            m_a=1.15,
            T_a_in=8.76,
            W_a_in=0.003,
            T_w_in=water,
            T_set=np.repeat(set_points[:, None], 2, 1),
            day=np.arange(60),
        )
        steady = fc.linearise(loop, day, at=0)
        panel.plot(100 * steady.opening, steady.T_sup, STYLES[name], color=colour, label=f"{name}, {water:g} °C")
        design_point = fc.linearise(loop, fc.design_day(0.5, "heating", T_w_in=water), at=0)
        panel.plot(100 * float(design_point.opening), 25.0, "o", color=colour, ms=5)
    panel.axhline(25.0, color="black", lw=0.8, ls=":")
    panel.annotate("design load", (3, 25.3), fontsize=8)
    panel.set(xlabel="opening [%]", ylabel="supply air at rest [°C]", xlim=(0, 100), ylim=(8, 31),
              title="The coils at rest, -20 °C outdoors")  # fmt: skip
    panel.legend(loc="lower right")


def _draw_steps(
    panel: Axes, conditions: Callable[[fc.Loop], tuple[fc.Boundary, np.ndarray]], step_at: int, size: float
) -> None:
    """Draw the step response, median and 90 % of the conditions, with heating gains and those of a cooling loop."""
    heating_loop = fc.Loop.preset("heating").assign(backlash=0.0)
    boundary, T_set = conditions(heating_loop)
    cooling = fc.Loop.preset("lbnl")
    for label, loop, colour, style in (
        ("gains of heating", heating_loop, BLUE, "-"),
        ("gains of lbnl", heating_loop.assign(**{n: cooling[n] for n in ("kp", "ti", "sample_time")}), RED, "--"),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of gains made for cooling: they are why it is run
            ds = fc.simulate(loop, boundary, traces=["T_sup"], trace_interval=5)
        shown = slice(step_at - SECONDS_BEFORE, step_at + SECONDS_AFTER)
        T = ds.T_sup.sel(elapsed_time=shown).transpose("day", "elapsed_time")
        share = 100 * (T.values - T_set[:, None]) / size
        low, middle, high = np.quantile(share, (0.05, 0.5, 0.95), axis=0)
        minutes = (T.elapsed_time.values - step_at) / 60
        panel.fill_between(minutes, low, high, color=colour, alpha=0.18, lw=0)
        panel.plot(minutes, middle, style, color=colour, label=label)
    panel.axhline(100, color="black", lw=0.8, ls=":")
    panel.set(xlabel="time after the step [min]", ylabel="share of the step [%]", xlim=(-3, 25), ylim=(-15, 155),
              title="A step of 2 K without backlash, 90 % of the conditions")  # fmt: skip
    panel.legend(loc="lower right")


def _draw_worn(panel: Axes) -> None:
    """Draw two hours of a heating day with a worn valve."""
    loop = fc.Loop.preset("heating").assign(
        backlash=BACKLASH, noise_std=0.02, estimate_ratio=[0.0, 0.95], buffer_ratio=6.0, buffer_swing=0.1,
        plant_gain=25.0,
    )  # fmt: skip
    day = fc.heating_day(8, SEED)
    ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=10)
    hours = ds.elapsed_time / 3600
    set_point = day.series["T_set"][0][::10]
    panel.plot(hours, set_point, color=YELLOW, lw=2.2, label="set-point")
    for ratio, colour, style, label in ((0.0, BLUE, "-", "plain PI"), (0.95, RED, "--", "inverse of 95 %")):
        panel.plot(hours, ds.T_sup.sel(estimate_ratio=ratio), style, color=colour, lw=1.1, label=label)
    panel.set(
        xlabel="time [h]", ylabel="supply air [°C]", xlim=(4, 6), title=f"heating_day, backlash {100 * BACKLASH:g} %"
    )
    panel.set_ylim(22, 28.5)
    panel.set_xticks([4, 4.5, 5, 5.5, 6])
    panel.legend(loc="upper left")


@apply_style()
def draw(conditions: Callable[[fc.Loop], tuple[fc.Boundary, np.ndarray]], step_at: int, size: float) -> None:
    """Draw the figure.  conditions: days with a step of ``size`` K at second ``step_at``, and set-points before it."""
    figure, panels = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    _draw_rest(panels[0])
    _draw_steps(panels[1], conditions, step_at, size)
    _draw_worn(panels[2])
    save_figure(figure, "heating/heating.png", dpi=200)


SEARCH_SEED, FRESH_SEED = 16001, 16002
SEARCH_SIZE, FRESH_SIZE = 200, 400
OUTDOOR_TEMPERATURES, OUTDOOR_SHARE, T_RETURN, W_A_IN = (-20.0, 15.0), 0.3, 21.0, 0.003
AIR_FLOWS, WATER_TEMPERATURES, SET_POINTS = (0.4, 1.3), (45.0, 70.0), (16.0, 30.0)
"""Air flow, kg/s; water and set-points, °C."""
STEP_SIZE = 2.0  # step of the set-point, K
STEP_AT = 5400  # second of the step
DAY_SECONDS = 10800
RESPONSE_INTERVAL = 5  # seconds between the samples of the response
SETTLED_DISTANCE = 0.05  # distance from the new set-point, share of the step, within which a loop has settled
KP, TI = (0.01, 0.015, 0.02, 0.025, 0.03, 0.04), (40.0, 50.0, 60.0, 70.0, 80.0, 100.0, 120.0)
MOST_OVERSHOOT = 0.10  # share of the step, in 95 % of the conditions of either coil
GAP_RANGE = (0.01, 0.15)  # backlash of the worn valves, drawn evenly
VALVES = 12  # number of worn valves
COOLING_GAINS = ("lbnl", "paper_like", "paper_like_fast", "g36")
GAIN_NAMES = ("kp", "ti", "sample_time")


class Conditions(NamedTuple):
    """Constant conditions with a step of the set-point, a day each."""

    boundary: fc.Boundary
    T_set: np.ndarray


class Response(NamedTuple):
    """Overshoot, of the step, and settling time, s, over the loop's dims and days."""

    overshoot: xr.DataArray
    settling: xr.DataArray
    ds: xr.Dataset


def conditions(loop: fc.Loop, seed: int, size: int) -> Conditions:
    """Conditions at which the valve of ``loop`` works: both set-points need between 2 and 97 % of its stroke."""
    rng = np.random.default_rng(seed)
    series: dict[str, np.ndarray] = {}
    n = 2 * size
    outdoor = rng.uniform(*OUTDOOR_TEMPERATURES, n)
    series["T_a_in"] = OUTDOOR_SHARE * outdoor + (1.0 - OUTDOOR_SHARE) * T_RETURN
    series["m_a"], series["T_w_in"] = rng.uniform(*AIR_FLOWS, n), rng.uniform(*WATER_TEMPERATURES, n)
    T_set = rng.uniform(*SET_POINTS, n)
    is_held = []
    for step in (0.0, STEP_SIZE):
        constant_series = {
            name: np.repeat(values[:, None], 2, 1) for name, values in (series | {"T_set": T_set + step}).items()
        }
        steady = fc.linearise(loop, fc.Boundary(**constant_series, W_a_in=W_A_IN, day=np.arange(n)), at=0)
        is_held.append((steady.reachable > 0.0) & (steady.opening > 0.02) & (steady.opening < 0.97))
    valid = np.flatnonzero(np.asarray(is_held[0] & is_held[1]).ravel())[:size]
    if valid.size < size:
        raise RuntimeError("too few of the drawn conditions are within reach")
    day_series = {name: np.repeat(values[valid, None], DAY_SECONDS, 1) for name, values in series.items()}
    steps = np.repeat(T_set[valid, None], DAY_SECONDS, 1)
    steps[:, STEP_AT:] += STEP_SIZE
    return Conditions(fc.Boundary(**day_series, W_a_in=W_A_IN, T_set=steps, day=np.arange(size)), T_set[valid])


def step_response(loop: fc.Loop, step_conditions: Conditions) -> Response:
    """Simulate a step of the set-point."""
    ds = fc.simulate(loop, step_conditions.boundary, traces=["T_sup"], trace_interval=RESPONSE_INTERVAL)
    T = ds.T_sup.sel(elapsed_time=slice(STEP_AT, None))
    share = (T - xr.DataArray(step_conditions.T_set, dims="day")) / STEP_SIZE - 1.0
    seconds_after_step = xr.DataArray(np.arange(1, T.elapsed_time.size + 1) * RESPONSE_INTERVAL, dims="elapsed_time")
    settling = (
        seconds_after_step.where((abs(share) > SETTLED_DISTANCE).drop_vars("elapsed_time"))
        .max("elapsed_time")
        .fillna(0.0)
    )
    return Response(share.max("elapsed_time").clip(0.0), settling, ds.drop_vars("T_sup"))


def good_valve_loop(name: str, **values: object) -> fc.Loop:
    """A preset with a valve without backlash."""
    return fc.Loop.preset(name).assign(backlash=0.0, **values)


def sizing_rows() -> list[list[str]]:
    """The design load of each preset: -20 °C outdoors, 1.15 kg/s, set-point 25 °C."""
    rows = []
    for name in PRESETS:
        preset, loop = fc.presets()[name], good_valve_loop(name)
        day = fc.design_day(0.5, "heating", T_w_in=preset.day["T_w_in"])
        steady = fc.linearise(loop, day, at=0)
        fully_open = fc.linearise(loop, fc.design_day(0.5, "heating", T_w_in=preset.day["T_w_in"], T_set=80.0), at=0)
        air = {n: float(v[0, 0]) for n, v in day.series.items()}
        heat = air["m_a"] * float(loop["cp_a"]) * (25.0 - air["T_a_in"])  # type: ignore[arg-type]
        m_w = float(steady.m_w)
        T_w_out = preset.day["T_w_in"] - heat / (m_w * float(loop["cp_w"]))  # type: ignore[arg-type]
        rows.append(
            [f"`{name}`", f"{preset.day['T_w_in']:g}", f"{air['T_a_in']:.1f}", f"{heat:.1f}",
             f"{float(steady.opening):.0%}", f"{m_w:.2f}", f"{T_w_out:.0f}",
             f"{float(fully_open.T_sup):.1f}", f"{float(steady.gain):.0f}"]
        )  # fmt: skip
    return rows


def choose_gains(size: int = SEARCH_SIZE) -> tuple[list[list[str]], tuple[float, float]]:
    """Find the pair of gains that settles soonest without much overshoot; rows of all pairs for both coils."""
    responses = []
    for name in PRESETS:
        loop = good_valve_loop(name)
        responses.append(step_response(loop.assign(kp=list(KP), ti=list(TI)), conditions(loop, SEARCH_SEED, size)))
    overshoot = [r.overshoot.quantile(0.95, "day") for r in responses]
    settling = [r.settling.quantile(0.95, "day") for r in responses]
    is_calm = (overshoot[0] <= MOST_OVERSHOOT) & (overshoot[1] <= MOST_OVERSHOOT)
    slowest = np.maximum(settling[0], settling[1])
    preset_gains = fc.Loop.preset("heating")["kp"], fc.Loop.preset("heating")["ti"]
    best_index = slowest.where(is_calm).argmin(["kp", "ti"])
    best = KP[int(best_index["kp"])], TI[int(best_index["ti"])]
    rows = [
        [f"{kp:g}", f"{ti:g}", *(f"{float(o.sel(kp=kp, ti=ti)):.0%}, {float(s.sel(kp=kp, ti=ti)):.0f}"
                                 for o, s in zip(overshoot, settling, strict=True)),
         ("yes" if bool(is_calm.sel(kp=kp, ti=ti)) else "no")
         + ", settles soonest" * ((kp, ti) == best) + ", the presets" * ((kp, ti) == preset_gains)]
        for kp in KP for ti in TI
        if abs(float(slowest.sel(kp=kp, ti=ti)) / float(slowest.isel(best_index)) - 1.0) < 0.25
    ]  # fmt: skip
    return rows, best


def fresh_rows(size: int = FRESH_SIZE) -> list[list[str]]:
    """The presets on fresh conditions, and beside them the gains of the cooling presets on the same coils."""
    rows = []
    for name in PRESETS:
        fresh_conditions = conditions(good_valve_loop(name), FRESH_SEED, size)
        gaps = np.random.default_rng(FRESH_SEED).uniform(*GAP_RANGE, VALVES)
        for gains in (name, *COOLING_GAINS):
            loop = good_valve_loop(name, **{n: fc.Loop.preset(gains)[n] for n in GAIN_NAMES})
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of gains made for cooling: they are why it is run
                step = step_response(loop, fresh_conditions)
                worn = fc.simulate(loop.assign(backlash=("sample", gaps)), fresh_conditions.boundary)
                hunting_index = fc.limit_cycle(loop, fresh_conditions.boundary, at=STEP_AT - 1).hunting_index
            overshoot, settling = step.overshoot, step.settling.where(step.settling < DAY_SECONDS - STEP_AT)
            unsettled_share = float(settling.isnull().mean())
            rows.append(
                [
                    f"`{name}`",
                    "own" if gains == name else f"those of `{gains}`",
                    f"{float(loop['kp']):g}, {float(loop['ti']):g}, {float(loop['sample_time']):g}",  # type: ignore[arg-type]
                    f"{float(overshoot.median()):.0%}, {float(overshoot.quantile(0.95)):.0%}, "
                    f"{float(overshoot.max()):.0%}",
                    f"{unsettled_share:.0%} never"
                    if unsettled_share > 0.05
                    else f"{float(settling.median()):.0f}, {float(settling.quantile(0.95)):.0f}",
                    f"{float(hunting_index.max()):.2f}",
                    str(share_of(step.ds.hunts)),
                    str(share_of(worn.hunts)),
                ]
            )
    return rows


def sample() -> None:
    """Compare the rows of the design load."""
    compare_rows("heating/heating_sizing", sizing_rows())


def main() -> None:
    """Write the tables and the figure."""
    write_table(
        "heating/heating_sizing",
        "The design load of the heating presets: air of 1.15 kg/s, -20 °C outdoors, set-point 25 °C",
        ["preset", "water, °C", "mixed air, °C", "load, kW", "opening", "water flow, kg/s", "water leaves at, °C",
         "supply air, fully open, °C", "gain there, K per stroke"],
        sizing_rows(),
    )  # fmt: skip
    rows, best = choose_gains()
    write_table(
        "heating/heating_choice",
        f"Gains for both coils on {SEARCH_SIZE} conditions without backlash: overshoot of a step of {STEP_SIZE:g} K "
        "and "
        "settling time to 5 % of it in s, both the 95 % quantile; pairs that settle about as fast as the soonest",
        ["kp, 1/K", "ti, s", "`heating`", "`heating_45`", f"overshoot up to {MOST_OVERSHOOT:.0%} on both"],
        rows,
    )
    print("settles soonest:", *best)
    write_table(
        "heating/heating_fresh",
        f"The heating presets on {FRESH_SIZE} fresh conditions, and the gains of the cooling presets on the same "
        f"coils; overshoot, settling and hunting index without backlash, worn valves of {100 * GAP_RANGE[0]:g} to "
        f"{100 * GAP_RANGE[1]:g} %",
        ["coil", "gains", "kp in 1/K, ti in s, sample time in s", "overshoot: median, 95 %, most",
         "settling, s: median, 95 %", "largest hunting index", "hunting, X = 0", "hunting, worn"],
        fresh_rows(),
    )  # fmt: skip
    write_backlash()
    draw(lambda loop: conditions(loop, FRESH_SEED, 100), STEP_AT, STEP_SIZE)
