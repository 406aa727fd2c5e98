"""The study of heating: conditions within reach, the rule of choice, and its rows."""

import numpy as np
import pytest

import fastcoil as fc
from studies.common import STUDIES
from studies.heating import backlash, heating

pytestmark = pytest.mark.kernel


def test_conditions_are_within_reach_before_and_after_the_step():
    loop = heating.good("heating")
    of = heating.conditions(loop, 3, 5)
    ds = fc.simulate(loop, of.boundary, traces=["T_sup", "opening"], trace_interval=60, n_jobs=1)
    for second, more in ((heating.STEP_AT - 60, 0.0), (heating.SECONDS - 60, heating.STEP)):
        at = ds.sel(elapsed_time=second)
        assert np.abs(at.T_sup - (of.T_set + more)).max() < 0.2
        assert ((at.opening > 0.01) & (at.opening < 0.98)).all()


def test_a_response_has_the_overshoot_and_the_settling_time_of_its_trace():
    loop = heating.good("heating", ti=30.0)
    of = heating.conditions(loop, 3, 2)
    found = heating.response(loop, of)
    ds = fc.simulate(loop, of.boundary, traces=["T_sup"], trace_interval=heating.SEEN, n_jobs=1)
    for day in (0, 1):
        T = ds.T_sup.isel(day=day).values[heating.STEP_AT // heating.SEEN :]
        share = ((T - of.T_set[day]) / heating.STEP).tolist()
        assert float(found.overshoot[day]) == pytest.approx(max(0.0, max(share) - 1.0))
        last = max(k for k, x in enumerate(share) if abs(x - 1.0) > 0.05)
        assert float(found.settling[day]) == (last + 1) * heating.SEEN


def test_the_presets_have_the_gains_that_the_study_chose():
    text = (STUDIES / "heating" / "tables" / "heating_choice.md").read_text()
    (chosen,) = [line for line in text.splitlines() if line.endswith("| chosen |")]
    kp, ti = (float(cell) for cell in chosen.split("|")[1:3])
    for name in backlash.PRESETS:
        assert (fc.Loop.preset(name)["kp"], fc.Loop.preset(name)["ti"]) == (kp, ti)
