import json

import pytest
from click.testing import CliRunner

from fastcoil.cli.main import main


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The folder that the quick mode writes, and what it says, in ``said.txt``; no test may change it."""
    out = tmp_path_factory.mktemp("paper") / "new"
    result = CliRunner().invoke(main, ["paper", "--quick", "-j", "2", "-o", str(out)])
    assert result.exit_code == 0, result.output
    (out / "said.txt").write_text(result.stdout)
    return out


@pytest.fixture(scope="session")
def card(folder):
    """The scorecard of the quick mode, from its file."""
    return json.loads((folder / "scorecard.json").read_text())
