"""The study of heating: conditions within reach, the rule of choice, and its rows."""

import numpy as np
import pytest

import fastcoil as fc
from studies.common import STUDIES
from studies.heating import backlash, heating

pytestmark = pytest.mark.kernel


def test_conditions_are_within_reach_before_and_after_the_step():
    loop = heating.good_valve_loop("heating")
    step_conditions = heating.conditions(loop, 3, 5)
    ds = fc.simulate(loop, step_conditions.boundary, traces=["T_sup", "opening"], trace_interval=60, n_jobs=1)
    for second, step in ((heating.STEP_AT - 60, 0.0), (heating.DAY_SECONDS - 60, heating.STEP_SIZE)):
        at_second = ds.sel(elapsed_time=second)
        assert np.abs(at_second.T_sup - (step_conditions.T_set + step)).max() < 0.2
        assert ((at_second.opening > 0.01) & (at_second.opening < 0.98)).all()


def test_a_response_has_the_overshoot_and_the_settling_time_of_its_trace():
    loop = heating.good_valve_loop("heating", ti=30.0)
    step_conditions = heating.conditions(loop, 3, 2)
    response = heating.step_response(loop, step_conditions)
    every = heating.RESPONSE_INTERVAL
    ds = fc.simulate(loop, step_conditions.boundary, traces=["T_sup"], trace_interval=every, n_jobs=1)
    for day in (0, 1):
        T = ds.T_sup.isel(day=day).values[heating.STEP_AT // every :]
        share = ((T - step_conditions.T_set[day]) / heating.STEP_SIZE).tolist()
        assert float(response.overshoot[day]) == pytest.approx(max(0.0, max(share) - 1.0))
        last = max(k for k, x in enumerate(share) if abs(x - 1.0) > 0.05)
        assert float(response.settling[day]) == (last + 1) * every


def test_the_presets_have_one_pair_of_the_gains_that_the_study_finds_calm():
    """It settles within a fifth of the soonest, which the printed march made it."""
    text = (STUDIES / "heating" / "tables" / "heating_choice.md").read_text()
    rows = {line.rpartition("| ")[2].strip(" |"): line.split("|")[1:5] for line in text.splitlines() if "yes, " in line}
    kp, ti = (float(cell) for cell in rows["yes, the presets"][:2])
    for name, column in zip(backlash.PRESETS, (2, 3), strict=True):
        assert (fc.Loop.preset(name)["kp"], fc.Loop.preset(name)["ti"]) == (kp, ti)
        own, soonest = (float(rows[of][column].split(",")[1]) for of in ("yes, the presets", "yes, settles soonest"))
        assert own < 1.2 * soonest
