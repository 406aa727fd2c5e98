"""Why does a loop swing?  What a trend log alone shows, against simulations in which the cause is known.

Valves and loops are drawn so that about half of them hunt.  Each is simulated as it is, without its backlash, and, on
days whose water or air swings, without that swing: so it is known whether it hunts, and of what.  The gap is the cause
where the loop swings less than half as much without it.  ``fc.diagnose`` sees the log of the first simulation only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from fastcoil.design.swing_verdict import LEAST_REGULARITY
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from fastcoil.measured.triage import LEAST_HOURLY_SWING_K
from studies.common import HEATING_GAIN, compare_rows, draw_loguniform, write_table
from studies.days import CONSTANT, DESIGN, HEATING, STEPPED, loop_settings, make_days
from studies.diagnosis.diagnosis import share_or_none

SEED, VALVES, DAY_SEED = 7411, 448, 74111
SWINGING = "swinging"
KINDS = (STEPPED, CONSTANT, DESIGN, SWINGING, HEATING)
CAUSES = ("none", "backlash", "tuning", "disturbance")
ANSWERS = (*CAUSES, "unknown")
LOG_INTERVAL = 10  # seconds between the samples of a log
RESTLESS_SHARE = 0.7  # share of the loops that have a large gain and a short integral time
VISIBLE_STD = 0.035  # standard deviation, K, of a swing of 0.1 K from peak to peak


class Logs(NamedTuple):
    """Logs of a kind of day, one per valve, and the truth: (valves,)."""

    logs: list[xr.Dataset]
    cause: list[str]
    backlash: np.ndarray
    stroke_time: np.ndarray


def valves(kind: str, seed: int = SEED, n: int = VALVES) -> dict[str, np.ndarray]:
    """Parameters of the valves and loops of a kind of day: a quarter has no backlash, tunings are calm to restless."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])

    is_restless = rng.uniform(size=n) < RESTLESS_SHARE
    gain = HEATING_GAIN if kind == HEATING else 1.0
    return {
        "backlash": np.where(np.arange(n) % 4 == 0, 0.0, rng.uniform(0.02, 0.15, n)),
        "rangeability": draw_loguniform(rng, 20, 100, n),
        "authority": draw_loguniform(rng, 0.05, 0.9, n),
        "C_w": rng.uniform(8.8, 14.0, n),
        "C_c": draw_loguniform(rng, 10, 30, n),
        "kp": np.where(is_restless, draw_loguniform(rng, 0.03, 0.1, n), draw_loguniform(rng, 0.005, 0.06, n)) * gain,
        "ti": np.where(is_restless, draw_loguniform(rng, 4, 30, n), draw_loguniform(rng, 20, 300, n)),
        "sample_time": rng.choice([5.0, 10.0, 15.0, 30.0], n),
        "noise_std": rng.uniform(0.0, 0.05, n),
        "sensor_time_constant": rng.uniform(5, 60, n),
        "stroke_time": rng.uniform(30, 150, n),
    }


def swinging_days(day: fc.Boundary, seed: int, n: int) -> list[fc.Boundary]:
    """Make days whose water or air swings, as behind a chiller or a mixing damper; one per valve."""
    rng = np.random.default_rng([seed, 21])
    t = np.arange(day.series["T_set"].shape[-1])
    days = []
    for k in range(n):
        name, size = ("T_w_in", rng.uniform(0.5, 2.0)) if k % 2 else ("T_a_in", rng.uniform(0.5, 3.0))
        period = np.exp(rng.uniform(np.log(240), np.log(1500)))
        series = {name: values[0] for name, values in day.series.items() if name not in ("noise", "enabled")}
        series[name] = series[name] + size * np.sin(2 * np.pi * t / period)
        days.append(fc.Boundary(**series))
    return days


def swings_in_logs(ds: xr.Dataset) -> np.ndarray:
    """Swing of each loop, K peak to peak, 0 of those that ``fc.diagnose`` takes for calm or noisy."""
    is_regular = (ds.swing_regularity >= LEAST_REGULARITY) | (ds.hunting_swing >= LEAST_HOURLY_SWING_K)
    return np.asarray(ds.hunting_swing.where((ds.hunts > 0.0) & is_regular, 0.0))


def simulate_logs(
    kind: str, seed: int = SEED, n: int = VALVES, day_seed: int = DAY_SEED, test: fc.ValveTest | None = None
) -> Logs:  # fmt: skip
    """Simulate the valves of a kind, and find out why each swings.  test: a valve test in the log, not in the truth."""
    drawn_parameters = valves(kind, seed, n)
    day = make_days(CONSTANT if kind == SWINGING else kind, [day_seed])
    days = swinging_days(day, seed, n) if kind == SWINGING else [day] * n
    names = ["command", "T_measured", *(["test"] if test else [])]
    traces = {"traces": names, "trace_interval": LOG_INTERVAL, "seed": seed}

    def simulate(
        boundary: fc.Boundary, k: slice, with_traces: bool = False, with_test: bool = False, **changes: object
    ) -> xr.Dataset:
        parameters = {name: ("sample", values[k]) for name, values in drawn_parameters.items()} | changes
        loop = fc.Loop.preset("lbnl").assign(m_full=1.7, estimate_ratio=0.0, **parameters, **loop_settings(kind))
        ds = fc.simulate(
            loop, boundary, test=test if with_test else None, **(traces if with_traces else {"seed": seed})
        )
        return ds.isel(day=0) if "day" in ds.dims else ds

    all_valves = slice(None)
    undisturbed = simulate(day, all_valves, with_traces=True)
    without_gap = simulate(day, all_valves, backlash=0.0)
    if kind == SWINGING:
        disturbed = [simulate(days[k], slice(k, k + 1), with_traces=True).isel(sample=0) for k in range(n)]
    else:
        disturbed = [undisturbed.isel(sample=k) for k in range(n)]
    logged = disturbed
    if test is not None and kind == SWINGING:
        logged = [simulate(days[k], slice(k, k + 1), with_traces=True, with_test=True).isel(sample=0) for k in range(n)]
    elif test is not None:
        tested = simulate(day, all_valves, with_traces=True, with_test=True)
        logged = [tested.isel(sample=k) for k in range(n)]
    causes = []
    for k in range(n):
        swings, swings_without_gap = swings_in_logs(undisturbed)[k], swings_in_logs(without_gap)[k]
        is_forced = kind == SWINGING and VISIBLE_STD < float(
            (disturbed[k].T_measured - undisturbed.T_measured[k]).std()
        )
        is_gap = swings > 2.0 * swings_without_gap
        own_cause = "backlash" if is_gap else "tuning" if max(swings, swings_without_gap) > 0.0 else ""
        causes.append(own_cause or ("disturbance" if is_forced else "none"))
    valve_logs = []
    for ds, boundary in zip(logged, days, strict=True):
        T_set = boundary.series["T_set"][0, ::LOG_INTERVAL]
        log = xr.Dataset({name: ("elapsed_time", ds[name].values.astype(float)) for name in names})
        log["T_set"] = ("elapsed_time", np.asarray(T_set, float))
        log = log.assign_coords(elapsed_time=("elapsed_time", ds.elapsed_time.values, {"units": "s"}))
        for name in log:
            log[name].attrs["units"] = "degC" if str(name).startswith("T_") else "1"
        valve_logs.append(log)
    return Logs(valve_logs, causes, drawn_parameters["backlash"], drawn_parameters["stroke_time"])


class Answer(NamedTuple):
    """Diagnosis of a log, and the truth."""

    kind: str
    true_cause: str
    said_cause: str
    backlash: float
    claimed: bool
    estimate: float

    @property
    def is_right(self) -> bool:
        """Whether the estimate is right, to 20 % of the backlash or 1 % of the stroke."""
        return bool(abs(self.estimate - self.backlash) <= max(SIZE_TOLERANCE * self.backlash, GOOD_BACKLASH) + 1e-9)


def diagnose_logs(kind: str) -> list[Answer]:
    """Diagnose every log of a kind; of every other valve the stroke time is known."""
    logs_of_kind = simulate_logs(kind)
    answers = []
    for k, log in enumerate(logs_of_kind.logs):
        diagnosis = fc.diagnose(log, stroke_time=float(logs_of_kind.stroke_time[k]) if k % 2 else None)
        answers.append(
            Answer(
                kind,
                logs_of_kind.cause[k],
                diagnosis.cause,
                float(logs_of_kind.backlash[k]),
                diagnosis.identified,
                diagnosis.backlash,
            )
        )
    return answers


def share_of_logs(flags: list[bool]) -> str:
    """Format a share of logs with its interval."""
    return share_or_none(xr.DataArray([flags], dims=("day", "sample")).astype(float)) if flags else "none"


def count_answers(kind: str, pairs: Sequence[tuple[str, str]]) -> list[list[str]]:
    """Count the answers by true cause on a kind of day, from pairs of truth and answer."""
    answers_by_cause = {true: [answer for cause, answer in pairs if cause == true] for true in CAUSES}
    return [
        [kind, true, f"{len(said)}", *(f"{said.count(a)}" for a in ANSWERS)]
        for true, said in answers_by_cause.items()
        if said
    ]


def sample() -> None:
    """Run a sample of the study: the first kind of day."""
    compare_rows(
        "diagnosis/diagnosis_cause",
        count_answers(KINDS[0], [(answer.true_cause, answer.said_cause) for answer in diagnose_logs(KINDS[0])]),
    )


def main() -> None:
    """Measure on every kind of day and write the tables."""
    all_answers: list[Answer] = []
    rows = []
    for kind, kind_answers in zip(
        KINDS, Parallel(n_jobs=-1)(delayed(diagnose_logs)(kind) for kind in KINDS), strict=True
    ):
        all_answers += kind_answers
        rows += count_answers(kind, [(answer.true_cause, answer.said_cause) for answer in kind_answers])
    write_table(
        "diagnosis/diagnosis_cause",
        f"Why loops swing: {VALVES} valves on a day of each kind, logged every {LOG_INTERVAL} s; diagnosed cause by "
        "true "
        "cause",
        ["day", "truth", "loops", *ANSWERS],
        rows,
    )
    summary = []
    for cause in ANSWERS:
        n_answered = [answer for answer in all_answers if answer.said_cause == cause]
        right_share = share_of_logs([answer.true_cause == cause for answer in n_answered]) if cause in CAUSES else "–"
        n_caused = [answer for answer in all_answers if answer.true_cause == cause]
        share_found = share_of_logs([answer.said_cause == cause for answer in n_caused]) if cause in CAUSES else "–"
        summary.append([f"cause: {cause}", str(len(n_answered)), right_share, share_found])
    claims = [answer for answer in all_answers if answer.claimed]
    good_valve_answers = [answer for answer in all_answers if answer.backlash == 0.0]
    summary.append(["a backlash", str(len(claims)), share_of_logs([answer.is_right for answer in claims]),
                    share_of_logs([answer.claimed and answer.is_right for answer in all_answers])])  # fmt: skip
    is_accused = [answer.claimed and answer.estimate > GOOD_BACKLASH + 1e-9 for answer in good_valve_answers]
    summary.append(["a backlash above 1 %, of good valves", str(sum(is_accused)), "–", share_of_logs(is_accused)])
    write_table(
        "diagnosis/diagnosis_answers",
        f"{len(all_answers):,} logs, grouped by the cause and the backlash that `diagnose` gives",
        ["answer", "logs", "right of these", "share of the logs of which it is true"],
        summary,
    )
