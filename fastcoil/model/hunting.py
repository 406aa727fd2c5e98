"""When does a loop hunt?  The rule, for simulations and for replays of a log.

Every 10 s x = T_sup - T_set less its mean of some 300 s is compared with the swing that air, water and set-point would
make of it at a held opening.  A block of 20 settled minutes hunts where x swings visibly, and by more, or more often,
than that; a loop hunts where half of its blocks do.  The numbers were chosen and tested in ``studies/hunting``.
"""

import numpy as np

SWING_SAMPLE_S = 10  # between samples of the swing: a cycle below two of them is not seen
SWING_MEAN_S = 300  # of the mean that is taken off: swings of a coil have periods of 1 to 10 min, loads change in hours
SWING_LEAD_S = 300  # before settled time, in which that mean begins
SWING_BLOCK_S = 1200  # of a block: two of the longest periods, and the settled part of a set-point that is held 30 min
LEAST_SWING_BLOCK_S = 600  # of the last block of a window: shorter ones do not show two periods
HUNTING_SWING_K = 0.1  # peak-to-peak supply temperature above which a loop may hunt: less is not worth a repair
DISTURBANCE_RATIO = 1.3  # of the swings of T_sup and of disturbances, above which the loop adds to them
EXTRA_TURNS = 1.0  # of T_sup against the disturbances in a block, above which the swing has a rhythm of its own
LEAST_TURN_K = 0.04  # reversal of T_sup that is a turn: above the ripple of a sampled controller
LEAST_DISTURBANCE_TURN_K = 0.02  # reversal of the disturbance that is one: the loop may amplify it
AIR_FLOW_EXPONENT = 0.6  # of the air flow in the temperature change of the air, at a held opening
SAME_PERIOD_SHARE = 0.2  # of the longer of two periods, by which they may differ and be alike
HUNTING_SHARE = 0.5  # of the blocks


def disturbance_change(
    T_sup: float, T_a_in: float, T_w_in: float, m_a: float, dT_a_in: float, dT_w_in: float, dm_a: float
) -> float:
    """Change of T_sup, K, that changes of entering air, °C, water, °C, and air flow, kg/s, make at a held opening.

    The effectiveness of the coil follows from T_sup, °C.
    """
    cooled, most = T_a_in - T_sup, T_a_in - T_w_in
    effectiveness = min(max(cooled / most, 0.0), 1.0) if most != 0.0 else 0.0
    return (1.0 - effectiveness) * dT_a_in + effectiveness * dT_w_in + AIR_FLOW_EXPONENT * cooled * dm_a / m_a


def next_extreme(h: float, extreme: float, direction: float, least: float) -> tuple[float, float, float]:
    """Follow a swing: last extreme, K, direction, ±1, and whether it turned, 0 or 1, with a reversal by ``least``."""
    retreat = direction * (extreme - h)
    turned = retreat > least
    return (h if turned | (retreat < 0.0) else extreme), (-direction if turned else direction), 1.0 if turned else 0.0


def follow_swing(signal: np.ndarray, spacing: float, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a signal less its mean, and where it turns with a reversal by ``least``; spacing: of its samples, s."""
    swing, turns = np.empty(signal.size), np.empty(signal.size)
    mean, extreme, direction = 0.0, 0.0, 1.0
    for k, value in enumerate(signal.tolist()):
        mean += max(1.0 / (k + 1), spacing / SWING_MEAN_S) * (value - mean)
        swing[k] = value - mean
        extreme, direction, turns[k] = next_extreme(swing[k], extreme, direction, least)
    return swing, turns


def is_same_period(period: float, previous_period: float, sample_time: float) -> bool:
    """Whether two periods, s, are equally long, to 20 % of the longer one or a sample of the controller and of these."""
    longer = period if period > previous_period else previous_period
    difference = abs(period - previous_period)
    return (difference <= SAME_PERIOD_SHARE * longer) | (difference <= sample_time + SWING_SAMPLE_S)


def judge_swing(blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether loops hunt, 1 or 0, and their median swing, K, from blocks; both NaN without one.

    blocks: (n_blocks, 4, n_loops): range of the swing of T_sup, K, its turns, and both of the disturbances.
    """
    if not len(blocks):
        return (np.full(blocks.shape[2], np.nan),) * 2
    swing, turns, disturbance, disturbance_turns = blocks.transpose(1, 0, 2)
    is_own = (swing > DISTURBANCE_RATIO * disturbance) | (turns > disturbance_turns + EXTRA_TURNS)
    hunts = ((swing > HUNTING_SWING_K) & is_own).mean(axis=0) >= HUNTING_SHARE
    return hunts.astype(float), np.median(swing, axis=0)
