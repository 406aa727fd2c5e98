"""Labels that a user types, and changes against a case."""

import numpy as np
import pytest
import xarray as xr
from helpers.results import drawn, result

from fastcoil.base.errors import InputError
from fastcoil.model.metric_table import STATUS_NON_FINITE
from fastcoil.study.analysis.paired import relative_to
from fastcoil.study.analysis.selected import case_of, in_words, is_label, selected


@pytest.fixture
def ds():
    rng = np.random.default_rng(1)
    return result(
        ("backlash", "tuning", "day"), {"backlash": [0.0, 0.02, 0.07], "tuning": ["slow", "fast"]},
        rmse=rng.uniform(0.5, 1.0, (3, 2, 4)), reversals=rng.integers(0, 3, (3, 2, 4)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("label", "text", "same"),
    [
        (0.07, "0.07", True),
        (0.07, "7e-2", True),
        (0.07, "0.0701", False),
        (1, "1", True),
        (1, "one", False),
        ("1", "1", True),
        ("1", "1.0", False),
        (np.datetime64("2026-01-02"), "2026-01-02", True),
        (np.datetime64("2026-01-02"), "2026-01-03", False),
    ],
)
def test_a_text_means_a_label_and_no_neighbour_of_it(label, text, same):
    assert is_label(label, text) is same


def test_one_label_is_fixed_and_several_are_kept_in_order(ds):
    found = selected(ds, {"backlash": ["0.07"], "day": ["3", "1"]})
    xr.testing.assert_identical(found, ds.sel(backlash=0.07, day=[1, 3]))
    assert in_words(found, {"backlash": ["0.07"], "day": ["1", "3"]}) == "backlash = 7 %, day = 1 and 3"


def test_a_drawn_parameter_with_few_values_picks_its_samples():
    ds = drawn(50)
    found = selected(ds, {"sample_time": ["10"], "day": ["0"]})
    xr.testing.assert_identical(found, ds.isel(day=0, sample=np.flatnonzero(ds.sample_time.values == 10.0)))
    assert in_words(found, {"sample_time": ["10"]}) == "sample time = 10 s"


@pytest.mark.parametrize(
    ("at", "sentence"),
    [
        ({"backlash": ["0.08"]}, "--at backlash=0.08: choose one of 0.0, 0.02, 0.07"),
        ({"backlash": ["0.02", "much"]}, "--at backlash=much: choose one of 0.0, 0.02, 0.07"),
        ({"tuning": ["fastt"]}, "--at tuning=fastt: choose one of fast, slow"),
        ({"backlas": ["0.02"]}, "--at backlas: no label of this study, did you mean 'backlash'?; it has"),
    ],
)
def test_an_unknown_label_is_refused_with_those_that_there_are(ds, at, sentence):
    with pytest.raises(InputError) as caught:
        selected(ds, at)
    (problem,) = caught.value.problems
    assert problem.startswith(sentence)


def test_of_many_labels_the_nearest_are_listed_and_drawn_ones_have_another_way():
    ds = result(("backlash", "day"), {"backlash": np.linspace(0.0, 1.0, 101).round(2)}, rmse=np.ones((101, 1)))
    with pytest.raises(InputError, match="choose one of 0.49, 0.5, .*0.6$"):
        selected(ds, {"backlash": ["0.545"]})
    with pytest.raises(InputError, match="kp has a value of its own at each sample, none to choose from: take --at sa"):
        selected(drawn(50), {"kp": ["0.02"]})
    one = drawn(50)
    other = int(np.flatnonzero(one.sample_time.values != 10.0)[0])
    with pytest.raises(InputError, match="no scenario has all of these labels together"):
        selected(one, {"sample_time": ["10"], "sample": [str(other)]})


def test_changes_are_those_within_pairs(ds):
    case, words = case_of(ds, {"backlash": ["0"], "tuning": ["slow"]})
    assert (case, words) == ({"backlash": 0, "tuning": 0}, "backlash = 0 %, tuning = slow")
    found = relative_to(ds, case, words)
    expected = ds.rmse / ds.rmse.isel(backlash=0, tuning=0, drop=True) - 1.0
    xr.testing.assert_allclose(found.rmse, expected.isel(backlash=[1, 2], tuning=[1]).drop_attrs())
    assert found.rmse.attrs["relative_to"] == words


def test_of_nothing_there_is_no_change_and_a_failed_partner_has_none(ds):
    ds.status[0, 0, 1] = STATUS_NON_FINITE
    found = relative_to(ds, {"backlash": 0}, "backlash = 0 %")
    assert np.isnan(found.rmse[:, 0, 1]).all()
    before, after = ds.reversals[0, 1].values, ds.reversals[1, 1].values
    shown = found.reversals[0, 1].values
    assert (shown[(before == 0) & (after == 0)] == 0.0).all()
    assert np.isnan(shown[(before == 0) & (after > 0)]).all()
    with np.errstate(divide="ignore", invalid="ignore"):
        np.testing.assert_allclose(shown[before > 0], (after / before - 1.0)[before > 0])


@pytest.mark.parametrize(
    ("labels", "sentence"),
    [
        ({"backlash": ["0.1"]}, "--relative-to backlash=0.1: choose one of"),
        ({"backlash": ["0", "0.02"]}, "--relative-to backlash: give one label"),
        ({"kp": ["0"]}, "--relative-to kp: no dimension of what is drawn; it has backlash, tuning, day"),
    ],
)
def test_a_case_that_there_is_not_is_refused(ds, labels, sentence):
    with pytest.raises(InputError) as caught:
        case_of(ds, labels)
    assert str(caught.value).startswith(sentence)


def test_a_case_without_others_is_refused(ds):
    with pytest.raises(InputError, match="no other case to compare"):
        relative_to(ds.isel(tuning=[0]), {"tuning": 0}, "tuning = slow")
