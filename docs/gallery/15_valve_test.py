"""
Twenty minutes that show the gap
================================

The set-point stands still and the command hardly turns: the trend log shows no gap.  A valve test does.
"""

import numpy as np

import fastcoil as fc

# %%
# A valve with 8 % backlash on a steady day, and a test of 20 minutes that begins after an hour and a half.

ahu = fc.Loop.preset("lbnl").assign(backlash=0.08, noise_std=0.02, kp=0.06, ti=60, sample_time=5, stroke_time=90)
day = fc.Boundary(**{**fc.paper_day(hours=3, seed=3).series, "T_set": 14.0})
test = fc.ValveTest(start=5400, minutes=20)
ds = fc.simulate(ahu, day, test=test, traces=["T_measured", "command", "test"], trace_interval=5).squeeze()

# %%
# The log without the test does not tell the gap:

log = ds.assign(T_set=("elapsed_time", np.full(ds.elapsed_time.size, 14.0), {"units": "degC"}))
without = log.isel(elapsed_time=slice(0, 5400 // 5)).drop_vars("test")
print(fc.diagnose(without, stroke_time=90).reason)

# %%
# The test does:

r = fc.read_test(log, stroke_time=90)
print(*r.summary(), sep="\n")
r.plot()

# %%
# The answer:

excursion = float(abs(ds.T_measured - 14.0).where(ds.test > 0).max())
print(f"{r.minutes:.0f} minutes and {excursion:.1f} K show a gap of {100 * r.backlash:.1f} %; in truth it is 8 %.")

# %%
# What a technician with a stop-watch does:

print(*test.instructions(), sep="\n")
