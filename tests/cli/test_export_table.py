"""``fastcoil export`` of results: files that others read, and mistakes in a sentence."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from helpers.commands import assert_command_refused, fastcoil
from helpers.results import drawn_result

import fastcoil as fc

STUDY = """
[loop]
preset = "lbnl"
[sweep]
estimate_ratio = [0.0, 1.0]
[sample]
method = "sobol"
size = 32
kp = { loguniform = [0.005, 0.05] }
[boundary]
hours = 1
seed = [1, 2]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished study of 128 scenario-days."""
    path = tmp_path_factory.mktemp("exported") / "study.toml"
    path.write_text(STUDY)
    fc.run_study(path, path.with_name("small"), n_jobs=1)
    return path.with_name("small")


@pytest.fixture
def run_export(tmp_path, monkeypatch):
    """Return a function that runs the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return partial(fastcoil, "export")


@pytest.mark.kernel
def test_a_name_of_ours_replaces_our_own_file_and_no_other(folder, run_export, tmp_path):
    words = (folder, "--csv", "--metric", "rmse")
    for _ in range(2):
        assert run_export(*words).exit_code == 0
    (table,) = tmp_path.iterdir()
    table.write_bytes(b"elapsed_time,T_sup\n0,14.2\n")
    assert_command_refused("export", *words)
    assert table.read_bytes() == b"elapsed_time,T_sup\n0,14.2\n"


@pytest.mark.kernel
def test_a_folder_its_file_and_a_saved_result_give_the_same_table(folder, run_export, tmp_path):
    ds = fc.open_study(folder)
    ds.to_netcdf(tmp_path / "mine.nc")
    assert run_export(folder, "--csv").output == "Written: small.csv (128 scenario-days, 40 columns)\n"
    assert [run_export(path, "--csv").exit_code for path in (folder / "results.nc", tmp_path / "mine.nc")] == [0, 0]
    csv_bytes = (tmp_path / "small.csv").read_bytes()
    assert csv_bytes == (tmp_path / "results.csv").read_bytes() == (tmp_path / "mine.csv").read_bytes()
    table = pd.read_csv(tmp_path / "small.csv", comment="#").set_index(["day", "estimate_ratio [1]", "sample"])
    expected = ds[["rmse", "motor_travel"]].to_dataframe()
    np.testing.assert_allclose(table["rmse [K]"], expected.rmse, rtol=1e-13)  # pandas 2 reads some one bit off
    np.testing.assert_allclose(table["kp [K-1]"], expected.kp, rtol=1e-13)
    assert f"# content_sha256: {ds.attrs['content_sha256']}" in csv_bytes.decode()


@pytest.mark.kernel
def test_a_table_has_what_is_asked_for(folder, run_export, tmp_path):
    result = run_export(folder, "--csv", "--metric", "rmse", "--at", "day=2", "-o", tmp_path / "part.csv")
    assert result.exit_code == 0, result.output
    part = pd.read_csv(tmp_path / "part.csv", comment="#")
    assert list(part) == ["estimate_ratio [1]", "sample", "kp [K-1]", "day", "rmse [K]", "status"]
    np.testing.assert_allclose(part["rmse [K]"], fc.open_study(folder).rmse.sel(day=2).values.ravel(), rtol=1e-13)


@pytest.mark.kernel
@pytest.mark.usefixtures("run_export")
def test_a_mistake_is_one_sentence_and_writes_nothing(folder, tmp_path):
    for words in ("", "--csv -o results.nc", "--csv --at day=3", "--csv --metric rmsee", "--csv --language c"):
        assert_command_refused("export", folder, *words.split())
        assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("run_export")
def test_what_is_no_result_is_refused(tmp_path):
    path = tmp_path / "table.nc"
    assert_command_refused("export", "table.nc", "--csv")
    path.write_text("a,b\n1,2\n")
    assert_command_refused("export", "table.nc", "--csv")
    path.unlink()
    drawn_result(3).drop_vars("status").to_netcdf(path)
    assert_command_refused("export", "table.nc", "--csv")


@pytest.mark.kernel
def test_an_unfinished_study_says_how_much_is_missing(run_export, tmp_path, interrupted_folder):
    result = run_export(interrupted_folder, "--csv", "-o", tmp_path / "part.csv")
    assert result.exit_code == 0
    assert "scenarios have not run (status not_run)" in result.output
    table = pd.read_csv(tmp_path / "part.csv", comment="#")
    assert 0 < (table.status == "not_run").sum() < len(table)
