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
def test_steps_are_compared_day_by_day_with_the_finest(read_table, monkeypatch):
    monkeypatch.setattr(numerics, "SUBSTEPS", (1, 8, 32))
    monkeypatch.setattr(numerics, "SHOWN_WAYS", (("lagged", 1), ("quasistatic", 8)))
    paper_day, heating_day = fc.paper_day, fc.heating_day
    monkeypatch.setattr(fc, "paper_day", lambda hours, seed: paper_day(hours=1, seed=seed))
    monkeypatch.setattr(fc, "heating_day", lambda hours, **values: heating_day(hours=1, **values))
    ds = numerics.simulate_steps(DAYS)
    numerics.write_steps(ds)
    numerics.write_backlash(ds)
    (_, *table), (_, *backlash_rows) = read_table("convergence_steps")[1], read_table("convergence_backlash")[1]
    assert [row[:3] for row in table[:2]] == [["paper_like", "lagged", "1"], ["paper_like", "quasistatic", "8"]]
    for name, march, n, rmse, *_ in table:
        at = {"preset": name, "backlash": 0.07}
        finest = ds.rmse.sel(**at, air_march="quasistatic", substeps=32).values.tolist()
        values = ds.rmse.sel(**at, air_march=march, substeps=int(n)).values.tolist()
        changes = [100 * (a - b) / statistics.mean(finest) for a, b in zip(values, finest, strict=True)]
        half = t.ppf(0.975, 2) * statistics.stdev(changes) / 3**0.5
        numbers = [float(x) for x in re.findall(r"-?[\d.]+", rmse)]
        assert numbers == pytest.approx([statistics.mean(changes), half][: len(numbers)], abs=0.06)
    loop = fc.Loop.preset("g36").assign(backlash=0.15, converged=True)
    alone = fc.simulate(loop, paper_day(hours=1, seed=list(DAYS)))
    (row,) = (row for row in backlash_rows if row[:2] == ["g36", "15%"])
    assert row[2].split(" → ")[1] == f"{float(alone.rmse.mean()):.3f}"
