"""
Is it the valve?
================

A supply temperature swings.  Replace the valve, retune the loop, or look for a
disturbance?  Only a trend log is available.
"""

import pandas as pd

import fastcoil as fc

# %%
# Here the log is simulated, from a valve with 9 % backlash that the diagnosis does not know.  Yours comes from
# the building: time, command, supply temperature and set-point, every 10 s.

ahu = fc.Loop.preset("lbnl").assign(backlash=0.09, noise_std=0.01, kp=0.03, ti=13)
day = fc.paper_day(hours=6, seed=2)
signals = fc.simulate(ahu, day, traces=["command", "T_measured"], trace_interval=10, n_jobs=1)
log = pd.DataFrame(
    {
        "elapsed_time [s]": signals.elapsed_time,
        "command [%]": (100 * signals.command).round(1),
        "T_sup [degC]": signals.T_measured.round(2),
        "T_set [degC]": day.to_dataset().T_set.sel(elapsed_time=signals.elapsed_time),
    }
)
log.to_csv("log.csv", index=False)
log.head()

# %%
# In a terminal this is ``fastcoil diagnose log.csv --stroke-time 90``:

d = fc.diagnose("log.csv", stroke_time=90)
print(*d.summary(), sep="\n")

# %%
# The same on a page:

d.plot()

# %%
# The answer:

low, high = (100 * bound for bound in d.interval)
print(f"The gap is {100 * d.backlash:.1f} % of the stroke (95 %: {low:.1f} to {high:.1f} %); in truth it is 9 %.")
print(f"The cause is the {d.cause}: {d.because}.")
