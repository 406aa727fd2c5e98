"""``fastcoil plot``: formats, resolutions, and mistakes in a sentence."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from matplotlib.image import imread

from fastcoil.cli.main import main

pytestmark = pytest.mark.kernel

SMALL = "[loop]\n[sweep]\nbacklash = [0.02, 0.07]\nestimate_ratio = [0.0, 0.5, 1.2]\n[boundary]\nhours = 1\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished study without figures."""
    path = tmp_path_factory.mktemp("plotted")
    (path / "small.toml").write_text(SMALL)
    words = ["run", str(path / "small.toml"), "-o", str(path / "out"), "--no-figures"]
    assert CliRunner().invoke(main, words).exit_code == 0
    return path / "out"


def plot(*words):
    return CliRunner().invoke(main, ["plot", *map(str, words)])


@pytest.mark.parametrize(
    ("format", "start"),
    [pytest.param("png", b"\x89PNG", marks=pytest.mark.full), ("pdf", b"%PDF"), ("svg", b"<?xml")],
)
def test_the_standard_figures_are_written_in_the_format_asked_for(folder, format, start):
    result = plot(folder, "--format", format)
    assert result.exit_code == 0, result.output
    paths = [folder / "figures" / f"{name}.{format}" for name in ("maps", "bands")]
    assert result.output.splitlines() == [str(path) for path in paths]
    for path in paths:
        assert path.read_bytes().startswith(start)


def test_dots_per_inch_are_those_asked_for(folder):
    words = (folder, "-x", "backlash", "--metric", "rmse")
    sizes = []
    for more in ((), ("--dpi", 100)):
        assert plot(*words, *more).exit_code == 0
        sizes.append(imread(folder / "figures" / "rmse_backlash.png").shape)
    assert sizes[0][:2] == (2 * sizes[1][0], 2 * sizes[1][1])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--format", "jpg"), "format = 'jpg', did you mean 'png'?: choose 'png', 'pdf' or 'svg'"),
        (("--dpi", "20"), "dpi = 20: give a whole number from 50 to 1200"),
        (("--dpi", "fine"), "dpi = 'fine': give a whole number from 50 to 1200"),
        (("--by", "backlash"), "--metric, -y and --by need -x: name the swept parameter along the x axis"),
    ],
)
def test_a_mistake_is_one_sentence_and_draws_nothing(folder, words, sentence):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    result = plot(folder, *words)
    assert result.exit_code == 2
    assert result.output == f"fastcoil: {sentence}\n"
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
