"""``tuning.py``: its tables hold what simulations of fresh valves and days give."""

import numpy as np
import pytest

import fastcoil as fc
from studies import days as kinds
from studies.tuning import tuning

pytestmark = pytest.mark.kernel


@pytest.fixture
def case(monkeypatch):
    """Few valves, short days, one case."""
    monkeypatch.setattr(kinds, "HOURS", 1)
    monkeypatch.setattr(tuning, "VALVES", 6)
    monkeypatch.setattr(tuning, "FRESH_VALVES", 5)
    monkeypatch.setattr(tuning, "EVALUATIONS", 12)
    monkeypatch.setattr("studies.robustness.best_pi.KP", np.array([0.02, 0.05]))
    monkeypatch.setattr("studies.robustness.best_pi.TI", np.array([40.0, 100.0]))
    return tuning.Case("lbnl", heating=True)


@pytest.mark.full
def test_every_row_is_what_a_simulation_of_that_tuning_gives(case, read_table, monkeypatch):
    monkeypatch.setattr(tuning, "CASES", (case,))
    tunings = {}
    monkeypatch.setattr(tuning, "tune_case", lambda of, real=tuning.tune_case: tunings.setdefault(of, real(of)))
    tuning.main()
    pi, inverse = tunings[case]
    _, (head, *rows) = read_table("tuning")
    fresh = case.loop(5, 2)
    days = kinds.make_days(kinds.HEATING, tuning.FRESH_DAYS)
    loops = {tuning.PRESET: fresh, tuning.TUNED_PI: fresh.assign(**pi.parameters)}
    loops[tuning.TUNED_INVERSE] = fresh.assign(estimate_ratio=0.95, **inverse.parameters)
    names = [tuning.PRESET, tuning.SIMC, tuning.BEST_PI, tuning.TUNED_PI, tuning.TUNED_INVERSE]
    assert [row[1] for row in rows] == names
    for name, loop in loops.items():
        (row,) = [dict(zip(head, cells, strict=True)) for cells in rows if cells[1] == name]
        ds = fc.simulate(loop, days, n_jobs=1)
        worst = np.sort(ds.rmse.values.ravel())[int(np.ceil(0.95 * ds.rmse.size - 1e-9)) - 1]
        assert row["RMSE, 95 % quantile, K"].startswith(f"{worst:.3f} (")
        assert row["hunting"].startswith(f"{100 * float(ds.hunts.mean()):.0f} %")
    _, (_, kind_row) = read_table("tuning_kinds")
    errors = [fc.simulate(loop, days, n_jobs=1).rmse.values for loop in (fresh, loops[tuning.TUNED_PI])]
    assert kind_row[-2].startswith(f"{100 * (errors[1] / errors[0] - 1).mean():+.0f} %")
    assert inverse.limits[0].most == pi.limits[0].most, "the inverse travels no more than the plain preset"
