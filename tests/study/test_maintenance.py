"""Looking after a study's folder: what is said can be typed as it stands."""

from __future__ import annotations

import shlex

import pytest
from helpers.studies import PLAIN, run_until_interrupted

from fastcoil.study import maintenance

pytestmark = pytest.mark.kernel


def test_status_suggests_a_command_that_takes_the_folder_for_one_word(tmp_path):
    out = tmp_path / "my study; and 'more'"
    run_until_interrupted(PLAIN, out, 1)
    command = maintenance.status(out)[-1].removeprefix("To resume: ")
    assert shlex.split(command) == ["fastcoil", "run", "STUDY.toml", "-o", str(out)]
