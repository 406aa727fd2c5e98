"""``days = 80``: the seeds 1 to 80, without a list of them."""

import pytest
from helpers.refusals import assert_refused

from fastcoil.study.file.spec import read_study


def write(tmp_path, boundary):
    path = tmp_path / "study.toml"
    path.write_text(f"[loop]\n[boundary]\nhours = 0.25\n{boundary}\n[run]\nwarm_up = 100\n")
    return path


def test_a_number_of_days_stands_for_their_seeds(tmp_path):
    by_number, by_list = (read_study(write(tmp_path, text)).plan for text in ("days = 3", "seed = [1, 2, 3]"))
    assert by_number.layout.boundary.day.tolist() == [1, 2, 3]
    assert by_number.layout.boundary.sha256 == by_list.layout.boundary.sha256


@pytest.mark.parametrize(
    ("boundary", "code"), [("days = 0", "value"), ("days = 2.5", "type"), ("days = 2\nseed = 4", "conflict")]
)
def test_no_number_of_days_is_refused(tmp_path, boundary, code):
    assert_refused("days", code, read_study, write(tmp_path, boundary))
