"""
Does an estimate of the backlash help?
======================================

A valve with 7 % backlash hunts under its PI.  A backlash inverse makes the motor jump across the gap, but it
needs an estimate of the gap.  How accurate must it be?
"""

import matplotlib.pyplot as plt

import fastcoil as fc

# %%
# Four estimates, from none (the plain PI) to one that is too large, on the same day:

loop = fc.Loop.preset("paper_like").assign(backlash=0.07, estimate_ratio=[0.0, 0.6, 0.95, 1.1])
day = fc.paper_day(hours=8, seed=1)
ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=10, n_jobs=1)
ds[["rmse", "switch_frequency", "motor_travel"]].to_dataframe().round(2)

# %%
# The supply air temperature beside its set-point, for an hour and a half:

T_set = day.to_dataset().T_set.sel(elapsed_time=ds.elapsed_time)
hours = ds.elapsed_time / 3600
figure, panels = plt.subplots(2, 2, sharex=True, sharey=True, figsize=(9, 5), layout="constrained")
for panel, ratio in zip(panels.flat, ds.estimate_ratio.values, strict=True):
    panel.plot(hours, ds.T_sup.sel(estimate_ratio=ratio), color="#004488", label="supply air")
    panel.plot(hours, T_set, color="#DDAA33", linestyle="--", label="set-point")
    panel.set(title=f"estimate: {100 * ratio:g} % of the backlash", xlim=(2.5, 4), ylim=(12, 17))
panels[0, 0].legend(loc="lower right")
figure.supxlabel("time [h]")
figure.supylabel("temperature [°C]")

# %%
# The answer:

rmse, travel = ds.rmse.to_series(), ds.motor_travel.to_series()
print(f"No estimate: {rmse[0.0]:.2f} K of error.  60 %: {rmse[0.6]:.2f} K.  95 %: {rmse[0.95]:.2f} K.")
print(f"110 %: {rmse[1.1]:.2f} K, but the motor travels {travel[1.1] / travel[0.95]:.1f} times as far as with 95 %.")
