"""Which second of a day counts towards which metric."""

import numpy as np

from fastcoil.model.engine import metrics
from fastcoil.model.engine.metrics import schedule


def seconds_with(found, flag):
    return np.flatnonzero(found.flags & flag).tolist()


def test_schedule_of_a_small_day():
    T_set = np.where(np.arange(4000) < 1500, 14.0, 13.0)
    enabled = np.ones(4000)
    enabled[3000] = 0.0
    found = schedule(T_set, enabled, 100)
    counted = [*range(100, 3000), *range(3001, 4000)]
    settled = [*range(600, 1500), *range(2100, 3000), *range(3601, 4000)]
    assert seconds_with(found, metrics.COUNTED) == counted
    assert seconds_with(found, metrics.SETTLED) == settled
    assert seconds_with(found, metrics.WINDOW_STARTS) == [600, 2100, 3601]
    assert seconds_with(found, metrics.WINDOW_ENDS) == [1499, 2999, 3999]
    # blocks 100-699, 700-1299, ... 3100-3699; that of second 3000 does not count
    assert seconds_with(found, metrics.IN_SWITCH_BLOCK) == [*range(100, 2500), *range(3100, 3700)]
    assert seconds_with(found, metrics.IN_PEAK_BLOCK) == [*range(100, 2800)]
    assert seconds_with(found, metrics.PEAK_BLOCK_ENDS) == [999, 1899, 2799]
    assert seconds_with(found, metrics.IN_ESTIMATE_WINDOW) == counted
    numbers = (found.n_counted, found.n_settled, found.n_windows, found.n_switch_blocks, found.n_peak_blocks)
    assert numbers == (len(counted), len(settled), 3, 5, 3)


def test_estimate_window_is_the_last_two_hours():
    found = schedule(np.full(9000, 14.0), np.ones(9000), 100)
    assert seconds_with(found, metrics.IN_ESTIMATE_WINDOW) == list(range(1800, 9000))
    assert found.n_estimate == 7200
