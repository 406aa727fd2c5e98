"""
A process of my own instead of the coil
=======================================

Process control describes a loop by a gain, a lag and a dead time.  Does the gap of its valve make it hunt, and what
helps?  The plant is a function; everything else, from theory to reports, is as for the coil.
"""

from typing import NamedTuple

import matplotlib.pyplot as plt

import fastcoil as fc


class Parameters(NamedTuple):
    gain: float = fc.parameter(-20.0, unit="K", text="change of the temperature for a full opening")
    lag: float = fc.parameter(120.0, unit="s", lower=1.0, text="time constant")


class Memory(NamedTuple):
    T: float = 25.0


@fc.plant(Parameters, Memory)
def first_order(now, p, memory):
    T = memory.T + (now.T_a_in + p.gain * now.opening - memory.T) / p.lag
    return T, Memory(T)


# %%
# The valve is seen ``dead_time`` seconds late.  Theory first, then the loop with and without an inverse:

day = fc.constant_day(hours=4, T_a_in=25.0, T_set=15.0)
loop = fc.Loop(plant=first_order, dead_time=30, backlash=0.07, kp=0.06, ti=40.0, sample_time=10)
print(fc.explain(loop, day).answer)

estimates = loop.assign(estimate_ratio=[0.0, 0.95], buffer=0.005)
ds = fc.simulate(estimates, day, traces=["T_sup", "opening"], trace_interval=10, n_jobs=1)
fc.plot.traces(ds.sel(elapsed_time=slice(7200, None)))
plt.show()

# %%
# A sweep, as of any loop:

gains = loop.assign(kp=[0.03, 0.06], ti=[40.0, 120.0], estimate_ratio=[0.0, 0.95], buffer=0.005)
swept = fc.simulate(gains, day, warm_up=7200, n_jobs=1)
print(swept.hunting_swing.round(2).to_series().unstack())
