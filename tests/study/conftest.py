"""What tests of studies with code of their own share."""

import pytest


@pytest.fixture
def trace(tmp_path):
    """A file that is made when the code of the study is run."""
    from fastcoil.study.file.user_code import load_function

    load_function.cache_clear()
    return tmp_path / "trace"


@pytest.fixture
def with_code(tmp_path, trace):
    """Return a function that writes a study file, and next to it code that leaves the trace when it is run."""

    def write(study, source):
        (tmp_path / "mine.py").write_text(source.format(trace=str(trace)))
        path = tmp_path / "study.toml"
        path.write_text(study)
        return path

    return write


@pytest.fixture
def leaves_nothing(tmp_path):
    """Check that no process outlives the test, and have dask put its files into the test's folder."""
    from helpers import processes

    dask = pytest.importorskip("dask")
    before = processes.living_descendants()
    with dask.config.set({"temporary-directory": str(tmp_path / "dask")}):
        yield
    new_processes = [p for pid, p in processes.living_descendants().items() if pid not in before]
    alive = [p for p in new_processes if not processes.have_ended([p], 3.0)]
    assert not alive, [p.cmdline() for p in alive]
