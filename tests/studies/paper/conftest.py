import json

import pytest

from studies.paper.grid import KINDS
from studies.paper.regenerate import regenerate


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The folder that the quick mode writes, and what it says, in ``said.txt``; no test may change it."""
    out = tmp_path_factory.mktemp("paper") / "new"
    kinds = {name: KINDS[name] for name in ("stepped", "design")}
    verdicts, _ = regenerate(out, quick=True, n_jobs=2, kinds=kinds)
    (out / "said.txt").write_text("\n".join(verdicts))
    return out


@pytest.fixture(scope="session")
def card(folder):
    """The scorecard of the quick mode, from its file."""
    return json.loads((folder / "scorecard.json").read_text())
