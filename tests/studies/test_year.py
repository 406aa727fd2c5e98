"""The study of a year: what backlash costs, from the study file to the tables."""

import re

import numpy as np
import pytest
from helpers.made_weather import write_weather

import fastcoil as fc
from studies.common import study_file
from studies.year import year

DAYS = [2, 3]
"""Of 2023: Monday and Tuesday."""


@pytest.fixture(scope="module")
def ds(tmp_path_factory):
    """Two hot days of the study with four loops."""
    folder = tmp_path_factory.mktemp("year")
    weather = write_weather(folder, lambda h: 27.0 + 4.0 * np.sin(2.0 * np.pi * (h - 9.0) / 24.0), T_dew=12.0)
    study = folder / "year.toml"
    study.write_text(re.sub(r"size = \d+", "size = 4", study_file("year").read_text()))
    return year.simulate_year(weather, DAYS, study)


@pytest.mark.kernel
def test_the_year_wears_and_is_one_sequence(ds):
    assert int(ds["status"].max()) == 0
    assert ds.attrs["carry_over"] == 1
    gap = ds["backlash_final"]
    assert bool((gap.sel(valve="sound") == 0.0).all())
    assert bool((gap.sel(valve=["new", "used", "loose"]).diff("day") > 0.0).all())
    # wear by itself: what the stem has travelled, counted or not, is at least what the days counted
    growth = gap.isel(day=-1) - ds["backlash"]
    assert bool((growth >= 1e-4 * ds["stem_travel"].sum("day") * (ds["backlash"] > 0.0) - 1e-12).all())


@pytest.mark.kernel
def test_rows_compare_each_loop_with_its_own_sound_valve(ds):
    rows = {(row[0], row[1]): row for row in year.cost_rows(ds)}
    assert len(rows) == 4 * 3 - 1
    costs = fc.cost(ds, **year.TARIFF)["yearly_cost"]
    extra_cost = costs.sel(valve="loose", controller="pi") - costs.sel(valve="sound", controller="pi")
    assert float(rows["loose", "plain PI"][2].split()[0]) == pytest.approx(float(extra_cost.median()), abs=0.051)
    parts = [float(cell) for cell in rows["loose", "plain PI"][5:]]
    assert sum(parts) == pytest.approx(float(extra_cost.mean()), abs=0.21)


@pytest.mark.kernel
def test_the_tables_and_the_figure_are_written(ds, read_table, monkeypatch, tmp_path):
    monkeypatch.setattr(year, "simulate_year", lambda: ds)
    year.main()
    head, *rows = read_table("year_valve")[1]
    assert len(rows) == 12
    assert all(len(row) == len(head) for row in rows)
    assert [row[0] for row in rows[:3]] == ["sound"] * 3
    assert (tmp_path / "studies" / "year" / "year.png").stat().st_size > 10_000
