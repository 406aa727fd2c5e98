"""Whether a loop hunts, from the whole recorded run: the rule B of blocks of 20 min."""

import math
from itertools import pairwise
from statistics import fmean, median

SAMPLE = 10  # s
MEAN_SAMPLES = 30  # 300 s
BLOCK_SAMPLES = 120  # 20 min
LEAST_SAMPLES = 60  # 10 min


def swing_metrics(T_sup, inputs, since, enabled, warm_up, sample_time):
    """Swing, period and verdict; NaN without a block.

    T_sup [degC]; inputs: tuples of air flow [kg/s], entering air, water and set point [degC], per second.
    since: seconds since the last disturbance of the set point, per second.
    """
    blocks, periods = [], []
    for run in sampled_runs(since, enabled, warm_up):
        error = [T_sup[t] - inputs[t][3] for t in run]
        forced = [0.0]
        for before, now in pairwise(run):
            forced.append(forced[-1] + forced_change(T_sup[now], inputs[before], inputs[now]))
        h, g = without_mean(error), without_mean(forced)
        h_turns, g_turns = turns(h, 0.04), turns(g, 0.02)
        inside = [k for k, t in enumerate(run) if since[t] >= 600 and t >= warm_up]
        for k in range(0, len(inside), BLOCK_SAMPLES):
            block = inside[k : k + BLOCK_SAMPLES]
            if len(block) >= LEAST_SAMPLES:
                blocks.append([spread(h, block), count(h_turns, block), spread(g, block), count(g_turns, block)])
                last = block[-1]
        if inside and len(inside) >= LEAST_SAMPLES:
            lower = [run[k] for k in h_turns if h_turns[k] > 0]
            periods += [b - a for a, b in pairwise(lower) if run[inside[0]] <= b <= run[last]]
    alike = sum(abs(b - a) <= max(0.2 * max(a, b), sample_time + SAMPLE) for a, b in pairwise(periods))
    return {
        "hunting_swing": median(r for r, *_ in blocks) if blocks else math.nan,
        "hunting_period": fmean(periods) if periods else math.nan,
        "swing_regularity": alike / (len(periods) - 1) if len(periods) > 1 else math.nan,
        "hunts": float(sum(map(is_hunting, blocks)) >= len(blocks) / 2) if blocks else math.nan,
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


def forced_change(T_sup, before, now):
    """Change [K] of the supply temperature at a held opening less that of the set point."""
    m_a, T_a, T_w, _ = now
    dm_a, dT_a, dT_w, dT_set = (b - a for a, b in zip(before, now, strict=True))
    eps = min(1.0, max(0.0, (T_a - T_sup) / (T_a - T_w)))
    return (1.0 - eps) * dT_a + eps * dT_w + 0.6 * (T_a - T_sup) / m_a * dm_a - dT_set


def without_mean(signal):
    """The signal less its mean: of all samples so far, from 300 s on exponential."""
    mean, rest = 0.0, []
    for n, value in enumerate(signal, 1):
        mean += (value - mean) / min(n, MEAN_SAMPLES)
        rest.append(value - mean)
    return rest


def turns(h, least):
    """Samples at which the signal has turned by at least so much [K], +1 from falling to rising; it begins rising."""
    found, rising, extreme = {}, True, h[0]
    for k, value in enumerate(h):
        extreme = max(extreme, value) if rising else min(extreme, value)
        if abs(value - extreme) > least:
            rising, extreme = not rising, value
            found[k] = 1 if rising else -1
    return found


def spread(h, block):
    """Peak to peak [K] within a block."""
    return max(h[k] for k in block) - min(h[k] for k in block)


def count(found, block):
    """Number of turns within a block."""
    return sum(k in found for k in block)


def is_hunting(block):
    """Whether a block hunts: more than 0.1 K, and more swing or more turns than the disturbances make."""
    r, n, r_d, n_d = block
    return r > 0.1 and (r > 1.3 * r_d or n > n_d + 1)
