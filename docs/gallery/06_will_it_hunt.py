"""
Will this loop hunt?
====================

Before simulating, linearise the loop at its operating point; the describing function of the gap predicts whether
a limit cycle exists.  Then simulate, and compare.
"""

import matplotlib.pyplot as plt
import numpy as np

import fastcoil as fc

# %%
# What a step of the command does at this operating point: gain, time constant and dead time.

day = fc.constant_day(hours=8)
loop = fc.Loop.preset("lbnl").assign(backlash=0.07, kp=0.03)
m = fc.linearise(loop, day)
print(f"gain {float(m.gain):.0f} K per stroke, time constant {float(m.lag):.0f} s, dead time {float(m.delay):.0f} s")

# %%
# The open loop in the complex plane.  The gap turns and shrinks it: the loop hunts where L comes near enough to -1,
# which is what the hunting index of ``limit_cycle`` measures.

L = fc.linearise(loop.assign(ti=[10.0, 30.0]), day, frequency=np.geomspace(3e-3, 0.2, 400))
values = L.loop_magnitude * np.exp(1j * np.radians(L.loop_phase))
figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
for ti in L.ti.values:
    axes.plot(values.sel(ti=ti).real, values.sel(ti=ti).imag, label=f"Ti = {ti:g} s")
axes.plot(-1.0, 0.0, "k+")
axes.set(xlim=(-2.5, 1.0), ylim=(-2.5, 1.0), aspect="equal", xlabel="real part of L", ylabel="imaginary part of L")
axes.legend()

# %%
# The opening against the command: one loop of the curve per swing.  The width of the figure is the
# gap.

hunting = loop.assign(ti=10.0)
swing = fc.simulate(hunting, day, traces=["command", "opening"], warm_up=3 * 3600, n_jobs=1)
fc.plot.limit_cycle(swing, fc.limit_cycle(hunting, day))

# %%
# 300 tunings, predicted and simulated:

map_of = loop.assign(kp=np.geomspace(0.005, 0.08, 15).round(5), ti=np.geomspace(6, 120, 20).round(3))
theory = fc.limit_cycle(map_of, day)
simulated = fc.simulate(map_of, day, warm_up=3 * 3600, n_jobs=1)

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
mesh = axes.pcolormesh(simulated.ti, simulated.kp, simulated.hunting_swing, cmap="viridis", shading="nearest")
axes.contour(theory.ti, theory.kp, theory.hunting_index.transpose("kp", "ti"), levels=[0.85], colors="#BB5566")
axes.set(
    xscale="log", yscale="log", xlabel="ti [s]", ylabel="kp [1/K]", title="red: where hunting is predicted to begin"
)
figure.colorbar(mesh, label="simulated swing, peak to peak [K]")

# %%
# The answer:

n_agree = int((theory.hunts == simulated.hunts).sum())
cycle = fc.limit_cycle(hunting, day)
print(f"With ti = 10 s it hunts by {2 * float(cycle.amplitude):.1f} K peak to peak every {float(cycle.period):.0f} s.")
print(f"Theory and simulation agree on {n_agree} of {theory.hunts.size} tunings.")
