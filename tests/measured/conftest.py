"""What the tests of fits share."""

import os

import pytest


@pytest.fixture(autouse=True, scope="module")
def _few_starts(request):
    """Fits descend from the best two of 64 guesses, which is enough for clean logs; those of valves as they do."""
    with pytest.MonkeyPatch.context() as patch:
        if not os.environ.get("FASTCOIL_FULL") and "test_valve" not in request.module.__name__:
            patch.setattr("fastcoil.measured.coil_problem._N_STARTS", 64)
            patch.setattr("fastcoil.measured.least_squares._REFINED", 2)
        yield
