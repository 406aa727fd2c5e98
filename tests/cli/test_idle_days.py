"""Days of a weather year on which the fan stands: what is said of them, and of one that is run again."""

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
kind = "weather_year"
path = "weather.csv"
year = 2023
days = [1, 2]                # a Sunday and a Monday
set_point = "fixed"
[run]
carry_over = true
"""


@pytest.fixture(scope="module")
def finished_study(tmp_path_factory):
    """The folder of the results, and what was said."""
    folder = tmp_path_factory.mktemp("idle")
    write_weather(folder, 30.0, days=3).rename(folder / "weather.csv")
    (folder / "idle.toml").write_text(STUDY)
    result = fastcoil("run", folder / "idle.toml", "-o", folder / "out", "-j", 1, "--no-figures")
    assert result.exit_code == 0, result.output
    return folder / "out", result.output


def test_the_summary_counts_days_on_which_the_loop_was_off(finished_study):
    _, output = finished_study
    assert "In 2 of 4 the loop was off all day: they have no RMSE, and count in no median." in output
    assert " s on 1 thread: " in output


def test_a_day_that_is_run_again_has_its_date_and_time(finished_study, monkeypatch):
    monkeypatch.setattr(maintenance, "TRACES", ("T_sup",))
    folder, _ = finished_study
    again = fastcoil("rerun", folder, "--at", "day=2", "--at", "backlash=0.07")
    assert again.exit_code == 0, again.output
    assert "Equal to the study's result to the last bit." in again.output
    ds = netcdf.load(str(next((folder / "reruns").glob("day=2*.nc"))))
    assert str(ds["start"].values)[:19] == "2023-01-02T00:00:00"
    assert str(ds["time"].values[-1])[:19] == "2023-01-02T23:59:59"
