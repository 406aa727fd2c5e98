"""Days of a weather file in sequence, with their dates: what is said of them, and of one that is run again."""

import pytest
from helpers.commands import fastcoil
from helpers.made_weather import write_weather

from fastcoil.loops import netcdf
from fastcoil.study import maintenance

pytestmark = pytest.mark.kernel

STUDY = """
[loop]
preset = "lbnl"
[sweep]
backlash = [0.0, 0.07]
[boundary]
kind = "weather"
path = "made.csv"
days = [1, 2]
hour = 1
hours = 2
m_a = 1.2
T_w_in = 7.0
T_set = 13.0
outdoor_fraction = 0.3
T_return = 24.0
RH_return = 0.5
[run]
carry_over = true
"""


@pytest.fixture(scope="module")
def finished_study(tmp_path_factory):
    """The folder of the results, and what was said."""
    folder = tmp_path_factory.mktemp("dated")
    write_weather(folder, 30.0, days=3)
    (folder / "dated.toml").write_text(STUDY)
    result = fastcoil("run", folder / "dated.toml", "-o", folder / "out", "-j", 1, "--no-figures")
    assert result.exit_code == 0, result.output
    return folder / "out", result.output


def test_the_summary_counts_days_and_threads(finished_study):
    _, output = finished_study
    assert "4 scenario-days (2 days × 2 values of backlash)" in output
    assert " s on 1 thread: " in output


def test_a_day_that_is_run_again_goes_on_from_the_one_before(finished_study, monkeypatch):
    monkeypatch.setattr(maintenance, "TRACES", ("T_sup",))
    folder, _ = finished_study
    again = fastcoil("rerun", folder, "--at", "day=2", "--at", "backlash=0.07")
    assert again.exit_code == 0, again.output
    assert "Equal to the study's result to the last bit." in again.output
    ds = netcdf.load(str(next((folder / "reruns").glob("day=2*.nc"))))
    assert ds["T_sup"].sizes["elapsed_time"] == 7200
