"""What the tests of fits share."""

import os

import pytest


@pytest.fixture(autouse=True, scope="module")
def _few_starts():
    """Fits of coils start from 64 guesses, which is enough for logs as clean as these."""
    with pytest.MonkeyPatch.context() as patch:
        if not os.environ.get("FASTCOIL_FULL"):
            patch.setattr("fastcoil.measured.coil_problem._N_STARTS", 64)
        yield
