"""What tests of studies with code of their own share."""

import pytest


@pytest.fixture
def trace(tmp_path):
    """A file that is made when the code of the study is run."""
    from fastcoil.study.workers.own_code import _load

    _load.cache_clear()
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
