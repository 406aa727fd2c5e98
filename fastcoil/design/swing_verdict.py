"""Whose swing it is: the loop's own, regular or not, or that of air, water and set-point.

A loop makes a swing itself where most of its twins swing too: the same loop, noise and running estimator, with air,
water and set-point constant as at an hour and set-point of the day.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.text import format_period, format_swing
from fastcoil.design.operating_points import CONDITION_SERIES, operating_points
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.model.hunting import HUNTING_SHARE
from fastcoil.model.metric_table import HUNTING_SWING_K

# chosen by twins with the opening held, and by eye
LEAST_OWN_SHARE = 1.0 / 3.0  # of a swing that the loop makes itself, that its twins show on average
SAME_ESTIMATE = 0.01  # of stroke, up to which two estimates are alike
TWIN_S = 3 * 3600  # of a twin after its warm-up
MOST_TWINS = 12  # of a day
LEAST_REGULARITY = 2.0 / 3.0  # share of periods as long as the one before, in a regular swing


class SwingVerdict(NamedTuple):
    """Swing of a loop, and whose it is."""

    is_own: bool
    is_regular: bool
    swing: float  # median peak to peak of T_sup, K
    period: float  # s
    swing_alone: float = math.nan  # the same with air, water and set-point constant, NaN if unknown
    movers: tuple[str, ...] = ()  # what moves on the day, such as "the air flow"
    rings: bool = False  # whether a swing that the loop does not sustain is larger than air, water, set-point explain
    prefix: str = ""  # of a size: "supply air " where the room is controlled

    @property
    def size(self) -> str:
        """Size and period, as in ``± 3.1 K every 2 min``."""
        return f"{format_swing(self.swing)} every {format_period(self.period)}"

    @property
    def clause(self) -> str:
        """What the loop does, as in ``the loop hunts: ± 3.1 K every 2 min``."""
        if not self.is_own:
            return "does not hunt"
        if self.is_regular:
            return f"hunts: {self.prefix}{self.size}"
        return f"keeps swinging, irregularly: {self.prefix}about {format_swing(self.swing)}"

    @property
    def reason(self) -> str:
        """Whose swing it is, a sentence; empty for a regular swing of the loop, and for a calm one."""
        names = " or ".join([", ".join(self.movers[:-1]), *self.movers[-1:]] if self.movers[1:] else self.movers)
        if self.is_own and not self.is_regular and self.movers:
            alone = f"with constant air, water and set-point it still swings {format_swing(self.swing_alone)}"
            return f"It makes the swing itself: {alone}."
        if self.is_own or not self.swing > HUNTING_SWING_K or not names:
            return ""
        if self.rings:
            return f"It rings: after changes of {names} T_sup swings {self.size}, and comes to rest without them."
        verb, constant = ("do", "them") if self.movers[1:] else ("does", "that")
        cause = f"T_sup swings {self.size} because {names} {verb}"
        if self.swing_alone > self.swing:  # of a loop that learns its gap from what moves
            return f"{cause}."
        rest = f"would swing {format_swing(self.swing_alone)}" if self.swing_alone > HUNTING_SWING_K else "would not"
        return f"{cause}; with {constant} constant it {rest}."


def moving_inputs(boundary: Boundary) -> tuple[str, ...]:
    """Name what moves on a day."""
    moves = {name: bool(np.ptp(boundary.extremes[name]) > 0.0) for name in CONDITION_SERIES}
    flow, air = moves["m_a"], moves["T_a_in"] or moves["W_a_in"]
    air_word = "the air" if flow and air else "the air flow" if flow else "the entering air"
    is_moving = {
        air_word: flow or air, "the water": moves["T_w_in"], "its pressure": moves["dp_ratio"],
        "the set-point": moves["T_set"], "the weather": moves["T_out"], "the heat gain": moves["Q_room"],
    }  # fmt: skip
    return tuple(word for word, is_one in is_moving.items() if is_one)


def still_boundary(boundary: Boundary, warm_up: int) -> Boundary:
    """Return the operating points of one day as days on which air, water and set-point stand still; the noise stays."""
    points, n_steps = operating_points(boundary, warm_up), min(boundary.n_steps, warm_up + TWIN_S)
    _, distinct = np.unique(np.round([*points.conditions.values()], 9), axis=1, return_index=True)
    k = np.sort(distinct)[np.unique(np.linspace(0, distinct.size - 1, MOST_TWINS).round().astype(int))]
    series = {name: np.repeat(values[k, None], n_steps, axis=1) for name, values in points.conditions.items()}
    noise, gap_scale = boundary.series["noise"][:, :n_steps], boundary.series["backlash_scale"].mean()
    return Boundary(**series, noise=np.repeat(noise, k.size, axis=0), backlash_scale=np.full(n_steps, gap_scale))


def judge_by_twins(results: xr.Dataset, loop: Loop, boundary: Boundary, *, warm_up: int, **options: Any) -> xr.Dataset:
    """Replace ``hunts`` by whether a loop makes its swing itself; add ``swing_alone``, of its twins, and ``rings``.

    Twins may not learn their gap, since nothing moves there.  A loop rings where it hunts on the day and its twins
    rest.
    """
    alone = []
    for k, label in enumerate(boundary.day if boundary.has_day_dim else [None]):
        day, of_day = (boundary, results) if label is None else (boundary.isel(day=k), results.sel(day=label))
        if of_day["hunts"].notnull().any():
            twins = simulate(loop, still_boundary(day, warm_up), warm_up=warm_up, progress=False, **options)
            of_day = twins.mean("day")
        alone.append(of_day[["hunts", "hunting_swing", "estimate_settled"]].reset_coords(drop=True))
    twin = xr.concat(alone, results["day"]) if boundary.has_day_dim else alone[0]
    swing, swing_alone = results["hunting_swing"], twin["hunting_swing"]
    is_own = (swing > HUNTING_SWING_K) & (twin["hunts"] >= HUNTING_SHARE) & (swing_alone >= LEAST_OWN_SHARE * swing)
    has_same_estimate = abs(results["estimate_settled"] - twin["estimate_settled"]) < SAME_ESTIMATE
    is_own &= has_same_estimate | (swing >= LEAST_OWN_SHARE * swing_alone)
    hunts = is_own.astype(float).where(results["hunts"].notnull()).assign_attrs(results["hunts"].attrs)
    rings = (results["hunts"] > 0.0) & (twin["hunts"] < HUNTING_SHARE) & (swing > HUNTING_SWING_K)
    return results.assign(hunts=hunts, swing_alone=swing_alone, rings=rings.astype(float))
