"""The metrics of a run, accumulated in the loop: one number per scenario and metric, no traces needed.

``make_schedule`` flags, before the loop runs, which seconds of the day count, are settled, or start or end a block.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model import hunting, metric_table
from fastcoil.model.engine.rows import LANES, T_A, T_C, T_W, VOLUME_STRIDE, W_A, R, name_offsets
from fastcoil.model.numerics.jit import scalar, section
from fastcoil.model.physics import LEAST_WATER_FLOW_KG_S, humidity_ratio, saturation_pressure_frost

disturbance_change, next_extreme, is_same_period = (
    scalar(step) for step in (hunting.disturbance_change, hunting.next_extreme, hunting.is_same_period)
)
IS_COUNTED = 1
IS_SETTLED = 2
WINDOW_STARTS = 4
WINDOW_ENDS = 8
IN_SWITCH_BLOCK = 16
IN_PEAK_BLOCK = 32
PEAK_BLOCK_ENDS = 64
IN_ESTIMATE_WINDOW = 128
IS_SWING_SAMPLE = 256
SWING_STARTS = 512
IN_SWING_BLOCK = 1024
SWING_BLOCK_ENDS = 2048


class DayHistory(NamedTuple):
    """Set-point, °C, and state of a loop before a day; disturbed_at: second, ≤ 0, of its last step or start."""

    T_set: float = np.nan
    enabled: bool = True
    disturbed_at: int = 0


NO_HISTORY = DayHistory()


class Schedule(NamedTuple):
    """Seconds of a day that the metrics use: flags, (n_steps,), sums of the constants above, and counts of them."""

    flags: np.ndarray
    n_counted: int
    n_settled: int
    n_windows: int
    n_switch_blocks: int
    n_peak_blocks: int
    n_estimate: int
    n_swing_blocks: int


def last_disturbance(T_set: np.ndarray, enabled: np.ndarray, history: DayHistory) -> np.ndarray:
    """Second of the last step of the set-point or start of the loop, at every second of a day, (n_steps,)."""
    steps = np.abs(np.diff(T_set, prepend=history.T_set)) > metric_table.SET_POINT_STEP_K
    starts = (enabled != 0.0) & ~np.concatenate([[history.enabled], enabled[:-1] != 0.0])
    return np.maximum.accumulate(np.where(steps | starts, np.arange(T_set.size), history.disturbed_at))


def history_after(T_set: np.ndarray, enabled: np.ndarray, history: DayHistory = NO_HISTORY) -> DayHistory:
    """History of the day that follows a day."""
    disturbed_at = int(last_disturbance(T_set, enabled, history)[-1])
    return DayHistory(float(T_set[-1]), bool(enabled[-1] != 0.0), disturbed_at - T_set.size)


def is_in_whole_block(counted: np.ndarray, warm_up: int, length: int) -> np.ndarray:
    """Flag the seconds of the blocks of ``length`` s, aligned at ``warm_up``, that are counted throughout."""
    inside = np.zeros(counted.size, bool)
    n_blocks = max((counted.size - warm_up) // length, 0)
    is_whole = counted[warm_up : warm_up + n_blocks * length].reshape(n_blocks, length).all(axis=1)
    inside[warm_up : warm_up + n_blocks * length] = np.repeat(is_whole, length)
    return inside


def flag_swing_samples(has_lead: np.ndarray, settled: np.ndarray) -> tuple[np.ndarray, int]:
    """Flag the samples of the swing, (n_steps,), and count its blocks, which begin with each settled window."""
    step, flags = hunting.SWING_SAMPLE_S, np.zeros(settled.size, np.int64)
    is_sample, is_settled = has_lead[::step], settled[::step]
    starts, window_starts = (part & ~np.concatenate([[False], part[:-1]]) for part in (is_sample, is_settled))
    k = np.arange(is_sample.size)
    since_start = k - np.maximum.accumulate(np.where(window_starts, k, 0))
    block = np.cumsum(is_settled & (since_start % (hunting.SWING_BLOCK_S // step) == 0)) * is_settled
    in_block = is_settled & (np.bincount(block) >= hunting.LEAST_SWING_BLOCK_S // step)[block]
    ends = in_block & (np.diff(block, append=0) != 0)
    flags[::step] = (
        IS_SWING_SAMPLE * is_sample + SWING_STARTS * starts + IN_SWING_BLOCK * in_block + SWING_BLOCK_ENDS * ends
    )
    return flags, int(ends.sum())


def make_schedule(T_set: np.ndarray, enabled: np.ndarray, warm_up: int, history: DayHistory = NO_HISTORY) -> Schedule:
    """Flag every second of a day.  T_set, °C, and enabled, 0/1: (n_steps,); warm_up: s."""
    t = np.arange(T_set.size)
    counted = (t >= warm_up) & (enabled != 0.0)
    since_disturbance = t - last_disturbance(T_set, enabled, history)
    settled = counted & (since_disturbance >= metric_table.SETTLING_TIME_S)
    starts = settled & ~np.concatenate([[False], settled[:-1]])
    ends = settled & ~np.concatenate([settled[1:], [False]])
    in_switch_block = is_in_whole_block(counted, warm_up, metric_table.SWITCH_BLOCK_S)
    in_peak_block = is_in_whole_block(counted, warm_up, metric_table.PEAK_BLOCK_S)
    peak_ends = in_peak_block & ((t - warm_up) % metric_table.PEAK_BLOCK_S == metric_table.PEAK_BLOCK_S - 1)
    in_estimate = counted & (t >= T_set.size - metric_table.ESTIMATE_WINDOW_S)
    has_lead = (enabled != 0.0) & (t >= warm_up - hunting.SWING_LEAD_S)
    has_lead &= since_disturbance >= metric_table.SETTLING_TIME_S - hunting.SWING_LEAD_S
    swing_flags, n_swing_blocks = flag_swing_samples(has_lead, settled)
    flags = (
        IS_COUNTED * counted + IS_SETTLED * settled + WINDOW_STARTS * starts + WINDOW_ENDS * ends
        + IN_SWITCH_BLOCK * in_switch_block + IN_PEAK_BLOCK * in_peak_block + PEAK_BLOCK_ENDS * peak_ends
        + IN_ESTIMATE_WINDOW * in_estimate + swing_flags
    )  # fmt: skip
    n_switch_blocks = in_switch_block.sum() // metric_table.SWITCH_BLOCK_S
    numbers = (counted.sum(), settled.sum(), starts.sum(), n_switch_blocks, peak_ends.sum(), in_estimate.sum())
    return Schedule(flags.astype(np.int64), *map(int, (*numbers, n_swing_blocks)))


N_METRICS = len(metric_table.METRICS)
M = name_offsets(metric_table.METRICS)
"""Row of each metric in the kernel's output."""
ESTIMATOR_METRICS = (
    "learn_time_first_down", "estimate_first_down", "learning_status", "half_periods", "half_period_spread",
)  # fmt: skip
"""Metrics of a single kind of estimator, see ``Estimator.results``."""

WATCH_INTERVAL_S = 60
"""Seconds between checks of range and frost: a temperature that leaves its range does not return, and frost lasts."""
MIN_STEM_MOVE = 1e-9
"""Change of opening, fraction, that counts as a movement of the stem: above round-off."""
T_RANGE = (-50.0, 150.0)
"""Temperatures outside, °C, are out of range."""


@section
def accumulate_travel(S, j, d_opening, d_position):
    """Add one second's movements of lane j, fractions of stroke, to stem and motor travel and reversals."""
    S[R.stem_travel + j] += abs(d_opening)
    S[R.motor_travel + j] += abs(d_position)
    moved = abs(d_opening) > MIN_STEM_MOVE
    direction = 1.0 if d_opening > 0.0 else -1.0
    S[R.reversals + j] += 1.0 if moved and direction * S[R.last_turn + j] < 0.0 else 0.0
    S[R.last_turn + j] = direction if moved else S[R.last_turn + j]


@section
def accumulate_second(S, V, controlled, flags, T_set, T_w_in, m_a, n_volumes):
    """Add one counted second to control error, hunting and energy; controlled: (LANES,), °C, of air or room."""
    last = V[n_volumes * VOLUME_STRIDE :]
    for j in range(LANES):
        e = controlled[j] - T_set
        S[R.sum_e2 + j] += e * e
        S[R.sum_abs_e + j] += abs(e)
        S[R.seconds_off + j] += 1.0 if abs(e) > metric_table.OFF_SET_POINT_ERROR_K else 0.0
        S[R.reheat + j] += m_a * (e if e < 0.0 else 0.0)
        S[R.recool + j] += m_a * (e if e > 0.0 else 0.0)
        S[R.sum_m_w + j] += S[R.m_w + j]
        S[R.power + j] = S[R.sign + j] * (S[R.C_flow + j] * (last[T_W + j] - T_w_in))
        S[R.sum_power + j] += S[R.power + j]
    if flags & WINDOW_STARTS:
        for j in range(LANES):
            S[R.T_set_from + j] = T_set
            S[R.highest + j] = controlled[j]
            S[R.lowest + j] = controlled[j]
    if flags & IS_SETTLED:
        for j in range(LANES):
            e = controlled[j] - T_set
            T = controlled[j] - (T_set - S[R.T_set_from + j])
            S[R.sum_e2_settled + j] += e * e
            S[R.highest + j] = T if T > S[R.highest + j] else S[R.highest + j]
            S[R.lowest + j] = T if T < S[R.lowest + j] else S[R.lowest + j]
    if flags & WINDOW_ENDS:
        for j in range(LANES):
            S[R.sum_range + j] += S[R.highest + j] - S[R.lowest + j]
    if flags & IN_PEAK_BLOCK:
        for j in range(LANES):
            S[R.sum_power_block + j] += S[R.power + j]
    if flags & PEAK_BLOCK_ENDS:
        for j in range(LANES):
            mean = S[R.sum_power_block + j] / metric_table.PEAK_BLOCK_S
            S[R.peak_power + j] = mean if mean > S[R.peak_power + j] else S[R.peak_power + j]
            S[R.sum_power_block + j] = 0.0
    if flags & IN_ESTIMATE_WINDOW:
        for j in range(LANES):
            S[R.sum_estimate + j] += S[R.estimate + j]


@section
def watch_swing(S, V, t, flags, before, now, block):
    """Follow the swing, its periods, and the disturbances that may explain it; add to ``block``, see ``hunting``."""
    if flags & SWING_STARTS:
        before = now
        S[R.turned_up_at : R.d_mean] = np.nan
        S[R.d : R.direction] = 0.0
        S[R.direction : R.g] = 1.0
        S[R.g : R.h] = 0.0
    lag_weight = hunting.SWING_SAMPLE_S / (hunting.SWING_SAMPLE_S + hunting.COIL_LAG_S)
    first = V[VOLUME_STRIDE:]
    for j in range(LANES):
        weight = S[R.mean_weight + j]
        S[R.mean_weight + j] = max(weight / (1.0 + weight), hunting.SWING_SAMPLE_S / hunting.SWING_MEAN_S)
        error = first[T_A + j] - now[4]
        S[R.error_mean + j] += weight * (error - S[R.error_mean + j])
        S[R.h + j] = error - S[R.error_mean + j]
        S[R.d + j] += disturbance_change(first[T_A + j], first[W_A + j], now, before)
        S[R.d_mean + j] += weight * (S[R.d + j] - S[R.d_mean + j])
        S[R.g + j] = S[R.d + j] - S[R.d_mean + j]
        S[R.g_lagged + j] += lag_weight * (S[R.g + j] - S[R.g_lagged + j])
        S[R.g_lagged_twice + j] += lag_weight * (S[R.g_lagged + j] - S[R.g_lagged_twice + j])
    is_inside = flags & IN_SWING_BLOCK != 0
    for j in range(LANES):
        extreme, direction, turned = next_extreme(S[R.h + j], S[R.extreme + j], S[R.direction + j])
        S[R.extreme + j] = extreme
        S[R.direction + j] = direction
        turned_up = turned & (direction > 0.0)
        period, last_period = t - S[R.turned_up_at + j], S[R.last_period + j]
        is_whole = turned_up & (period > 0.0) & is_inside  # not at the first turn of a window
        is_same = is_whole & is_same_period(period, last_period, S[R.sample_time + j])
        S[R.periods + j] += 1.0 if is_whole else 0.0
        S[R.same_periods + j] += 1.0 if is_same else 0.0
        S[R.sum_periods + j] += period if is_whole else 0.0
        S[R.last_period + j] = period if is_whole else last_period
        S[R.turned_up_at + j] = t if turned_up else S[R.turned_up_at + j]
    if is_inside:
        for k in range(hunting.SWING_SIGNALS):
            for i in range(k + 1):  # the products are symmetric
                one, other = S[R.unit + k * LANES :], S[R.unit + i * LANES :]
                products = block[k * hunting.SWING_SIGNALS + i]
                for j in range(LANES):
                    products[j] += one[j] * other[j]
        highest, lowest = block[hunting.N_SWING_ROWS - 2], block[hunting.N_SWING_ROWS - 1]
        for j in range(LANES):
            h = S[R.h + j]
            highest[j] = h if h > highest[j] else highest[j]
            lowest[j] = h if h < lowest[j] else lowest[j]


@section
def track_metal_extremes(S, V, n_volumes):
    """Update the largest distance of the metal, the extreme of all temperatures, from the middle of T_RANGE."""
    for i in range(1, n_volumes + 1):
        cv = V[i * VOLUME_STRIDE :]
        for j in range(LANES):
            deviation = abs(cv[T_C + j] - 0.5 * (T_RANGE[0] + T_RANGE[1]))
            S[R.farthest_T_c + j] = deviation if deviation > S[R.farthest_T_c + j] else S[R.farthest_T_c + j]


@section
def accumulate_frost(S, V, n_volumes, seconds):
    """Add the seconds since the last check to the lanes in which water freezes on the metal or in the tubes."""
    for j in range(LANES):
        S[R.coldest_wet + j] = np.inf
        S[R.coldest_water + j] = np.inf
    for i in range(1, n_volumes + 1):
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            T_c = pair[T_C + j]
            W_ice = humidity_ratio(saturation_pressure_frost(T_c), S[R.pressure + j])
            T_wet = T_c if pair[VOLUME_STRIDE + W_A + j] > W_ice else np.inf
            T_water = pair[T_W + j] if S[R.m_w + j] > LEAST_WATER_FLOW_KG_S else T_c
            S[R.coldest_wet + j] = T_wet if T_wet < S[R.coldest_wet + j] else S[R.coldest_wet + j]
            S[R.coldest_water + j] = T_water if T_water < S[R.coldest_water + j] else S[R.coldest_water + j]
    for j in range(LANES):
        S[R.frost_time + j] += seconds if S[R.coldest_wet + j] < 0.0 else 0.0
        S[R.freeze_time + j] += seconds if S[R.coldest_water + j] <= 0.0 else 0.0


@scalar
def lane_status(S, V, j, n_volumes):
    """Return the status of a lane.  A lane that was once inf or NaN never becomes finite again."""
    total = S[R.sum_e2 + j] + S[R.sum_power + j] + S[R.opening + j] + S[R.command + j]
    # NaN in an open loop
    total += 0.0 if S[R.mode + j] == 0.0 else S[R.integral + j] + S[R.u + j] + S[R.estimate + j]
    for i in range(1, n_volumes + 1):
        v = i * VOLUME_STRIDE + j
        total += V[v + T_W] + V[v + T_C] + V[v + T_A] + V[v + W_A]
    if not np.isfinite(total):
        return metric_table.STATUS_NON_FINITE
    is_out_of_range = S[R.farthest_T_c + j] > 0.5 * (T_RANGE[1] - T_RANGE[0])
    return metric_table.STATUS_OUT_OF_RANGE if is_out_of_range else metric_table.STATUS_OK


@section
def summarise(S, V, n_volumes, schedule, metrics, status):
    """Fill ``metrics``, (N_METRICS, LANES), NaN in failed lanes, and ``status``, (LANES,), at the end of a run."""
    seconds, settled, blocks = schedule.n_counted, schedule.n_settled, schedule.n_switch_blocks
    for j in range(LANES):
        status[j] = lane_status(S, V, j, n_volumes)
        m = metrics[:, j]
        m[M.rmse] = np.sqrt(S[R.sum_e2 + j] / seconds)
        m[M.rmse_settled] = np.sqrt(S[R.sum_e2_settled + j] / settled)
        m[M.iae] = S[R.sum_abs_e + j] / 3600.0
        m[M.share_off] = S[R.seconds_off + j] / seconds
        m[M.settled_range] = S[R.sum_range + j] / schedule.n_windows
        n_periods = S[R.periods + j]
        m[M.hunting_period] = S[R.sum_periods + j] / n_periods if n_periods > 0.0 else np.nan
        m[M.swing_regularity] = S[R.same_periods + j] / (n_periods - 1.0) if n_periods > 1.0 else np.nan
        m[M.switch_frequency] = S[R.sum_switches + j] / blocks
        m[M.stem_travel] = S[R.stem_travel + j]
        m[M.motor_travel] = S[R.motor_travel + j]
        m[M.reversals] = S[R.reversals + j]
        m[M.estimate_final] = S[R.estimate + j]
        largest = S[R.largest_estimate + j]  # 0 without an estimator
        m[M.estimate_largest] = largest if largest > S[R.estimate + j] else S[R.estimate + j]
        m[M.estimate_settled] = S[R.sum_estimate + j] / schedule.n_estimate
        has_estimate = S[R.estimator + j] > 0.0 or S[R.backlash_estimate + j] > 0.0
        m[M.size_error] = m[M.estimate_settled] - S[R.gap + j] if has_estimate else np.nan
        m[M.backlash_final] = S[R.gap + j]
        m[M.learn_time_reached] = S[R.time_reached + j]
        m[M.learn_time_confirmed] = S[R.time_confirmed + j]
        m[M.time_identified] = S[R.time_identified + j]
        m[M.test_aborted] = S[R.test_aborted + j]
        m[M.coil_energy] = S[R.sum_power + j] / 3600.0
        m[M.coil_peak_power] = S[R.peak_power + j] if schedule.n_peak_blocks > 0 else np.nan
        m[M.reheat_energy] = -S[R.reheat + j] * S[R.cp_a + j] / 3600.0
        m[M.recool_energy] = S[R.recool + j] * S[R.cp_a + j] / 3600.0
        m[M.water_volume] = S[R.sum_m_w + j] / 1000.0  # m3 from kg
        m[M.condensate] = S[R.condensate + j]
        m[M.frost_time] = S[R.frost_time + j]
        m[M.freeze_time] = S[R.freeze_time + j]
        if status[j] != metric_table.STATUS_OK:
            m[:] = np.nan
