"""
What does backlash cost in a year?
==================================

A coil through a year of weather, from six to eight in the evening, with 30 % outdoor air.  The weather is made up
here; put your own EPW or TMY3 file in its place.
"""

import csv
import math

import matplotlib.pyplot as plt
import numpy as np

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
# One day in twenty stands for those around it, which keeps this script short.  With dates, costs know their months.

days = np.arange(9, 366, 20)
year = fc.weather_day(
    "weather.csv", days=days, hour=6, hours=14, m_a=1.2, T_w_in=7.0, T_set=14.0, outdoor_fraction=0.3,
    T_return=24.0, RH_return=0.5,
).assign(start=np.datetime64("2023-01-01T06:00") + (days - 1).astype("timedelta64[D]"))  # fmt: skip
loop = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.05, 0.1, 0.15], noise_std=0.02)
ds = fc.simulate(loop, year, n_jobs=1)

# %%
# Prices convert kWh and kW into money.  The error, day by day, shows when the gap is felt.

costs = fc.cost(ds, electricity=0.13, demand=15.0, heat=0.05, cop=4.0, currency="USD")
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for gap, colour in zip(ds.backlash.values, ("0.6", "#DDAA33", "#BB5566", "#004488"), strict=True):
    axes.plot(ds.day, ds.rmse.sel(backlash=gap), "o-", color=colour, label=f"{100 * gap:g} %")
axes.set(xlabel="day of the year", ylabel="RMS error of the day [K]")
axes.legend(title="backlash")

# %%
# The answer:

bill = costs.yearly_cost.to_series()
error = ds.rmse.mean("day").to_series()
print(f"Without backlash this coil costs {bill[0.0]:,.0f} USD a year, with 15 % {bill[0.15] - bill[0.0]:+.0f} USD.")
print(f"The RMS error of its air is {error[0.15]:.2f} K instead of {error[0.0]:.2f} K.")
