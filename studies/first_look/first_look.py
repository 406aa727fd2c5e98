"""The first look of the README: one loop that hunts, with the plain PI and three inverses."""

import matplotlib.pyplot as plt

import fastcoil as fc

loop = fc.Loop.preset("paper_like").assign(converged=True, backlash=0.07, estimate_ratio=[0.0, 0.6, 0.95, 1.1])
day = fc.paper_day(hours=8, seed=1)
ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=10)
print(ds[["rmse", "rmse_settled", "switch_frequency"]].to_dataframe().round(3))

set_point = day.to_dataset().T_set.sel(elapsed_time=ds.elapsed_time)
hours = ds.elapsed_time / 3600
figure, panels = plt.subplots(1, 4, sharey=True, figsize=(11, 2.8), layout="constrained")
for panel, ratio in zip(panels, ds.estimate_ratio.values, strict=True):
    panel.plot(hours, ds.T_sup.sel(estimate_ratio=ratio), color="#004488", label="supply air")
    panel.plot(hours, set_point, color="#DDAA33", linestyle="--", label="set-point")
    panel.set(title=f"estimate: {100 * ratio:g} % of backlash", xlabel="time [h]", xlim=(2.5, 4), ylim=(12, 17))
panels[0].set_ylabel("temperature [°C]")
panels[0].legend(loc="lower right")
figure.savefig("first_look.png", dpi=200)
