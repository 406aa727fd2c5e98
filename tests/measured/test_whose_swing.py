"""Whose swing a log shows: the loop's, regular or not, or that of the air and water that are logged beside it."""

import numpy as np
import pytest

import fastcoil as fc

pytestmark = pytest.mark.kernel

SECONDS = np.arange(6 * 3600)
STILL = fc.constant_day(hours=6)
GOOD, UNITS = fc.Loop.preset("lbnl").assign(backlash=0.0), {"m_a": "kg s-1", "T_a_in": "degC", "T_w_in": "degC"}
GUSTS = 1.15 * (1.0 + 0.2 * sum(np.sin(2.0 * np.pi * SECONDS / p + p) for p in (210.0, 340.0, 520.0, 870.0)))


def swing_line(loop, day, with_inputs=True):
    """Diagnose a log of a loop every 10 s; return the diagnosis and its sentences on the swing."""
    ds = fc.simulate(loop.assign(noise_std=0.03), day, traces=["T_measured", "command"], trace_interval=10)
    units = {"T_set": "degC"} | (UNITS if with_inputs else {})
    series = {name: ("elapsed_time", day.series[name][0][::10], {"units": unit}) for name, unit in units.items()}
    d = fc.diagnose(ds.assign(series), stroke_time=90.0)
    return d, next(line for line in d.summary() if line.startswith("This loop "))


def test_a_regular_swing_of_the_loop_is_hunting_whatever_else_is_logged():
    for with_inputs in (True, False):
        _, line = swing_line(GOOD.assign(backlash=0.07, kp=0.04, ti=10.0), STILL, with_inputs)
        assert line.startswith("This loop hunts: ± 3.1 K every 2.7 min, probably caused by the tuning: ")


def test_a_regular_swing_that_the_logged_air_explains_is_not_the_loops_and_its_gains_stay():
    d, line = swing_line(GOOD, STILL.assign(m_a=1.15 * (1.0 + 0.2 * np.sin(2.0 * np.pi * SECONDS / 600.0))))
    assert line == "This loop does not hunt.  T_sup swings ± 0.52 K every 10 min: the logged air and water explain it."
    assert (d.cause, d.is_own) == ("disturbance", 0.0)
    assert d.advice.reason == "Leave the gains: the swing comes from outside the loop."


def test_an_irregular_swing_is_the_airs_only_where_the_log_shows_it():
    _, line = swing_line(GOOD, STILL.assign(m_a=GUSTS))
    assert line.startswith("This loop does not hunt.  T_sup swings ± ")
    assert line.endswith(" every now and then because air or water do; with them constant it would not.")
    _, line = swing_line(GOOD, STILL.assign(m_a=GUSTS), with_inputs=False)
    assert line.startswith("This loop keeps swinging, irregularly: about ")
    assert line.endswith("The log does not show whose swing it is: log m_a, T_a_in and T_w_in as well.")


def test_an_irregular_swing_beside_air_that_hardly_moves_is_the_loops():
    """The air answers the loop, as where it is recirculated: a swing may fit whatever answers it."""
    loop = GOOD.assign(backlash=0.15, neutral_zone=0.03, kp=0.05, ti=20.0)
    T_sup = fc.simulate(loop, STILL, traces=["T_sup"])["T_sup"].values
    d, line = swing_line(loop, STILL.assign(T_a_in=25.0 + 0.05 * (T_sup - 14.0)))
    assert line.startswith("This loop keeps swinging, irregularly: about ")
    assert line.endswith("It makes the swing itself: air and water move too little.")
    assert d.is_own == 1.0
