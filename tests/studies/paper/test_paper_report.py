"""The folder of the paper in quick mode: its data, figures and page."""

import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.pages import Page
from matplotlib.image import imread

from fastcoil.base.figures import encode_figure
from fastcoil.loops.netcdf import load
from fastcoil.loops.provenance import content_sha256
from studies.paper import figures

pytestmark = pytest.mark.kernel


FIGURES = ("fig01", "fig07", "fig09", "fig10", "fig11", "fig12")
GRIDS = ("quiet", "days", "learning", "starts", "coils")


def test_every_figure_is_drawn_as_png_and_svg_and_shows_something(folder):
    for name in (*FIGURES, "scorecard"):
        assert imread(folder / f"{name}.png")[..., :3].std() > 0.03, name
        assert (folder / f"{name}.svg").read_text().count("<path") > 10, name


def test_data_carry_units_and_their_hash(folder):
    for name in (*FIGURES, *(f"grid_{g}" for g in GRIDS)):
        ds = load(folder / f"{name}.nc")
        assert ds.attrs["content_sha256"] == content_sha256(ds), name
        assert all("units" in ds[n].attrs or "flag_meanings" in ds[n].attrs for n in ds.data_vars), ds
        assert name not in FIGURES or "Fig" in ds.attrs["caption"]


def test_a_figure_drawn_again_is_the_same_file(folder):
    figure = figures.draw_valve_curves(load(folder / "fig01.nc"))
    for suffix in ("png", "svg"):
        assert encode_figure(figure, suffix) == (folder / f"fig01.{suffix}").read_bytes()


@pytest.fixture(scope="module")
def figures_by_name(folder, card):
    """All figures, by name."""
    return {
        "fig01": figures.draw_valve_curves(load(folder / "fig01.nc")),
        "fig10": figures.draw_tracking(load(folder / "fig10.nc"), "95 %"),
        "fig11": figures.draw_estimates(load(folder / "fig11.nc")),
        "fig12": figures.draw_staircases(load(folder / "fig12.nc")),
        "scorecard": figures.draw_shares(card),
    }


def test_texts_fit_and_colours_are_those_of_the_palette(figures_by_name):
    for figure in figures_by_name.values():
        assert_palette(figure)
        assert_texts_fit(figure)


def test_every_claim_figure_and_warning_is_on_the_page(folder, card):
    page = Page(folder / "report.html")
    page.assert_self_contained()
    assert len(page.pictures) == 7
    assert page.text.index("Quick mode: too few tunings and days to be quoted.") < page.text.index("Answer")
    for claim in card["claims"]:
        assert f"{claim['claim']} ({claim['section']})" in page.text
        for kind, verdict in claim["kinds"].items():
            assert f"{kind}: {verdict['verdict_text']}" in page.text
    shares = [verdict["share"] for claim in card["claims"] for verdict in claim["kinds"].values()]
    n_hold, n_not = sum(share >= 0.95 for share in shares), sum(share <= 0.05 for share in shares)
    assert f"Of {len(shares)} verdicts, one for each claim and kind of day, {n_hold} say that it holds" in page.text
    assert f"{n_not} that it does not (5 % or less)" in page.text
    assert all(sha256 in page.text for sha256 in card["grid"]["content_sha256"].values())
