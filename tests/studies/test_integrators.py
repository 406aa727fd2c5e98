"""``integrators.py``: an integration of the coil that shares only formulas with the package."""

import numpy as np
import pytest

import fastcoil as fc
from studies.numerics import integrators

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("preset", ["g36", pytest.param("lbnl", marks=pytest.mark.full)])
def test_the_quasistatic_march_is_the_method_that_the_study_recommends(preset):
    day, tunings = fc.paper_day(hours=0.75, seed=[5, 6]), integrators.draw_tunings(preset, 3)
    by_hand = integrators.integrate_rmse(preset, tunings, day, integrators.IMPLICIT, steps=2)
    np.testing.assert_allclose(integrators.march_rmse(preset, tunings, day, "quasistatic", 2), by_hand, rtol=1e-7)
    assert (by_hand != integrators.integrate_rmse(preset, tunings, day, integrators.EULER, steps=2)).all()


def test_a_method_that_runs_away_is_said_to_diverge():
    assert integrators.describe_error(np.array([[1.0, np.nan]]), np.ones((1, 2))) == "diverges"
    assert integrators.describe_error(np.array([[1.1, 1.1]]), np.ones((1, 2))) == "+10.0 ± 0.0, 10.00"
