"""The measured series beside the checkout."""

from __future__ import annotations

from pathlib import Path

import pytest

DATA = Path(__file__).parents[3] / "shared" / "data"


def measured(name: str) -> Path:
    """The file of a measured series; the test is skipped where there are none."""
    if not DATA.is_dir():
        pytest.skip("the measured series are not beside this checkout")
    return DATA / name
