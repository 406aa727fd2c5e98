"""What a loop and its days cannot be meant to be together is told, and nothing else."""

import warnings

import numpy as np
import pytest
from helpers.rules import own_pi

import fastcoil as fc
from fastcoil.loops.clashes import tell_doubts
from fastcoil.loops.presets import COOLING

HOUR = 0.6
COOLING_DAY = fc.paper_day(hours=HOUR)
HEATING_DAY = fc.heating_day(hours=HOUR)
FREE_COOLING = fc.constant_day(HOUR, T_a_in=8.0, T_w_in=np.linspace(7.0, 9.0, 2160), relative_humidity=0.3)


MISTAKES = {
    "a heating coil on a day of cooling": (fc.Loop.preset("heating"), COOLING_DAY, "opening the valve cools"),
    "a cooling coil on a day of heating": (fc.Loop.preset("lbnl"), HEATING_DAY, "opening the valve warms"),
    "gains of a cooling coil": (fc.Loop(action="heating"), HEATING_DAY, r"kp = 0\.03 1/K and ti = 8 s.*paper_like"),
    "water too cold": (
        fc.Loop.preset("heating"),
        fc.heating_day(HOUR, T_w_in=20.0),
        r"T_set is 24 degC or more.*at most: no opening warms",
    ),
    "water too warm": (fc.Loop(), fc.constant_day(HOUR, T_set=5.0), r"T_set is 5 degC or less.*no opening cools"),
    "one action of a sweep": (fc.Loop(action=["heating", "cooling"]), COOLING_DAY, "opening the valve cools"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_cannot_be_meant_is_told(mistake):
    loop, day, words = MISTAKES[mistake]
    with pytest.warns(UserWarning, match=words) as told:
        tell_doubts(loop, day)
    assert len(told) == 1


RIGHT = {
    **{name: (fc.Loop.preset(name), COOLING_DAY) for name in COOLING},
    "heating": (fc.Loop.preset("heating"), HEATING_DAY),
    "heating_45": (fc.Loop.preset("heating_45"), fc.heating_day(HOUR, T_w_in=45.0)),
    "water at times warmer than the air": (fc.Loop(), FREE_COOLING),
    "water and air of one temperature": (fc.Loop(), fc.constant_day(HOUR, T_a_in=20.0, T_w_in=20.0, T_set=20.0)),
    "nothing to do: the air is colder than the set-point": (fc.Loop(), fc.constant_day(HOUR, T_a_in=13.0, T_set=14.0)),
    "gains that were chosen": (fc.Loop.preset("lbnl").assign(action="heating", kp=0.0045), HEATING_DAY),
    "gains that are swept": (fc.Loop.preset("lbnl").assign(action="heating", kp=[0.018, 0.01]), HEATING_DAY),
    "cooling gains with tepid water": (fc.Loop(action="heating"), fc.heating_day(HOUR, T_w_in=35.0)),
    "a law of the user's own": (fc.Loop.preset("lbnl").assign(law=own_pi), HEATING_DAY),
    "an action that kp turns round": (fc.Loop.preset("lbnl").assign(kp=-0.018), HEATING_DAY),
}


@pytest.mark.parametrize("case", RIGHT)
def test_what_may_be_meant_is_not_told(case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tell_doubts(*RIGHT[case])


@pytest.mark.kernel
def test_a_run_is_told_where_it_is_called_and_an_open_loop_is_not():
    with pytest.warns(UserWarning, match="opening the valve cools") as told:
        fc.simulate(fc.Loop.preset("heating"), COOLING_DAY, n_jobs=1)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fc.simulate(fc.Loop.preset("heating"), COOLING_DAY, command=np.full(2160, 0.5), n_jobs=1)
