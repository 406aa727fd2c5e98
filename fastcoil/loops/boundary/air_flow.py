"""A loop without air flow is not in operation: its seconds count in no metric, and a warning says so."""

from __future__ import annotations

import warnings

import numpy as np

from fastcoil.base.arrays import Array


def enabled_by(m_a: Array) -> tuple[Array, int]:
    """The series ``enabled`` of an air flow, of its shape: 0 where no air flows; and how many samples are 0."""
    flows = m_a > 0.0
    return flows.astype(np.float64), int(flows.size - np.count_nonzero(flows))


def warn_of_stops(seconds: int, stacklevel: int = 3) -> None:
    """Warn of the seconds that count in no metric because no air flows."""
    if seconds:
        warnings.warn(
            f"m_a is 0 during {seconds / 3600:,.4g} h and enabled is left out: the loop is off there, and these hours "
            "count in no metric; give enabled to have it otherwise",
            UserWarning,
            stacklevel=stacklevel,
        )
