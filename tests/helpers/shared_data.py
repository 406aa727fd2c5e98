"""Measured series, in a folder next to the checkout."""

from pathlib import Path

import pytest

DATA_FOLDER = Path(__file__).parents[3] / "shared" / "data"


def measured_file(name: str) -> Path:
    """Return the path of a measured series; skip the test if the folder is missing."""
    if not DATA_FOLDER.is_dir():
        pytest.skip("the measured series are not next to this checkout")
    return DATA_FOLDER / name
