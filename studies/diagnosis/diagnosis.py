"""Does a trend log of command and supply temperature reveal the backlash?  Valves and days never seen before.

The thresholds of ``fastcoil.measured`` were chosen on valves and days of seeds 301 to 503; those here share none of
them.  Right means: within 20 % of the true backlash or 1 % of the stroke.  A *population* is a kind of day
and what sets its valves or logs apart: an inverse that runs, a stem with other faults, a coarse sensor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE, identify_backlash
from studies.common import compare_rows, draw_backlash, draw_loop_parameters, share_of, write_table
from studies.days import CONSTANT, DESIGN, HEATING, STEPPED, kinds, loop_settings, make_days

TRACE_INTERVAL = 5  # seconds between the samples of the traces that logs are thinned from
STEPPED_HEATING = "stepped heating"
HEATING_SET_POINTS = (25.0, 23.5, 27.0, 25.0, 22.5, 24.0, 28.0, 26.0, 24.5, 23.0, 22.0, 25.5, 29.0, 27.5, 24.0, 25.0)
"""Set-points of a stepped day of heating, °C, half an hour each."""


class Population(NamedTuple):
    """What sets valves, loops and logs apart from the plain ones of a kind of day.

    inverse: estimate over true backlash of a running inverse, from and to; that of a good valve thinks of 3 %.
    slip_ratio: jump over backlash.  late: samples by which the temperatures lag the commands.  log_resolution:
    resolution of the logged command, fraction of stroke, and of the temperature, K.  accepts_range: whether what lies
    between the gap and the gap with the neutral zone, or without the slip jump, counts as right too.
    """

    kind: str = STEPPED
    loop: dict[str, float] = {}
    authority: tuple[float, float] = (0.05, 0.9)
    kp: tuple[float, float] = (0.005, 0.06)
    ti: tuple[float, float] = (20, 300)
    sample_times: tuple[float, ...] = (5.0, 10.0, 15.0, 30.0)
    inverse: tuple[float, float] = (0.0, 0.0)
    neutral_zone: float = 0.0
    slip_ratio: float = 0.0
    stroke_time_wrong: float = 1.0
    late: int = 0
    log_resolution: tuple[float, float] = (0.0, 0.0)
    intervals: tuple[int, ...] = (10, 15, 30)
    tells_sample_time: bool = False
    accepts_range: bool = False


class Logs(NamedTuple):
    """Logs of a population.  Per valve: its backlash, least and most that counts.  Signals: (days, valves or 1, n)."""

    backlash: np.ndarray
    least: np.ndarray
    most: np.ndarray
    sample_time: np.ndarray
    stroke_time: np.ndarray
    interval: np.ndarray
    signals: dict[str, np.ndarray]
    late: int
    tells_sample_time: bool


POPULATIONS_BY_KIND = {kind: Population(kind) for kind in (*kinds(), STEPPED_HEATING)}
INVERSE_RANGE = (0.2, 1.6)
OTHER_POPULATIONS = {
    "inverse of 95 %": Population(inverse=(0.95, 0.95)),
    "inverse of 95 %, sample time given": Population(inverse=(0.95, 0.95), tells_sample_time=True),
    "inverse of 20 to 160 %": Population(inverse=INVERSE_RANGE),
    "inverse of 20 to 160 %, sample time given": Population(inverse=INVERSE_RANGE, tells_sample_time=True),
    "inverse of 20 to 160 %, constant days": Population(CONSTANT, inverse=INVERSE_RANGE),
    "0.1 K, 1 % of command": Population(loop={"sensor_resolution": 0.1, "command_resolution": 0.01}),
    "log rounded to 0.1 K, 1 %": Population(log_resolution=(0.01, 0.1)),
    "authority 0.02 to 0.1": Population(authority=(0.02, 0.1)),
    "neutral zone up to 2 %": Population(neutral_zone=0.02),
    "neutral zone up to 2 %, counted as gap": Population(neutral_zone=0.02, accepts_range=True),
    "slip jump 0.3 X": Population(slip_ratio=0.3),
    "slip jump 0.3 X, 0.7 X to X counted": Population(slip_ratio=0.3, accepts_range=True),
    "leakage 0.1 %": Population(loop={"leakage": 0.001}),
    "sample time 7 or 20 s": Population(sample_times=(7.0, 20.0)),
    "fast tunings that hunt": Population(kp=(0.03, 0.1), ti=(8, 20)),
    "stroke time wrong by up to 2": Population(stroke_time_wrong=2.0),
    "temperature a sample late": Population(late=1),
    "command a sample late": Population(late=-1),
    "log of 60 s": Population(intervals=(60,)),
    "log of 60 s, fast tunings": Population(intervals=(60,), kp=(0.03, 0.1), ti=(8, 20)),
    "log of 60 s, sample time of 60 s given": Population(intervals=(60,), sample_times=(60.0,), tells_sample_time=True),
}
GOOD_POPULATIONS = {
    **{kind: population for kind, population in POPULATIONS_BY_KIND.items() if kind != DESIGN},
    "inverse of 3 %": Population(inverse=(1.0, 1.0)),
    "log of 60 s": Population(intervals=(60,)),
}


def valves(population: Population, seed: list[int], n: int, good_only: bool = False) -> dict[str, np.ndarray]:
    """Parameters of the valves and loops.

    A quarter has no backlash; of the others half have one of the sizes of ``remedies.toml``, half any size.
    """
    rng = np.random.default_rng(seed)

    sizes = draw_backlash(rng, n)
    backlash = np.where((np.arange(n) % 4 == 0) | good_only, 0.0, sizes)
    estimate_ratio = rng.uniform(*population.inverse, n)
    return {
        "backlash": backlash,
        **draw_loop_parameters(
            rng,
            n,
            heating=HEATING in population.kind,
            authority=population.authority,
            kp=population.kp,
            ti=population.ti,
            sample_times=population.sample_times,
        ),
        "backlash_estimate": estimate_ratio * np.where(backlash > 0.0, backlash, 0.03),
        "slip_jump": population.slip_ratio * backlash,
        "neutral_zone": rng.uniform(0.0, population.neutral_zone, n),
    }


def days_of_kind(kind: str, seeds: list[int]) -> fc.Boundary:
    """Days of a kind of ``days.py``, or of heating with a set-point that steps."""
    if kind != STEPPED_HEATING:
        return make_days(kind, seeds)
    days = make_days(HEATING, seeds)
    series = {name: days.series[name] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")}
    series["T_set"] = np.broadcast_to(np.repeat(HEATING_SET_POINTS, 1800), series["T_set"].shape)
    return fc.Boundary(**series, day=seeds)


def simulate_logs(population: Population, seed: list[int], days: list[int], n: int, good_only: bool = False) -> Logs:
    """Simulate the valves of a population on its days."""
    parameters = valves(population, seed, n, good_only)
    loop = fc.Loop.preset("lbnl").assign(
        m_full=1.7, **{name: ("sample", values) for name, values in parameters.items()}, **population.loop,
        **loop_settings(HEATING if HEATING in population.kind else population.kind),
    )  # fmt: skip
    boundary = days_of_kind(population.kind, days)
    ds = fc.simulate(
        loop, boundary, traces=["command", "T_measured"], trace_interval=TRACE_INTERVAL, seed=seed[0], n_jobs=1
    )
    command, T = (
        ds[n].transpose("day", "sample", "elapsed_time").values.astype(float) for n in ("command", "T_measured")
    )
    signals = {
        "command": _round_to(command, population.log_resolution[0]),
        "T_measured": _round_to(T, population.log_resolution[1]),
    }
    signals |= {
        n: np.asarray(boundary.series[n], float)[:, np.newaxis, ::TRACE_INTERVAL] for n in ("T_set", "m_a", "T_a_in")
    }
    rng = np.random.default_rng([*seed, 9])
    log_factor = np.log(population.stroke_time_wrong)
    backlash, stroke_time = (
        parameters["backlash"],
        parameters["stroke_time"] * np.exp(rng.uniform(-log_factor, log_factor, n)),
    )
    least, most = (
        backlash - population.accepts_range * parameters["slip_jump"],
        backlash + population.accepts_range * parameters["neutral_zone"],
    )
    interval = rng.choice(population.intervals, n)
    return Logs(
        backlash, least, most, parameters["sample_time"], stroke_time, interval, signals, population.late,
        population.tells_sample_time
    )  # fmt: skip


def _round_to(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step if step > 0.0 else values


SEED = 9211
VALVES, DAYS = 128, 3
OTHER_VALVES = 64
N_GOOD_VALVES, GOOD_DAYS = 150, 4
LOG_HOURS = (8, 4, 2)
WITH_SET_POINT = "command, T_sup, T_set"
COLUMN_SETS = {
    WITH_SET_POINT: ("T_set",),
    "command, T_sup": (),
    "with air flow and T_in": ("T_set", "m_a", "T_a_in"),
}


class LogResult(NamedTuple):
    """Result of the logs of one population, set of columns and length."""

    name: str
    columns: str
    hours: int
    estimates: xr.Dataset

    @property
    def wrong_share(self) -> float:
        """Share of what was claimed that is wrong."""
        is_claimed = self.estimates.identified > 0
        return float(1.0 - self.estimates.right.where(is_claimed).mean()) if is_claimed.any() else 0.0


def identify_logs(logs: Logs, hours: int, columns: tuple[str, ...]) -> xr.Dataset:
    """Identify the backlash from the first hours of every log; the stroke time of two valves in three is known."""
    days, valves = logs.signals["command"].shape[:2]
    estimates = np.empty((days, valves, 4))
    for v, stride in enumerate(logs.interval // TRACE_INTERVAL):
        known_parameters = {"stroke_time": logs.stroke_time[v] if v % 3 else None}
        if logs.tells_sample_time:
            known_parameters["sample_time"] = logs.sample_time[v]
        n = hours * 3600 // TRACE_INTERVAL // stride - abs(logs.late)
        for d in range(days):
            columns_of_log = {name: s[d, v if s.shape[1] > 1 else 0, ::stride] for name, s in logs.signals.items()}
            command = columns_of_log["command"][max(logs.late, 0) :][:n]
            columns_of_log = {name: series[max(-logs.late, 0) :][:n] for name, series in columns_of_log.items()}
            estimate = identify_backlash(
                command, columns_of_log["T_measured"], float(logs.interval[v]),
                columns_of_log["T_set"] if "T_set" in columns else None,
                tuple(columns_of_log[n] for n in columns if n != "T_set"), **known_parameters,
            )  # fmt: skip
            estimates[d, v] = estimate.backlash, estimate.low, estimate.high, estimate.identified
    names = ("backlash", "low", "high", "identified")
    ds = xr.Dataset({n: (("day", "sample"), estimates[..., i]) for i, n in enumerate(names)})
    true = xr.DataArray(logs.backlash, dims="sample")
    least, most = (xr.DataArray(smallest_edge, dims="sample") for smallest_edge in (logs.least, logs.most))
    distance = np.maximum(np.maximum(least - ds.backlash, ds.backlash - most), 0.0)
    ds["right"] = ds.backlash.notnull() & (distance <= np.maximum(SIZE_TOLERANCE * true, GOOD_BACKLASH) + 1e-9)
    ds["covered"] = (ds.low <= most) & (least <= ds.high)
    return ds.assign_coords(true=true)


def share_or_none(holds: xr.DataArray, among: xr.DataArray | None = None) -> str:
    """Format a share with its interval, or "none" without any case."""
    return "none" if among is not None and not bool(among.any()) else share_of(holds, among).to_text(1)


def result_cells(result: LogResult) -> list[str]:
    """Cells of a result: wrong claims first, then the shares."""
    ds = result.estimates
    is_claimed, is_good = ds.identified > 0, (ds.true == 0.0).broadcast_like(ds.right)
    is_accused = (ds.backlash > GOOD_BACKLASH + 1e-9) & is_claimed & is_good
    return [
        result.name, result.columns, f"{result.hours} h",
        f"{int((is_claimed & ~ds.right).sum())} of {int(is_claimed.sum())}", share_or_none(ds.right, is_claimed),
        f"{int(is_accused.sum())} of {int(is_good.sum())}", share_or_none(ds.covered),
        share_or_none(is_claimed), share_or_none(is_claimed, ~is_good), share_or_none(ds.right),
    ]  # fmt: skip


HEAD = ["day", "columns", "length", "wrong claims", "right of what is claimed", "good valves accused",
        "interval covers", "claimed", "claimed of the worn", "right, claimed or not"]  # fmt: skip


def run_populations(
    populations: dict[str, Population], columns: list[str], valves: int, days: int, good_only: bool = False
) -> list[LogResult]:
    """Run the populations; results with the largest share of wrong claims come first."""
    rows = []
    for k, (name, population) in enumerate(populations.items()):
        seeds = [10 * SEED + 5 * good_only + day for day in range(days)]
        population_logs = simulate_logs(population, [SEED, k, int(good_only), valves], seeds, valves, good_only)
        for column_set in columns:
            if column_set == "command, T_sup" and population.kind != STEPPED:
                continue  # a set-point that stands still shows nothing
            rows += [
                LogResult(name, column_set, hours, identify_logs(population_logs, hours, COLUMN_SETS[column_set]))
                for hours in LOG_HOURS
            ]
        print(f"{name}: done", flush=True)
    return sorted(rows, key=lambda row: -row.wrong_share)


def sample() -> None:
    """Compare the rows of the first kind of day, with a set-point."""
    kind, population = next(iter(POPULATIONS_BY_KIND.items()))
    compare_rows(
        "diagnosis/diagnosis", map(result_cells, run_populations({kind: population}, [WITH_SET_POINT], VALVES, DAYS))
    )


def main() -> None:
    """Measure on every kind of day, on other valves, loops and logs, and on good valves, and write the tables."""
    rows = run_populations(POPULATIONS_BY_KIND, list(COLUMN_SETS), VALVES, DAYS)
    title = f"Backlash from trend logs: {VALVES} valves × {DAYS} days of each kind, logged every 10, 15 or 30 s"
    write_table("diagnosis/diagnosis", title, HEAD, map(result_cells, rows))
    rows = run_populations(OTHER_POPULATIONS, [WITH_SET_POINT], OTHER_VALVES, DAYS)
    title = f"Other valves, loops and logs: {OTHER_VALVES} valves × {DAYS} days each"
    write_table("diagnosis/diagnosis_others", title, ["what is other", *HEAD[1:]], map(result_cells, rows))
    rows = run_populations(GOOD_POPULATIONS, [WITH_SET_POINT], N_GOOD_VALVES, GOOD_DAYS, good_only=True)
    stepped = {kind: POPULATIONS_BY_KIND[kind] for kind in (STEPPED, STEPPED_HEATING)}
    rows += run_populations(stepped, ["with air flow and T_in"], N_GOOD_VALVES, GOOD_DAYS, good_only=True)
    accused_rows = [
        [row.name, row.columns, f"{row.hours} h",
         f"{int((is_claimed & is_above_one_percent).sum())} of {row.estimates.right.size}",
         share_or_none(is_claimed & is_above_one_percent), share_or_none(is_claimed & ~is_above_one_percent)]
        for row in rows
        for is_claimed,
        is_above_one_percent in [(row.estimates.identified > 0, row.estimates.backlash > GOOD_BACKLASH + 1e-9)]
    ]  # fmt: skip
    title = f"Good valves: {N_GOOD_VALVES} × {GOOD_DAYS} days each"
    write_table(
        "diagnosis/diagnosis_good",
        title,
        ["day", "columns", "length", "accused", "share", "claimed as good"],
        accused_rows,
    )
