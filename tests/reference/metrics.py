"""The metrics, from the whole recorded run."""

import math
from itertools import pairwise

METRICS = (
    "rmse", "rmse_settled", "iae", "share_off", "settled_range", "hunting_swing", "hunting_period",
    "swing_regularity", "hunts", "stem_travel", "motor_travel", "reversals", "switch_frequency", "estimate_final",
    "estimate_largest", "estimate_settled", "size_error", "backlash_final", "learn_time_reached",
    "learn_time_confirmed", "time_identified", "learn_time_first_down", "estimate_first_down", "learning_status",
    "half_periods", "half_period_spread", "test_aborted", "coil_energy", "coil_peak_power", "reheat_energy",
    "recool_energy", "water_volume", "condensate", "frost_time", "freeze_time",
)  # fmt: skip

SETTLING_TIME = 600  # s since the last step of the set-point or start of the loop
SET_POINT_STEP = 0.05  # K
SWITCH_BLOCK = 600  # s
PEAK_BLOCK = 900  # s
ESTIMATE_WINDOW = 7200  # s
OFF_THRESHOLD_K = 0.5  # K
FROST_INTERVAL_S = 60  # s between looks for frost and ice
MOVEMENT_THRESHOLD = 1e-9  # strokes


def seconds_since_disturbance(T_set, enabled):
    """Seconds since the last step of the set point [degC] or start of the loop, for every second."""
    since, last_change = [], 0
    for t, T in enumerate(T_set):
        if t > 0 and (abs(T - T_set[t - 1]) > SET_POINT_STEP or (enabled[t] and not enabled[t - 1])):
            last_change = t
        since.append(t - last_change)
    return since


def tracking_metrics(T_sup, T_set, counted, since):
    """Tracking of the set point [degC] by the true supply temperature [degC], over counted seconds."""
    n_steps = len(T_sup)
    error = [T_sup[t] - T_set[t] for t in range(n_steps)]
    settled = [counted[t] and since[t] >= SETTLING_TIME for t in range(n_steps)]
    ranges = []
    for start, stop in true_runs(settled):
        shifted = [T_sup[t] - (T_set[t] - T_set[start]) for t in range(start, stop)]
        ranges.append(max(shifted) - min(shifted))
    return {
        "rmse": math.sqrt(mean([e * e for e in select_flagged(error, counted)])),
        "rmse_settled": math.sqrt(mean([e * e for e in select_flagged(error, settled)])),
        "iae": math.fsum(abs(e) for e in select_flagged(error, counted)) / 3600.0,
        "share_off": mean([float(abs(e) > OFF_THRESHOLD_K) for e in select_flagged(error, counted)]),
        "settled_range": mean(ranges),
    }


def movement_metrics(opening, position, counted):
    """Travel [strokes] of stem and motor and reversals of the stem, over counted seconds."""
    stem_moves = select_flagged(changes(opening), counted)
    motor_moves = select_flagged(changes(position), counted)
    directions = [move > 0.0 for move in stem_moves if abs(move) > MOVEMENT_THRESHOLD]
    return {
        "stem_travel": math.fsum(abs(move) for move in stem_moves),
        "motor_travel": math.fsum(abs(move) for move in motor_moves),
        "reversals": float(sum(now != before for before, now in pairwise(directions))),
    }


def switching_metrics(switches, estimate, gaps, estimator, counted, warm_up, open_loop):
    """Mode switches per 10 min, the estimate [strokes] and the learning times [s]; NaN in open loop.

    gaps: the true backlash [strokes] of every second.
    """
    n_steps = len(estimate)
    recent = [counted[t] and t >= n_steps - ESTIMATE_WINDOW for t in range(n_steps)]
    switches_per_block = [] if open_loop else block_sums(switches, counted, warm_up, SWITCH_BLOCK)
    return {
        "switch_frequency": mean(switches_per_block),
        "estimate_final": estimate[-1],
        "estimate_largest": math.nan if open_loop else max(estimate),
        "estimate_settled": mean(select_flagged(estimate, recent)),
        "time_identified": math.nan if estimator.is_off else identified_since(estimate, gaps),
        **estimator.metrics(),
    }


def identified_since(estimate, gaps):
    """Second from which the estimate is right to 20 % of the backlash or 1 % of stroke; NaN if it ends wrong."""
    pairs = enumerate(zip(estimate, gaps, strict=True))
    wrong = [t for t, (value, gap) in pairs if abs(value - gap) > max(0.2 * gap, 0.01)]
    since = wrong[-1] + 1 if wrong else 0
    return float(since) if since < len(estimate) else math.nan


def air_metrics(T_sup, T_set, m_a, cp_a, counted):
    """Heat [kWh] that the supply air lacks of its set-point, and has above it, over counted seconds."""
    lacks = [m_a[t] * cp_a * (T_set[t] - T_sup[t]) for t in range(len(T_sup)) if counted[t]]
    return {
        "reheat_energy": math.fsum(heat for heat in lacks if heat > 0.0) / 3600.0,
        "recool_energy": -math.fsum(heat for heat in lacks if heat < 0.0) / 3600.0,
    }


def coil_metrics(power, m_w, condensates, counted, warm_up):
    """Energy [kWh], peak power [kW], water [m3] and condensate [kg], over counted seconds."""
    peaks = [total / PEAK_BLOCK for total in block_sums(power, counted, warm_up, PEAK_BLOCK)]
    return {
        "coil_energy": math.fsum(select_flagged(power, counted)) / 3600.0,
        "coil_peak_power": max(peaks, default=math.nan),
        "water_volume": math.fsum(select_flagged(m_w, counted)) / 1000.0,
        "condensate": math.fsum(select_flagged(condensates, counted)),
    }


def mean(values):
    """Arithmetic mean; NaN of nothing."""
    return math.fsum(values) / len(values) if values else math.nan


def select_flagged(values, flags):
    """The values whose flag is set."""
    return [value for value, flag in zip(values, flags, strict=True) if flag]


def changes(positions):
    """Change of each second against the one before; everything stands at 0 before the run."""
    return [now - before for before, now in pairwise([0.0, *positions])]


def true_runs(flags):
    """Maximal runs of set flags, as (start, stop) with stop excluded."""
    edges = [t for t, (before, now) in enumerate(pairwise([False, *flags, False])) if bool(before) != bool(now)]
    return zip(edges[::2], edges[1::2], strict=True)


def block_sums(values, counted, first, length):
    """Sums over the blocks of `length` seconds aligned at `first` that fit the run and count throughout."""
    starts = range(first, len(values) - length + 1, length)
    blocks = [slice(start, start + length) for start in starts]
    return [math.fsum(values[block]) for block in blocks if all(counted[block])]
