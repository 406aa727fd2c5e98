"""When does a loop hunt?  The rule, for simulations and for replays of a log.

Every 10 s of settled time T_sup - T_set, less its mean of some 300 s, is the swing.  A regression over each 20 min
finds how much of it entering air, water and set-point explain at a held opening, delayed as the coil may.  A block
hunts where the rest is visible and not a small part of the swing; a loop hunts where half of its blocks do.  The
numbers were chosen on some loops and tested on others, see ``studies/hunting/verdict.py``.
"""

import numpy as np

from fastcoil.model.metric_table import HUNTING_SWING_K

SWING_SAMPLE_S = 10  # between samples of the swing: a cycle below two of them is not seen
SWING_MEAN_S = 300  # of the mean that is taken off: coils swing in 1 to 10 min, loads change in hours
SWING_LEAD_S = 300  # before settled time, in which that mean begins
SWING_BLOCK_S = 1200  # of a block: two slow cycles, and the settled part of a set-point that is held for 30 min
LEAST_SWING_BLOCK_S = 600  # of the last block of a window: a shorter one may not show a cycle
OWN_SHARE = 0.4  # of the variance of a block that disturbances must leave unexplained: misses 9 %, calls 5 % of others
HUNTING_SHARE = 0.5  # of the blocks, for a loop that hunts
LEAST_TURN_K = 0.04  # reversal of the swing that is a turn, between which periods count: above ripple and rounding
SAME_PERIOD_SHARE = 0.2  # of the longer of two periods, by which they may differ and be alike
COIL_LAG_S = 60.0  # of each of the two lags that delay a disturbance: sensor, metal and water of a coil together
FLOW_SHARE = 0.45  # of the change of the air flow that the cooling of the air loses: 0.36 to 0.48 in the presets
WET_SHARE = 0.65  # of a change of temperature that a wet coil passes on, latent heat takes the rest: 0.54 to 0.74
LATENT_K = 2500.0  # change of temperature that has the heat of a change of humidity by 1 kg/kg
LEAST_DRYING = 1e-5  # humidity that the air loses in a wet coil, kg/kg
LEAST_FLOW = 1e-3  # of air, kg/s, to which a change of the flow is relative: air may stand still
SWING_SIGNALS = 5  # of the regression: 1, the disturbance now, after a lag and after two, and the swing
N_SWING_ROWS = SWING_SIGNALS**2 + 2  # of a block: summed products of all pairs of signals, highest and lowest swing
Inputs = tuple[float, float, float, float, float]  # m_a, T_a_in, W_a_in, T_w_in, T_set, in the units of a boundary


def disturbance_change(T_sup: float, W_sup: float, now: Inputs, before: Inputs) -> float:
    """Change of T_sup - T_set, K, from one sample to the next at a held opening."""
    m_a, T_a_in, W_a_in, T_w_in, T_set = now
    cooled, most = T_a_in - T_sup, T_a_in - T_w_in
    eps = min(max(cooled / most, 0.0), 1.0) if most != 0.0 else 0.0
    dry = (1.0 - eps) * (T_a_in - before[1]) + eps * (T_w_in - before[3])
    wet = WET_SHARE * (dry + (1.0 - eps) * LATENT_K * (W_a_in - before[2]))
    is_wet = W_a_in - W_sup > LEAST_DRYING
    flow_change = (m_a - before[0]) / max(m_a, before[0], LEAST_FLOW)
    return (wet if is_wet else dry) + FLOW_SHARE * cooled * flow_change - (T_set - before[4])


def next_extreme(h: float, extreme: float, direction: float) -> tuple[float, float, bool]:
    """Follow a swing h, K: its last extreme, its direction, ±1, and whether it has just turned."""
    retreat = direction * (extreme - h)
    turned = retreat > LEAST_TURN_K
    return (h if turned | (retreat < 0.0) else extreme), (-direction if turned else direction), turned


def is_same_period(period: float, previous_period: float, sample_time: float) -> bool:
    """Whether two periods, s, are alike: to 20 % of the longer one, or to a sample of the controller and of these."""
    longer = period if period > previous_period else previous_period
    difference = abs(period - previous_period)
    return (difference <= SAME_PERIOD_SHARE * longer) | (difference <= sample_time + SWING_SAMPLE_S)


def judge_swing(blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether loops hunt, 1 or 0, and the median swing of ``blocks``, (n_blocks, N_SWING_ROWS, n_loops), K; or NaN."""
    if not len(blocks):
        return (np.full(blocks.shape[2], np.nan),) * 2
    swing = blocks[:, -2] - blocks[:, -1]
    products = np.moveaxis(blocks[:, :-2], 1, 0).reshape(SWING_SIGNALS, SWING_SIGNALS, *swing.shape)
    for k in range(1, SWING_SIGNALS):
        products[:k, k] = products[k, :k]
    own_share = _unexplained_share(products)
    is_own = (own_share * swing**2 > HUNTING_SWING_K**2) & (own_share > OWN_SHARE)
    return (is_own.mean(axis=0) >= HUNTING_SHARE).astype(float), np.median(swing, axis=0)


def _unexplained_share(products: np.ndarray) -> np.ndarray:
    """Share of the variance of the last signal that the others leave, eliminated one by one; the first is 1."""
    rest, variances = products, np.zeros_like(products[0])
    while len(rest) > 1:
        pivot, is_new = rest[0, 0], rest[0, 0] > 1e-10 * variances[0]
        rest = rest[1:, 1:] - rest[1:, :1] * (rest[:1, 1:] * np.divide(is_new, pivot, out=0.0 * pivot, where=is_new))
        variances = np.einsum("ii...->i...", rest) if rest.shape[0] == SWING_SIGNALS - 1 else variances[1:]
    variance = variances[-1]
    share: np.ndarray = np.divide(rest[0, 0], variance, out=np.ones_like(variance), where=variance > 0.0)
    return share.clip(0.0, 1.0)
