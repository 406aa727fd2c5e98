"""The simulations: valves, loops, and buffers around both bounds, on every kind of day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.buffer.rule import PER_HOUR, Plant, largest, smallest
from studies.common import loguniform
from studies.days import HEATING, of_kind, settings
from studies.robustness.best_pi import LEAST_GAIN, first_order, gains_of

SIZES = (0.0, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
"""Buffers around the lower bound, as multiples of it."""
SWINGS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Swings by the buffer's own cycle that the upper bound is tried at, K."""
ALLOWED = 0.1
"""Swing that the rules of ``on_rules`` allow, K."""
NONE, WIDEST = 1e-9, 0.9
"""Least buffer, by which round-off is no reversal, and the largest."""
STILL_HOURS, SHAKEN, COUNTED = 8, 5400, 9000
"""Days on which nothing changes: their hours, the second until which the set-point is ``SHAKE`` higher, and the one
from which they count."""
SHAKE = 0.7
SHARES = (0.95, 1.0)
"""Estimates over the backlash: what one may know, and the case of the theory."""
METRICS = ("rmse", "rmse_settled", "motor_travel", "switch_frequency", "hunting_swing", "hunting_period", "hunts",
           "status")  # fmt: skip
PI, WITHOUT, SHIPPED, LOWER, BOUNDED = "PI", "no buffer", "by noise, as shipped", "lower bound", "lower bound, capped"
HALF, TWICE, UPPER, SMALL, WIDE = "half the lower bound", "twice the lower bound", "upper bound", "0.25 %", "1 %"
SLOWER, BY_TREND = "lower bound, kp halved", "by the trend"
SHIPPED_RATIO = 6.0
RULES = (PI, WITHOUT, SMALL, WIDE, SHIPPED, BY_TREND, HALF, LOWER, TWICE, UPPER, BOUNDED, SLOWER)
"""What stands behind the PI: nothing, or an inverse of 95 % with one of these buffers."""


class Valves(NamedTuple):
    """Valves and loops along ``sample``, and what their step says of their plants; all arrays are (n_valves,)."""

    loop: fc.Loop
    plant: Plant
    kp: Any
    ti: Any
    sigma: Any
    sample_time: Any
    backlash: Any

    @property
    def lower(self) -> Any:
        """Lower bound of the buffer."""
        return smallest(self.kp, self.sigma, self.sample_time)

    def upper(self, swing: float) -> Any:
        """Upper bound of the buffer for this swing, K."""
        return np.minimum(largest(self.plant, self.kp, self.ti, swing), WIDEST)


def population(size: int, seed: int, kind: str) -> Valves:
    """Valves, and loops with gains around those that SIMC gives for this kind of days.

    kp is 0.4 to 2 times and ti 0.4 to 4 times that of SIMC: loops that creep, and loops that ring.
    """
    rng = np.random.default_rng(seed)

    drawn = {
        "backlash": rng.choice([0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15], size),
        "rangeability": loguniform(rng, 20.0, 100.0, size),
        "authority": loguniform(rng, 0.05, 0.9, size),
        "C_w": rng.uniform(8.8, 14.0, size),
        "C_c": loguniform(rng, 10.0, 30.0, size),
        "sample_time": rng.choice([1.0, 2.0, 5.0, 10.0, 15.0, 30.0], size),
        "noise_std": loguniform(rng, 0.005, 0.05, size),
        "sensor_time_constant": rng.uniform(5.0, 60.0, size),
        "stroke_time": rng.uniform(30.0, 150.0, size),
    }
    kp_factor, ti_factor = loguniform(rng, 0.4, 2.0, size), loguniform(rng, 0.4, 4.0, size)
    given: Mapping[str, Any] = {name: ("sample", values) for name, values in drawn.items()}
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **given, **settings(kind))
    model = first_order(loop, kind)
    gains = gains_of(model)
    kp, ti, gain = gains.kp.values * kp_factor, gains.ti.values * ti_factor, model.gain.clip(LEAST_GAIN).values
    tuned = loop.assign(kp=("sample", kp), ti=("sample", ti), plant_gain=("sample", gain))
    plant = Plant(gain, model.tau.values, model.theta.values)
    return Valves(tuned, plant, kp, ti, drawn["noise_std"], drawn["sample_time"], drawn["backlash"])


class Runs(NamedTuple):
    """All that ran on valves of one seed: valves by heating or not, metrics by kind of day."""

    valves: dict[bool, Valves]
    lower: dict[str, xr.Dataset]
    still: dict[bool, xr.Dataset]
    upper: dict[str, xr.Dataset]
    rules: dict[str, xr.Dataset]

    def of(self, kind: str) -> Valves:
        """The valves that ran on this kind of days."""
        return self.valves[kind == HEATING]


def of_metrics(loop: fc.Loop, days: fc.Boundary, **options: Any) -> xr.Dataset:
    """The metrics that the tables need."""
    return fc.simulate(loop, days, **options)[list(METRICS)].reset_coords(drop=True)


def buffers(valves: Valves, widths: Any, dim: str) -> xr.DataArray:
    """Buffers (n_widths, n_valves) as a parameter."""
    return xr.DataArray(np.clip(widths, NONE, WIDEST), dims=(dim, "sample"))


def on_lower(valves: Valves, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Buffers around the lower bound, with the noise and without it, an inverse of 95 %."""
    noise = xr.DataArray(np.outer([0.0, 1.0], valves.sigma), dims=("noisy", "sample"))
    widths = buffers(valves, np.outer(SIZES, valves.lower), "size")
    return of_metrics(
        valves.loop.assign(estimate_ratio=SHARES[0], buffer=widths, noise_std=noise), of_kind(kind, seeds)
    )


def still(kind: str) -> fc.Boundary:
    """A day on which nothing changes after one step of the set-point, which shakes the loop once."""
    day = of_kind(kind, [0])
    held = {n: np.full(3600 * STILL_HOURS, float(day.series[n].mean())) for n in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    T_set = np.full(3600 * STILL_HOURS, float(day.series["T_set"].mean()))
    T_set[:SHAKEN] += SHAKE
    return fc.Boundary(**held, T_set=T_set)


def on_still(valves: Valves, kind: str) -> xr.Dataset:
    """The buffer's cycle alone: no noise, no disturbance, buffers of these swings, both estimates."""
    widths = buffers(valves, [valves.upper(swing) for swing in SWINGS[1:]], "swing")
    quiet = valves.loop.assign(noise_std=0.0, buffer=widths, estimate_ratio=("share", SHARES))
    return of_metrics(quiet, still(kind), warm_up=COUNTED)


def on_upper(valves: Valves, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Buffers of these swings on days as they are, without noise, both estimates."""
    widths = buffers(valves, [valves.upper(swing) for swing in SWINGS], "swing")
    quiet = valves.loop.assign(noise_std=0.0, buffer=widths, estimate_ratio=("share", SHARES))
    return of_metrics(quiet, of_kind(kind, seeds))


def seen_range(valves: Valves) -> Any:
    """Peak to peak of the noise on one trend of as long as one false turn is to take, K."""
    rng = np.random.default_rng(8)
    samples = np.maximum(np.round(3600.0 / (PER_HOUR * valves.sample_time)), 2).astype(int)
    return valves.sigma * np.array([np.ptp(rng.standard_normal(n)) for n in samples])


def on_rules(valves: Valves, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Every rule for the buffer behind the same gains on the same days with the same noise, along ``controller``."""
    lower, upper, n = valves.lower, valves.upper(ALLOWED), len(valves.kp)
    width = {
        PI: np.full(n, NONE),
        WITHOUT: np.full(n, NONE),
        SMALL: np.full(n, 0.0025),
        WIDE: np.full(n, 0.01),
        SHIPPED: np.full(n, NONE),
        HALF: 0.5 * lower,
        LOWER: lower,
        TWICE: 2.0 * lower,
        UPPER: upper,
        BOUNDED: np.minimum(lower, upper),
        SLOWER: 0.5 * lower,
        BY_TREND: np.minimum(valves.kp * seen_range(valves), ALLOWED / valves.plant.gain),
    }
    is_shipped = [rule == SHIPPED for rule in RULES]
    kp = xr.DataArray(
        np.outer([0.5 if rule == SLOWER else 1.0 for rule in RULES], valves.kp), dims=("controller", "sample")
    )
    loop = valves.loop.assign(
        kp=kp,
        estimate_ratio=("controller", [0.0 if rule == PI else SHARES[0] for rule in RULES]),
        buffer=buffers(valves, [width[rule] for rule in RULES], "controller"),
        buffer_ratio=("controller", np.where(is_shipped, SHIPPED_RATIO, 0.0)),
        buffer_noise=("controller", ["measured" if shipped else "given" for shipped in is_shipped]),
        buffer_swing=("controller", np.where(is_shipped, ALLOWED, 0.0)),
    )
    return of_metrics(loop, of_kind(kind, seeds)).assign_coords(controller=list(RULES))
