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
def test_every_row_is_what_a_simulation_of_that_tuning_gives(case, written, monkeypatch):
    monkeypatch.setattr(tuning, "CASES", (case,))
    found = {}
    monkeypatch.setattr(tuning, "tuned", lambda of, real=tuning.tuned: found.setdefault(of, real(of)))
    tuning.main()
    pi, inverse = found[case]
    _, (head, *rows) = written("tuning")
    fresh = case.loop(5, 2)
    days = kinds.of_kind(kinds.HEATING, tuning.FRESH_DAYS)
    loops = {
        tuning.OWN: fresh,
        tuning.PI: fresh.assign(**pi.parameters),
        tuning.INVERSE: fresh.assign(estimate_ratio=0.95, **inverse.parameters),
    }
    assert [row[1] for row in rows] == [tuning.OWN, tuning.SIMC, tuning.BEST, tuning.PI, tuning.INVERSE]
    for name, loop in loops.items():
        (row,) = [dict(zip(head, cells, strict=True)) for cells in rows if cells[1] == name]
        ds = fc.simulate(loop, days, n_jobs=1)
        worst = np.sort(ds.rmse.values.ravel())[int(np.ceil(0.95 * ds.rmse.size - 1e-9)) - 1]
        assert row["RMSE, 95 % quantile, K"].startswith(f"{worst:.3f} (")
        assert row["hunting"].startswith(f"{100 * float(ds.hunts.mean()):.0f} %")
    _, (_, kind_row) = written("tuning_kinds")
    both = [fc.simulate(loop, days, n_jobs=1).rmse.values for loop in (fresh, loops[tuning.PI])]
    assert kind_row[-2].startswith(f"{100 * (both[1] / both[0] - 1).mean():+.0f} %")
    assert inverse.limits[0].most == pi.limits[0].most, "the inverse travels no more than the plain preset"
