"""What the gates share."""

import pytest
from helpers.calls import build, why_not
from helpers.forks import forks


@pytest.fixture(scope="session")
def watched(tmp_path_factory):
    """Run a study or a command in a process forked for it, see ``forks``; its calls can be seen, see ``calls``."""
    if why_not():
        pytest.skip(why_not())
    library = build(tmp_path_factory.mktemp("library"))
    with forks("fastcoil.cli.main", "fastcoil.analysis.summary", LD_PRELOAD=str(library)) as run:
        yield run
