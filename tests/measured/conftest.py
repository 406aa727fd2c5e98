"""What the tests of fits share."""

import os

import pytest

from fastcoil.measured import fit_coil, least_squares

USUAL_STARTS = fit_coil._N_STARTS, least_squares._N_REFINED


@pytest.fixture
def all_starts(monkeypatch):
    """Fits descend from as many guesses as they do for a user."""
    monkeypatch.setattr(fit_coil, "_N_STARTS", USUAL_STARTS[0])
    monkeypatch.setattr(least_squares, "_N_REFINED", USUAL_STARTS[1])


@pytest.fixture(autouse=True, scope="module")
def _few_starts(request):
    """Fits descend from the best two of 64 guesses, which is enough for clean logs; those of valves as they do."""
    with pytest.MonkeyPatch.context() as patch:
        if not os.environ.get("FASTCOIL_FULL") and "test_valve" not in request.module.__name__:
            patch.setattr(fit_coil, "_N_STARTS", 64)
            patch.setattr(least_squares, "_N_REFINED", 2)
        yield
