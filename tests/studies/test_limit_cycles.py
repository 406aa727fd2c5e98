"""The study of limit cycles: its forecasts are right on loops of another seed."""

import pytest

from studies.hunting.limit_cycles import Verdicts, simulate_and_predict


@pytest.mark.full
@pytest.mark.kernel
@pytest.mark.parametrize("population", ["cooling", "heating", "too small"])
def test_on_loops_of_another_seed_97_of_100_forecasts_are_right(population):
    case = simulate_and_predict(population, 3101, 100)
    verdicts = Verdicts.compare(case.seen, case.predicted)
    assert float(((verdicts.hunts == verdicts.predicted) & verdicts.among).sum() / verdicts.among.sum()) >= 0.97
