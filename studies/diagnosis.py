"""Does a trend log of command and supply temperature tell the backlash?  Measured on valves and days never seen before.

Run with ``python studies/diagnosis.py``.  It simulates valves drawn like those of ``remedies.toml`` on days of every
kind of ``kinds.py``, thins the traces to what a trend log holds, and asks ``fastcoil.diagnosis`` for the backlash.  The
thresholds there were chosen on the valves and days of seed 301; those here share none of them.  Right means: within
20 % of the true backlash or 1 % of the stroke.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from kinds import CONSTANT, DESIGN, HEATING, STEPPED, of_kind, settings
from report import write_table

import fastcoil as fc
from fastcoil.diagnosis.identify import GOOD, TOLERANCE, identify_backlash

SEED, VALVES = 9107, 128
DAYS = range(91071, 91074)
HOURS = (8, 4, 2)
SIMULATED, LOGGED = 5, (10, 15, 30)
"""Seconds: of the traces, and of the logs; each valve has one."""
HEATING_GAIN = 0.3
"""The drawn kp is for cooling; a loop with water of 40 °C responds about three times as much."""
COLUMNS = {
    "command, T_sup, T_set": ("T_set",),
    "command, T_sup": (),
    "with air flow and T_in": ("T_set", "m_a", "T_a_in"),
}
Z = 1.96


class Logs(NamedTuple):
    """Logs of a kind of day: true backlash (valves,); signals (days, valves or 1, samples); s between samples."""

    backlash: np.ndarray
    stroke_time: np.ndarray
    interval: np.ndarray
    signals: dict[str, np.ndarray]


def valves(kind: str) -> dict[str, np.ndarray]:
    """Parameters of the valves and loops of a kind of day.

    A quarter has no backlash; of the others half have one of the sizes of ``remedies.toml``, half any size.
    """
    draw = np.random.default_rng([SEED, (STEPPED, CONSTANT, DESIGN, HEATING).index(kind)])

    def loguniform(low: float, high: float) -> np.ndarray:
        return np.exp(draw.uniform(np.log(low), np.log(high), VALVES))

    sizes = np.where(np.arange(VALVES) % 2, draw.choice([0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15], VALVES),
                     draw.uniform(0.005, 0.15, VALVES))  # fmt: skip
    return {
        "backlash": np.where(np.arange(VALVES) % 4 == 0, 0.0, sizes),
        "rangeability": loguniform(20, 100),
        "authority": loguniform(0.05, 0.9),
        "C_w": draw.uniform(8.8, 14.0, VALVES),
        "C_c": loguniform(10, 30),
        "kp": loguniform(0.005, 0.06) * (HEATING_GAIN if kind == HEATING else 1.0),
        "ti": loguniform(20, 300),
        "sample_time": draw.choice([5.0, 10.0, 15.0, 30.0], VALVES),
        "noise_std": draw.uniform(0.0, 0.05, VALVES),
        "sensor_time_constant": draw.uniform(5, 60, VALVES),
        "stroke_time": draw.uniform(30, 150, VALVES),
    }


def logs(kind: str) -> Logs:
    """Simulate the valves of a kind on its days."""
    drawn = valves(kind)
    parameters = {name: ("sample", values) for name, values in drawn.items()}
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, estimate_ratio=0.0, **parameters, **settings(kind))
    days = of_kind(kind, DAYS)
    ds = fc.simulate(loop, days, traces=["command", "T_measured"], trace_interval=SIMULATED, seed=SEED)
    signals = {
        n: ds[n].transpose("day", "sample", "elapsed_time").values.astype(float) for n in ("command", "T_measured")
    }
    signals |= {n: np.asarray(days.series[n], float)[:, np.newaxis, ::SIMULATED] for n in ("T_set", "m_a", "T_a_in")}
    interval = np.random.default_rng([SEED, 9]).choice(LOGGED, VALVES)
    return Logs(drawn["backlash"], drawn["stroke_time"], interval, signals)


def identified(of: Logs, hours: int, columns: tuple[str, ...]) -> xr.Dataset:
    """What the first hours of every log tell; of two valves in three the stroke time is known."""
    found = np.empty((len(DAYS), VALVES, 4))
    for v, every in enumerate(of.interval // SIMULATED):
        at = slice(0, hours * 3600 // SIMULATED, every)
        for d in range(len(DAYS)):
            seen = {n: s[d, v if s.shape[1] > 1 else 0, at] for n, s in of.signals.items()}
            one = identify_backlash(
                seen["command"], seen["T_measured"], float(of.interval[v]),
                seen["T_set"] if "T_set" in columns else None,
                tuple(seen[n] for n in columns if n != "T_set"), stroke_time=of.stroke_time[v] if v % 3 else None,
            )  # fmt: skip
            found[d, v] = one.backlash, one.low, one.high, one.identified
    names = ("backlash", "low", "high", "identified")
    ds = xr.Dataset({n: (("day", "sample"), found[..., i]) for i, n in enumerate(names)})
    true = xr.DataArray(of.backlash, dims="sample")
    ds["right"] = abs(ds.backlash - true) <= np.maximum(TOLERANCE * true, GOOD) + 1e-9
    ds["covered"] = (ds.low <= true) & (true <= ds.high)
    return ds.assign_coords(true=true)


def share(true: xr.DataArray, of: xr.DataArray | None = None) -> str:
    """A share with its 95 % interval (Wilson) over valves and days.

    Days of a valve are alike, and so are valves of a day: the number of logs is taken as what would have the variance
    that the means of the valves and those of the days show.
    """
    values = true.astype(float) if of is None else true.astype(float).where(of.astype(bool))
    n, p = int(values.count()), float(values.mean())
    if n == 0:
        return "none"
    means = [values.mean(dim).dropna(other) for dim, other in (("day", "sample"), ("sample", "day"))]
    spread = sum(float(m.var(ddof=1)) / m.size for m in means if m.size > 1)
    alike = min(float(n), p * (1 - p) / spread) if spread > 0.0 else float(n)
    middle, half = p + Z**2 / (2 * alike), Z * np.sqrt(p * (1 - p) / alike + Z**2 / (4 * alike**2))
    low, high = (100 * (middle + s * half) / (1 + Z**2 / alike) for s in (-1, 1))
    return f"{100 * p:.1f} % ({low:.1f} to {high:.1f})"


def row(kind: str, name: str, hours: int, ds: xr.Dataset) -> list[str]:
    """Shares of one kind of day, set of columns and length."""
    good = (ds.true == 0.0).broadcast_like(ds.right)
    claimed = ds.identified > 0
    return [
        kind, name, f"{hours} h", share(ds.right), share(claimed), share(ds.right, claimed), share(ds.covered),
        share(ds.backlash > GOOD + 1e-9, good), share((ds.backlash > GOOD + 1e-9) & claimed, good),
    ]  # fmt: skip


def main() -> None:
    """Measure on every kind of day and write the table."""
    rows = []
    for kind in (STEPPED, CONSTANT, DESIGN, HEATING):
        simulated = logs(kind)
        for name, columns in COLUMNS.items():
            if kind != STEPPED and not columns:
                continue  # a set-point that stands still tells nothing
            rows += [row(kind, name, hours, identified(simulated, hours, columns)) for hours in HOURS]
            print(*rows[-len(HOURS) :], sep="\n", flush=True)
    write_table(
        "diagnosis",
        f"Backlash from trend logs: {VALVES} valves × {len(DAYS)} days of each kind, logged every 10, 15 or 30 s",
        ["day", "columns", "length", "right", "identified", "right of these", "interval covers",
         "good valve above 1 %", "good valve accused"],
        rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
