"""
Would an inverse help my own air handler?
=========================================

Two logs give the parameters of a valve and of a coil.  With them a study predicts what a controller would do
on *this* machine.
"""

import numpy as np
import pandas as pd

import fastcoil as fc

# %%
# The logs are simulated here, from a machine whose parameters the fits do not know.  The command was moved by
# hand every five minutes, and a flow meter was at hand:

rng = np.random.default_rng(1)
ahu = fc.Loop(backlash=0.09, C_c=20.0, beta1=0.36)
day = fc.paper_day(hours=6, seed=1)
command = np.repeat(rng.uniform(0.0, 1.0, 72), 300)
ds = fc.simulate(ahu, day, command=command, traces=["m_w", "T_sup"], n_jobs=1)
columns = {"elapsed_time [s]": np.arange(21600), "command [%]": 100 * command}
columns["m_w [L/s]"] = np.maximum(ds.m_w + rng.normal(0, 0.02, 21600), 0)
columns |= {
    f"{name} [{unit}]": day.series[name][0]
    for name, unit in (("m_a", "kg/s"), ("T_a_in", "degC"), ("W_a_in", "kg/kg"), ("T_w_in", "degC"))
}
columns["T_sup [degC]"] = ds.T_sup + rng.normal(0, 0.05, 21600)
pd.DataFrame(columns)[::10].to_csv("log.csv", index=False)

# %%
# The valve, measured and fitted:

valve = fc.fit_valve("log.csv")
valve.plot()

# %%
# The coil:

coil = fc.fit_coil("log.csv", holds="m_w")
coil.plot()

# %%
# Both in a loop, with the tuning of the preset ``lbnl``, and estimates up to one and a half times the backlash:

loop = fc.Loop.preset("lbnl").assign(
    **{**coil.parameters, **valve.parameters, "estimate_ratio": np.linspace(0, 1.5, 7).round(3), "buffer": 0.002}
)
result = fc.simulate(loop, fc.paper_day(hours=8, seed=[1, 2, 3, 4]), n_jobs=1)
means = result[["rmse", "motor_travel"]].mean("day").to_dataframe().round(3)
means[["rmse", "motor_travel"]]

# %%
# The answer:

best = means.rmse.idxmin()
low, high = (100 * bound for bound in valve.intervals["backlash"])
size = 100 * valve.parameters["backlash"]
print(f"This valve has {size:.1f} % backlash (95 %: {low:.1f} to {high:.1f} %); in truth it has 9 %.")
print(
    f"An estimate of {100 * best:.0f} % of it lowers the error from {means.rmse[0.0]:.2f} to {means.rmse[best]:.2f} K."
)
