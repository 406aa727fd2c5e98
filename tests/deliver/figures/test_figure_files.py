"""Figures are written as PNG, PDF or SVG: whole or not at all, the same bytes every time."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.image import imread

from fastcoil.base import figures as files
from fastcoil.base.errors import StorageError

STARTS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.fixture
def figure():
    drawn = Figure(figsize=(2.0, 1.5))
    drawn.subplots().plot([1, 3, 2])
    return drawn


@pytest.mark.parametrize("format", files.FIGURE_FORMATS)
def test_a_format_is_what_it_says_with_the_dots_asked_for(figure, tmp_path, format):
    (path,) = files.write_figures({"drawn": figure}, tmp_path / "new", format=format)
    assert path == tmp_path / "new" / f"drawn.{format}"
    assert path.read_bytes().startswith(STARTS[format])
    assert path.read_bytes() == files.encode_figure(figure, format)
    if format == "png":
        assert imread(path).shape[:2] == (300, 400)
        (path,) = files.write_figures({"drawn": figure}, tmp_path, dpi=100)
        assert imread(path).shape[:2] == (150, 200)


def test_a_matplotlibrc_of_the_user_changes_no_byte():
    def encoded():
        with files.apply_style():
            drawn = Figure(layout="constrained")
            axes = drawn.subplots()
            axes.plot(np.datetime64("2024-07-01T08:00", "s") + 3600 * np.arange(3), [1, 300, 2], label="one")
            axes.set(yscale="log", title="title")
            axes.legend()
        return files.encode_figure(drawn)

    settings = {"text.usetex": True, "font.family": "serif", "lines.marker": "o", "savefig.bbox": "tight"}
    expected = encoded()
    with rc_context(settings | {"timezone": "Asia/Tokyo", "xtick.labelsize": 20, "axes.facecolor": "k"}):
        assert encoded() == expected


@pytest.mark.parametrize(
    ("options", "code"), [({"format": "pgn"}, "choice"), ({"dpi": 20}, "value"), ({"dpi": True}, "type")]
)
def test_another_format_or_resolution_is_refused(options, code):
    assert_refused(*options, code, files.check_format, **{"format": "png", "dpi": 200} | options)


def test_a_figure_that_cannot_be_written_leaves_the_old_file(figure, tmp_path, monkeypatch):
    (tmp_path / "drawn.png").write_text("old")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(StorageError, match=r"drawn\.png cannot be written: No space left"):
        files.write_figures({"drawn": figure}, tmp_path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("drawn.png", "old")]


RESULT_HASH, OTHER_HASH = "1a" * 32, "2b" * 32


@pytest.mark.parametrize("format", files.FIGURE_FORMATS)
def test_a_figure_carries_the_hash_of_its_results_which_no_title_can_fake(figure, tmp_path, format):
    figure.suptitle(f"content_sha256 {OTHER_HASH} /Keywords (content_sha256 {OTHER_HASH})")
    (path,) = files.write_figures({"drawn": figure}, tmp_path, format=format, drawn_from=RESULT_HASH)
    assert path.read_bytes() == files.encode_figure(figure, format, drawn_from=RESULT_HASH)
    assert files.read_origin(path) == RESULT_HASH
    (plain,) = files.write_figures({"plain": figure}, tmp_path, format=format)
    assert files.read_origin(plain) is None


def test_figures_of_other_results_are_stale_and_those_that_do_not_say_are_neither(figure, tmp_path):
    folder = tmp_path / "figures"
    for name, drawn_from in (("mine", RESULT_HASH), ("old", OTHER_HASH), ("unknown", None)):
        files.write_figures({name: figure}, folder, drawn_from=drawn_from)
        files.write_figures({name: figure}, folder, format="svg", drawn_from=drawn_from)
    (folder / "notes.txt").write_text(f"content_sha256 {OTHER_HASH}")
    (folder / "folder.png").mkdir()
    assert files.current_figures(tmp_path, RESULT_HASH) == [folder / "mine.png", folder / "mine.svg"]
    assert files.stale_figures(tmp_path, RESULT_HASH) == [folder / "old.png", folder / "old.svg"]
    assert files.stale_figures(tmp_path / "none", RESULT_HASH) == []


def test_a_label_with_dollars_is_no_formula(figure):
    figure.axes[0].set_title("Saving $5 or $x^$")
    figure.axes[0].set_xticks([0.0], ["$x^$"])
    assert files.encode_figure(figure).startswith(b"\x89PNG")
