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
from studies.common import HEATING_GAIN, compare_rows, draw_backlash, draw_loguniform, draw_loop_parameters, write_table
from studies.days import CONSTANT, DESIGN, HEATING, STEPPED, loop_settings, make_days
from studies.diagnosis.diagnosis import share_or_none

SEED, VALVES_SEED, VALVES = 7703, 9107, 128
TRACE_INTERVAL = 5  # seconds between samples of the traces
LOG_INTERVALS = (10, 15, 30)  # seconds between samples of the logs; each valve has one of these
DAYS = range(77031, 77034)
FAST_KP, FAST_TI = (0.01, 0.12), (5.0, 40.0)
"""Of the fast tunings: drawn by their logarithms."""
KINDS_AND_TUNINGS = (
    (STEPPED, False),
    (STEPPED, True),
    (CONSTANT, False),
    (CONSTANT, True),
    (DESIGN, True),
    (HEATING, True),
)
"""Kind of day, and whether the loops are tuned fast.  Calm loops are hardly ever identified on design days."""
ESTIMATE_RATIO = 0.95
BUFFER = 0.01
CHANGES = ("no gap", "half kp", "inverse")
FAR_FACTOR, FAR_KELVIN = 1.2, 0.02
"""A wrong prediction misses the RMSE by more than both, as a factor and in K."""


class SimulatedLoops(NamedTuple):
    """Loops of a kind and their logs: parameters (valves,); signals (days, valves or 1, samples); metrics."""

    parameters: dict[str, np.ndarray]
    signals: dict[str, np.ndarray]
    days: fc.Boundary
    kind: str
    unchanged_metrics: xr.Dataset


def valves(kind: str) -> dict[str, np.ndarray]:
    """Parameters of the valves and loops of a kind of day.

    A quarter has no backlash; of the others half have one of the sizes of ``remedies.toml``, half any size.
    """
    rng = np.random.default_rng([VALVES_SEED, (STEPPED, CONSTANT, DESIGN, HEATING).index(kind)])

    backlash = np.where(np.arange(VALVES) % 4 == 0, 0.0, draw_backlash(rng, VALVES))
    return {"backlash": backlash, **draw_loop_parameters(rng, VALVES, heating=kind == HEATING)}


def loop_parameters(kind: str, is_fast: bool) -> dict[str, np.ndarray]:
    """Parameters of the loops of a kind."""
    parameters = valves(kind)
    if is_fast:
        rng, n = np.random.default_rng([SEED, 1]), parameters["kp"].size
        scale = HEATING_GAIN if kind == HEATING else 1.0
        parameters["kp"] = draw_loguniform(rng, *FAST_KP, n) * scale
        parameters["ti"] = draw_loguniform(rng, *FAST_TI, n)
    return parameters


def simulate(parameters: dict[str, np.ndarray], kind: str, days: fc.Boundary, **changes: object) -> xr.Dataset:
    """Metrics of loops, with some parameters changed; traces too if nothing is."""
    values = (
        {name: ("sample", series) for name, series in parameters.items()}
        | loop_settings(kind)
        | {"backlash_estimate": 0.0}
    )
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **(values | changes))
    traces = [] if changes else ["command", "T_measured"]
    return fc.simulate(loop, days, traces=traces, trace_interval=TRACE_INTERVAL, seed=SEED)


def simulate_kind(kind: str, is_fast: bool) -> SimulatedLoops:
    """Simulate the loops of a kind on its days."""
    parameters, days = loop_parameters(kind, is_fast), make_days(kind, DAYS)
    ds = simulate(parameters, kind, days)
    signals = {
        n: ds[n].transpose("day", "sample", "elapsed_time").values.astype(float) for n in ("command", "T_measured")
    }
    signals["T_set"] = np.asarray(days.series["T_set"], float)[:, np.newaxis, ::TRACE_INTERVAL]
    return SimulatedLoops(parameters, signals, days, kind, ds.drop_vars(["command", "T_measured"]))


def predict_changes(loops: SimulatedLoops) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Backlash identified and whether a loop could be fitted, (days, valves); outcomes (days, valves, 1 + changes).

    Nothing predicted is NaN; an outcome is RMSE, travel and whether it hunts.
    """
    n = loops.parameters["kp"].size
    interval = np.random.default_rng([SEED, 9]).choice(LOG_INTERVALS, n)
    backlash, has_fit = np.full((len(DAYS), n), np.nan), np.zeros((len(DAYS), n), bool)
    outcomes = np.full((len(DAYS), n, 1 + len(CHANGES), 3), np.nan)
    for d in range(len(DAYS)):
        for v, stride in enumerate(interval // TRACE_INTERVAL):
            columns = {
                name: signal[d, v if signal.shape[1] > 1 else 0, ::stride] for name, signal in loops.signals.items()
            }
            stroke = loops.parameters["stroke_time"][v] if v % 3 else None
            log = columns["command"], columns["T_measured"]
            identification = identify_backlash(*log, float(interval[v]), columns["T_set"], stroke_time=stroke)
            if not identification.identified:
                continue
            backlash[d, v] = identification.backlash
            loop = fit_loop_model(*log, columns["T_set"], float(interval[v]), identification.backlash, stroke or 90.0)
            if isinstance(loop, str) or loop.doubt:
                continue
            has_fit[d, v] = True
            predictions = (
                what_if(loop), what_if(loop, backlash=0.0), what_if(loop, kp_factor=0.5),
                what_if(loop, estimate=ESTIMATE_RATIO * identification.backlash, buffer=BUFFER),
            )  # fmt: skip
            for k, prediction in enumerate(predictions):
                if isinstance(prediction, Outcome):
                    outcomes[d, v, k] = prediction.rmse, prediction.travel_per_day, prediction.hunts
    return backlash, has_fit, outcomes


def simulate_changes(loops: SimulatedLoops, backlash: np.ndarray) -> np.ndarray:
    """RMSE, motor travel and hunts as simulated: (days, valves, 1 + changes, 3)."""
    n = loops.parameters["kp"].size
    changes: tuple[dict[str, object], ...] = (
        {"backlash": ("sample", np.zeros(n))},
        {"kp": ("sample", 0.5 * loops.parameters["kp"])},
    )
    runs = [
        loops.unchanged_metrics,
        *(simulate(loops.parameters, loops.kind, loops.days, **change) for change in changes),
    ]
    estimates = np.nan_to_num(ESTIMATE_RATIO * backlash)
    inverse_runs = [
        simulate(loops.parameters, loops.kind, make_days(loops.kind, [day]), backlash_estimate=("sample", estimates[d]),
                 buffer=BUFFER)
        for d, day in enumerate(DAYS)
    ]  # fmt: skip
    values = np.empty((len(DAYS), n, 1 + len(CHANGES), 3))
    for i, name in enumerate(("rmse", "motor_travel", "hunts")):
        for k, run in enumerate(runs):
            values[:, :, k, i] = run[name].transpose("day", "sample").values
        for d, run in enumerate(inverse_runs):
            values[d, :, -1, i] = run[name].squeeze().values
    return values


def change_row(
    kind: str, is_fast: bool, change: int, predictions: tuple[np.ndarray, ...], true: np.ndarray
) -> list[str]:
    """Row of the errors of predicting one change on one kind of day."""
    backlash, _, outcomes = predictions
    is_identified, is_predicted = np.isfinite(backlash), np.isfinite(outcomes[:, :, [0, change], 0]).all(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        error_ratio = (outcomes[:, :, change] / outcomes[:, :, 0]) / (true[:, :, change] / true[:, :, 0])

    kelvin = np.abs(error_ratio[..., 0] - 1.0) * true[:, :, change, 0]
    is_far = (np.abs(np.log(error_ratio[..., 0])) > np.log(FAR_FACTOR)) & (kelvin > FAR_KELVIN)

    def to_data_array(values: np.ndarray) -> xr.DataArray:
        return xr.DataArray(values, dims=("day", "sample"))

    def format_spread(values: np.ndarray) -> str:
        low, middle, high = np.quantile(values[is_predicted & np.isfinite(values)], (0.1, 0.5, 0.9))
        return f"× {middle:.2f} ({low:.2f} to {high:.2f})"

    hunts = outcomes[:, :, change, 2] > 0
    return [
        f"{kind}{', tuned fast' if is_fast else ''}", CHANGES[change - 1],
        share_or_none(to_data_array(hunts != true[:, :, change, 2]), to_data_array(is_predicted)),
        share_or_none(to_data_array(is_far), to_data_array(is_predicted)),
        share_or_none(to_data_array(~is_predicted), to_data_array(is_identified)),
        f"{is_predicted.sum()} of {backlash.size}",
        f"{int(true[:, :, 0, 2][is_predicted].sum())} → {int(true[:, :, change, 2][is_predicted].sum())}",
        format_spread(true[:, :, change, 0] / true[:, :, 0, 0]), format_spread(error_ratio[..., 0]),
        format_spread(error_ratio[..., 1]),
    ]  # fmt: skip


def kind_rows(kind: str, is_fast: bool) -> list[list[str]]:
    """A row for each change, on a kind of day."""
    loops = simulate_kind(kind, is_fast)
    predictions = predict_changes(loops)
    outcomes = simulate_changes(loops, predictions[0])
    return [change_row(kind, is_fast, change, predictions, outcomes) for change in range(1, 1 + len(CHANGES))]


def sample() -> None:
    """Run a sample of the study: the first kind of day."""
    compare_rows("diagnosis/diagnosis_predictions", kind_rows(*KINDS_AND_TUNINGS[0]))


def main() -> None:
    """Measure on every kind of day and write the table."""
    rows = []
    for kind, is_fast in KINDS_AND_TUNINGS:
        rows += kind_rows(kind, is_fast)
        print(*rows[-len(CHANGES) :], sep="\n", flush=True)
    write_table(
        "diagnosis/diagnosis_predictions",
        f"What the loop fitted to an 8-h log predicts: {VALVES} loops × {len(DAYS)} days of each kind",
        ["day", "change", "hunting predicted wrongly", "RMSE off by more than 20 % and 0.02 K", "no prediction",
         "predictions", "hunt: before → after", "RMSE truly", "predicted RMSE against true",
         "predicted travel against true"],
        rows,
    )  # fmt: skip
