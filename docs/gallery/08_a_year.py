"""
What does backlash cost in a year?
==================================

An air handler through a year of weather: fan from six to eight, economiser, a set-point that follows the
outdoor air.  The weather is made up here; put your own EPW or TMY3 file in its place.
"""

import csv
import math

import matplotlib.pyplot as plt

import fastcoil as fc

# %%
# A weather file of 8,760 hours, from two sines:

with open("weather.csv", "w", newline="") as file:
    rows = csv.writer(file)
    rows.writerow(["hour_of_year", "T_drybulb_C", "T_dewpoint_C"])
    for hour in range(1, 8761):
        season, clock = math.sin(2 * math.pi * (hour / 24 - 110) / 365), math.sin(2 * math.pi * (hour % 24 - 9) / 24)
        T = 13 + 9 * season + 5 * clock
        rows.writerow([hour, f"{T:.2f}", f"{min(7 + 6 * season, T):.2f}"])

# %%
# One day in twenty stands for those around it, which keeps this script short; leave ``days`` out to run them
# all.  The year is never held in memory: each day is made when needed.

year = fc.weather_year(
    "weather.csv", year=2023, days=range(9, 366, 20), fan_hours=[6, 20], weekend_fan_hours=[6, 20],
    set_point="outdoor_reset", water="load",
)  # fmt: skip
loop = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.05, 0.1, 0.15], noise_std=0.02)
ds = fc.simulate(loop, year, n_jobs=1)

# %%
# Prices convert kWh and kW into money.  The error, day by day, shows when the gap is felt.  In winter outdoor air
# does all the cooling and the coil rests: those days have no dot.

costs = fc.cost(ds, electricity=0.13, demand=15.0, heat=0.05, cop=4.0, currency="USD")
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for gap, colour in zip(ds.backlash.values, ("0.6", "#DDAA33", "#BB5566", "#004488"), strict=True):
    axes.plot(ds.day, ds.rmse.sel(backlash=gap), "o-", color=colour, label=f"{100 * gap:g} %")
axes.set(xlabel="day of the year", ylabel="RMS error of the day [K]")
axes.legend(title="backlash")

# %%
# The answer:

bill = costs.yearly_cost.to_series()
off = (100 * ds.share_off.mean("day")).to_series()
print(f"Without backlash this coil costs {bill[0.0]:,.0f} USD a year, with 15 % {bill[0.15] - bill[0.0]:+.0f} USD.")
print(f"Its air is off by more than 0.5 K for {off[0.15]:.1f} % of the time instead of {off[0.0]:.1f} %.")
