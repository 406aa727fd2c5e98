"""Does the loop fitted to a trend log predict what another valve or controller would do?  Predicted against simulated.

It simulates loops drawn over wide ranges, and loops
 tuned so fast that many hunt, and asks the fitted loop of ``fastcoil.measured.diagnosis`` what each log would have been
without the gap, with half the gain, and with an inverse of 95 % of the size found.  Then it simulates just that.  Only
logs whose backlash is identified are asked.  The thresholds of the fit were chosen on loops of the seeds 501 and 601;
the days here share none with those, and the fast tunings are of a seed of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.measured.fitted_loop import Outcome, fit_loop_model, what_if
from fastcoil.measured.identify import identify_backlash
from studies.common import HEATING_GAIN, compare_rows, drawn_loops, loguniform, mixed_sizes, write_table
from studies.days import CONSTANT, DESIGN, HEATING, STEPPED, of_kind, settings
from studies.diagnosis.diagnosis import share

SEED, VALVES_SEED, VALVES = 7703, 9107, 128
SIMULATED, LOGGED = 5, (10, 15, 30)
"""Seconds: of the traces, and of the logs; each valve has one."""
DAYS = range(77031, 77034)
KP, TI = (0.01, 0.12), (5.0, 40.0)
"""Of the fast tunings: drawn by their logarithms."""
KINDS = ((STEPPED, False), (STEPPED, True), (CONSTANT, False), (CONSTANT, True), (DESIGN, True), (HEATING, True))
"""Kind of day, and whether the loops are tuned fast.  Calm loops are hardly ever identified on design days."""
RATIO, BUFFER = 0.95, 0.01
CHANGES = ("no gap", "half kp", "inverse")
FAR, FAR_KELVIN = 1.2, 0.02
"""A wrong prediction misses the RMSE by more than both, as a factor and in K."""


class Simulated(NamedTuple):
    """Loops of a kind and their logs: parameters (valves,); signals (days, valves or 1, samples); metrics."""

    parameters: dict[str, np.ndarray]
    signals: dict[str, np.ndarray]
    days: fc.Boundary
    kind: str
    as_it_is: xr.Dataset


def valves(kind: str) -> dict[str, np.ndarray]:
    """Parameters of the valves and loops of a kind of day.

    A quarter has no backlash; of the others half have one of the sizes of ``remedies.toml``, half any size.
    """
    draw = np.random.default_rng([VALVES_SEED, (STEPPED, CONSTANT, DESIGN, HEATING).index(kind)])

    backlash = np.where(np.arange(VALVES) % 4 == 0, 0.0, mixed_sizes(draw, VALVES))
    return {"backlash": backlash, **drawn_loops(draw, VALVES, heating=kind == HEATING)}


def drawn(kind: str, fast: bool) -> dict[str, np.ndarray]:
    """Parameters of the loops of a kind."""
    found = valves(kind)
    if fast:
        draw, n = np.random.default_rng([SEED, 1]), found["kp"].size
        scale = HEATING_GAIN if kind == HEATING else 1.0
        found["kp"] = loguniform(draw, *KP, n) * scale
        found["ti"] = loguniform(draw, *TI, n)
    return found


def simulate(of: dict[str, np.ndarray], kind: str, days: fc.Boundary, **changed: object) -> xr.Dataset:
    """Metrics of loops, with some parameters changed; traces too if nothing is."""
    values = {name: ("sample", series) for name, series in of.items()} | settings(kind) | {"backlash_estimate": 0.0}
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **(values | changed))
    traces = [] if changed else ["command", "T_measured"]
    return fc.simulate(loop, days, traces=traces, trace_interval=SIMULATED, seed=SEED)


def simulated(kind: str, fast: bool) -> Simulated:
    """The loops of a kind on its days."""
    parameters, days = drawn(kind, fast), of_kind(kind, DAYS)
    ds = simulate(parameters, kind, days)
    signals = {
        n: ds[n].transpose("day", "sample", "elapsed_time").values.astype(float) for n in ("command", "T_measured")
    }
    signals["T_set"] = np.asarray(days.series["T_set"], float)[:, np.newaxis, ::SIMULATED]
    return Simulated(parameters, signals, days, kind, ds.drop_vars(["command", "T_measured"]))


def predicted(of: Simulated) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Backlash identified and whether a loop could be fitted, (days, valves); outcomes (days, valves, 1 + changes).

    Nothing predicted is NaN; an outcome is RMSE, travel and whether it hunts.
    """
    n = of.parameters["kp"].size
    interval = np.random.default_rng([SEED, 9]).choice(LOGGED, n)
    size, fitted = np.full((len(DAYS), n), np.nan), np.zeros((len(DAYS), n), bool)
    outcomes = np.full((len(DAYS), n, 1 + len(CHANGES), 3), np.nan)
    for d in range(len(DAYS)):
        for v, every in enumerate(interval // SIMULATED):
            seen = {name: signal[d, v if signal.shape[1] > 1 else 0, ::every] for name, signal in of.signals.items()}
            stroke = of.parameters["stroke_time"][v] if v % 3 else None
            log = seen["command"], seen["T_measured"]
            one = identify_backlash(*log, float(interval[v]), seen["T_set"], stroke_time=stroke)
            if not one.identified:
                continue
            size[d, v] = one.backlash
            loop = fit_loop_model(*log, seen["T_set"], float(interval[v]), one.backlash, stroke or 90.0)
            if isinstance(loop, str) or loop.doubt:
                continue
            fitted[d, v] = True
            answers = (
                what_if(loop), what_if(loop, backlash=0.0), what_if(loop, kp_factor=0.5),
                what_if(loop, estimate=RATIO * one.backlash, buffer=BUFFER),
            )  # fmt: skip
            for k, answer in enumerate(answers):
                if isinstance(answer, Outcome):
                    outcomes[d, v, k] = answer.rmse, answer.travel_per_day, answer.hunts
    return size, fitted, outcomes


def truly(of: Simulated, size: np.ndarray) -> np.ndarray:
    """RMSE, motor travel and hunts as simulated: (days, valves, 1 + changes, 3)."""
    n = of.parameters["kp"].size
    changes: tuple[dict[str, object], ...] = (
        {"backlash": ("sample", np.zeros(n))},
        {"kp": ("sample", 0.5 * of.parameters["kp"])},
    )
    runs = [of.as_it_is, *(simulate(of.parameters, of.kind, of.days, **changed) for changed in changes)]
    estimates = np.nan_to_num(RATIO * size)
    inverse = [
        simulate(of.parameters, of.kind, of_kind(of.kind, [day]), backlash_estimate=("sample", estimates[d]),
                 buffer=BUFFER)
        for d, day in enumerate(DAYS)
    ]  # fmt: skip
    found = np.empty((len(DAYS), n, 1 + len(CHANGES), 3))
    for i, name in enumerate(("rmse", "motor_travel", "hunts")):
        for k, run in enumerate(runs):
            found[:, :, k, i] = run[name].transpose("day", "sample").values
        for d, run in enumerate(inverse):
            found[d, :, -1, i] = run[name].squeeze().values
    return found


def row(kind: str, fast: bool, change: int, foreseen: tuple[np.ndarray, ...], true: np.ndarray) -> list[str]:
    """How the predictions of one change on one kind of day miss."""
    size, _, outcomes = foreseen
    asked, answered = np.isfinite(size), np.isfinite(outcomes[:, :, [0, change], 0]).all(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        miss = (outcomes[:, :, change] / outcomes[:, :, 0]) / (true[:, :, change] / true[:, :, 0])

    kelvin = np.abs(miss[..., 0] - 1.0) * true[:, :, change, 0]
    far = (np.abs(np.log(miss[..., 0])) > np.log(FAR)) & (kelvin > FAR_KELVIN)

    def array(values: np.ndarray) -> xr.DataArray:
        return xr.DataArray(values, dims=("day", "sample"))

    def spread(values: np.ndarray) -> str:
        low, middle, high = np.quantile(values[answered & np.isfinite(values)], (0.1, 0.5, 0.9))
        return f"× {middle:.2f} ({low:.2f} to {high:.2f})"

    hunts = outcomes[:, :, change, 2] > 0
    return [
        f"{kind}{', tuned fast' if fast else ''}", CHANGES[change - 1],
        share(array(hunts != true[:, :, change, 2]), array(answered)),
        share(array(far), array(answered)),
        share(array(~answered), array(asked)),
        f"{answered.sum()} of {size.size}",
        f"{int(true[:, :, 0, 2][answered].sum())} → {int(true[:, :, change, 2][answered].sum())}",
        spread(true[:, :, change, 0] / true[:, :, 0, 0]), spread(miss[..., 0]), spread(miss[..., 1]),
    ]  # fmt: skip


def rows_of(kind: str, fast: bool) -> list[list[str]]:
    """A row for each change, on a kind of day."""
    of = simulated(kind, fast)
    foreseen = predicted(of)
    true = truly(of, foreseen[0])
    return [row(kind, fast, change, foreseen, true) for change in range(1, 1 + len(CHANGES))]


def sample() -> None:
    """The first kind of day."""
    compare_rows("diagnosis/diagnosis_predictions", rows_of(*KINDS[0]))


def main() -> None:
    """Measure on every kind of day and write the table."""
    rows = []
    for kind, fast in KINDS:
        rows += rows_of(kind, fast)
        print(*rows[-len(CHANGES) :], sep="\n", flush=True)
    write_table(
        "diagnosis/diagnosis_predictions",
        f"What the loop fitted to an 8-h log predicts: {VALVES} loops × {len(DAYS)} days of each kind",
        ["day", "change", "hunting predicted wrongly", "RMSE off by more than 20 % and 0.02 K", "no prediction",
         "predictions", "hunt: before → after", "RMSE truly", "predicted RMSE against true",
         "predicted travel against true"],
        rows,
    )  # fmt: skip
