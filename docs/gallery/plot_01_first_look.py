"""
A first look: does an estimate of the backlash help?
====================================================

A valve with 7 % backlash hunts under its PI.  We give the backlash inverse estimates of different sizes.
"""

import fastcoil as fc

loop = fc.Loop.preset("paper_like").assign(backlash=0.07, estimate_ratio=[0.0, 0.6, 0.95, 1.1])
ds = fc.simulate(loop, fc.paper_day(hours=8, seed=1), n_jobs=1)
print(ds.rmse.to_series().round(3))
