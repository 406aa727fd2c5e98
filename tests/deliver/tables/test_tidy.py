"""CSV: every scenario-day once, as xarray's own ``to_dataframe`` has it; units and the study."""

import numpy as np
import pandas as pd
import pytest
from helpers.results import drawn

import fastcoil.deliver.tables as tidy
from fastcoil.base.errors import InputError, StorageError
from fastcoil.deliver.tables import Tidy, check_metrics, write_csv

ATTRS = {
    "title": "A title,\nwith # and a line",
    "content_sha256": "f" * 64,
    "fastcoil_version": "0",
    "parameters": "{}",
}


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch):
    monkeypatch.setattr(tidy, "_ROWS", 7)


@pytest.fixture
def ds():
    """Two days, 12 samples, two named tunings; one failed, one without a value, flags."""
    found = drawn(12, attrs=ATTRS)
    found = found.expand_dims(tuning=["as found", "faster"]).transpose("day", "tuning", "sample")
    found["learning_status"] = found.rmse * 0.0 + np.arange(12) % 6
    found["learning_status"].attrs = {"flag_meanings": "off learning stepped_down stopped no_evidence not_identifiable"}
    found["T_sup"] = found.rmse.expand_dims(elapsed_time=3)
    found = found.copy(deep=True)
    found.rmse[0, 1, 2] = np.nan
    found.status[0, 1, 2] = 2
    return found


def expected(ds, names):
    """xarray's own table, in the order of the file, with words for flags."""
    frame = ds[names].to_dataframe().reset_index()
    for name in (n for n in ("status", "learning_status") if n in names):
        frame[name] = np.array(ds[name].attrs["flag_meanings"].split())[frame[name].to_numpy().astype(int)]
    return frame


NAMES = ["rmse", "iae", "learning_status", "status"]


def test_csv_says_first_what_it_is_of_and_is_read_back_as_it_was(ds, tmp_path):
    write_csv(Tidy(ds), tmp_path / "t.csv")
    head = (tmp_path / "t.csv").read_text().splitlines()[:4]
    assert head[:3] == [
        "# title: A title, with # and a line", "# fastcoil_version: 0", f"# content_sha256: {'f' * 64}",
    ]  # fmt: skip
    assert head[3].startswith("day,tuning,sample,")
    found = pd.read_csv(tmp_path / "t.csv", comment="#")
    units = {"kp [K-1]": "kp", "ti [s]": "ti", "sample_time [s]": "sample_time", "rmse [K]": "rmse", "iae [K h]": "iae"}
    assert set(units) <= set(found)
    frame = expected(ds, NAMES)
    assert len(found) == 48
    pd.testing.assert_frame_equal(
        found.rename(columns=units)[list(frame)], frame, check_dtype=False, check_column_type=False
    )


def test_a_label_with_the_sign_of_a_comment_comes_back_whole(ds, tmp_path):
    odd = ds.assign_coords(tuning=["#1", 'a, "b"'])
    write_csv(Tidy(odd, ("rmse",)), tmp_path / "t.csv")
    found = pd.read_csv(tmp_path / "t.csv", comment="#")
    assert found.tuning.unique().tolist() == ["#1", 'a, "b"']
    assert found["rmse [K]"].isna().sum() == 1


def test_no_text_starts_a_formula_in_a_spreadsheet(ds, tmp_path):
    odd = ds.assign_coords(tuning=["=1+1", "@SUM(A1)"]).assign_attrs(title="fans, =HYPERLINK(1)")
    write_csv(Tidy(odd, ("rmse",)), tmp_path / "t.csv")
    text = (tmp_path / "t.csv").read_text()
    assert text.startswith("# title: fans, '=HYPERLINK(1)\n")
    assert set(pd.read_csv(tmp_path / "t.csv", comment="#").tuning) == {"'=1+1", "'@SUM(A1)"}


def test_metrics_may_be_picked_and_fixed_labels_stay_as_columns(ds):
    table = Tidy(ds.isel(tuning=1), ("iae", "iae", "status"))
    assert table.columns == ["day", "sample", "tuning", "kp", "ti", "sample_time", "iae", "status"]
    rows = pd.concat(table.pieces())
    assert set(rows.tuning) == {"faster"}
    assert len(rows) == table.n_rows == 24


@pytest.mark.parametrize(
    ("metrics", "sentence"),
    [
        (("rmsee",), "--metric 'rmsee' is not in this result, did you mean 'rmse'?"),
        (("T_sup",), "--metric T_sup has values along elapsed_time"),
    ],
)
def test_what_is_no_column_is_refused(ds, metrics, sentence):
    with pytest.raises(InputError) as caught:
        check_metrics(ds, metrics)
    (problem,) = caught.value.problems
    assert problem.startswith(sentence)


def test_a_table_that_cannot_be_finished_leaves_nothing(ds, tmp_path, monkeypatch):
    pieces = Tidy.pieces

    def break_off(table):
        yield next(pieces(table))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Tidy, "pieces", break_off)
    with pytest.raises(StorageError, match="No space left"):
        write_csv(Tidy(ds), tmp_path / "t")
    assert not any(tmp_path.iterdir())
