"""``fastcoil paper``: figures and scorecard in quick mode, criteria on made-up results, the rule of the verdicts."""

from __future__ import annotations

import json

import jsonschema
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from scipy import stats

import fastcoil as fc
from fastcoil.cli import main
from fastcoil.paper import figures, grid, runs, verdicts
from fastcoil.paper.claims import CLAIMS
from fastcoil.results import load
from fastcoil.scenario import PRESETS
from fastcoil.stability import stable

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


# ------------------------------------------------------------------------------------------ the quick mode


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
        within = (
            "" if claim["n_days"] == 1 else " ({:.0f} to {:.0f})".format(*(100 * x for x in claim["share_interval"]))
        )
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
        np.testing.assert_array_equal(times, hours * H)
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


# -------------------------------------------------------------------------------------------- the whole grid


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


# -------------------------------------------------------------------------------------- criteria, both ways

H = 3600.0


def by_case(metric, **values):
    """A result of one tuning and day: a metric by case."""
    names = [name.replace("_", " ").replace("pct", " %") for name in values]
    data = np.array(list(values.values()))[:, None, None]
    return xr.Dataset(
        {metric: (("case", "tuning", "day"), data)}, coords={"case": names, "tuning": ["made up"], "day": [1]}
    )


def ratios(metric, *values):
    """The metric for all estimates in turn."""
    ds = by_case(metric, **{f"c{k}": v for k, v in enumerate(values)})
    return ds.assign_coords(case=[grid.case(r) for r in grid.RATIOS[: len(values)]])


def learned(case, first_down, confirmed, step=0.007):
    ds = by_case("estimate_first_down", a=first_down).assign_coords(case=[case])
    ds["learn_time_confirmed"] = ds.estimate_first_down * 0 + confirmed
    return ds.assign_coords(learning_step=("case", [step]))


def noisy(literal, noise):
    return xr.concat([learned("literal", literal, 5.5 * H), learned("noise", noise, 5.5 * H)], "case")


def buffered(switches, rmse):
    """Switches of the inverse with noise and buffer, where there are 5 without noise, and its error; the PI's is 1."""
    names = ["95 %", "95 %, noise, buffer", "plain PI, noise"]
    ds = by_case("switch_frequency", a=5.0, b=switches, c=3.0).assign_coords(case=names)
    return ds.merge(by_case("rmse_settled", a=0.1, b=rmse, c=1.0).assign_coords(case=names))


def hunting(without, with_it):
    return by_case("hunts", no_backlash=without, plain_PI=with_it).isel(day=0, drop=True)


def largest(n):
    return xr.Dataset({"largest": ("tuning", [n])})


def renamed(ds, **names):
    return ds.assign_coords(case=[names.get(str(c), str(c)) for c in ds.case.values])


FLAT = (6.0, 6.1, 6.2, 6.3, 6.4, 6.5, 6.6)
FALLING = (1.0, 0.9, 0.8, 0.6, 0.4, 0.2, 0.1, 0.05)
NOISE_CASES = {"a": "95 %", "b": "95 %, noise"}
MADE_UP = {
    "hunts": (hunting(False, True), hunting(True, True)),
    "fluctuates": (
        by_case("rmse_settled", no_backlash=0.1, plain_PI=0.21), by_case("rmse_settled", no_backlash=0.1, plain_PI=0.19)
    ),
    "sixty": (
        ratios("rmse_settled", 1.0, 0, 0, 0, 0.5, 0, 0, 0, 0.1), ratios("rmse_settled", 1.0, 0, 0, 0, 1.1, 0, 0, 0, 0.1)
    ),
    "ninety-five": (
        by_case("rmse_settled", no_backlash=0.1, plain_PI=1.1, **{"95pct": 0.19}),
        by_case("rmse_settled", no_backlash=0.1, plain_PI=1.1, **{"95pct": 0.21}),
    ),
    "unity": (
        by_case("rmse_settled", no_backlash=0.100, **{"100pct": 0.104}),
        by_case("rmse_settled", no_backlash=0.100, **{"100pct": 0.106}),
    ),
    "flat": (ratios("switch_frequency", *FLAT), ratios("switch_frequency", *FLAT[:-1], 9.5)),
    "jump": (
        by_case("switch_frequency", **{"10pct": 6.0, "110pct": 13.0}),
        by_case("switch_frequency", **{"10pct": 6.0, "110pct": 11.0}),
    ),
    "falls": (ratios("rmse", *FALLING, 0.04), ratios("rmse", *FALLING[:4], 0.7, *FALLING[5:], 0.04)),
    "rises": (
        by_case("rmse", **{"100pct": 0.100, "120pct": 0.102}), by_case("rmse", **{"100pct": 0.100, "120pct": 0.1005})
    ),
    "rises, settled": (
        by_case("rmse_settled", **{"100pct": 0.100, "120pct": 0.102}),
        by_case("rmse_settled", **{"100pct": 0.100, "120pct": 0.1005}),
    ),
    "best": (ratios("rmse", *FALLING, 0.06, 0.2, 0.3, 0.4), ratios("rmse", *FALLING, 0.06, 0.04, 0.3, 0.4)),
    "finds": (learned("literal", 0.077, 5.5 * H), learned("literal", 0.056, 5.5 * H)),
    "three hours": (learned("literal", 0.07, 2.9 * H), learned("literal", 0.07, 3.0 * H)),
    "three hours, every 15 min": (learned("every 15 min", 0.07, 2.9 * H), learned("every 15 min", 0.035, 1.0 * H)),
    "three hours, twice the step": (learned("twice the step", 0.07, 2.9 * H), learned("twice the step", 0.07, np.nan)),
    "three hours, growing steps": (learned("growing steps", 0.07, 2.9 * H), learned("growing steps", np.nan, np.nan)),
    "any start": (
        xr.concat([learned("a", 0.07, 1.0), learned("b", 0.056, 1.0, 0.014)], "case"),
        xr.concat([learned("a", 0.07, 1.0), learned("b", 0.056, 1.0, 0.007)], "case"),
    ),
    "volumes": (largest(8), largest(9)),
    "energy": (
        by_case("coil_energy", no_backlash=100.0, plain_PI=101.5),
        by_case("coil_energy", no_backlash=100.0, plain_PI=99.0),
    ),
    "peak": (
        by_case("coil_peak_power", no_backlash=100.0, plain_PI=101.5),
        by_case("coil_peak_power", no_backlash=100.0, plain_PI=100.5),
    ),
    "noise": (
        renamed(by_case("switch_frequency", a=5.0, b=11.0), **NOISE_CASES),
        renamed(by_case("switch_frequency", a=5.0, b=9.0), **NOISE_CASES),
    ),
    "buffer": (buffered(7.0, 0.2), buffered(8.0, 0.2)),
    "noise, learner": (noisy(0.07, 0.028), noisy(0.07, 0.077)),
    "buffer, learner": (learned("noise, buffer", 0.07, 5.5 * H), learned("noise, buffer", np.nan, np.nan)),
}  # fmt: skip
"""For each claim a result on which it holds, and one on which it does not."""


def test_every_claim_has_its_made_up_results():
    assert set(MADE_UP) == {claim.name for claim in CLAIMS}


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda c: c.name)
def test_a_claim_holds_where_it_should_and_not_where_it_should_not(claim):
    holds, not_so = (claim.holds(ds) for ds in MADE_UP[claim.name])
    assert bool(holds.all())
    assert not bool(not_so.any())
    assert "case" not in holds.dims


def test_a_buffer_must_help_control_too_and_noise_breaks_only_what_works():
    claims = {claim.name: claim.holds for claim in CLAIMS}
    assert not claims["buffer"](buffered(5.0, 1.2)).any()
    assert not claims["noise, learner"](noisy(0.028, 0.028)).any()


@pytest.mark.parametrize("claim", [c for c in CLAIMS if c.evidence in ("days", "learning")], ids=lambda c: c.name)
def test_a_failed_scenario_holds_nothing(claim):
    failed = MADE_UP[claim.name][0]
    assert not claim.holds(failed.assign({n: v * np.nan for n, v in failed.data_vars.items()})).any()


# ------------------------------------------------------------------------------------- the rule of the verdicts

TUNINGS = xr.Dataset(
    {"sample_time": ("tuning", np.repeat([1.0, 10.0, 15.0, 30.0], 25)), "kp": ("tuning", np.full(100, 0.03))}
)


@pytest.mark.parametrize(
    ("n", "word"), [(100, "holds"), (95, "holds"), (94, "holds only if"), (6, "holds only if"), (5, "does not hold")]
)
def test_the_share_decides(n, word):
    verdict = verdicts.judge(xr.DataArray(np.arange(100) < n, dims="tuning"), TUNINGS)
    assert (verdict.word, verdict.share) == (word, n / 100)


def test_an_interval_covers_the_share_of_other_days_as_often_as_it_says():
    """Days are alike for all tunings, so that a thousand tunings tell no more than a few."""
    rng = np.random.default_rng(1)
    n_studies, n_days, n_tunings = 400, 6, 1000
    of_day = rng.normal(0.5, 0.1, (n_studies, n_days, 1))
    holds = xr.DataArray(rng.random((n_studies, n_days, n_tunings)) < of_day, dims=("study", "day", "tuning"))
    found = [verdicts.interval(study) for study in holds]
    assert np.mean([low <= 0.5 <= high for low, high in found]) == pytest.approx(0.95, abs=0.03)
    expected = stats.ttest_1samp(holds[0].mean("tuning"), 0.0).confidence_interval(0.95)
    np.testing.assert_allclose(found[0], expected)


def test_an_interval_stays_within_0_and_1_and_needs_days():
    holds = xr.DataArray([[True, True], [True, True], [True, False]], dims=("day", "tuning"))
    low, high = verdicts.interval(holds)
    assert 0.0 <= low < 5 / 6 < high == 1.0
    np.testing.assert_allclose(verdicts.interval(~holds), (0.0, 1.0 - low))
    assert verdicts.interval(holds.isel(day=0)) is None
    assert verdicts.interval(holds.isel(day=[0])) is None


def test_a_condition_is_found_with_its_shares():
    slow = TUNINGS.sample_time >= 15.0
    days = xr.concat([slow, slow & (TUNINGS.sample_time > 15.0)], "day")
    verdict = verdicts.judge(days, TUNINGS)
    assert verdict.condition == "the sample time is 15 s or more"
    assert (verdict.inside, verdict.elsewhere) == (0.75, 0.0)
    assert verdict.text == "holds only if the sample time is 15 s or more (75 % there, 0 % elsewhere)"


def test_a_pair_of_regions_is_found_where_one_does_not_tell():
    kp = xr.DataArray(np.tile([0.005, 0.03], 50), dims="tuning")
    verdict = verdicts.judge((TUNINGS.sample_time >= 15.0) & (kp >= 0.02), TUNINGS.assign(kp=kp))
    assert " and " in verdict.condition
    assert (verdict.inside, verdict.elsewhere) == (1.0, 0.0)


def test_no_condition_is_named_where_none_tells_or_it_is_the_claim_itself():
    every_other = xr.DataArray(np.arange(100) % 2 == 0, dims="tuning")
    verdict = verdicts.judge(every_other, TUNINGS)
    assert verdict.condition is None
    assert "no region" in verdict.text
    known = xr.Dataset({"hunts": every_other})
    assert verdicts.judge(every_other, known).inside == 1.0
    assert verdicts.judge(every_other, known, about="hunts").condition is None


# ------------------------------------------------------------------------------------------------- mistakes


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
