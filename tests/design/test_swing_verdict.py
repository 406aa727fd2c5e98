"""Whose swing it is: three sentences for three states, from one source, true of the loop with all else constant."""

import numpy as np
import pytest
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.design.swing_verdict import SwingVerdict, moving_inputs, still_boundary
from fastcoil.design.tuning_plan import plan_tuning

SECONDS = np.arange(8 * 3600)
OWN, FORCED = SwingVerdict(True, True, 6.2, 120.0, 6.5, ("the air flow",)), ("the air flow", "the water")


@pytest.mark.parametrize(
    "verdict",
    [
        OWN,
        OWN._replace(is_regular=False, swing=2.2),
        OWN._replace(is_regular=False, swing=2.2, movers=()),
        OWN._replace(is_own=False, swing=0.44, period=600.0, swing_alone=3.3e-15, movers=FORCED),
        OWN._replace(is_own=False, swing=0.44, period=600.0, swing_alone=0.12),
        OWN._replace(is_own=False, swing=0.44, period=np.nan, swing_alone=0.0, movers=("the entering air", *FORCED)),
        OWN._replace(is_own=False, swing=0.96, period=306.0, swing_alone=0.0, movers=FORCED, rings=True),
        OWN._replace(is_own=False, swing=0.1),
    ],
)
def test_each_state_has_its_sentence(verdict):
    assert_worded(f"This loop {verdict.clause}.  {verdict.reason}".rstrip())


def test_the_twins_of_a_day_stand_still_at_its_hours_and_set_points_and_keep_the_noise():
    day = fc.paper_day(hours=8).assign(noise=0.1 * np.sin(SECONDS), backlash_scale=1.0 + SECONDS / 3e4)
    still = still_boundary(day, 1800)
    assert (still.n_days, still.n_steps) == (12, 1800 + 3 * 3600)
    assert still.series["T_set"].mean() == pytest.approx(day.series["T_set"][0, 1800:].mean(), abs=0.3)
    assert moving_inputs(still.isel(day=3)) == ()
    np.testing.assert_allclose(still.series["noise"], np.tile(0.1 * np.sin(SECONDS[:12600]), (12, 1)))
    np.testing.assert_allclose(still.series["backlash_scale"], 1.0 + SECONDS.mean() / 3e4)
    assert still_boundary(fc.constant_day(hours=8), 600).n_days == 1
    assert moving_inputs(day) == ("the air", "the water", "the set-point")
    assert moving_inputs(fc.constant_day(hours=1).assign(T_a_in=np.linspace(20, 21, 3600))) == ("the entering air",)


@pytest.mark.kernel
def test_a_cycle_of_three_samples_hunts():
    e = fc.explain(fc.Loop.preset("paper_like").assign(backlash=0.1, kp=0.059, ti=5.4), fc.constant_day(hours=8))
    assert e.answer == "This loop hunts: ± 2 K every 90 s."


@pytest.mark.kernel
def test_a_loop_that_swings_irregularly_makes_its_swing():
    e = fc.explain(fc.Loop.preset("lbnl").assign(backlash=0.09, kp=0.03, ti=13.0), fc.paper_day(hours=8))
    assert e.answer.startswith("This loop keeps swinging, irregularly: about ± 0.48 K.  It makes the swing itself: ")
    assert "with constant air, water and set-point it still swings ± 0.51 K." in e.answer


@pytest.mark.kernel
def test_no_cure_that_is_calmer_makes_a_loop_hunt_that_swings_until_it_has_learned_its_gap():
    loop = fc.Loop.preset("lbnl").assign(kp=0.03, ti=10.0, estimator="identify")
    e = fc.explain(loop, fc.paper_day(hours=2))
    assert e.answer.startswith("This loop hunts: ± 1.6 K every 2.8 min.")
    swing = e.cures["hunting_swing"].values
    assert "makes it hunt" not in e.cures["verdict"].values[swing <= swing[0]]
    assert e.cures["verdict"].sel(cure="simc") == "cures it"
    assert fc.explain(loop, fc.paper_day(hours=8)).answer.startswith("This loop does not hunt.  T_sup swings ± 0.07")


@pytest.mark.kernel
def test_a_loop_that_follows_the_air_flow_does_not_hunt_and_swings_because_the_air_flow_does():
    """With the valve held at its mean the temperature swings at least as much, and with constant air not at all."""
    loop, still = fc.Loop.preset("lbnl").assign(backlash=0.0), fc.constant_day(hours=8)
    day = still.assign(m_a=1.15 * (1.0 + 0.08 * np.sin(2.0 * np.pi * SECONDS / 600.0)))
    command = fc.simulate(loop, day, traces=["command"])["command"].values
    held = fc.simulate(loop, day, command=np.full(SECONDS.size, command[7200:].mean()))
    e = fc.explain(loop, day)
    swing = float(e.cures["hunting_swing"][0])
    assert float(held["hunting_swing"]) > swing
    assert float(fc.simulate(loop, still)["hunting_swing"]) < 0.01
    because = "because the air flow does; with that constant it would not."
    assert e.answer == f"This loop does not hunt.  T_sup swings ± {swing / 2:.2g} K every 10 min {because}"
    assert not (e.cures["hunts"] > 0.0).any()


@pytest.mark.kernel
def test_a_loop_that_changes_start_and_that_comes_to_rest_without_them_rings():
    loop = fc.Loop.preset("lbnl").assign(backlash=0.09, kp=0.03, ti=15.0)
    e = fc.explain(loop, fc.paper_day(hours=8))
    assert float(fc.simulate(loop, fc.constant_day(hours=8))["hunting_swing"]) < 0.1
    swing, period = (float(e.cures[name][0]) for name in ("hunting_swing", "hunting_period"))
    assert e.answer.startswith(
        "This loop does not hunt, although theory predicts that it may.  It rings: after changes "
    )
    assert f"T_sup swings ± {swing / 2:.2g} K every {period / 60:.2g} min, and comes to rest" in e.answer
    assert "It rings" not in fc.explain(loop.assign(ti=47.0), fc.paper_day(hours=8)).answer


@pytest.mark.kernel
def test_a_tuning_counts_the_loops_that_make_their_swing_and_not_those_that_follow_the_air_flow():
    """Of these loops every second one hunts by itself, and all swing with the air flow."""
    m_a = [1.15 * (1.0 + 0.08 * np.sin(2.0 * np.pi * SECONDS[:7200] / period)) for period in (600.0, 500.0)]
    series = {name: values[0, :7200] for name, values in fc.constant_day(hours=8).series.items()}
    days = fc.Boundary(**series | {"m_a": np.array(m_a)})
    loop = fc.Loop.preset("lbnl").assign(backlash=0.0, ti=("sample", [30.0, 3.0] * 3))
    t = fc.tune(loop, days, search={"kp": (0.017, 0.019)}, evaluations=8, progress=False)
    request = plan_tuning(loop, days, search={"kp": (0.017, 0.019)})
    for ds, group in ((t.trained, request.training), (t.held_out, request.holdout)):
        share = np.mean(group.loop["ti"] == 3.0)
        assert (ds["hunts_mean"].sel(edge="value") == share).all()
        assert (fc.simulate(group.loop, group.boundary)["hunting_swing"] > 0.1).all()
        assert f"; {100 * share:.0f} % of these loops hunt, now {100 * share:.0f} %" in str(t) or ds is t.trained
