"""``fc.compare(…).to_table()``: what it says to people is what the Dataset says."""

import copy
import pickle
import re

import numpy as np
import pytest
from helpers.results import result

import fastcoil as fc

NUMBER = re.compile(r"[+−]?[\d.,]+")


def numbers(text):
    return [float(n.replace("−", "-").replace(",", "")) for n in NUMBER.findall(text)]


@pytest.fixture(scope="module")
def ds():
    rng = np.random.default_rng(1)
    rmse = np.array([1.0, 0.8, 0.79])[:, None, None] * rng.uniform(0.5, 1.5, (1, 12, 6)) + 0.02 * rng.random((3, 12, 6))
    return result(
        ("estimate_ratio", "sample", "day"), {"estimate_ratio": [0.0, 0.5, 1.0]}, rmse=rmse, share_off=0.1 * rmse,
        learn_time_reached=np.full(rmse.shape, np.nan), half_periods=np.full(rmse.shape, np.nan),
    )  # fmt: skip


def compared(ds, **options):
    return fc.compare(ds, baseline={"estimate_ratio": 0.0}, over=["sample", "day"], **options)


def test_every_label_but_that_of_the_baseline_has_a_row_with_its_unit(ds):
    table = compared(ds, metrics=["rmse", "share_off"]).to_table()
    assert table.index.names == ["metric", "estimate / backlash [%]"]
    assert table.index.to_list() == [
        (metric, label) for metric in ("RMS error [K]", "share of time with |e| > 0.5 K [%]") for label in ("50", "100")
    ]
    assert list(table) == ["baseline", "value", "difference (95 %)", "lower in", "pairs"]


def test_the_numbers_are_those_of_the_dataset_to_the_digits_shown(ds):
    found = compared(ds, metrics="rmse", relative=True, threshold=0.05, level=0.9)
    table = found.to_table()
    row, at = table.loc["RMS error [K]", "100"], found.rmse.sel(estimate_ratio=1.0)
    assert numbers(row["difference (90 %)"]) == pytest.approx(
        [100 * float(at.sel(statistic=s)) for s in ("mean", "low", "high")], abs=0.5
    )
    assert re.fullmatch(r"−[\d.]+ % \(−[\d.]+ to −[\d.]+\)", row["difference (90 %)"])
    assert numbers(row["lower by 5 % in (90 %)"]) == [
        round(100 * float(at.sel(statistic=f"share_below{edge}"))) for edge in ("", "_low", "_high")
    ]
    assert numbers(row["baseline"]) == pytest.approx([float(at.sel(statistic="baseline"))], rel=5e-3)
    assert row["pairs"] == "72"


def test_a_difference_has_the_digits_that_its_interval_leaves():
    ds = result(("kp", "day"), rmse=[[1.0, 1.0, 1.0], [0.8, 0.75, 0.78]])
    table = fc.compare(ds, baseline={"kp": 0}, over="day").to_table()
    # Student's interval of -0.20, -0.25, -0.22: -0.2233 ± 4.303 · 0.02517 / √3
    assert table["difference (95 %)"].to_list() == ["−0.22 (−0.29 to −0.16)"]


def test_an_absolute_threshold_is_told_in_the_unit_of_the_reader(ds):
    table = compared(ds, metrics="share_off", threshold=0.01).to_table()
    assert "lower by 1 % in (95 %)" in table
    row, at = table.iloc[0], compared(ds, metrics="share_off").share_off.sel(estimate_ratio=0.5)
    assert numbers(row["difference (95 %)"])[0] == pytest.approx(100 * float(at.sel(statistic="mean")), rel=0.05)
    assert "lower in (95 %)" in compared(ds, metrics="rmse", threshold=0.0).to_table()


def test_what_never_came_is_told_and_what_no_pair_has_is_left_out(ds):
    some = ds.copy(deep=True)
    some.learn_time_reached[2, :, :] = 3600.0
    table = compared(some).to_table()
    assert "counted half periods" not in table.index.get_level_values("metric")
    row = table.loc["time to reach the backlash [h]", "100"]
    assert (row["baseline"], row["value"], row["difference (95 %)"]) == ("never", "1", "median −∞")
    assert table.loc["time to reach the backlash [h]", "50"]["never"] == "72"
    assert "never" not in compared(some, metrics="rmse").to_table()


def test_parts_copies_and_pickles_have_the_table_too(ds):
    found = compared(ds, metrics="rmse")
    whole = found.to_table()
    part = found.sel(estimate_ratio=1.0).to_table()
    assert part.iloc[0].to_list() == whole.iloc[1].to_list()
    for other in (copy.deepcopy(found), pickle.loads(pickle.dumps(found)), found[["rmse"]]):
        assert other.to_table().equals(whole)
    assert len(found.sel(estimate_ratio=0.0).to_table()) == 0


def test_the_baseline_may_be_a_name_or_a_number_of_numpy():
    ds = result(
        ("controller", "kp", "day"), {"controller": ["pi", "inverse"]}, rmse=np.random.default_rng(2).random((2, 2, 4))
    )
    table = fc.compare(ds, baseline={"controller": np.str_("pi"), "kp": np.int64(1)}, over="day").to_table()
    assert table.index.to_list() == [
        ("RMS error [K]", c, k) for c, k in (("pi", "0"), ("inverse", "0"), ("inverse", "1"))
    ]


def test_a_selection_of_statistics_has_no_table(ds):
    with pytest.raises(fc.InputError, match=r"call it before .sel\(statistic="):
        compared(ds).sel(statistic="mean").to_table()
    with pytest.raises(fc.InputError, match="on what compare returned"):
        compared(ds).drop_attrs().to_table()
