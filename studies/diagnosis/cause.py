"""Why does a loop swing?  What a trend log alone shows, against simulations in which the cause is known.

Valves and loops are drawn so that about half of them hunt.  Each is
simulated as it is, without its backlash, and, on days whose water or air swings, without that swing: so it is known
whether it hunts, and of what.  ``fc.diagnose`` sees the log of the first simulation only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from studies.common import HEATING_GAIN, compare_rows, loguniform, write_table
from studies.days import CONSTANT, DESIGN, HEATING, STEPPED, of_kind, settings
from studies.diagnosis.diagnosis import share

SEED, VALVES, DAY = 7411, 448, 74111
SWINGING = "swinging"
KINDS = (STEPPED, CONSTANT, DESIGN, SWINGING, HEATING)
CAUSES = ("none", "backlash", "tuning", "disturbance")
ANSWERS = (*CAUSES, "unknown")
LOGGED = 10
"""Seconds."""
RESTLESS = 0.7
"""Share of the loops that have a large gain and a short integral time."""
VISIBLE = 0.035
"""K, standard deviation of a swing of 0.1 K from peak to peak."""


class Logs(NamedTuple):
    """Logs of a kind of day, one a valve, and what is true of them: (valves,)."""

    logs: list[xr.Dataset]
    cause: list[str]
    backlash: np.ndarray
    stroke_time: np.ndarray


def valves(kind: str, seed: int = SEED, n: int = VALVES) -> dict[str, np.ndarray]:
    """Parameters of the valves and loops of a kind of day: a quarter has no backlash, tunings are calm to restless."""
    draw = np.random.default_rng([seed, KINDS.index(kind)])

    restless = draw.uniform(size=n) < RESTLESS
    gain = HEATING_GAIN if kind == HEATING else 1.0
    return {
        "backlash": np.where(np.arange(n) % 4 == 0, 0.0, draw.uniform(0.02, 0.15, n)),
        "rangeability": loguniform(draw, 20, 100, n),
        "authority": loguniform(draw, 0.05, 0.9, n),
        "C_w": draw.uniform(8.8, 14.0, n),
        "C_c": loguniform(draw, 10, 30, n),
        "kp": np.where(restless, loguniform(draw, 0.03, 0.1, n), loguniform(draw, 0.005, 0.06, n)) * gain,
        "ti": np.where(restless, loguniform(draw, 4, 30, n), loguniform(draw, 20, 300, n)),
        "sample_time": draw.choice([5.0, 10.0, 15.0, 30.0], n),
        "noise_std": draw.uniform(0.0, 0.05, n),
        "sensor_time_constant": draw.uniform(5, 60, n),
        "stroke_time": draw.uniform(30, 150, n),
    }


def swinging(day: fc.Boundary, seed: int, n: int) -> list[fc.Boundary]:
    """The day with water or air that swings, as a chiller or a mixing damper makes it; each valve has its own."""
    draw = np.random.default_rng([seed, 21])
    t = np.arange(day.series["T_set"].shape[-1])
    found = []
    for k in range(n):
        name, size = ("T_w_in", draw.uniform(0.5, 2.0)) if k % 2 else ("T_a_in", draw.uniform(0.5, 3.0))
        period = np.exp(draw.uniform(np.log(240), np.log(1500)))
        series = {name: values[0] for name, values in day.series.items() if name not in ("noise", "enabled")}
        series[name] = series[name] + size * np.sin(2 * np.pi * t / period)
        found.append(fc.Boundary(**series))
    return found


def logs(
    kind: str, seed: int = SEED, n: int = VALVES, day_seed: int = DAY, test: fc.ValveTest | None = None
) -> Logs:  # fmt: skip
    """Simulate the valves of a kind, and find out why each swings.  test: a valve test in the log, not in the truth."""
    drawn = valves(kind, seed, n)
    day = of_kind(CONSTANT if kind == SWINGING else kind, [day_seed])
    days = swinging(day, seed, n) if kind == SWINGING else [day] * n
    names = ["command", "T_measured", *(["test"] if test else [])]
    traces = {"traces": names, "trace_interval": LOGGED, "seed": seed}

    def simulated(
        boundary: fc.Boundary, k: slice, traced: bool = False, tested: bool = False, **changes: object
    ) -> xr.Dataset:
        parameters = {name: ("sample", values[k]) for name, values in drawn.items()} | changes
        loop = fc.Loop.preset("lbnl").assign(m_full=1.7, estimate_ratio=0.0, **parameters, **settings(kind))
        ds = fc.simulate(loop, boundary, test=test if tested else None, **(traces if traced else {"seed": seed}))
        return ds.isel(day=0) if "day" in ds.dims else ds

    everyone = slice(None)
    alone = simulated(day, everyone, traced=True)
    without = simulated(day, everyone, backlash=0.0)
    if kind == SWINGING:
        swung = [simulated(days[k], slice(k, k + 1), traced=True).isel(sample=0) for k in range(n)]
    else:
        swung = [alone.isel(sample=k) for k in range(n)]
    seen = swung
    if test is not None and kind == SWINGING:
        seen = [simulated(days[k], slice(k, k + 1), traced=True, tested=True).isel(sample=0) for k in range(n)]
    elif test is not None:
        of_all = simulated(day, everyone, traced=True, tested=True)
        seen = [of_all.isel(sample=k) for k in range(n)]
    cause = []
    for k in range(n):
        itself, good = bool(alone.hunts[k]), bool(without.hunts[k])
        forced = kind == SWINGING and VISIBLE < float((swung[k].T_measured - alone.T_measured[k]).std())
        cause.append("tuning" if good else "backlash" if itself else "disturbance" if forced else "none")
    found = []
    for ds, one in zip(seen, days, strict=True):
        T_set = one.series["T_set"][0, ::LOGGED]
        log = xr.Dataset({name: ("elapsed_time", ds[name].values.astype(float)) for name in names})
        log["T_set"] = ("elapsed_time", np.asarray(T_set, float))
        log = log.assign_coords(elapsed_time=("elapsed_time", ds.elapsed_time.values, {"units": "s"}))
        for name in log:
            log[name].attrs["units"] = "degC" if str(name).startswith("T_") else "1"
        found.append(log)
    return Logs(found, cause, drawn["backlash"], drawn["stroke_time"])


class Answer(NamedTuple):
    """What a diagnosis says of a log, and what is true."""

    kind: str
    true: str
    said: str
    backlash: float
    claimed: bool
    found: float

    @property
    def is_right(self) -> bool:
        """Whether the found backlash is right, to 20 % of itself or 1 % of the stroke."""
        return bool(abs(self.found - self.backlash) <= max(SIZE_TOLERANCE * self.backlash, GOOD_BACKLASH) + 1e-9)


def answers(kind: str) -> list[Answer]:
    """Diagnose every log of a kind; of every other valve the stroke time is known."""
    of = logs(kind)
    found = []
    for k, log in enumerate(of.logs):
        d = fc.diagnose(log, stroke_time=float(of.stroke_time[k]) if k % 2 else None)
        found.append(Answer(kind, of.cause[k], d.cause, float(of.backlash[k]), d.identified, d.backlash))
    return found


def of_logs(flags: list[bool]) -> str:
    """A share of logs with its interval."""
    return share(xr.DataArray([flags], dims=("day", "sample")).astype(float)) if flags else "none"


def counted(kind: str, answered: Sequence[tuple[str, str]]) -> list[list[str]]:
    """A row for each true cause on a kind of day, from pairs of truth and answer."""
    of = {true: [said for truth, said in answered if truth == true] for true in CAUSES}
    return [[kind, true, f"{len(said)}", *(f"{said.count(a)}" for a in ANSWERS)] for true, said in of.items() if said]


def sample() -> None:
    """The first kind of day."""
    compare_rows("diagnosis/diagnosis_cause", counted(KINDS[0], [(one.true, one.said) for one in answers(KINDS[0])]))


def main() -> None:
    """Measure on every kind of day and write the tables."""
    everything: list[Answer] = []
    rows = []
    for kind, found in zip(KINDS, Parallel(n_jobs=-1)(delayed(answers)(kind) for kind in KINDS), strict=True):
        everything += found
        rows += counted(kind, [(one.true, one.said) for one in found])
    write_table(
        "diagnosis/diagnosis_cause",
        f"Why loops swing: {VALVES} valves on a day of each kind, logged every {LOGGED} s; diagnosed cause by true "
        "cause",
        ["day", "truth", "loops", *ANSWERS],
        rows,
    )
    summary = []
    for answer in ANSWERS:
        given = [one for one in everything if one.said == answer]
        right = of_logs([one.true == answer for one in given]) if answer in CAUSES else "–"
        true = [one for one in everything if one.true == answer]
        share = of_logs([one.said == answer for one in true]) if answer in CAUSES else "–"
        summary.append([f"cause: {answer}", str(len(given)), right, share])
    claimed = [one for one in everything if one.claimed]
    good = [one for one in everything if one.backlash == 0.0]
    summary.append(["a backlash", str(len(claimed)), of_logs([one.is_right for one in claimed]),
                    of_logs([one.claimed and one.is_right for one in everything])])  # fmt: skip
    accused = [one.claimed and one.found > GOOD_BACKLASH + 1e-9 for one in good]
    summary.append(["a backlash above 1 %, of good valves", str(sum(accused)), "–", of_logs(accused)])
    write_table(
        "diagnosis/diagnosis_answers",
        f"{len(everything):,} logs, grouped by the cause and the backlash that `diagnose` gives",
        ["answer", "logs", "right of these", "share of the logs of which it is true"],
        summary,
    )
