"""
A mixing damper with a worn linkage
===================================

An economiser mixes outdoor and return air.  Its linkage has play, as a valve's gearbox has, and its flow is steep in
the middle.  At which outdoor temperature does it hunt?
"""

import math
from typing import NamedTuple

import matplotlib.pyplot as plt

import fastcoil as fc


class Parameters(NamedTuple):
    T_outdoor: float = fc.parameter(5.0, unit="degC", text="temperature of the outdoor air")
    lag: float = fc.parameter(20.0, unit="s", lower=1.0, text="lag of the mixing box")


class Memory(NamedTuple):
    T: float = 23.0


@fc.plant(Parameters, Memory)
def mixing_box(now, p, memory):
    share = math.sin(0.5 * math.pi * now.opening) ** 2  # of outdoor air, behind a crank
    mixed = now.T_a_in + share * (p.T_outdoor - now.T_a_in)
    T = memory.T + (mixed - memory.T) / p.lag
    return T, Memory(T)


# %%
# The colder it is outdoors, the more a degree of the crank does:

day = fc.constant_day(hours=4, T_a_in=23.0, T_set=14.0)
damper = fc.Loop(
    plant=mixing_box, T_outdoor=[-20.0, -10.0, 0.0, 10.0], backlash=[0.0, 0.03, 0.07], kp=0.03, ti=15.0,
    sample_time=10, sensor_time_constant=30, stroke_time=90,
)  # fmt: skip
ds = fc.simulate(damper, day, warm_up=7200, n_jobs=1)
print(ds.hunting_swing.round(2).to_series().unstack())

# %%
# With the inverse, at -10 °C:

worst = damper.assign(T_outdoor=-10.0, backlash=0.07, estimate_ratio=[0.0, 0.95], buffer=0.005)
traces = fc.simulate(worst, day, traces=["T_sup", "command", "opening"], trace_interval=5, n_jobs=1)
fc.plot.traces(traces.sel(elapsed_time=slice(10800, None)))
plt.show()
