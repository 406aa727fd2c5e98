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
from studies.common import compare_rows, draw_loguniform, draw_loop_parameters, save_figure, share_of, write_table
from studies.days import CONSTANT, T_SET, make_days
from studies.hunting.loops import loop_properties
from studies.learning.identify_online import IDENTIFY_SETTINGS
from studies.valve_test.bound import CERTAIN_SIGMAS, simulate_bound

SEED, VALVES, DAYS, HOURS = 9701, 512, 8, 8
LOG_INTERVAL = 10  # seconds between samples
COUNTED_FROM = 1800  # seconds at the start of a day that no bound counts
GAPS = (0.02, 0.05, 0.10)  # sizes of backlash, fractions of stroke
NOISE_LEVELS = (0.0, 0.01, 0.02, 0.05)  # standard deviations of the sensor's noise, K
STEP_RANGE = (0.05, 3.0)  # smallest and largest step, K
GAP_SPREAD = 0.1
"""By how much a gap differs from these at most, as a share: those that readings compare are no better off."""
GOOD_EVERY = 8  # one valve in so many has no gap
HALF_HOUR = 1800


def stepped_set_point(size: float, rng: np.random.Generator) -> np.ndarray:
    """Return a set-point that steps up and down by ``size`` every half hour."""
    sign = rng.choice((-1.0, 1.0))
    return T_SET + 0.5 * sign * size * np.repeat(np.resize((1.0, -1.0), 2 * HOURS), HALF_HOUR)


def ramped_set_point(size: float, rng: np.random.Generator) -> np.ndarray:
    """Return a set-point whose steps by ``size`` are ramps of a quarter of an hour each."""
    quarter = HALF_HOUR // 2
    return np.convolve(
        np.pad(stepped_set_point(size, rng), (quarter - 1, 0), "edge"), np.full(quarter, 1.0 / quarter), "valid"
    )


def still_set_point(size: float, rng: np.random.Generator) -> np.ndarray:
    """Return a constant set-point."""
    return np.full(HOURS * 3600, T_SET)


def setback_set_point(size: float, rng: np.random.Generator) -> np.ndarray:
    """Return a set-point that is 4 K higher in the first hour, as after a night, and then constant."""
    return T_SET + np.where(np.arange(HOURS * 3600) < 3600, 4.0, 0.0)


def outdoor_reset(size: float, rng: np.random.Generator) -> np.ndarray:
    """Return a set-point that falls by 3 K as the day grows warm, and rises again, in steps of 0.1 K."""
    warming = np.sin(np.pi * np.arange(HOURS * 3600) / (HOURS * 3600))
    return T_SET + 1.5 - np.round(3.0 * warming, 1)


TRIM_K, RESPOND_K, LARGEST_RESPONSE_K, TRIM_INTERVAL, IGNORED_REQUESTS = 0.1, 0.2, 0.6, 120, 2
"""Guideline 36, supply air temperature: K up every two minutes; K down for each request more than are ignored, at most
so many K (ASHRAE Guideline 36-2021, 5.16.2.2)."""
LOWEST_SET_POINT, HIGHEST_SET_POINT = 12.0, 18.0
"""Limits of trim and respond, °C."""
ZONES = 20


def trim_and_respond(size: float, rng: np.random.Generator) -> np.ndarray:
    """Trim and respond of 20 zones, each of which asks for cooler air above a set-point of its own.

    What a zone can bear moves by 1 K with a load of a few hours; a zone answers after 10 min.
    """
    t = np.arange(0, HOURS * 3600, TRIM_INTERVAL)
    tolerable = rng.normal(15.5, 1.0, ZONES)[:, np.newaxis] + np.sin(
        2.0 * np.pi * (t / rng.uniform(2.0, 6.0, ZONES)[:, np.newaxis] / 3600.0 + rng.uniform(size=(ZONES, 1)))
    )
    T_set, felt_set_point, set_points = T_SET, T_SET, []
    for k in range(t.size):
        felt_set_point += (T_set - felt_set_point) * TRIM_INTERVAL / 600.0
        requests = int((felt_set_point > tolerable[:, k]).sum())
        response = (
            min(RESPOND_K * (requests - IGNORED_REQUESTS), LARGEST_RESPONSE_K) if requests > IGNORED_REQUESTS else 0.0
        )
        T_set = float(np.clip(T_set + TRIM_K - response, LOWEST_SET_POINT, HIGHEST_SET_POINT))
        set_points.append(T_set)
    return np.repeat(set_points, TRIM_INTERVAL)


MOVES: Mapping[str, Callable[[float, np.random.Generator], np.ndarray]] = {
    "steps": stepped_set_point, "ramps of 15 min": ramped_set_point, "still": still_set_point,
    "night setback": setback_set_point,
    "outdoor reset": outdoor_reset, "trim and respond": trim_and_respond,
}  # fmt: skip
SIZED_MOVES = ("steps", "ramps of 15 min")  # of ``MOVES``, those whose size is drawn


class LoopSample(NamedTuple):
    """Loops with their noise, and sizes of step."""

    values: dict[str, np.ndarray]
    about: np.ndarray
    """The gap that a valve's own is near to."""
    steps: np.ndarray


def draw_loops(seed: int, n: int) -> LoopSample:
    """Draw ``n`` loops; each has a day of its own."""
    rng = np.random.default_rng([seed, 1])
    has_gap = np.arange(n) % GOOD_EVERY > 0
    values = draw_loop_parameters(rng, n) | {"noise_std": rng.choice(NOISE_LEVELS, n)}
    nominal_gap = np.where(has_gap, rng.choice(GAPS, n), 0.0)
    gap = nominal_gap * rng.uniform(1.0 - GAP_SPREAD, 1.0 + GAP_SPREAD, n)
    return LoopSample({"backlash": gap, **values}, nominal_gap, draw_loguniform(rng, *STEP_RANGE, n))


def read_log(command: np.ndarray, T: np.ndarray, T_set: np.ndarray, stroke_time: float) -> tuple[float, ...]:
    """Read a log: the gap, its interval, whether it is claimed."""
    identification = identify_backlash(command, T, float(LOG_INTERVAL), T_set, (), stroke_time=stroke_time)
    return identification.backlash, identification.low, identification.high, float(identification.identified)


def evaluate_loop(loop: fc.Loop, day: fc.Boundary, seed: int) -> tuple[float, ...]:
    """Reading, estimate of ``identify``, bound, and RMSE of one loop on its day; no bound without a gap."""
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], seed=seed, n_jobs=1)
    command = np.asarray(ds.command.values.squeeze(), dtype=float)
    T, T_set = np.asarray(ds.T_measured.values.squeeze(), dtype=float), np.asarray(day.series["T_set"]).squeeze()
    logged_series = (series[::LOG_INTERVAL] for series in (command, T, T_set))
    log_reading = read_log(*logged_series, float(loop["stroke_time"]))
    online = fc.simulate(loop.assign(**IDENTIFY_SETTINGS), day, seed=seed, n_jobs=1)
    bound = np.nan
    if float(loop["backlash"]) > 0.0:
        still_command = np.where(np.arange(command.size) < COUNTED_FROM // 2, command, command[COUNTED_FROM:].mean())
        bound = simulate_bound(
            loop, day, command, still_command, slice(COUNTED_FROM, None, LOG_INTERVAL), seed
        ).unknown_coil
    return *log_reading, float(online.estimate_final), bound, float(ds.rmse), float(ds.reversals)


RESULT_NAMES = ("found", "low", "high", "claimed", "online", "bound", "rmse", "turns")


def run_move(move: str, seed: int, n: int = VALVES) -> xr.Dataset:
    """Simulate one way to move the set-point, and read the logs: (sample, day), each loop on a day of its own."""
    loop_sample = draw_loops(seed, n)
    days = make_days(CONSTANT, [100 * seed + k for k in range(DAYS)])
    rng = np.random.default_rng([seed, 2])
    preset = fc.Loop.preset("lbnl")
    all_loops = preset.assign(m_full=1.7, **{name: ("sample", values) for name, values in loop_sample.values.items()})
    K = loop_properties(all_loops, days.isel(0)).K.values.ravel()
    jobs = []
    for k in range(n):
        series = {name: np.asarray(days.series[name])[k % DAYS] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
        T_set = MOVES[move](loop_sample.steps[k], rng)
        loop = preset.assign(m_full=1.7, **{name: float(values[k]) for name, values in loop_sample.values.items()})
        jobs.append(delayed(evaluate_loop)(loop, fc.Boundary(**series, T_set=T_set), 1000 * seed + k))
    values = np.array(Parallel(n_jobs=-1)(jobs))
    index = np.arange(n)
    columns = np.full((len(RESULT_NAMES), n, DAYS), np.nan)
    columns[:, index, index % DAYS] = values.T
    ds = xr.Dataset({name: (("sample", "day"), column) for name, column in zip(RESULT_NAMES, columns, strict=True)})
    truths = {
        "true": loop_sample.values["backlash"],
        "about": loop_sample.about,
        "noise": loop_sample.values["noise_std"],
        "step": loop_sample.steps,
        "K": K,
    }
    return ds.assign({name: ("sample", column) for name, column in truths.items()})


RATIO_EDGES = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, np.inf)  # step over gap times gain
TURN_EDGES = (0, 1, 3, 6, 12, 24, 48, np.inf)  # turns of the stem in a day, each of which crosses the gap


def is_right(ds: xr.Dataset, name: str) -> xr.DataArray:
    """Return where a size is right."""
    return abs(ds[name] - ds.true) <= np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH) + 1e-9


def hours_to_certify(ds: xr.Dataset) -> xr.DataArray:
    """Hours after which the bound would certify the gap, as if all hours told as much as those of the day."""
    return HOURS * (CERTAIN_SIGMAS * ds.bound / np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH)) ** 2


def step_ratio(ds: xr.Dataset) -> xr.DataArray:
    """Return the size of the step over gap times plant gain."""
    return ds.step / (ds.true * ds.K)


def share_or_dash(holds: xr.DataArray, among: xr.DataArray) -> str:
    """A share with its interval; a dash without any case."""
    return share_of(holds, among).to_text(0) if bool(among.any()) else "—"


def share_cells(ds: xr.Dataset, among: xr.DataArray) -> list[str]:
    """Wrong claims; shares claimed, right, covered; of ``identify`` right and too high; what the bound allows."""
    is_claimed, hours_needed = (ds.claimed > 0.0) & among, hours_to_certify(ds).where(among)
    is_too_high = ds.online > ds.true + np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH) + 1e-9
    is_covered = (ds.low <= ds.true) & (ds.true <= ds.high)
    return [
        f"{int(among.sum())}", f"{int((is_claimed & ~is_right(ds, 'found')).sum())} of {int(is_claimed.sum())}",
        share_or_dash(is_claimed, among), share_or_dash(is_right(ds, "found"), among), share_or_dash(is_covered, among),
        share_or_dash(is_right(ds, "online"), among), share_or_dash(is_too_high, among),
        share_or_dash(hours_needed <= HOURS, among),
        f"{float(hours_needed.median()):.2g}" if bool(hours_needed.notnull().any()) else "—",
    ]  # fmt: skip


HEAD = (
    "loops", "wrong claims", "claimed", "right, claimed or not", "interval covers", "`identify` right",
    "`identify` too high", "certain by the bound", "hours to certify, by the bound, median",
)  # fmt: skip


def is_worn(ds: xr.Dataset) -> xr.DataArray:
    """Return which loops ran and have a gap."""
    return ds.rmse.notnull() & (ds.true > 0.0)


def rows_by_ratio(by_way: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by step over gap times gain."""
    for move in SIZED_MOVES:
        ds = by_way[move]
        for low, high in pairwise(RATIO_EDGES):
            label = f"above {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
            yield [move, label, *share_cells(ds, is_worn(ds) & (step_ratio(ds) >= low) & (step_ratio(ds) < high))]


def rows_by_gap_and_noise(ds: xr.Dataset) -> Iterator[list[str]]:
    """Share that is claimed by step over gap times gain, for each gap, and for each noise."""
    for low, high in pairwise((0.0, 0.2, 0.5, 1.0, np.inf)):
        is_inside = is_worn(ds) & (step_ratio(ds) >= low) & (step_ratio(ds) < high)
        parts = [*(ds.about == gap for gap in GAPS), *(ds.noise == noise for noise in NOISE_LEVELS)]
        label = f"above {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
        yield [label, *(share_or_dash(ds.claimed > 0.0, is_inside & part) for part in parts)]


def rows_by_move(by_way: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by the way the set-point moves and by gap, and how many good valves are accused."""
    for move, ds in by_way.items():
        is_good = ds.rmse.notnull() & (ds.true == 0.0)
        is_accused = is_good & (ds.claimed > 0.0) & (ds.found > GOOD_BACKLASH + 1e-9)
        for gap in GAPS:
            yield [move, f"{gap:.0%}", *share_cells(ds, is_worn(ds) & (ds.about == gap)),
                   f"{int(is_accused.sum())} of {int(is_good.sum())}", f"{float(ds.rmse.median()):.2f}"]  # fmt: skip


BOUND_OF_ONE_TURN = 0.06  # about the bound of one turn of the stem times the gain, K


def join_moves(by_way: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Join all loops, of all set-point patterns."""
    return xr.concat(list(by_way.values()), "sample")


def rows_by_turns(by_way: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by turns of the stem, whatever made it turn; last the bound times the gain, in theory as 1 / √turns."""
    ds = join_moves(by_way)
    for low, high in pairwise(TURN_EDGES):
        is_inside = is_worn(ds) & (ds.turns >= low) & (ds.turns < high)
        label = f"{low} or more" if np.isinf(high) else f"{low} to {high - 1}" if high - low > 1 else f"{low}"
        scaled = (ds.bound * ds.K).where(is_inside)
        is_claimed = is_inside & (ds.claimed > 0.0)
        rms_error, rms_bound = (
            float(np.sqrt((size**2).where(is_claimed).mean())) for size in (ds.found - ds.true, ds.bound)
        )
        yield [label, *share_cells(ds, is_inside), f"{1000 * float(scaled.median()):.0f}",
               f"{1000 * float((scaled * np.sqrt(ds.turns)).median()):.0f}" if high > 1 else "—",
               f"{rms_error / rms_bound:.1f}" if bool(is_claimed.any()) else "—"]  # fmt: skip


def rows_by_day(by_way: Mapping[str, xr.Dataset]) -> Iterator[list[str]]:
    """Rows by day, last all: the bound times the gain times √turns, and the power of the turns that fits the bound."""
    ds = join_moves(by_way)
    is_inside = is_worn(ds) & (ds.turns > 0.0) & ds.bound.notnull()
    for day in (*range(ds.sizes["day"]), slice(None)):
        among = is_inside.isel(day=day)
        if not among.any():  # the first day has the good valves, an eighth of all
            continue
        turns, scaled = (series.isel(day=day).where(among) for series in (ds.turns, ds.bound * ds.K))
        log_turns, log_bound = (np.log(series.values[among.values]) for series in (turns, scaled))
        power = np.polyfit(log_turns, log_bound, 1)[0] if np.unique(log_turns).size > 1 else np.nan
        constants = 1000.0 * scaled * np.sqrt(turns)
        yield ["all" if isinstance(day, slice) else f"{day + 1}", f"{int(among.sum())}",
               " · ".join(f"{float(constants.quantile(q)):.0f}" for q in (0.1, 0.5, 0.9)), f"{power:.2f}"]  # fmt: skip


FEW_HOURS, FEW_COUNTS, FEW_SIZES = 3, (1, 2, 3, 5, 11), (0.5, 1.0, 2.0)
"""Short logs: their hours, how often the set-point steps, and by how much, K; every count has every size."""


def evaluate_short_log(loop: fc.Loop, day: fc.Boundary, seed: int) -> tuple[float, ...]:
    """Read a short log: the gap, whether it is claimed, and the reversals of the stem."""
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], seed=seed, n_jobs=1)
    series = (ds.command.values.squeeze(), ds.T_measured.values.squeeze(), np.asarray(day.series["T_set"]).squeeze())
    command, T, T_set = (np.asarray(values, dtype=float)[::LOG_INTERVAL] for values in series)
    found, _, _, claimed = read_log(command, T, T_set, float(loop["stroke_time"]))
    return found, claimed, float(ds.reversals)


def rows_by_count_and_size(seed: int, n: int) -> Iterator[list[str]]:
    """Rows of short logs, in which number and size of the steps do not depend on each other."""
    loop_sample, days = draw_loops(seed, n), make_days(CONSTANT, [100 * seed + k for k in range(DAYS)])
    t, preset, jobs = np.arange(FEW_HOURS * 3600), fc.Loop.preset("lbnl"), []
    cases = [(count, size) for count in FEW_COUNTS for size in FEW_SIZES]
    for k in range(n):
        names = ("m_a", "T_a_in", "W_a_in", "T_w_in")
        series = {name: np.asarray(days.series[name])[k % DAYS, : t.size] for name in names}
        loop = preset.assign(m_full=1.7, **{name: float(values[k]) for name, values in loop_sample.values.items()})
        for count, size in cases:
            steps_so_far = t * (count + 1) // t.size
            day = fc.Boundary(**series, T_set=T_SET + size * (steps_so_far % 2 - 0.5))
            jobs.append(delayed(evaluate_short_log)(loop, day, 1000 * seed + k))
    found, claimed, turns = np.array(Parallel(n_jobs=-1)(jobs)).T.reshape(3, n, len(cases))
    dims = ("sample", "case")
    ds = xr.Dataset({"found": (dims, found), "claimed": (dims, claimed), "turns": (dims, turns)})
    ds = ds.assign(true=("sample", loop_sample.values["backlash"]))
    for case, (count, size) in enumerate(cases):
        part, worn = ds.isel(case=case), ds.true > 0.0
        is_claimed = (part.claimed > 0.0) & worn
        is_accused = (part.claimed > 0.0) & ~worn & (part.found > GOOD_BACKLASH + 1e-9)
        yield [f"{count}", f"{size:g}", f"{float(part.turns.where(worn).median()):.0f}",
               f"{int((is_claimed & ~is_right(part, 'found')).sum())} of {int(is_claimed.sum())}",
               share_or_dash(is_claimed, worn), f"{int(is_accused.sum())} of {int((~worn).sum())}"]  # fmt: skip


def write_short_logs(n: int) -> None:
    """Write the table of short logs."""
    write_table("least_movement/least_movement_short",
                f"Logs of {FEW_HOURS} h in which the set-point steps up and down at even intervals: {n} loops, each "
                "with every number and size of steps",
                ["steps", "size, K", "reversals of the stem, median", "wrong claims", "claimed", "good valves accused"],
                rows_by_count_and_size(SEED + len(MOVES), n))  # fmt: skip


@apply_style()
def draw(by_way: Mapping[str, xr.Dataset]) -> None:
    """Draw the share claimed over step / (X K), and the bound over the turns of the stem."""
    figure, (claimed_panel, bound_panel) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    ds = by_way["steps"]
    edges = np.geomspace(0.03, 10.0, 11)
    middle = np.sqrt(edges[1:] * edges[:-1])
    for gap in GAPS:
        is_bound = [
            is_worn(ds) & (ds.about == gap) & (step_ratio(ds) >= low) & (step_ratio(ds) < high)
            for low, high in pairwise(edges)
        ]
        values = [
            100 * float((ds.claimed > 0.0).where(is_inside).mean()) if int(is_inside.sum()) > 9 else np.nan
            for is_inside in is_bound
        ]
        claimed_panel.plot(middle, values, marker="o", label=f"X = {gap:.0%}")
    claimed_panel.set(xscale="log", xlabel="step / (X K)", ylabel="claimed [%]", ylim=(0, 100))
    claimed_panel.legend(loc="upper left")
    ds = join_moves(by_way)
    for noise in NOISE_LEVELS:
        is_bound = is_worn(ds) & (ds.noise == noise) & (ds.turns > 0.0)
        turns, bounds = ds.turns.where(is_bound), 1000 * (ds.bound * ds.K).where(is_bound)
        bound_panel.plot(turns.values.ravel(), bounds.values.ravel(), ".",
                         ms=3,
                   alpha=0.6, mew=0, label=f"noise {noise:g} K")  # fmt: skip
    turns = np.geomspace(1.0, 200.0, 50)
    bound_panel.plot(turns, 1000 * BOUND_OF_ONE_TURN / np.sqrt(turns), color="0.2", lw=1.2, label="60 mK / √turns")
    bound_panel.set(
        xscale="log", yscale="log", xlabel="turns of the stem in the day", ylabel="bound × K [mK]", ylim=(1, 1000)
    )
    bound_panel.legend(loc="lower left", markerscale=3)
    save_figure(figure, "least_movement/least_movement.png")


def sample() -> None:
    """Run a sample of the study: days whose set-point stands still."""
    move = "still"
    by_way = {move: run_move(move, SEED + list(MOVES).index(move), VALVES // 2)}
    compare_rows("least_movement/least_movement_ways", rows_by_move(by_way))


def main(n: int = VALVES) -> None:
    """Write the tables and the figure."""
    by_way = {}
    for k, move in enumerate(MOVES):
        by_way[move] = run_move(move, SEED + k, n if move in SIZED_MOVES else n // 2)
        print(move, "done", flush=True)
    loops_text = f"{n} loops for steps and for ramps, {n // 2} for each other set-point pattern, one {HOURS}-h day each"
    write_table("least_movement/least_movement",
                f"Set-points that move every half hour: {n} loops for steps and for ramps, one {HOURS}-h day each",
                ["set-point", "step / (X K)", *HEAD], rows_by_ratio(by_way))  # fmt: skip
    write_table("least_movement/least_movement_collapse",
                f"Share of the loops with set-point steps whose gap is claimed, by gap and by noise: {n} loops, one "
                f"{HOURS}-h day each",
                ["step / (X K)", *(f"gap {gap:.0%}" for gap in GAPS),
                 *(f"noise {noise:g} K" for noise in NOISE_LEVELS)],
                rows_by_gap_and_noise(by_way["steps"]))  # fmt: skip
    write_table("least_movement/least_movement_ways", f"Set-point patterns compared: {loops_text}",
                ["set-point", "gap", *HEAD, "good valves accused", "RMSE, median, K"],
                rows_by_move(by_way))  # fmt: skip
    write_table("least_movement/least_movement_turns",
                f"Claims and estimates by reversals of the stem, all set-point patterns pooled: {loops_text}",
                ["reversals", *HEAD, "bound × K, median, mK", "the same × √reversals",
                 "rms error of claims / rms bound"], rows_by_turns(by_way))  # fmt: skip
    write_table("least_movement/least_movement_days",
                f"The bound by day of drift, all set-point patterns pooled: {loops_text}",
                ["day", "loops", "bound × K × √reversals, 10 %, median, 90 %, mK", "power of the reversals"],
                rows_by_day(by_way))  # fmt: skip
    write_short_logs(n // 4)
    draw(by_way)
