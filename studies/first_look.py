"""The first look of the README: one loop that hunts, with the plain PI and three inverses."""

import fastcoil as fc

loop = fc.Loop.preset("paper_like").assign(backlash=0.07, estimate_ratio=[0.0, 0.6, 0.95, 1.1])
day = fc.paper_day(hours=8, seed=1)
ds = fc.simulate(loop, day, traces=["T_sup", "opening"], trace_interval=10)

print(ds[["rmse", "rmse_settled", "switch_frequency"]].to_dataframe().round(3))
grid = ds.T_sup.sel(elapsed_time=slice(9000, 14400)).plot.line(x="elapsed_time", col="estimate_ratio", figsize=(13, 3))
grid.fig.savefig("first_look.png")
