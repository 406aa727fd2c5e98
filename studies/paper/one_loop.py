"""Section 3 of the paper on one loop: the table of ``paper_like.toml``."""

from __future__ import annotations

from studies.common import results, write_table


def main() -> None:
    """Section 3 of the paper on one loop, median of ten days."""
    days = results("paper_like")
    ds = days.median("day")
    without = ds.sel(backlash=0.0, estimate_ratio=0.0)
    columns = ("rmse", "rmse_settled", "hunting_swing", "switch_frequency")
    rows = [["no backlash, plain PI", *(f"{float(without[c]):.3f}" for c in columns)]]
    for ratio in (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.3, 1.5):
        d = ds.sel(backlash=0.07, estimate_ratio=ratio)
        rows.append([f"estimate {ratio:.0%}", *(f"{float(d[c]):.3f}" for c in columns)])
    write_table(
        "paper/paper_like",
        f"The paper's phenomena on `paper_like`: backlash 7 %, median of {days.sizes['day']} days",
        ["", "RMSE, K", "settled RMSE, K", "peak to peak, K", "switches per 10 min"],
        rows,
    )
