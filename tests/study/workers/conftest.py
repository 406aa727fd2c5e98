"""What the tests of the workers share."""

import pytest

from fastcoil.study.file.spec import read_study
from fastcoil.study.workers import Job


@pytest.fixture(scope="module")
def job(small_study):
    """A job to hand out in shards; nothing of it is run."""
    return Job(read_study(small_study).plan, None)
