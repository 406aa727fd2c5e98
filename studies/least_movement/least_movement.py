"""How far a set-point must move for a log of command and temperature to show the gap of a valve.

Every loop has one day of 8 h with its PI at work; the set-point moves in one of several ways.  ``diagnose`` and the
estimator ``identify`` read it, and the Cramér–Rao bound says what the best unbiased reading could do with the same
command: a controller that sees the temperature alone tells nothing of the gap beyond it.  Sizes of steps, noise, gaps
and plants are drawn for each loop, so that what counts can be told from what does not.  Right means: within 20 % of the
gap or 1 % of the stroke.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from fastcoil.base.figures import apply_style
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE, identify_backlash
from studies.common import compare_rows, drawn_loops, loguniform, save_figure, share_of, write_table
from studies.days import CONSTANT, T_SET, of_kind
from studies.hunting.loops import foreseen
from studies.learning.identify_online import IDENTIFY
from studies.valve_test.bound import bound_of

SEED, VALVES, DAYS, HOURS = 9701, 512, 8, 8
LOGGED, COUNTS_FROM = 10, 1800
"""Seconds between samples, and those at the start of a day that no bound counts."""
GAPS, NOISE, STEPS = (0.02, 0.05, 0.10), (0.0, 0.01, 0.02, 0.05), (0.05, 3.0)
"""Gaps, fractions of stroke; standard deviations, K; smallest and largest step, K."""
ABOUT = 0.1
"""By how much a gap differs from these at most, as a share: those that readings compare are no better off."""
GOOD_ONES = 8
"""One valve in so many has no gap."""
SURE = 1.96
"""Standard deviations of the bound that a gap to be certified has to be within."""
HALF_HOUR = 1800


def steps(size: float, draw: np.random.Generator) -> np.ndarray:
    """Up and down by ``size`` every half hour."""
    sign = draw.choice((-1.0, 1.0))
    return T_SET + 0.5 * sign * size * np.repeat(np.resize((1.0, -1.0), 2 * HOURS), HALF_HOUR)


def ramps(size: float, draw: np.random.Generator) -> np.ndarray:
    """The same, each move spread over a quarter of an hour."""
    quarter = HALF_HOUR // 2
    return np.convolve(np.pad(steps(size, draw), (quarter - 1, 0), "edge"), np.full(quarter, 1.0 / quarter), "valid")


def still(size: float, draw: np.random.Generator) -> np.ndarray:
    """It stands still."""
    return np.full(HOURS * 3600, T_SET)


def setback(size: float, draw: np.random.Generator) -> np.ndarray:
    """4 K higher in the first hour, as after a night, and then still."""
    return T_SET + np.where(np.arange(HOURS * 3600) < 3600, 4.0, 0.0)


def outdoor_reset(size: float, draw: np.random.Generator) -> np.ndarray:
    """Down by 3 K as the day grows warm, and up again, in steps of 0.1 K."""
    warm = np.sin(np.pi * np.arange(HOURS * 3600) / (HOURS * 3600))
    return T_SET + 1.5 - np.round(3.0 * warm, 1)


TRIM, RESPOND, MOST, EVERY, IGNORED = 0.1, 0.2, 0.6, 120, 2
"""Guideline 36, supply air temperature: K up every two minutes; K down for each request more than are ignored, at most
so many K (ASHRAE Guideline 36-2021, 5.16.2.2)."""
LEAST_SET, MOST_SET, ZONES = 12.0, 18.0, 20


def trim_and_respond(size: float, draw: np.random.Generator) -> np.ndarray:
    """Trim and respond of 20 zones, each of which asks for cooler air above a set-point of its own.

    What a zone can bear moves by 1 K with a load of a few hours; a zone answers after 10 min.
    """
    t = np.arange(0, HOURS * 3600, EVERY)
    bears = draw.normal(15.5, 1.0, ZONES)[:, np.newaxis] + np.sin(
        2.0 * np.pi * (t / draw.uniform(2.0, 6.0, ZONES)[:, np.newaxis] / 3600.0 + draw.uniform(size=(ZONES, 1)))
    )
    T_set, felt, found = T_SET, T_SET, []
    for k in range(t.size):
        felt += (T_set - felt) * EVERY / 600.0
        requests = int((felt > bears[:, k]).sum())
        down = min(RESPOND * (requests - IGNORED), MOST) if requests > IGNORED else 0.0
        T_set = float(np.clip(T_set + TRIM - down, LEAST_SET, MOST_SET))
        found.append(T_set)
    return np.repeat(found, EVERY)


MOVES: Mapping[str, Callable[[float, np.random.Generator], np.ndarray]] = {
    "steps": steps, "ramps of 15 min": ramps, "still": still, "night setback": setback,
    "outdoor reset": outdoor_reset, "trim and respond": trim_and_respond,
}  # fmt: skip
SIZED = ("steps", "ramps of 15 min")
"""Those whose size is drawn."""


class Drawn(NamedTuple):
    """Loops with their noise, and sizes of step."""

    values: dict[str, np.ndarray]
    about: np.ndarray
    """The gap that a valve's own is near to."""
    steps: np.ndarray


def drawn(seed: int, n: int) -> Drawn:
    """Draw ``n`` loops; each has a day of its own."""
    draw = np.random.default_rng([seed, 1])
    worn = np.arange(n) % GOOD_ONES > 0
    values = drawn_loops(draw, n) | {"noise_std": draw.choice(NOISE, n)}
    about = np.where(worn, draw.choice(GAPS, n), 0.0)
    gap = about * draw.uniform(1.0 - ABOUT, 1.0 + ABOUT, n)
    return Drawn({"backlash": gap, **values}, about, loguniform(draw, *STEPS, n))


def reading(command: np.ndarray, T: np.ndarray, T_set: np.ndarray, stroke_time: float) -> tuple[float, ...]:
    """What a log shows: the gap, its interval, whether it is claimed."""
    found = identify_backlash(command, T, float(LOGGED), T_set, (), stroke_time=stroke_time)
    return found.backlash, found.low, found.high, float(found.identified)


def one(loop: fc.Loop, day: fc.Boundary, seed: int) -> tuple[float, ...]:
    """Reading, estimate of ``identify``, bound, and RMSE of one loop on its day; no bound without a gap."""
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], seed=seed, n_jobs=1)
    command = np.asarray(ds.command.values.squeeze(), dtype=float)
    T, T_set = np.asarray(ds.T_measured.values.squeeze(), dtype=float), np.asarray(day.series["T_set"]).squeeze()
    seen = (series[::LOGGED] for series in (command, T, T_set))
    read = reading(*seen, float(loop["stroke_time"]))
    online = fc.simulate(loop.assign(**IDENTIFY), day, seed=seed, n_jobs=1)
    least = np.nan
    if float(loop["backlash"]) > 0.0:
        held = np.where(np.arange(command.size) < COUNTS_FROM // 2, command, command[COUNTS_FROM:].mean())
        least = bound_of(loop, day, command, held, slice(COUNTS_FROM, None, LOGGED), seed)
    return *read, float(online.estimate_final), least, float(ds.rmse), float(ds.reversals)


NAMES = ("found", "low", "high", "claimed", "online", "bound", "rmse", "turns")


def measured(move: str, seed: int, n: int = VALVES) -> xr.Dataset:
    """What the logs of one way to move show: (sample, day), each loop on a day of its own, the others NaN."""
    of = drawn(seed, n)
    days = of_kind(CONSTANT, [100 * seed + k for k in range(DAYS)])
    draw = np.random.default_rng([seed, 2])
    preset = fc.Loop.preset("lbnl")
    whole = preset.assign(m_full=1.7, **{name: ("sample", values) for name, values in of.values.items()})
    K = foreseen(whole, days.isel(0)).K.values.ravel()
    jobs = []
    for k in range(n):
        series = {name: np.asarray(days.series[name])[k % DAYS] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
        T_set = MOVES[move](of.steps[k], draw)
        loop = preset.assign(m_full=1.7, **{name: float(values[k]) for name, values in of.values.items()})
        jobs.append(delayed(one)(loop, fc.Boundary(**series, T_set=T_set), 1000 * seed + k))
    values = np.array(Parallel(n_jobs=-1)(jobs))
    at = np.arange(n)
    spread = np.full((len(NAMES), n, DAYS), np.nan)
    spread[:, at, at % DAYS] = values.T
    ds = xr.Dataset({name: (("sample", "day"), each) for name, each in zip(NAMES, spread, strict=True)})
    known = {
        "true": of.values["backlash"],
        "about": of.about,
        "noise": of.values["noise_std"],
        "step": of.steps,
        "K": K,
    }
    return ds.assign({name: ("sample", each) for name, each in known.items()})


RATIOS = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, np.inf)
"""Step over gap times gain."""
TURNS = (0, 1, 3, 6, 12, 24, 48, np.inf)
"""Of the stem in a day: each crosses the gap."""


def right(ds: xr.Dataset, name: str) -> xr.DataArray:
    """Where a size is right."""
    return abs(ds[name] - ds.true) <= np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH) + 1e-9


def certain(ds: xr.Dataset) -> xr.DataArray:
    """Hours after which the bound would certify the gap, as if all hours told as much as those of the day."""
    return HOURS * (SURE * ds.bound / np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH)) ** 2


def ratio(ds: xr.Dataset) -> xr.DataArray:
    """Step over gap times gain."""
    return ds.step / (ds.true * ds.K)


def share(holds: xr.DataArray, among: xr.DataArray) -> str:
    """A share with its interval; a dash without any case."""
    return share_of(holds, among).written(0) if bool(among.any()) else "—"


def shares(ds: xr.Dataset, among: xr.DataArray) -> list[str]:
    """Wrong claims; shares claimed, right, covered; of ``identify`` right and too high; what the bound allows."""
    claimed, hours = (ds.claimed > 0.0) & among, certain(ds).where(among)
    too_high = ds.online > ds.true + np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH) + 1e-9
    covered = (ds.low <= ds.true) & (ds.true <= ds.high)
    return [
        f"{int(among.sum())}", f"{int((claimed & ~right(ds, 'found')).sum())} of {int(claimed.sum())}",
        share(claimed, among), share(right(ds, "found"), among), share(covered, among),
        share(right(ds, "online"), among), share(too_high, among), share(hours <= HOURS, among),
        f"{float(hours.median()):.2g}" if bool(hours.notnull().any()) else "—",
    ]  # fmt: skip


HEAD = (
    "loops", "wrong claims", "claimed", "right, claimed or not", "interval covers", "`identify` right",
    "`identify` too high", "certain by the bound", "hours to certify, by the bound, median",
)  # fmt: skip


def worn(ds: xr.Dataset) -> xr.DataArray:
    """Loops that ran and have a gap."""
    return ds.rmse.notnull() & (ds.true > 0.0)


def by_ratio(found: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by step over gap times gain."""
    for move in SIZED:
        ds = found[move]
        for low, high in pairwise(RATIOS):
            words = f"above {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
            yield [move, words, *shares(ds, worn(ds) & (ratio(ds) >= low) & (ratio(ds) < high))]


def collapse(ds: xr.Dataset) -> Iterator[list[str]]:
    """Share that is claimed by step over gap times gain, for each gap, and for each noise."""
    for low, high in pairwise((0.0, 0.2, 0.5, 1.0, np.inf)):
        inside = worn(ds) & (ratio(ds) >= low) & (ratio(ds) < high)
        parts = [*(ds.about == gap for gap in GAPS), *(ds.noise == noise for noise in NOISE)]
        words = f"above {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
        yield [words, *(share(ds.claimed > 0.0, inside & part) for part in parts)]


def by_move(found: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by the way the set-point moves and by gap, and how many good valves are accused."""
    for move, ds in found.items():
        good = ds.rmse.notnull() & (ds.true == 0.0)
        accused = good & (ds.claimed > 0.0) & (ds.found > GOOD_BACKLASH + 1e-9)
        for gap in GAPS:
            yield [move, f"{gap:.0%}", *shares(ds, worn(ds) & (ds.about == gap)),
                   f"{int(accused.sum())} of {int(good.sum())}", f"{float(ds.rmse.median()):.2f}"]  # fmt: skip


OF_ONE_TURN = 0.06
"""K: about the bound of one turn, times the gain."""


def together(found: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """All loops, whatever moved their set-point."""
    return xr.concat(list(found.values()), "sample")


def by_turns(found: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by turns of the stem, whatever made it turn; last the bound times the gain, in theory as 1 / √turns."""
    ds = together(found)
    for low, high in pairwise(TURNS):
        inside = worn(ds) & (ds.turns >= low) & (ds.turns < high)
        words = f"{low} or more" if np.isinf(high) else f"{low} to {high - 1}" if high - low > 1 else f"{low}"
        scaled = (ds.bound * ds.K).where(inside)
        claimed = inside & (ds.claimed > 0.0)
        error, least = (float(np.sqrt((size**2).where(claimed).mean())) for size in (ds.found - ds.true, ds.bound))
        yield [words, *shares(ds, inside), f"{1000 * float(scaled.median()):.0f}",
               f"{1000 * float((scaled * np.sqrt(ds.turns)).median()):.0f}" if high > 1 else "—",
               f"{error / least:.1f}" if bool(claimed.any()) else "—"]  # fmt: skip


@apply_style()
def draw(found: Mapping[str, xr.Dataset]) -> None:
    """Draw the share claimed over step / (X K), and the bound over the turns of the stem."""
    figure, (left, other) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    ds = found["steps"]
    edges = np.geomspace(0.03, 10.0, 11)
    middle = np.sqrt(edges[1:] * edges[:-1])
    for gap in GAPS:
        at = [worn(ds) & (ds.about == gap) & (ratio(ds) >= low) & (ratio(ds) < high) for low, high in pairwise(edges)]
        values = [100 * float((ds.claimed > 0.0).where(one).mean()) if int(one.sum()) > 9 else np.nan for one in at]
        left.plot(middle, values, marker="o", label=f"X = {gap:.0%}")
    left.set(xscale="log", xlabel="step / (X K)", ylabel="claimed [%]", ylim=(0, 100))
    left.legend(loc="upper left")
    ds = together(found)
    for noise in NOISE:
        at = worn(ds) & (ds.noise == noise) & (ds.turns > 0.0)
        other.plot(ds.turns.where(at).values.ravel(), 1000 * (ds.bound * ds.K).where(at).values.ravel(), ".", ms=3,
                   alpha=0.6, mew=0, label=f"noise {noise:g} K")  # fmt: skip
    turns = np.geomspace(1.0, 200.0, 50)
    other.plot(turns, 1000 * OF_ONE_TURN / np.sqrt(turns), color="0.2", lw=1.2, label="60 mK / √turns")
    other.set(
        xscale="log", yscale="log", xlabel="turns of the stem in the day", ylabel="bound × K [mK]", ylim=(1, 1000)
    )
    other.legend(loc="lower left", markerscale=3)
    save_figure(figure, "least_movement/least_movement.png")


def sample() -> None:
    """Days whose set-point stands still."""
    move = "still"
    found = {move: measured(move, SEED + list(MOVES).index(move), VALVES // 2)}
    compare_rows("least_movement/least_movement_ways", by_move(found))


def main(n: int = VALVES) -> None:
    """Write the tables and the figure."""
    found = {}
    for k, move in enumerate(MOVES):
        found[move] = measured(move, SEED + k, n if move in SIZED else n // 2)
        print(move, "done", flush=True)
    of = f"{n} loops for steps and for ramps, {n // 2} for each other set-point pattern, one {HOURS}-h day each"
    write_table("least_movement/least_movement",
                f"Set-points that move every half hour: {n} loops for steps and for ramps, one {HOURS}-h day each",
                ["set-point", "step / (X K)", *HEAD], by_ratio(found))  # fmt: skip
    write_table("least_movement/least_movement_collapse",
                f"Share of the loops with set-point steps whose gap is claimed, by gap and by noise: {n} loops, one "
                f"{HOURS}-h day each",
                ["step / (X K)", *(f"gap {gap:.0%}" for gap in GAPS), *(f"noise {noise:g} K" for noise in NOISE)],
                collapse(found["steps"]))  # fmt: skip
    write_table("least_movement/least_movement_ways", f"Set-point patterns compared: {of}",
                ["set-point", "gap", *HEAD, "good valves accused", "RMSE, median, K"], by_move(found))  # fmt: skip
    write_table("least_movement/least_movement_turns",
                f"Claims and estimates by reversals of the stem, all set-point patterns pooled: {of}",
                ["reversals", *HEAD, "bound × K, median, mK", "the same × √reversals",
                 "rms error of claims / rms bound"], by_turns(found))  # fmt: skip
    draw(found)
