"""The study of limit cycles: what it counts, and that its loops run."""

import numpy as np
import pytest
import xarray as xr

from studies.hunting.limit_cycles import Judged, compared


def judged(**values):
    """Of four loops on one day; values: four of each."""
    seen = {"status": [0, 0, 0, 0], "hunting_period": 100.0, "hunting_swing": 1.0}
    predicted = {"margin": [1.0, 1.0, 1.0, 1.0], "period": 100.0, "amplitude": 0.5}
    both = []
    for defaults, names in ((seen, ("hunts", *seen)), (predicted, ("theory", *predicted))):
        arrays = {n.replace("theory", "hunts"): np.resize(values.get(n, defaults.get(n, 0.0)), (4, 1)) for n in names}
        both.append(xr.Dataset({n: (("sample", "day"), a) for n, a in arrays.items()}))
    return Judged.of(*both)


def test_what_is_missed_is_counted_apart_from_false_alarms():
    of = judged(hunts=[1.0, 1.0, 0.0, 0.0], theory=[0.0, 1.0, 1.0, 1.0])
    assert of.cells()[:4] == ["1", "2", "4", "2"]


def test_out_of_reach_and_failed_loops_do_not_count():
    of = judged(
        hunts=[1.0, 1.0, 1.0, 1.0], theory=[0.0, 0.0, 1.0, 1.0], margin=[0.0, 1.0, 1.0, 1.0], status=[0, 1, 0, 0]
    )
    assert of.cells()[:4] == ["0", "0", "2", "2"]


def test_an_amplitude_is_half_of_a_swing_and_both_limits_are_kept():
    of = judged(period=[84.0, 86.0, 114.0, 116.0], amplitude=[0.32, 0.34, 0.74, 0.76])
    assert of.period.values.ravel().tolist() == [False, True, True, False]
    assert of.swing.values.ravel().tolist() == [False, True, True, False]


@pytest.mark.full
@pytest.mark.kernel
@pytest.mark.parametrize("population", ["cooling", "heating", "too small"])
def test_on_loops_of_another_seed_97_of_100_forecasts_are_right(population):
    case = compared(population, 3101, 100)
    of = Judged.of(case.seen, case.predicted)
    right = ((of.hunts == of.predicted) & of.among).sum() / of.among.sum()
    assert float(right) >= 0.97
