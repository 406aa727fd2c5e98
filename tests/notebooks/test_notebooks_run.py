"""The notebooks of the docs run from top to bottom in a real kernel, and show what they should."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(300)]

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
RUN_SCRIPT = """
import sys
import nbclient, nbformat
from jupyter_client import AsyncKernelManager

notebook = nbformat.read(sys.argv[1], as_version=4)
# pipes of the file system: nothing listens on a network
manager = AsyncKernelManager(kernel_name="python3", transport="ipc")
nbclient.NotebookClient(notebook, timeout=120, km=manager).execute()
nbformat.write(notebook, sys.argv[2])
"""


@pytest.fixture(scope="module")
def executed_cells(tmp_path_factory):
    """(source, outputs) of every cell of code; all run in one kernel, each notebook in an empty namespace."""
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("nbclient")
    joined_notebook = nbformat.v4.new_notebook()
    for path in NOTEBOOKS:
        cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        joined_notebook.cells += [*cells, nbformat.v4.new_code_cell("%reset -f")]
    folder = tmp_path_factory.mktemp("notebooks")
    nbformat.write(joined_notebook, folder / "before.ipynb")
    # in a process of its own, with whatever the client leaves behind; a command tested before has named a backend
    environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    process = subprocess.run(
        [sys.executable, "-c", RUN_SCRIPT, "before.ipynb", "after.ipynb"],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=250, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return [(cell.source, cell.outputs) for cell in nbformat.read(folder / "after.ipynb", as_version=4).cells]


def output_kinds(outputs):
    return {kind for output in outputs for kind in output.get("data", {})}


def test_two_notebooks_are_stored_without_what_they_show():
    assert [path.stem for path in NOTEBOOKS] == ["first-loop", "learning-the-gap"]
    for path in NOTEBOOKS:
        for cell in json.loads(path.read_text())["cells"]:
            assert not cell.get("outputs")
            assert cell.get("execution_count") is None


def test_every_figure_is_shown_once_and_nothing_is_warned_of(executed_cells):
    for source, outputs in executed_cells:
        figures = [output for output in outputs if "image/png" in output.get("data", {})]
        assert len(figures) == ("fc.plot." in source), source
        assert not [output for output in outputs if output.output_type in ("stream", "error")], source


def test_loops_days_and_explanations_show_themselves(executed_cells):
    ends = {source.splitlines()[-1]: output_kinds(outputs) for source, outputs in executed_cells}
    for last in ("loop", "day", "sweep", "fc.explain(fc.Loop(), day)"):
        assert "text/plain" in ends[last], last
