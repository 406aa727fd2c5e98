"""
How good must an estimate be for valves of any age?
===================================================

New valves have little backlash, worn ones much, and controllers are tuned in many ways.  A sweep covers
all combinations.
"""

import matplotlib.pyplot as plt
import numpy as np

import fastcoil as fc

# %%
# Any parameter may be a list, and every list is an axis of the result.  ``kp`` and ``ti`` belong together, so
# they share the axis ``tuning``:

tunings = {"calm": (0.01, 30.0), "as found": (0.018, 30.0), "sharp": (0.03, 15.0)}
kp, ti = np.array(list(tunings.values())).T
loop = fc.Loop.preset("lbnl").assign(
    kp=("tuning", kp),
    ti=("tuning", ti),
    backlash=[0.02, 0.05, 0.08, 0.11, 0.14],
    backlash_estimate=np.linspace(0.0, 0.2, 21),
)
days = fc.paper_day(hours=4, seed=[1, 2])
ds = fc.simulate(loop, days, n_jobs=1)
rmse = ds.rmse.mean("day").assign_coords(tuning=list(tunings))
print(dict(ds.sizes), "makes", ds.rmse.size, "scenarios")

# %%
# The error over the estimate, a line for each valve.  The dot is where the estimate equals the backlash:

figure, panels = plt.subplots(1, 3, figsize=(9, 3.2), sharey=True, layout="constrained")
shades = plt.get_cmap("viridis")(np.linspace(0, 0.85, rmse.sizes["backlash"]))
for panel, tuning in zip(panels, tunings, strict=True):
    for gap, shade in zip(ds.backlash.values, shades, strict=True):
        line = rmse.sel(tuning=tuning, backlash=gap)
        panel.plot(100 * ds.backlash_estimate, line, color=shade, label=f"{100 * gap:g} %")
        panel.plot(100 * gap, line.interp(backlash_estimate=gap), "o", color=shade)
    panel.set(title=f"tuning: {tuning}", xlabel="estimate [% of stroke]")
panels[0].set_ylabel("RMS error [K]")
panels[0].legend(title="backlash")

# %%
# The answer, from the smallest estimate that gives half of the possible gain:

gain = 1 - rmse / rmse.sel(backlash_estimate=0.0)
enough = ds.backlash_estimate.where(gain > 0.5 * gain.max("backlash_estimate"))
share = enough.min("backlash_estimate").sel(backlash=0.08, tuning="as found") / 0.08
best = float(gain.max("backlash_estimate").sel(backlash=0.08, tuning="as found"))
print(f"At 8 % backlash and the tuning as found the best estimate takes {100 * best:.0f} % of the error.")
print(f"An estimate of {100 * float(share):.0f} % of the backlash gives half of that: a rough one will do.")
