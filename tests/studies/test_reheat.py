"""``reheat.py``: its days are what they say, and its tables count what plain Python counts."""

import numpy as np
import pytest

import fastcoil as fc
from studies.reheat import reheat


def test_days_of_each_kind_move_what_they_say():
    days = {kind: reheat.winter_day(kind, 5) for kind in (reheat.CONSTANT, reheat.SETBACK, reheat.LOAD)}
    moves = {kind: {name for name, values in day.items() if np.ptp(values) > 0.0} for kind, day in days.items()}
    both = {"T_a_in", "T_w_in", "T_out"}
    assert moves == {reheat.CONSTANT: both, reheat.SETBACK: both | {"T_set"}, reheat.LOAD: both | {"Q_room"}}


@pytest.mark.kernel
def test_the_range_of_the_discharge_air_is_that_of_whole_hours_in_the_median(monkeypatch):
    monkeypatch.setattr(reheat, "CONTROLLERS", {reheat.PI: {}})
    loop = fc.Loop.preset("reheat").assign(kp=0.3, ti=300.0, backlash=("sample", [0.0, 0.15]))
    days = reheat.days_of(reheat.CONSTANT, (5,), hours=6)
    ds = reheat.run_boxes(loop, {}, days).sel(controller=reheat.PI).isel(day=0)
    T_sup = fc.simulate(loop, days, warm_up=reheat.WARM_UP, traces=["T_sup"], trace_interval=60).T_sup.isel(day=0)
    for k in range(2):
        minutes = T_sup.isel(sample=k).values[reheat.WARM_UP // 60 :].reshape(-1, 60)
        assert float(ds.discharge[k]) == pytest.approx(np.median(minutes.max(axis=1) - minutes.min(axis=1)))
    assert ds.discharge[1] > 2.0 * ds.discharge[0]


@pytest.mark.kernel
def test_tables_have_a_row_for_each_kind_and_controller(monkeypatch):
    monkeypatch.setattr(reheat, "CONTROLLERS", {n: reheat.CONTROLLERS[n] for n in (reheat.PI, "`identify`")})
    loop = reheat.boxes(6)
    by_kind = {reheat.CONSTANT: reheat.run_boxes(loop, {}, reheat.days_of(reheat.CONSTANT, (5, 6), hours=3))}
    rows = reheat.controller_rows("gains", by_kind)
    assert [row[:3] for row in rows] == [["gains", "constant", reheat.PI], ["gains", "constant", "`identify`"]]
    (found,) = reheat.found_rows({"gains": by_kind})
    assert found[2].startswith("0 %"), "nothing is found in three hours"
