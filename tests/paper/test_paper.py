"""``fastcoil paper``: figures, scorecard and data in quick mode, the whole grid, mistakes."""

from __future__ import annotations

import json

import jsonschema
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.paper import figures, grid, runs
from fastcoil.paper.claims import CLAIMS
from fastcoil.simulation.dataset import load
from fastcoil.simulation.presets import PRESETS
from fastcoil.simulation.stability import stable

pytestmark = pytest.mark.kernel

FIGURES = ("fig01", "fig07", "fig09", "fig10", "fig11", "fig12")
GRIDS = ("quiet", "days", "learning", "starts", "coils")
NUMBER = {"type": "number", "minimum": 0, "maximum": 1}
INTERVAL = {"type": ["array", "null"], "items": NUMBER, "minItems": 2, "maxItems": 2}
CLAIM_SCHEMA = {
    "type": "object",
    "required": ["name", "section", "claim", "counts_as_holding", "measured", "verdict", "condition", "share",
                 "share_interval", "share_of_hunting", "share_of_hunting_interval", "share_of_days", "n_tunings",
                 "n_days"],
    "properties": {
        "section": {"type": "string", "pattern": "^[0-9]"},
        "claim": {"type": "string", "minLength": 10},
        "counts_as_holding": {"type": "string", "minLength": 10},
        "verdict": {"enum": ["holds", "holds only if", "does not hold"]},
        "condition": {"type": ["string", "null"]},
        "share": NUMBER,
        "share_interval": INTERVAL,
        "share_of_hunting_interval": INTERVAL,
        "share_where_condition": NUMBER | {"type": ["number", "null"]},
        "share_of_hunting": NUMBER | {"type": ["number", "null"]},
        "share_elsewhere": NUMBER | {"type": ["number", "null"]},
        "n_tunings": {"type": "integer", "minimum": 1},
        "n_days": {"type": "integer", "minimum": 1},
        "share_of_days": {"required": list(PRESETS), "additionalProperties": NUMBER},
        "measured": {
            "required": [*PRESETS, "grid"],
            "additionalProperties": {"minProperties": 1, "additionalProperties": {"type": ["number", "null"]}},
        },
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the quick mode writes."""
    out = tmp_path_factory.mktemp("paper") / "new"
    result = CliRunner().invoke(main, ["paper", "--quick", "-j", "2", "-o", str(out)])
    assert result.exit_code == 0, result.output
    (out / "said.txt").write_text(result.stdout)
    return out


@pytest.fixture(scope="module")
def card(folder):
    return json.loads((folder / "scorecard.json").read_text())


@pytest.mark.parametrize("name", [*FIGURES, "scorecard"])
def test_every_figure_is_drawn_as_png_and_svg_and_shows_something(folder, name):
    from matplotlib.image import imread

    assert imread(folder / f"{name}.png")[..., :3].std() > 0.03
    assert (folder / f"{name}.svg").read_text().count("<path") > 10


@pytest.mark.parametrize("name", [*FIGURES, *(f"grid_{g}" for g in GRIDS)])
def test_data_carry_units_and_their_hash(folder, name):
    ds = load(folder / f"{name}.nc")
    assert all("units" in ds[n].attrs or "flag_meanings" in ds[n].attrs for n in ds.data_vars), ds
    assert name not in FIGURES or "Fig" in ds.attrs["caption"]


def test_the_scorecard_has_every_claim_with_all_fields(card):
    assert [c["name"] for c in card["claims"]] == [c.name for c in CLAIMS]
    for claim in card["claims"]:
        jsonschema.validate(claim, CLAIM_SCHEMA)
    assert "digitised" in card["caveat"]
    assert "Quick mode" in card["caveat"]
    of_hunting = {claim["name"]: claim["share_of_hunting"] for claim in card["claims"]}
    assert {name for name, share in of_hunting.items() if share is None} == {"hunts", "volumes"}


def test_the_scorecard_to_read_and_the_screen_say_the_same(folder, card):
    text, said = (folder / "scorecard.md").read_text(), (folder / "said.txt").read_text()
    for claim in card["claims"]:
        assert claim["claim"] in said
        limits = claim["share_interval"]
        within = " ({:.0f} to {:.0f})".format(*(100 * x for x in limits)) if limits else ""
        assert f"| {claim['claim']} | {claim['verdict_text']} | {runs.percent(claim['share'])}{within} |" in text
    assert runs.arithmetic() in text
    for table in text.split("\n\n"):
        assert len({line.count(" | ") for line in table.splitlines() if line.startswith("|")}) <= 1
    assert len(said.splitlines()) < 60
    assert "scorecard.md" in said


def test_the_arithmetic_of_the_three_hours_is_what_happens(folder):
    literal = load(folder / "fig12.nc").sel(rule="literal")
    for hours, words, times in (
        (4.5, "= 4.5 h", literal.learn_time_reached),
        (5.5, "5.5 h until", literal.learn_time_confirmed),
    ):
        assert words in runs.arithmetic()
        np.testing.assert_array_equal(times, 3600.0 * hours)
    before = literal.estimate.sel(elapsed_time=slice(0, runs.THREE_HOURS - 1)).max("elapsed_time")
    np.testing.assert_allclose(before, 0.042)
    assert "4.2 % at most" in runs.arithmetic()


def test_switches_of_the_figure_are_those_of_the_metric(folder):
    ds = load(folder / "fig12.nc")
    counted = ds.switches.sel(block_start=slice(1800, None)).mean("block_start")
    np.testing.assert_allclose(counted.transpose(*ds.switch_frequency.dims), ds.switch_frequency)


def test_a_figure_drawn_again_is_the_same_file(folder):
    figure = figures.valve_curves(load(folder / "fig01.nc"))
    for suffix in ("png", "svg"):
        assert figures.image(figure, suffix) == (folder / f"fig01.{suffix}").read_bytes()


def test_results_do_not_depend_on_the_number_of_threads():
    loop = grid.tunings(quick=True)
    one, two = (grid.quiet(loop, n_jobs).attrs["content_sha256"] for n_jobs in (1, 2))
    assert one == two


# -------------------------------------------------------------------------------------------------- the whole grid


def test_the_grid_has_at_least_500_tunings_and_the_presets_by_name():
    loop = grid.tunings()
    assert loop.sizes["tuning"] >= 500
    assert grid.named(loop["kp"]["tuning"]) == list(PRESETS)
    lbnl = loop["stroke_time"].sel(tuning="lbnl")
    assert float(lbnl) == fc.Loop.preset("lbnl")["stroke_time"]
    for start, step in grid.STARTS_AND_STEPS:
        updates = np.ceil((runs.BACKLASH - start) / step) + 2
        assert updates * runs.INTERVAL < grid.LONG_HOURS * 3600


def test_the_buffer_is_six_deviations_of_the_noise_on_the_output():
    loop = grid.tunings(quick=True)
    buffers = runs.buffers(xr.DataArray([0.0, 1.0], dims="case"), loop)
    np.testing.assert_allclose(buffers.isel(case=1), 6 * 0.05 * loop["kp"])
    assert (buffers.isel(case=0) == 1e-9).all()


def test_stable_says_what_a_simulation_refuses(short):
    loop = fc.Loop(n_volumes=[8, 9])
    assert stable(loop, short).values.tolist() == [True, False]
    with pytest.raises(fc.InputError, match="unstable"):
        fc.simulate(loop, short, warm_up=0)


# -------------------------------------------------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (("-o", "file"), 2, "file is a file: choose another folder"),
        (("-o", "file/below"), 4, "file/below cannot be made"),
        (("-j", "0"), 2, "n_jobs = 0"),
    ],
)
def test_a_mistake_is_told_in_one_sentence_and_writes_nothing(tmp_path, monkeypatch, words, code, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    result = CliRunner().invoke(main, ["paper", "--quick", *words])
    assert result.exit_code == code
    assert sentence in result.output
    assert "Traceback" not in result.output
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"
