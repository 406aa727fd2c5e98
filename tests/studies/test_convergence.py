"""``numerics.py``: its tables hold what plain Python finds in small runs."""

import re
import statistics

import pytest
from scipy.stats import t

import fastcoil as fc
from studies.numerics import numerics

pytestmark = pytest.mark.kernel

DAYS = range(7, 10)


@pytest.mark.full
def test_steps_are_compared_day_by_day_with_the_finest(written, monkeypatch):
    monkeypatch.setattr(numerics, "SUBSTEPS", (1, 8, 32))
    monkeypatch.setattr(numerics, "SHOWN", (("lagged", 1), ("quasistatic", 8)))
    paper_day, heating_day = fc.paper_day, fc.heating_day
    monkeypatch.setattr(fc, "paper_day", lambda hours, seed: paper_day(hours=1, seed=seed))
    monkeypatch.setattr(fc, "heating_day", lambda hours, **given: heating_day(hours=1, **given))
    ds = numerics.steps(DAYS)
    numerics.write_steps(ds)
    numerics.write_backlash(ds)
    (_, *table), (_, *of_gap) = written("convergence_steps")[1], written("convergence_backlash")[1]
    assert [row[:3] for row in table[:2]] == [["paper_like", "lagged", "1"], ["paper_like", "quasistatic", "8"]]
    for name, march, n, rmse, *_ in table:
        at = {"preset": name, "backlash": 0.07}
        finest = ds.rmse.sel(**at, air_march="quasistatic", substeps=32).values.tolist()
        given = ds.rmse.sel(**at, air_march=march, substeps=int(n)).values.tolist()
        each = [100 * (a - b) / statistics.mean(finest) for a, b in zip(given, finest, strict=True)]
        half = t.ppf(0.975, 2) * statistics.stdev(each) / 3**0.5
        shown = [float(x) for x in re.findall(r"-?[\d.]+", rmse)]
        assert shown == pytest.approx([statistics.mean(each), half][: len(shown)], abs=0.06)
    alone = fc.simulate(
        fc.Loop.preset("g36").assign(backlash=0.15, converged=True), paper_day(hours=1, seed=list(DAYS))
    )
    (row,) = (row for row in of_gap if row[:2] == ["g36", "15%"])
    assert row[2].split(" → ")[1] == f"{float(alone.rmse.mean()):.3f}"
