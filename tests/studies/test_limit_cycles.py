"""The study of limit cycles: its forecasts are right on loops of another seed."""

import pytest

from studies.hunting.limit_cycles import Judged, compared


@pytest.mark.full
@pytest.mark.kernel
@pytest.mark.parametrize("population", ["cooling", "heating", "too small"])
def test_on_loops_of_another_seed_97_of_100_forecasts_are_right(population):
    case = compared(population, 3101, 100)
    of = Judged.of(case.seen, case.predicted)
    right = ((of.hunts == of.predicted) & of.among).sum() / of.among.sum()
    assert float(right) >= 0.97
