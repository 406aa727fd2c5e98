"""The learning rule of the paper on single loops: the table of ``learner.toml``."""

from __future__ import annotations

import xarray as xr

from studies.common import results, write_table


def main() -> None:
    """When the rule reaches the backlash, how often, and where it ends."""
    ds = results("learner")
    n_days = ds.sizes["day"]
    rows = []
    for rule in ds.rule.values:
        for loop in ds.loop.values:
            d = ds.sel(rule=rule, loop=loop)
            reached, confirmed = d.learn_time_reached, d.learn_time_confirmed
            rows.append(
                [
                    rule,
                    loop,
                    f"{int(reached.notnull().sum())} of {n_days}",
                    hours(reached),
                    f"{int(confirmed.notnull().sum())} of {n_days}",
                    hours(confirmed),
                    f"{float(d.estimate_first_down.median()):.3f}",
                    f"{float(d.estimate_final.median()):.3f}",
                ]
            )
    head = ["rule", "loop", "reached on", "after", "confirmed on", "after", "first step down to", "final estimate"]
    write_table("learning/learner", f"The self-learning rule: backlash 7 %, {n_days} days of 8 h", head, rows)


def hours(times: xr.DataArray) -> str:
    """Median time in hours; a dash where fewer than half of the days have one, for the others come later than all."""
    in_time = times.fillna(float("inf")).median()
    return f"{float(in_time) / 3600:.2f} h" if float(in_time) < float("inf") else "—"
