"""CSV: every scenario-day once, as xarray's own ``to_dataframe`` has it; units and the study."""

import numpy as np
import pandas as pd
import pytest
from helpers.refusals import assert_refused
from helpers.results import drawn_result

import fastcoil.deliver.tables as tidy
from fastcoil.base.errors import StorageError
from fastcoil.deliver.tables import TidyTable, check_metrics, write_csv

ATTRS = {
    "title": "A title,\nwith # and a line",
    "content_sha256": "f" * 64,
    "fastcoil_version": "0",
    "parameters": "{}",
}


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch):
    monkeypatch.setattr(tidy, "_ROWS_PER_PIECE", 7)


@pytest.fixture
def ds():
    """Two days, 12 samples, two named tunings; one failed, one without a value, flags."""
    result = drawn_result(12, attrs=ATTRS)
    result = result.expand_dims(tuning=["as found", "faster"]).transpose("day", "tuning", "sample")
    result["learning_status"] = result.rmse * 0.0 + np.arange(12) % 6
    result["learning_status"].attrs["flag_meanings"] = "off learning stepped_down stopped no_evidence not_identifiable"
    result["T_sup"] = result.rmse.expand_dims(elapsed_time=3)
    result = result.copy(deep=True)
    result.rmse[0, 1, 2] = np.nan
    result.status[0, 1, 2] = 2
    return result


def expected_frame(ds, names):
    """xarray's own table, in the order of the file, with words for flags."""
    frame = ds[names].to_dataframe().reset_index()
    for name in (n for n in ("status", "learning_status") if n in names):
        frame[name] = np.array(ds[name].attrs["flag_meanings"].split())[frame[name].to_numpy().astype(int)]
    return frame


NAMES = ["rmse", "iae", "learning_status", "status"]


def test_csv_says_first_what_it_is_of_and_is_read_back_as_it_was(ds, tmp_path):
    write_csv(TidyTable(ds), tmp_path / "t.csv")
    head = (tmp_path / "t.csv").read_text().splitlines()[:4]
    assert head[:3] == [
        "# title: A title, with # and a line", "# fastcoil_version: 0", f"# content_sha256: {'f' * 64}",
    ]  # fmt: skip
    assert head[3].startswith("day,tuning,sample,")
    table = pd.read_csv(tmp_path / "t.csv", comment="#")
    units = {"kp [K-1]": "kp", "ti [s]": "ti", "sample_time [s]": "sample_time", "rmse [K]": "rmse", "iae [K h]": "iae"}
    assert set(units) <= set(table)
    frame = expected_frame(ds, NAMES)
    assert len(table) == 48
    ours = table.rename(columns=units)[list(frame)]
    pd.testing.assert_frame_equal(ours, frame, check_dtype=False, check_column_type=False)


def test_a_label_with_the_sign_of_a_comment_comes_back_whole(ds, tmp_path):
    odd = ds.assign_coords(tuning=["#1", 'a, "b"'])
    write_csv(TidyTable(odd, ("rmse",)), tmp_path / "t.csv")
    table = pd.read_csv(tmp_path / "t.csv", comment="#")
    assert table.tuning.unique().tolist() == ["#1", 'a, "b"']
    assert table["rmse [K]"].isna().sum() == 1


@pytest.mark.parametrize("start", ["=", "@", " =", "\uff1d", "\u3000+", "\ufeff\uff0d", '"=', "\x0b\ufe6b"])
def test_no_text_starts_a_formula_in_a_spreadsheet(ds, tmp_path, start):
    odd = ds.assign_coords(tuning=[f"{start}1+1", f"a,{start}1"]).assign_attrs(title="fans, =HYPERLINK(1)")
    write_csv(TidyTable(odd, ("rmse",)), tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text().startswith("# title: fans, '=HYPERLINK(1)\n")
    unseen, sign = start[:-1], start[-1]
    tunings = set(pd.read_csv(tmp_path / "t.csv", comment="#").tuning)
    assert tunings == {f"{unseen}'{sign}1+1", f"a,{unseen}'{sign}1"}


def test_metrics_may_be_picked_and_fixed_labels_stay_as_columns(ds):
    table = TidyTable(ds.isel(tuning=1), ("iae", "iae", "status"))
    assert table.columns == ["day", "sample", "tuning", "kp", "ti", "sample_time", "iae", "status"]
    rows = pd.concat(table.pieces())
    assert set(rows.tuning) == {"faster"}
    assert len(rows) == table.n_rows == 24


@pytest.mark.parametrize(("metric", "code"), [("rmsee", "name"), ("T_sup", "shape")])
def test_what_is_no_column_is_refused(ds, metric, code):
    assert_refused("--metric", code, check_metrics, ds, (metric,))


def test_a_table_that_cannot_be_finished_leaves_nothing(ds, tmp_path, monkeypatch):
    pieces = TidyTable.pieces

    def break_off(table):
        yield next(pieces(table))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(TidyTable, "pieces", break_off)
    with pytest.raises(StorageError, match="No space left"):
        write_csv(TidyTable(ds), tmp_path / "t")
    assert not any(tmp_path.iterdir())
