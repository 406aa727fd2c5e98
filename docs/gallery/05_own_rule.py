"""
Can a simple rule of my own find the backlash?
==============================================

An idea: look at the mode switches of the inverse every quarter of an hour.  Where they are few, raise the
estimate; where they are many, lower it.  Does that work on other valves?
"""

from typing import NamedTuple

import matplotlib.pyplot as plt

import fastcoil as fc

# %%
# An estimator is a function too.  It returns the estimate, a fraction of the stroke:


class Parameters(NamedTuple):
    window: float = fc.parameter(900.0, unit="s", lower=60.0, text="time between two looks at the switches")
    climb: float = fc.parameter(0.005, lower=0.0, upper=0.1, text="step of the estimate")
    most: float = fc.parameter(10.0, lower=0.0, text="mode switches in a window that are not too many")


class Memory(NamedTuple):
    next_look: float = 0.0
    switches: float = 0.0


@fc.estimator(Parameters, Memory)
def by_count(now, p, memory):
    if now.t < memory.next_look:
        return now.estimate, memory
    too_many = now.switches - memory.switches > p.most
    estimate = now.estimate - p.climb if too_many else now.estimate + p.climb
    return min(max(estimate, 0.0), 0.2), Memory(now.t + p.window, now.switches)


# %%
# Beside the paper's rule and ``identify``, which comes with fastcoil, on four valves:

valves = [0.0, 0.04, 0.08, 0.12]
loop = fc.Loop.preset("lbnl").assign(
    estimator=["learner", "identify", by_count], learning_step=0.007, buffer=0.002, backlash=valves
)
ds = fc.simulate(loop, fc.paper_day(hours=12, seed=[1, 2]), traces=["estimate"], trace_interval=300, n_jobs=1)

figure, panels = plt.subplots(1, 3, sharey=True, figsize=(9, 3.2), layout="constrained")
for panel, name in zip(panels, ds.estimator.values, strict=True):
    for gap, colour in zip(valves, ("0.6", "#004488", "#BB5566", "#DDAA33"), strict=True):
        estimate = 100 * ds.estimate.sel(estimator=name, backlash=gap).isel(day=0)
        panel.plot(ds.elapsed_time / 3600, estimate, color=colour, label=f"{100 * gap:g} %")
        panel.axhline(100 * gap, color=colour, linestyle=":")
    panel.set(title=str(name), xlabel="time [h]")
panels[0].set_ylabel("estimate [% of stroke]")
panels[0].legend(title="backlash (dotted)")

# %%
# The answer, as the mean distance from the true backlash at the end:

off = (100 * abs(ds.size_error)).mean(["day", "backlash"]).to_series()
print(", ".join(f"{name} {value:.1f} %" for name, value in off.items()), "of the stroke.")
good = 100 * float(ds.estimate_final.sel(estimator="by_count", backlash=0.0).mean())
print(f"On the good valve, which has no gap at all, our rule ends at {good:.1f} %.")
