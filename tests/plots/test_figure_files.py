"""Figures are written as PNG, PDF or SVG: whole or not at all, the same bytes every time."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

import fastcoil as fc
from fastcoil.errors import StorageError
from fastcoil.plots import files

STARTS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.fixture
def figure():
    drawn = Figure(figsize=(2.0, 1.5))
    drawn.subplots().plot([1, 3, 2])
    return drawn


@pytest.mark.parametrize("format", files.FORMATS)
def test_a_format_is_what_it_says_and_the_same_every_time(figure, tmp_path, format):
    (path,) = files.write({"drawn": figure}, tmp_path / "new", format=format)
    assert path == tmp_path / "new" / f"drawn.{format}"
    assert path.read_bytes().startswith(STARTS[format])
    assert path.read_bytes() == files.encode(figure, format)


def test_dots_per_inch_are_those_asked_for_and_at_least_150(figure, tmp_path):
    (path,) = files.write({"drawn": figure}, tmp_path)
    assert imread(path).shape[:2] == (300, 400)
    (path,) = files.write({"drawn": figure}, tmp_path, dpi=100)
    assert imread(path).shape[:2] == (150, 200)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"format": "pgn"}, "format = 'pgn', did you mean 'png'?: choose 'png', 'pdf' or 'svg'"),
        ({"format": "jpeg"}, "format = 'jpeg': choose 'png', 'pdf' or 'svg'"),
        ({"dpi": 20}, "dpi = 20: give a whole number from 50 to 1200"),
        ({"dpi": 150.5}, "dpi = 150.5: give a whole number from 50 to 1200"),
        ({"dpi": True}, "dpi = True: give a whole number from 50 to 1200"),
    ],
)
def test_another_format_or_resolution_is_refused_and_writes_nothing(figure, tmp_path, options, sentence):
    with pytest.raises(fc.InputError) as caught:
        files.write({"drawn": figure}, tmp_path / "new", **options)
    assert caught.value.problems == [sentence]
    assert not (tmp_path / "new").exists()


def test_a_figure_that_cannot_be_written_leaves_the_old_file(figure, tmp_path, monkeypatch):
    (tmp_path / "drawn.png").write_text("old")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(StorageError, match=r"drawn\.png cannot be written: No space left"):
        files.write({"drawn": figure}, tmp_path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("drawn.png", "old")]
