"""Tables of what ``robustness.toml`` found."""

from __future__ import annotations

import xarray as xr

from studies.common import results, write_table


def median_change(values: xr.DataArray, reference: xr.DataArray) -> str:
    """Format the median relative change in per cent."""
    return f"{100 * float((values / reference - 1).median()):+.0f} %"


def percent_of_loops(holds: xr.DataArray) -> str:
    """Format the share of the loops in which ``holds`` is true."""
    return f"{float(holds.mean()):.1%}"


def write_robustness() -> None:
    """Write each estimate against the plain PI of the same loop and the best one, by backlash, and the baselines."""
    all_results = results("robustness").load()
    ds = all_results.isel(tuning=(all_results.error_dead_band == 0.0).values)
    plain = ds.sel(estimate_ratio=0.0)
    # of lowest error relative to the best of the same valve
    best_index = {"tuning": int((plain.rmse / plain.rmse.min("tuning")).mean("backlash").argmin("tuning"))}
    best = plain.rmse.isel(best_index, drop=True)
    write_table(
        "robustness/robustness",
        f"Robustness: change against the plain PI, {ds.rmse.size:,} days; the best plain PI of {ds.sizes['tuning']} "
        f"tunings is `{ds.tuning.values[best_index['tuning']]}`",
        ["estimate / backlash", "RMSE", "settled RMSE", "lower RMSE in", "lower RMSE than the best plain PI in",
         "switches per 10 min", "motor travel"],
        (
            [
                f"{ratio:g}",
                median_change(d.rmse, plain.rmse),
                median_change(d.rmse_settled, plain.rmse_settled),
                percent_of_loops(d.rmse < plain.rmse),
                percent_of_loops(d.rmse < best),
                f"{float(d.switch_frequency.median()):.1f}",
                f"× {float((d.motor_travel / plain.motor_travel).median()):.1f}",
            ]
            for ratio in (0.0, 0.5, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.5)
            for d in [ds.sel(estimate_ratio=ratio)]
        ),
    )  # fmt: skip
    write_baselines(all_results)
    inverse_95, exact = ds.sel(estimate_ratio=0.95), ds.sel(estimate_ratio=1.0)
    write_table(
        "robustness/robustness_by_backlash",
        "Robustness: change against the plain PI, by backlash",
        ["backlash", "RMSE of the plain PI (median)", "RMSE at 95 %", "settled RMSE at 95 %", "RMSE at 100 %"],
        (
            [
                f"{x:.0%}",
                f"{float(plain.rmse.sel(backlash=x).median()):.3f} K",
                median_change(inverse_95.rmse.sel(backlash=x), plain.rmse.sel(backlash=x)),
                median_change(inverse_95.rmse_settled.sel(backlash=x), plain.rmse_settled.sel(backlash=x)),
                median_change(exact.rmse.sel(backlash=x), plain.rmse.sel(backlash=x)),
            ]
            for x in (0.02, 0.05, 0.07, 0.1, 0.15)
        ),
    )


BASELINES = {
    "plain PI": ("paper_like", 0.0),
    "error dead band of 0.2 K": ("dead_band_02", 0.0),
    "error dead band of 0.5 K": ("dead_band_05", 0.0),
    "inverse of 60 %": ("paper_like", 0.6),
    "inverse of 95 %": ("paper_like", 0.95),
    "inverse of 110 %": ("paper_like", 1.1),
    "PI by SIMC": ("simc_s30", 0.0),
    "PI by SIMC, inverse of 60 %": ("simc_s30", 0.6),
    "PI by SIMC, inverse of 95 %": ("simc_s30", 0.95),
    "PI by SIMC, inverse of 110 %": ("simc_s30", 1.1),
    "best plain PI": ("best_pi_s30", 0.0),
    "best PI, inverse of 60 %": ("best_pi_s30", 0.6),
    "best PI, inverse of 95 %": ("best_pi_s30", 0.95),
    "best PI, inverse of 110 %": ("best_pi_s30", 1.1),
}
"""Tuning and estimate of each remedy on the plant of ``paper_like``, at its sample time of 30 s."""


def write_baselines(ds: xr.Dataset) -> None:
    """Write an inverse, a dead band and a better tuning of one loop, against its plain PI."""
    plain = ds.sel(tuning="paper_like", estimate_ratio=0.0)
    write_table(
        "robustness/robustness_baselines",
        f"The loop `paper_like` with each remedy: change against its plain PI, median of {plain.backlash.size} "
        "backlashes",
        ["remedy", "RMSE", "settled RMSE", "RMSE at 2 %", "at 7 %", "at 15 %", "motor travel", "hunting in"],
        (
            [
                name,
                median_change(d.rmse, plain.rmse),
                median_change(d.rmse_settled, plain.rmse_settled),
                *(median_change(d.rmse.sel(backlash=x), plain.rmse.sel(backlash=x)) for x in (0.02, 0.07, 0.15)),
                f"× {float((d.motor_travel / plain.motor_travel).median()):.1f}",
                f"{int(d.hunts.sum())} of {d.hunts.size}",
            ]
            for name, (tuning, ratio) in BASELINES.items()
            for d in [ds.sel(tuning=tuning, estimate_ratio=ratio)]
        ),
    )


def main() -> None:
    """Write every table."""
    write_robustness()
