"""
Would a controller of my own do better?
=======================================

The gain of a coil changes with its load, the gain of a PI does not.  Here is a PI whose gain falls as the valve
opens less, as a plain Python function; it runs compiled, beside the PI that comes with fastcoil.
"""

from typing import NamedTuple

import matplotlib.pyplot as plt

import fastcoil as fc

# %%
# A law has parameters, a memory, and a function that is called at every sample of the controller.  ``now.e`` is
# the control error, above 0 where the valve should open:


class Parameters(NamedTuple):
    kp: float
    ti: float
    sample_time: float
    least: float = fc.parameter(
        0.3, lower=0.05, upper=1.0, text="share of the gain that is left when the valve is closed"
    )


class Memory(NamedTuple):
    integral: float = 0.0


@fc.law(Parameters, Memory)
def scheduled(now, p, memory):
    gain = p.kp * (p.least + (1.0 - p.least) * min(2.0 * memory.integral, 1.0))
    integral = min(max(memory.integral + gain * p.sample_time / p.ti * now.e, 0.0), 1.0)
    return gain * now.e + integral, Memory(integral)


# %%
# Put it beside the PI, on several valves and with more and more gain:

loop = fc.Loop.preset("lbnl").assign(
    law=["pi", scheduled],
    rangeability=50.0,
    authority=[0.1, 0.3],
    m_full=1.6,
    kp=[0.02, 0.04, 0.06, 0.08, 0.1],
)
days = fc.paper_day(hours=4, seed=[1, 2])
ds = fc.simulate(loop, days, n_jobs=1)
rmse = ds.rmse.mean(["day", "authority"])

figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
for name, style, colour in (("pi", "-o", "#004488"), ("scheduled", "--s", "#BB5566")):
    axes.plot(ds.kp, rmse.sel(law=name), style, color=colour, label=name)
axes.set(xlabel="kp [1/K]", ylabel="RMS error [K], mean of valves and days")
axes.legend(title="law")

# %%
# The answer:

best = rmse.min("kp").to_series()
turns = ds.motor_travel.mean(["day", "authority"]).sel(kp=float(ds.kp[-1])).to_series()
print(f"With the best kp for each: {best['pi']:.3f} K by the PI, {best['scheduled']:.3f} K by the law of our own.")
print(f"At the largest kp the motor travels {turns['pi']:.0f} and {turns['scheduled']:.0f} strokes.")
