"""What the gates share."""

import pytest
from helpers.calls import build, why_not
from helpers.forks import forks

MODULES = ("fastcoil.cli.main", "fastcoil.analysis.summary", "fastcoil.study.maintenance", "fastcoil.plots.study",
           "matplotlib.figure")  # fmt: skip
"""What commands import."""


@pytest.fixture(scope="session")
def forked(tmp_path_factory):
    """Run a study or a command in a process forked for it, see ``forks``."""
    env = {} if why_not() else {"LD_PRELOAD": str(build(tmp_path_factory.mktemp("library")))}
    with forks(*MODULES, **env) as run:
        yield run


@pytest.fixture
def watched(forked):
    """The same; its system calls can be seen, see ``calls``."""
    if why_not():
        pytest.skip(why_not())
    return forked
