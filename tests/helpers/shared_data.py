"""Measured series, in a folder next to the checkout."""

from pathlib import Path

import pytest

DATA = Path(__file__).parents[3] / "shared" / "data"


def measured(name: str) -> Path:
    """Path of a measured series; the test is skipped if the folder is missing."""
    if not DATA.is_dir():
        pytest.skip("the measured series are not next to this checkout")
    return DATA / name
