"""Whether a loop hunts, from the whole recorded run: blocks of 20 min, and what disturbances explain of them."""

import math
from itertools import pairwise
from statistics import fmean, median

import numpy as np

SAMPLE = 10  # s
MEAN_SAMPLES = 30  # 300 s
BLOCK_SAMPLES = 120  # 20 min
LEAST_SAMPLES = 60  # 10 min


def swing_metrics(T_sup, W_sup, inputs, since, enabled, warm_up, sample_time):
    """Swing, period and verdict; NaN without a block.

    T_sup [degC], W_sup [kg/kg]; inputs: tuples of air flow [kg/s], entering air [degC] and humidity [kg/kg], entering
    water and set point [degC], per second.  since: seconds since the last disturbance of the set point, per second.
    """
    blocks, periods = [], []
    for run in sampled_runs(since, enabled, warm_up):
        error = [T_sup[t] - inputs[t][4] for t in run]
        forced = [0.0]
        for before, now in pairwise(run):
            forced.append(forced[-1] + forced_change(T_sup[now], W_sup[now], inputs[before], inputs[now]))
        h, g = without_mean(error), without_mean(forced)
        lagged = first_order_lag(g)
        causes = g, lagged, first_order_lag(lagged)
        inside = [k for k, t in enumerate(run) if since[t] >= 600 and t >= warm_up]
        parts = [inside[k : k + BLOCK_SAMPLES] for k in range(0, len(inside), BLOCK_SAMPLES)]
        parts = [part for part in parts if len(part) >= LEAST_SAMPLES]
        blocks += [([h[k] for k in part], [[c[k] for k in part] for c in causes]) for part in parts]
        if parts:
            lower = [run[k] for k in lower_turns(h)]
            periods += [b - a for a, b in pairwise(lower) if run[inside[0]] <= b <= run[parts[-1][-1]]]
    alike = sum(abs(b - a) <= max(0.2 * max(a, b), sample_time + SAMPLE) for a, b in pairwise(periods))
    return {
        "hunting_swing": median(max(h) - min(h) for h, _ in blocks) if blocks else math.nan,
        "hunting_period": fmean(periods) if periods else math.nan,
        "swing_regularity": alike / (len(periods) - 1) if len(periods) > 1 else math.nan,
        "hunts": float(sum(is_hunting(*block) for block in blocks) >= len(blocks) / 2) if blocks else math.nan,
    }


def sampled_runs(since, enabled, warm_up):
    """Runs of sampled seconds, from 300 s before the settled ones on."""
    run = []
    for t in range(0, len(since), SAMPLE):
        if enabled[t] and t >= warm_up - 300 and since[t] >= 300:
            run.append(t)
        elif run:
            yield run
            run = []
    if run:
        yield run


def forced_change(T_sup, W_sup, before, now):
    """Change [K] of the supply temperature at a held opening less that of the set point."""
    m_a, T_a, W_a, T_w, _ = now
    dm_a, dT_a, dW_a, dT_w, dT_set = (b - a for a, b in zip(before, now, strict=True))
    eps = min(1.0, max(0.0, (T_a - T_sup) / (T_a - T_w)))
    if W_a - W_sup > 1e-5:
        by_entering = 0.65 * ((1.0 - eps) * (dT_a + 2500.0 * dW_a) + eps * dT_w)
    else:
        by_entering = (1.0 - eps) * dT_a + eps * dT_w
    return by_entering + 0.45 * (T_a - T_sup) * dm_a / max(before[0], m_a, 0.001) - dT_set


def without_mean(signal):
    """The signal less its mean: of all samples so far, from 300 s on exponential."""
    mean, rest = 0.0, []
    for n, value in enumerate(signal, 1):
        mean += (value - mean) / min(n, MEAN_SAMPLES)
        rest.append(value - mean)
    return rest


def first_order_lag(signal):
    """The signal behind a lag of 60 s, at rest before its first sample."""
    level, lagged = 0.0, []
    for value in signal:
        level = (level * 60.0 + value * SAMPLE) / (60.0 + SAMPLE)
        lagged.append(level)
    return lagged


def lower_turns(h):
    """Samples at which the signal has risen by more than 0.04 K from its lowest, having fallen as much before."""
    found, rising, extreme = [], True, h[0]
    for k, value in enumerate(h):
        extreme = max(extreme, value) if rising else min(extreme, value)
        if abs(value - extreme) > 0.04:
            rising, extreme = not rising, value
            found += [k] * rising
    return found


def is_hunting(h, causes):
    """Whether a block hunts: least squares on the causes leave 40 % of the variance, and 0.1 K of the swing."""
    h_centred = np.array(h) - np.mean(h)
    X = np.stack([np.array(cause) - np.mean(cause) for cause in causes], axis=1)
    rest = h_centred - X @ np.linalg.lstsq(X, h_centred, rcond=1e-6)[0]
    variance = float(h_centred @ h_centred)
    share = float(rest @ rest) / variance if variance > 0.0 else 1.0
    return share > 0.4 and math.sqrt(share) * (max(h) - min(h)) > 0.1
