"""``fastcoil plot``: formats, resolutions, and mistakes in a sentence."""

import re

import pytest
from helpers.commands import assert_command_refused, fastcoil
from helpers.full import full_except

pytestmark = pytest.mark.kernel

SMALL_STUDY = (
    "[loop]\n[sweep]\nbacklash = [0.02, 0.07]\nestimate_ratio = [0, 0.2, 0.5, 0.8, 1, 1.1, 1.2]\n"
    "[boundary]\nhours = 1\n"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished study without figures."""
    path = tmp_path_factory.mktemp("plotted")
    (path / "small.toml").write_text(SMALL_STUDY)
    assert fastcoil("run", path / "small.toml", "-o", path / "out", "--no-figures").exit_code == 0
    return path / "out"


def plot(*words):
    return fastcoil("plot", *words)


def read_files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("format", "start"), full_except([("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")], [("pdf", b"%PDF")])
)
@pytest.mark.usefixtures("blank_figures")
def test_the_standard_figures_are_written_in_the_format_asked_for(folder, format, start):
    result = plot(folder, "--format", format)
    assert result.exit_code == 0, result.output
    paths = [folder / "figures" / f"bands.{format}"]
    assert result.output.splitlines() == [str(path) for path in paths]
    for path in paths:
        assert path.read_bytes().startswith(start)


@pytest.mark.parametrize(
    "words",
    [
        *("--dpi fine", "--by backlash", "--width 84", "--width 20mm", "-o figure.pdf --format png", "-o figure.jpg"),
        *(f"-x backlash {axes}" for axes in ("-y backlash", "--by backlash", "-y estimate_ratio --by kp", "--by day")),
        *("-x estimate --metric rms", "--at backlash=0.05"),
    ],
)
def test_a_mistake_is_one_sentence_and_draws_nothing(folder, words):
    before = read_files(folder)
    assert_command_refused("plot", folder, *words.split())
    assert read_files(folder) == before


def test_a_figure_goes_where_it_is_sent_in_the_format_of_its_name(folder, tmp_path):
    before = read_files(folder)
    result = plot(folder, "-x", "backlash", "--metric", "rmse", "-o", tmp_path / "one.pdf", "--width", "84mm")
    assert result.exit_code == 0, result.output
    assert [path.name for path in tmp_path.iterdir()] == ["one.pdf"]
    width = re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", (tmp_path / "one.pdf").read_bytes())
    assert float(width[1]) == pytest.approx(84 / 25.4 * 72, abs=0.01)
    assert plot(folder, "--at", "backlash=0.02", "-o", tmp_path / "many").exit_code == 0
    assert [path.name for path in (tmp_path / "many").iterdir()] == ["bands_backlash=0.02.png"]
    assert read_files(folder) == before


def test_labels_are_told_in_the_name_and_in_the_heading(folder):
    result = plot(folder, "--at", "backlash=0.07", "--format", "svg")
    assert result.exit_code == 0, result.output
    path = folder / "figures" / "bands_backlash=0.07.svg"
    assert result.output == f"{path}\n"
    figure_text = re.sub(r"\s+", " ", " ".join(re.findall(r">([^<>]+)</text>", path.read_text())))
    assert "small, at backlash = 7 %" in figure_text


def test_a_plain_pi_and_an_inverse_have_rows_of_their_own_and_labels_without_one_are_counted(folder, tmp_path):
    assert plot(folder, "-x", "backlash", "--metric", "rmse", "-o", tmp_path / "rows.svg").exit_code == 0
    text = " ".join(re.findall(r">([^<>]+)</text>", (tmp_path / "rows.svg").read_text()))
    assert "shown are 3 of 7 values of estimate / backlash" in text
    for words in ("estimate / backlash = 0 %, plain PI", "estimate / backlash = 80 %", "estimate / backlash = 120 %"):
        assert words in text
