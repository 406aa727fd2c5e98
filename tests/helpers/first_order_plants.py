"""Plants of first order with a delay, for which oracles are known."""

import numpy as np

from fastcoil.design.plants import OPENINGS, Plants


def first_order_plants(gain: float, lag: float, delay: int, n: int = 1) -> Plants:
    """Make n equal plants: K per unit opening, s, whole s."""
    t = np.arange(1, delay + int(15 * lag) + 1)
    step = np.where(t > delay, 1.0 - np.exp(-(t - delay) / lag), 0.0)
    ones = np.ones(n)
    return Plants(
        opening=0.4 * ones,
        T_sup=14.0 * ones,
        gain=gain * ones,
        reachable=ones > 0.0,
        m_w=ones,
        wet_volumes=0.0 * ones,
        response=np.tile(gain * step, (n, 1)),
        kind=np.zeros(n, dtype=np.int64),
        curve=np.tile(14.0 + gain * (OPENINGS - 0.4), (n, 1)),
    )


def join_plants(*plants: Plants) -> Plants:
    """Join plants as those of several operating points."""
    length = max(plant.response.shape[1] for plant in plants)
    responses = [np.pad(p.response, ((0, 0), (0, length - p.response.shape[1])), mode="edge") for p in plants]
    joined = {name: np.concatenate([getattr(p, name) for p in plants]) for name in Plants._fields if name != "response"}
    return Plants(**joined | {"response": np.concatenate(responses), "kind": np.arange(len(plants))})
