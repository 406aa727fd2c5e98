"""Studies whose own reduction raises, or changes the process it runs in."""

import pytest
from click.testing import CliRunner

from fastcoil.cli.main import main

RAISING = """
class Mine(BaseException):
    def __init__(self, first, second):  # no other process can make it again from its text
        super().__init__(f"{first} {second}")

def f(traces):
    raise {what}
"""


@pytest.mark.kernel
@pytest.mark.usefixtures("leaves_nothing")
@pytest.mark.parametrize("backend", ["threads", "loky", pytest.param("dask", marks=pytest.mark.full)])
@pytest.mark.parametrize(
    ("what", "code", "sentence"),
    [
        ("Mine('two', 'words')", 2, "fastcoil: reduce = 'mine:f' raised Mine: two words"),
        pytest.param("SystemExit(0)", 2, "raised SystemExit: 0", marks=pytest.mark.full),
        pytest.param("GeneratorExit", 2, "raised GeneratorExit", marks=pytest.mark.full),
        pytest.param("RecursionError", 2, "raised RecursionError", marks=pytest.mark.full),
        pytest.param("MemoryError", 2, "raised MemoryError", marks=pytest.mark.full),
        pytest.param("KeyboardInterrupt", 130, "fastcoil: interrupted", marks=pytest.mark.full),
    ],
)
def test_whatever_a_reduction_raises_ends_the_run_with_a_sentence(
    tmp_path, small_study, request, backend, what, code, sentence
):
    text = small_study.read_text().replace('"T_sup", "mode"]', '"T_sup"]\nreduce = "mine:f"')
    (tmp_path / "study.toml").write_text(text)
    (tmp_path / "mine.py").write_text(RAISING.replace("{what}", what))
    words = ["run", tmp_path / "study.toml", "-o", tmp_path / "out", "--backend", backend, "-j", 1, "--no-figures"]
    if backend == "dask":
        words += ["--scheduler", request.getfixturevalue("two_workers").address]
    done = CliRunner().invoke(main, list(map(str, words)))
    assert done.exit_code == code, done.output
    (last,) = done.stderr.splitlines()[-1:]
    assert sentence in last
    assert "Traceback" not in done.output
