"""The notebooks of the docs run from top to bottom in a real kernel, and show what they should."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(300)]

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
RUN = """
import sys
import nbclient, nbformat
from jupyter_client import AsyncKernelManager

notebook = nbformat.read(sys.argv[1], as_version=4)
# pipes of the file system: nothing listens on a network
manager = AsyncKernelManager(kernel_name="python3", transport="ipc")
nbclient.NotebookClient(notebook, timeout=120, km=manager).execute()
nbformat.write(notebook, sys.argv[2])
"""
QUIETLY = """
import os
import fastcoil.base.progress as shown
for name in ("PYTEST_VERSION", "PYTEST_CURRENT_TEST"):
    os.environ.pop(name, None)
shown.PATIENCE = 0.0
"""
"""As outside of tests, but without the two seconds in which work that is done at once shows nothing."""
LOOKS = (
    "import fastcoil as fc; ds = fc.simulate(fc.Loop(kp=[0.02, 0.03]), fc.paper_day(hours=1))",
    "ds = fc.simulate(fc.Loop(kp=[0.02, 0.03]), fc.paper_day(hours=1), progress=False)",
)


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """Name → (source, outputs) of every cell of code; all run in one kernel, each notebook in an empty namespace."""
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("nbclient")
    whole, sizes = nbformat.v4.new_notebook(), {}
    for path in NOTEBOOKS:
        cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        whole.cells += [*cells, nbformat.v4.new_code_cell("%reset -f")]
        sizes[path.stem] = len(cells) + 1
    whole.cells += [nbformat.v4.new_code_cell(source) for source in (QUIETLY, *LOOKS)]
    folder = tmp_path_factory.mktemp("notebooks")
    nbformat.write(whole, folder / "before.ipynb")
    # in a process of its own, with whatever the client leaves behind; a command tested before has named a backend
    here = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    ran = subprocess.run(
        [sys.executable, "-c", RUN, "before.ipynb", "after.ipynb"],
        cwd=folder, env=here, capture_output=True, text=True, timeout=250, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    shown = [(cell.source, cell.outputs) for cell in nbformat.read(folder / "after.ipynb", as_version=4).cells]
    found = {}
    for name, size in sizes.items():
        found[name], shown = shown[:size], shown[size:]
    return found | {"progress": shown}


def kinds(outputs):
    return {kind for output in outputs for kind in output.get("data", {})}


def test_two_notebooks_are_stored_without_what_they_show():
    assert [path.stem for path in NOTEBOOKS] == ["first-loop", "learning-the-gap"]
    for path in NOTEBOOKS:
        for cell in json.loads(path.read_text())["cells"]:
            assert not cell.get("outputs")
            assert cell.get("execution_count") is None


def test_every_figure_is_shown_once(executed):
    for name in ("first-loop", "learning-the-gap"):
        for source, outputs in executed[name]:
            figures = [output for output in outputs if "image/png" in output.get("data", {})]
            assert len(figures) == ("fc.plot." in source), source
    drawn = {word for name in executed for source, _ in executed[name] for word in source.replace("(", " ").split()}
    assert {"fc.plot.traces", "fc.plot.map", "fc.plot.bands", "fc.plot.limit_cycle", "fc.plot.learning"} <= drawn


def test_loops_days_and_explanations_show_themselves(executed):
    ends = {source.splitlines()[-1]: kinds(outputs) for cells in executed.values() for source, outputs in cells}
    for last in ("loop", "day", "sweep", "fc.explain(fc.Loop(), day)"):
        assert "text/plain" in ends[last], last


def test_nothing_is_warned_of(executed):
    for cells in executed.values():
        for source, outputs in cells:
            assert not [output for output in outputs if output.output_type in ("stream", "error")], source


def test_progress_is_a_line_that_ends_with_what_was_done(executed):
    asked = next(outputs for source, outputs in executed["first-loop"] if "progress=True" in source)
    (line,) = (output["data"] for output in asked if "image/png" not in output["data"])
    assert line["text/plain"].startswith("210 scenario-days in")
    assert line["text/html"] == line["text/plain"]


def test_progress_is_shown_in_a_notebook_unless_it_is_silenced(executed):
    _, (_, unasked), (_, silenced) = executed["progress"]
    assert [output["data"]["text/plain"].partition(" in ")[0] for output in unasked] == ["2 scenario-days"]
    assert not silenced
