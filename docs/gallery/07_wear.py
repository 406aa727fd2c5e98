"""
What if the gap grows?
======================

Gears wear.  Here a valve begins with 5 % backlash and wears far faster than a real one, so that twelve days
stand for years.  Which controller keeps up?
"""

import matplotlib.pyplot as plt
import xarray as xr

import fastcoil as fc

# %%
# ``wear_rate`` is the growth of the gap per stroke that the stem travels.  With ``carry_over`` each day begins
# in the final state of the previous one: coil, controller, estimate and gap.  A DataArray gives the three
# controllers names:


def by_controller(*values):
    names = ["plain PI", "95 % of the first gap", "identify"]
    return xr.DataArray(list(values), dims="controller", coords={"controller": names})


loop = fc.Loop.preset("lbnl").assign(
    backlash=0.05,
    wear_rate=4e-3,
    estimator=by_controller("none", "none", "identify"),
    backlash_estimate=by_controller(0.0, 0.0475, 0.0),
    buffer=0.002,
)
days = fc.paper_day(hours=8, seed=range(12))
ds = fc.simulate(loop, days, carry_over=True, n_jobs=1)

# %%
# Gap, estimate and error at the end of each day:

figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for name, colour, style in zip(ds.controller.values, ("#004488", "#BB5566", "#DDAA33"), ("-", "--", ":"), strict=True):
    run = ds.sel(controller=name)
    panels[0].plot(ds.day, 100 * run.backlash_final, style, color=colour, label=f"gap under {name}")
    panels[1].plot(ds.day, run.rmse, style, color=colour, label=name)
panels[0].plot(
    ds.day, 100 * ds.estimate_final.sel(controller="identify"), "ko", markersize=4, label="estimate of identify"
)
panels[0].set(xlabel="day", ylabel="gap at the end of the day [% of stroke]")
panels[1].set(xlabel="day", ylabel="RMS error of the day [K]")
panels[0].legend()
panels[1].legend()

# %%
# The answer:

first, last = (ds.isel(day=slice(a, b)).rmse.mean("day").to_series() for a, b in ((0, 3), (-3, None)))
for name in first.index:
    gap = 100 * float(ds.backlash_final.sel(controller=name).isel(day=-1))
    print(
        f"{name}: error {first[name]:.2f} K on the first three days, {last[name]:.2f} K on the last; gap {gap:.1f} %."
    )
