"""``fastcoil paper``: its files in quick mode, and mistakes."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from fastcoil.base.figures import encode
from fastcoil.cli.main import main
from fastcoil.deliver.figures import paper as figures
from fastcoil.loops.netcdf import load
from fastcoil.loops.provenance import content_sha256

pytestmark = pytest.mark.kernel

FIGURES = ("fig01", "fig07", "fig09", "fig10", "fig11", "fig12")
GRIDS = ("quiet", "days", "learning", "starts", "coils")


@pytest.mark.parametrize("name", [*FIGURES, "scorecard"])
def test_every_figure_is_drawn_as_png_and_svg_and_shows_something(folder, name):
    from matplotlib.image import imread

    assert imread(folder / f"{name}.png")[..., :3].std() > 0.03
    assert (folder / f"{name}.svg").read_text().count("<path") > 10


@pytest.mark.parametrize("name", [*FIGURES, *(f"grid_{g}" for g in GRIDS)])
def test_data_carry_units_and_their_hash(folder, name):
    ds = load(folder / f"{name}.nc")
    assert ds.attrs["content_sha256"] == content_sha256(ds)
    assert all("units" in ds[n].attrs or "flag_meanings" in ds[n].attrs for n in ds.data_vars), ds
    assert name not in FIGURES or "Fig" in ds.attrs["caption"]


def test_a_figure_drawn_again_is_the_same_file(folder):
    figure = figures.valve_curves(load(folder / "fig01.nc"))
    for suffix in ("png", "svg"):
        assert encode(figure, suffix) == (folder / f"fig01.{suffix}").read_bytes()


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (("-o", "file"), 2, "file is a file: choose another folder"),
        (("-o", "file/below"), 4, "file/below cannot be made"),
        (("-j", "0"), 2, "n_jobs = 0"),
    ],
)
def test_a_mistake_is_one_sentence_and_writes_nothing(tmp_path, monkeypatch, words, code, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    result = CliRunner().invoke(main, ["paper", "--quick", *words])
    assert result.exit_code == code
    assert sentence in result.output
    assert "Traceback" not in result.output
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"
