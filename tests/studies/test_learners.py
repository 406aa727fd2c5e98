"""``learners.py``: estimators that act on the same days, and its tables."""

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import days as kinds
from studies.learning import learners, learners_runs
from studies.learning.learners_runs import Condition

NAMES = list(learners_runs.controllers())


def test_days_are_as_long_as_asked_for_and_weather_has_the_asked_share_of_outdoor_air(weather_file):
    options = {"weather": weather_file, "hours": 3}
    mixed, outdoor = (kinds.make_days(kinds.WEATHER, [1], outdoor_fraction=f, **options) for f in (0.5, 1.0))
    assert mixed.n_steps == outdoor.n_steps == 3 * 3600
    # the other half is return air of 24 °C
    np.testing.assert_allclose(mixed.series["T_a_in"], 0.5 * (24.0 + outdoor.series["T_a_in"]), atol=0.05)
    assert kinds.make_days(kinds.DESIGN, [1]).n_steps == kinds.HOURS * 3600


@pytest.mark.kernel
def test_every_controller_acts_on_the_same_days_and_the_same_noise(monkeypatch):
    monkeypatch.setattr(learners_runs, "simc_gains", lambda loop, kind: xr.Dataset({"plant_gain": 12.0}))
    loop = learners_runs.select_loop(learners_runs.four_loops([0.07]), sample=[1])
    ds = learners_runs.simulate_condition(Condition("one", loop, kinds.STEPPED, [3, 4], hours=4))
    assert int(ds.status.max()) == 0
    rmse = {name: ds.rmse.sel(controller=name).values.ravel().tolist() for name in NAMES}
    idle_controllers = [name for name in NAMES[1:] if rmse[name] == rmse["pi"]]
    assert idle_controllers in ([], ["hagglund"]), "it may find nothing in four hours"
    days = kinds.make_days(kinds.STEPPED, [3, 4], hours=4)
    alone = fc.simulate(loop.assign(learning_step=0.007, learning_interval=1800, learning_ratio=2.0), days)
    loop_with_stroke = loop.assign(**learners_runs.controllers()["identify"], plant_gain=12.0, identify_stroke_time=0.0)
    estimates = fc.simulate(loop_with_stroke, days).estimate_final.values.ravel().tolist()
    assert ds.estimate_final.sel(controller="identify_stroke").values.ravel().tolist() == estimates
    assert max(estimates) > 0.0
    assert rmse["paper"] == alone.rmse.values.ravel().tolist()


@pytest.mark.full
@pytest.mark.kernel
def test_the_command_writes_every_table_and_the_figure(read_table, monkeypatch, tmp_path):
    monkeypatch.setattr(learners_runs, "kinds", lambda: (kinds.STEPPED, kinds.HEATING))
    for days in ("LOOP_DAYS", "VALVE_DAYS"):
        monkeypatch.setattr(learners_runs, days, [1, 2])
    learners.main(2)
    names = ("failures", "twenty", "worse", "good", "cost", "cost_morning")
    assert all(len(read_table(f"learners_{name}")[1]) > 3 for name in names)
    assert (tmp_path / "studies" / "learning" / "learners.png").stat().st_size > 20_000
