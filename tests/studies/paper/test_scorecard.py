"""The scorecard: every claim with all its fields, the same as data, in Markdown and on the screen."""

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from fastcoil.loops.netcdf import load
from fastcoil.loops.presets import COOLING_PRESETS
from studies.paper import scorecard as verdicts
from studies.paper.claims import CLAIMS

pytestmark = pytest.mark.kernel


FIELDS = {"name", "section", "claim", "counts_as_holding", "n_tunings", "n_days", "change", "kinds"}
KIND_FIELDS = {
    *("verdict", "condition", "share", "share_interval", "share_of_hunting", "share_of_hunting_interval"),
    *("share_where_condition", "share_elsewhere", "share_of_days", "measured"),
}


def test_the_scorecard_has_every_claim_with_all_fields_on_every_kind_of_day(card):
    assert sorted(c["name"] for c in card["claims"]) == sorted(c.name for c in CLAIMS)
    for claim in card["claims"]:
        assert claim.keys() >= FIELDS
        for verdict in claim["kinds"].values():
            assert verdict.keys() >= KIND_FIELDS
            assert verdict["verdict"] in ("holds", "holds only if", "does not hold")
            shares = [verdict["share"], *verdict["share_of_days"].values(), *(verdict["share_interval"] or ())]
            assert all(0.0 <= share <= 1.0 for share in shares)
            assert verdict["share_of_days"].keys() >= set(COOLING_PRESETS)
            assert verdict["measured"].keys() >= {*COOLING_PRESETS, "grid"}
        by_day = claim["evidence"] not in ("quiet", "coils")
        assert list(claim["kinds"]) == (list(card["kinds"]) if by_day else [claim["evidence"]])
    assert "digitised" in card["caveat"]
    assert "Quick mode" in card["caveat"]
    assert list(card["kinds"]) == ["stepped", "design"]
    of_hunting = {c["name"]: c["kinds"] for c in card["claims"]}
    without = {name for name, kinds in of_hunting.items() for k in kinds.values() if k["share_of_hunting"] is None}
    assert without == {"hunts", "volumes"}


@pytest.mark.parametrize(
    ("name", "case", "factor", "other_case"),
    [
        ("rises", "100 %", 1.01, "120 %"),
        ("against best PI", "95 %", 1 / 0.99, "best PI"),
        ("best PI alone", "best PI", 1 / 0.99, "95 %"),
        ("best against best", "best inverse", 1 / 0.99, "best PI"),
        ("against dead band", "95 %", 1 / 0.99, "dead band"),
    ],
)
def test_a_share_is_what_plain_python_counts(folder, card, name, case, factor, other_case):
    """Tunings × days of a kind on which the error of the other case is over 1 % larger, without those that hunt."""
    quiet, days = load(folder / "grid_quiet.nc"), load(folder / "grid_days.nc")
    (claim,) = (c for c in card["claims"] if c["name"] == name)
    for kind in card["kinds"]:
        exceeds = []
        for tuning in quiet.tuning.values:
            if not bool(quiet.hunts.sel(case="no backlash", tuning=tuning)):
                rmse = days.rmse.sel(kind=kind, tuning=tuning)
                pairs = zip(rmse.sel(case=case).values, rmse.sel(case=other_case).values, strict=True)
                exceeds += [b > factor * a for a, b in pairs]
        assert claim["kinds"][kind]["share"] == pytest.approx(sum(exceeds) / len(exceeds))
        assert claim["n_tunings"] * claim["n_days"] == len(exceeds)


TUNINGS = xr.Dataset(
    {"sample_time": ("tuning", np.repeat([1.0, 10.0, 15.0, 30.0], 25)), "kp": ("tuning", np.full(100, 0.03))}
)


@pytest.mark.parametrize(
    ("n", "word"), [(100, "holds"), (95, "holds"), (94, "holds only if"), (6, "holds only if"), (5, "does not hold")]
)
def test_the_share_decides(n, word):
    verdict = verdicts.judge_claim(xr.DataArray(np.arange(100) < n, dims="tuning"), TUNINGS)
    assert (verdict.word, verdict.share) == (word, n / 100)


def test_a_region_that_tells_nothing_does_not_look_as_if_it_did():
    """Its shares are not those of the tunings on which it was the best of many."""
    rng, few = np.random.default_rng(3), TUNINGS.isel(tuning=slice(None, None, 4))
    few = few.assign(kp=("tuning", rng.uniform(0.005, 0.05, 25)), ti=("tuning", rng.uniform(10.0, 200.0, 25)))
    judgements = [verdicts.judge_claim(xr.DataArray(rng.random(25) < 0.5, dims="tuning"), few) for _ in range(200)]
    differences = [judgement.inside - judgement.elsewhere for judgement in judgements if judgement.condition]
    assert len(differences) > 50
    assert np.mean(differences) == pytest.approx(0.0, abs=3 * np.std(differences) / len(differences) ** 0.5)


def test_an_interval_covers_the_share_of_other_days_as_often_as_it_says():
    """Days are alike for all tunings, so that a thousand tunings tell no more than a few."""
    rng = np.random.default_rng(1)
    n_studies, n_days, n_tunings = 400, 6, 1000
    of_day = rng.normal(0.5, 0.1, (n_studies, n_days, 1))
    holds = xr.DataArray(rng.random((n_studies, n_days, n_tunings)) < of_day, dims=("study", "day", "tuning"))
    intervals = [verdicts.share_interval(study) for study in holds]
    assert np.mean([low <= 0.5 <= high for low, high in intervals]) == pytest.approx(0.95, abs=0.03)
    expected = stats.ttest_1samp(holds[0].mean("tuning"), 0.0).confidence_interval(0.95)
    np.testing.assert_allclose(intervals[0], expected)


def test_a_condition_is_found_with_its_shares():
    slow = TUNINGS.sample_time >= 15.0
    days = xr.concat([slow, slow & (TUNINGS.sample_time > 15.0)], "day")
    verdict = verdicts.judge_claim(days, TUNINGS)
    assert verdict.condition == "the sample time is 15 s or more"
    assert (verdict.inside, verdict.elsewhere) == (pytest.approx(0.75, abs=0.1), 0.0)
    inside = round(100 * verdict.inside)
    assert verdict.text == f"holds only if the sample time is 15 s or more ({inside} % there, 0 % elsewhere)"
    verdict = verdicts.judge_claim(slow | (np.arange(slow.size) % 4 == 0), TUNINGS)
    assert verdict.elsewhere > 0.05
    assert verdict.text.startswith(f"holds in part, more often if {verdict.condition} (")
