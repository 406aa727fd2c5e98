"""The simulations: valves, loops, and buffers around both bounds, on every kind of day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.buffer.rule import ALLOWED_TURNS_PER_HOUR, Plant, largest_buffer, smallest_buffer
from studies.common import draw_loguniform
from studies.days import HEATING, loop_settings, make_days
from studies.robustness.best_pi import LEAST_GAIN, fit_first_order, gains_from_model

BUFFER_MULTIPLES = (0.0, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)  # buffers around the lower bound, as multiples of it
SWINGS = (0.0, 0.05, 0.1, 0.2, 0.4)  # swings by the buffer's own cycle that the upper bound is tried at, K
ALLOWED_SWING = 0.1  # swing that the rules of ``run_rules`` allow, K
NO_BUFFER = 1e-9  # smallest buffer: round-off is no reversal
WIDEST_BUFFER = 0.9
STILL_HOURS = 8  # hours of a day on which nothing changes
SHAKE_SIZE = 0.7  # by how much the set-point of such a day is higher at first, K
SHAKE_END = 5400  # second until which it is higher
COUNTED_FROM = 9000  # second from which such a day counts
ESTIMATE_SHARES = (0.95, 1.0)  # estimates over the backlash: what one may know, and the case of the theory
METRICS = ("rmse", "rmse_settled", "motor_travel", "switch_frequency", "hunting_swing", "hunting_period", "hunts",
           "status")  # fmt: skip
PI, WITHOUT_BUFFER, SHIPPED_RULE, LOWER_BOUND, CAPPED_LOWER_BOUND = (
    "PI",
    "no buffer",
    "by noise, as shipped",
    "lower bound",
    "lower bound, capped",
)
HALF_LOWER_BOUND, TWICE_LOWER_BOUND, UPPER_BOUND, SMALL_BUFFER, WIDE_BUFFER = (
    "half the lower bound",
    "twice the lower bound",
    "upper bound",
    "0.25 %",
    "1 %",
)
SLOWER_PI, BY_TREND = "lower bound, kp halved", "by the trend"
SHIPPED_RATIO = 6.0
RULES = (
    PI,
    WITHOUT_BUFFER,
    SMALL_BUFFER,
    WIDE_BUFFER,
    SHIPPED_RULE,
    BY_TREND,
    HALF_LOWER_BOUND,
    LOWER_BOUND,
    TWICE_LOWER_BOUND,
    UPPER_BOUND,
    CAPPED_LOWER_BOUND,
    SLOWER_PI,
)
"""What stands behind the PI: nothing, or an inverse of 95 % with one of these buffers."""


class Valves(NamedTuple):
    """Valves and loops along ``sample``, and the plant model of each from a step; all arrays are (n_valves,)."""

    loop: fc.Loop
    plant: Plant
    kp: Any
    ti: Any
    sigma: Any
    sample_time: Any
    backlash: Any

    @property
    def lower_bound(self) -> Any:
        """Lower bound of the buffer."""
        return smallest_buffer(self.kp, self.sigma, self.sample_time)

    def upper_bound(self, swing: float) -> Any:
        """Upper bound of the buffer for this swing, K."""
        return np.minimum(largest_buffer(self.plant, self.kp, self.ti, swing), WIDEST_BUFFER)


def population(size: int, seed: int, kind: str) -> Valves:
    """Valves, and loops with gains around those that SIMC gives for this kind of days.

    kp is 0.4 to 2 times and ti 0.4 to 4 times that of SIMC: loops that creep, and loops that ring.
    """
    rng = np.random.default_rng(seed)

    parameters = {
        "backlash": rng.choice([0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15], size),
        "rangeability": draw_loguniform(rng, 20.0, 100.0, size),
        "authority": draw_loguniform(rng, 0.05, 0.9, size),
        "C_w": rng.uniform(8.8, 14.0, size),
        "C_c": draw_loguniform(rng, 10.0, 30.0, size),
        "sample_time": rng.choice([1.0, 2.0, 5.0, 10.0, 15.0, 30.0], size),
        "noise_std": draw_loguniform(rng, 0.005, 0.05, size),
        "sensor_time_constant": rng.uniform(5.0, 60.0, size),
        "stroke_time": rng.uniform(30.0, 150.0, size),
    }
    kp_factor, ti_factor = draw_loguniform(rng, 0.4, 2.0, size), draw_loguniform(rng, 0.4, 4.0, size)
    along_sample: Mapping[str, Any] = {name: ("sample", values) for name, values in parameters.items()}
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **along_sample, **loop_settings(kind))
    model = fit_first_order(loop, kind)
    gains = gains_from_model(model)
    kp, ti, gain = gains.kp.values * kp_factor, gains.ti.values * ti_factor, model.gain.clip(LEAST_GAIN).values
    tuned = loop.assign(kp=("sample", kp), ti=("sample", ti), plant_gain=("sample", gain))
    plant = Plant(gain, model.tau.values, model.theta.values)
    return Valves(tuned, plant, kp, ti, parameters["noise_std"], parameters["sample_time"], parameters["backlash"])


class Runs(NamedTuple):
    """Simulations of valves of one seed: valves by heating or not, metrics by kind of day."""

    valves: dict[bool, Valves]
    lower: dict[str, xr.Dataset]
    still: dict[bool, xr.Dataset]
    upper: dict[str, xr.Dataset]
    rules: dict[str, xr.Dataset]

    def valves_on(self, kind: str) -> Valves:
        """Return the valves that ran on this kind of days."""
        return self.valves[kind == HEATING]


def simulate_metrics(loop: fc.Loop, days: fc.Boundary, **options: Any) -> xr.Dataset:
    """Simulate, and return the metrics that the tables need."""
    return fc.simulate(loop, days, **options)[list(METRICS)].reset_coords(drop=True)


def buffer_parameter(valves: Valves, widths: Any, dim: str) -> xr.DataArray:
    """Convert buffers (n_widths, n_valves) to a parameter."""
    return xr.DataArray(np.clip(widths, NO_BUFFER, WIDEST_BUFFER), dims=(dim, "sample"))


def run_lower(valves: Valves, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Simulate buffers around the lower bound, with and without noise, with an inverse of 95 %."""
    noise_std = xr.DataArray(np.outer([0.0, 1.0], valves.sigma), dims=("noisy", "sample"))
    widths = buffer_parameter(valves, np.outer(BUFFER_MULTIPLES, valves.lower_bound), "size")
    return simulate_metrics(
        valves.loop.assign(estimate_ratio=ESTIMATE_SHARES[0], buffer=widths, noise_std=noise_std),
        make_days(kind, seeds),
    )


def still_day(kind: str) -> fc.Boundary:
    """Make a day on which nothing changes after one step of the set-point, which shakes the loop once."""
    day = make_days(kind, [0])
    constant_series = {
        n: np.full(3600 * STILL_HOURS, float(day.series[n].mean())) for n in ("m_a", "T_a_in", "W_a_in", "T_w_in")
    }
    T_set = np.full(3600 * STILL_HOURS, float(day.series["T_set"].mean()))
    T_set[:SHAKE_END] += SHAKE_SIZE
    return fc.Boundary(**constant_series, T_set=T_set)


def run_still(valves: Valves, kind: str) -> xr.Dataset:
    """Simulate the buffer's cycle alone: no noise, no disturbance, buffers of these swings, both estimates."""
    widths = buffer_parameter(valves, [valves.upper_bound(swing) for swing in SWINGS[1:]], "swing")
    quiet_loop = valves.loop.assign(noise_std=0.0, buffer=widths, estimate_ratio=("share", ESTIMATE_SHARES))
    return simulate_metrics(quiet_loop, still_day(kind), warm_up=COUNTED_FROM)


def run_upper(valves: Valves, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Simulate buffers of these swings on ordinary days, without noise, for both estimates."""
    widths = buffer_parameter(valves, [valves.upper_bound(swing) for swing in SWINGS], "swing")
    quiet_loop = valves.loop.assign(noise_std=0.0, buffer=widths, estimate_ratio=("share", ESTIMATE_SHARES))
    return simulate_metrics(quiet_loop, make_days(kind, seeds))


def trend_range(valves: Valves) -> Any:
    """Peak-to-peak noise on a trend as long as the allowed time between two false turns, K."""
    rng = np.random.default_rng(8)
    samples = np.maximum(np.round(3600.0 / (ALLOWED_TURNS_PER_HOUR * valves.sample_time)), 2).astype(int)
    return valves.sigma * np.array([np.ptp(rng.standard_normal(n)) for n in samples])


def run_rules(valves: Valves, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Simulate every buffer rule with the same gains, days and noise, along ``controller``."""
    lower, upper, n = valves.lower_bound, valves.upper_bound(ALLOWED_SWING), len(valves.kp)
    width = {
        PI: np.full(n, NO_BUFFER),
        WITHOUT_BUFFER: np.full(n, NO_BUFFER),
        SMALL_BUFFER: np.full(n, 0.0025),
        WIDE_BUFFER: np.full(n, 0.01),
        SHIPPED_RULE: np.full(n, NO_BUFFER),
        HALF_LOWER_BOUND: 0.5 * lower,
        LOWER_BOUND: lower,
        TWICE_LOWER_BOUND: 2.0 * lower,
        UPPER_BOUND: upper,
        CAPPED_LOWER_BOUND: np.minimum(lower, upper),
        SLOWER_PI: 0.5 * lower,
        BY_TREND: np.minimum(valves.kp * trend_range(valves), ALLOWED_SWING / valves.plant.gain),
    }
    is_shipped = [rule == SHIPPED_RULE for rule in RULES]
    kp = xr.DataArray(
        np.outer([0.5 if rule == SLOWER_PI else 1.0 for rule in RULES], valves.kp), dims=("controller", "sample")
    )
    loop = valves.loop.assign(
        kp=kp,
        estimate_ratio=("controller", [0.0 if rule == PI else ESTIMATE_SHARES[0] for rule in RULES]),
        buffer=buffer_parameter(valves, [width[rule] for rule in RULES], "controller"),
        buffer_ratio=("controller", np.where(is_shipped, SHIPPED_RATIO, 0.0)),
        buffer_noise=("controller", ["measured" if shipped else "given" for shipped in is_shipped]),
        buffer_swing=("controller", np.where(is_shipped, ALLOWED_SWING, 0.0)),
    )
    return simulate_metrics(loop, make_days(kind, seeds)).assign_coords(controller=list(RULES))
