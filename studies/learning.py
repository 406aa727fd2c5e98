"""Which learning rule to ship: the tables and figures of ``studies/README.md`` on learning.

Run with ``python studies/learning.py`` in the repository: runs ``learning_step.toml`` where it is not finished in
``results/``, chooses a rule for each loop and noise, and tries the choice on days it has not seen.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from answers import HERE, results, table
from matplotlib.figure import Figure
from scipy.stats import beta

import fastcoil as fc
from fastcoil.plots import write

TOO_LOW, TOO_HIGH = 0.8, 1.2
"""A learned size outside these shares of the true one is a failure: the learner stopped early, or ran away."""
MOST_FAILURES = 0.05
CHOICE = ["rule", "learning_step", "learning_interval", "learning_ratio", "buffer"]
LOOPS = ["tuning", "noise_std"]
PAIRED = ["backlash", "backlash_estimate", "day"]
FRESH_DAYS = list(range(301, 311))


def judged(ds: xr.Dataset) -> xr.Dataset:
    """Of every choice on every kind of loop: shares of failures, hours to reach and confirm, what it costs."""
    learned = ds.estimate_final / ds.backlash
    hours = {n: ds[f"learn_time_{n}"].fillna(np.inf) / 3600.0 for n in ("reached", "confirmed")}
    return xr.Dataset(
        {
            "low": (learned < TOO_LOW).mean(PAIRED),
            "high": (learned > TOO_HIGH).mean(PAIRED),
            "error": abs(learned - 1.0).median(PAIRED),
            "never": np.isinf(hours["confirmed"]).mean(PAIRED),
            # never is later than all else: the median is censored where it is infinite
            "reached": hours["reached"].reduce(_middle, PAIRED),
            "confirmed": hours["confirmed"].reduce(_middle, PAIRED),
            "rmse": ds.rmse.mean(PAIRED),
            "travel": ds.motor_travel.median(PAIRED),
        }
    )


def _middle(values: np.ndarray, axis: tuple[int, ...]) -> np.ndarray:
    kept = [k for k in range(values.ndim) if k not in axis]
    rows = np.sort(values.transpose(*kept, *axis).reshape(*(values.shape[k] for k in kept), -1), axis=-1)
    return rows[..., (rows.shape[-1] - 1) // 2]


def interval(k: int, n: int) -> str:
    """Share k/n with its 95 % interval (Clopper and Pearson)."""
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{100 * k / n:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def chosen(of: xr.Dataset) -> dict[str, Any] | None:
    """The safe choice that confirms soonest, the more accurate one of equals; ``None`` where none is safe."""
    flat = of.stack(choice=CHOICE)
    flat = flat.isel(choice=np.flatnonzero((flat.low + flat.high <= MOST_FAILURES).values))
    if not flat.sizes["choice"]:
        return None
    best = flat.isel(choice=int(np.lexsort((flat.error.values, flat.confirmed.values))[0]))
    return dict(zip(CHOICE, best.choice.item(), strict=True))


def tried(ds: xr.Dataset, choice: dict[str, Any], loop: dict[str, Any]) -> tuple[int, int]:
    """Failures of a choice on fresh days, of how many."""
    cell = ds.sel(choice | loop).isel(day=0)
    found = fc.simulate(fc.Loop.from_dataset(cell), fc.paper_day(hours=16, seed=FRESH_DAYS))
    learned = found.estimate_final / found.backlash
    return int(((learned < TOO_LOW) | (learned > TOO_HIGH)).sum()), found.rmse.size


def recommendations(ds: xr.Dataset, of: xr.Dataset) -> None:
    """For each loop and noise the choice, what it found, and how it did on fresh days."""
    print("### What to ship\n")
    rows = []
    for tuning, noise in product(ds.tuning.values, ds.noise_std.values):
        loop = {"tuning": str(tuning), "noise_std": float(noise)}
        choice = chosen(of.sel(loop))
        if choice is None:
            least = float((of.sel(loop).low + of.sel(loop).high).min())
            rows.append([str(tuning), f"{noise:g}", f"none is safe (at best {100 * least:.0f} % fail)", *["—"] * 7])
            continue
        found = of.sel(loop | choice)
        hours = [
            f"{float(found[n]):.1f} h" if np.isfinite(found[n]) else "later than 16 h" for n in ("reached", "confirmed")
        ]
        rows.append(
            [str(tuning), f"{noise:g}", choice["rule"], f"{100 * choice['learning_step']:.2g} %",
             f"{choice['learning_interval'] / 60:.0f} min", f"{choice['learning_ratio']:g}",
             f"{100 * choice['buffer']:.0f} %", " / ".join(hours), f"{100 * float(found.error):.0f} %",
             interval(*tried(ds, choice, loop))]
        )  # fmt: skip
    table(
        ["loop", "noise, K", "rule", "step", "interval", "ratio", "buffer", "reached / confirmed (median)",
         "error (median)", "failures on fresh days (95 % interval)"],
        rows,
    )  # fmt: skip


def failures(of: xr.Dataset) -> None:
    """How often each rule fails over loops and noise, all of its settings together."""
    print("### How often the rules fail: stops early / runs away, % of days\n")
    rest = [d for d in CHOICE if d not in ("rule", "buffer")]
    low, high = (100 * of[n].mean(rest) for n in ("low", "high"))
    table(
        ["loop", "noise, K", *(f"{r}, buffer {100 * b:.0f} %" for r in of.rule.values for b in of.buffer.values)],
        (
            [str(t), f"{n:g}"]
            + [
                f"{float(low.sel(tuning=t, noise_std=n, rule=r, buffer=b)):.0f} / "
                f"{float(high.sel(tuning=t, noise_std=n, rule=r, buffer=b)):.0f}"
                for r in of.rule.values
                for b in of.buffer.values
            ]
            for t in of.tuning.values
            for n in of.noise_std.values
        ),
    )


def front(of: xr.Dataset) -> Figure:
    """Time to confirm against failures, a point for each choice; loops side by side."""
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        fig = Figure(figsize=(10, 3.4), layout="constrained")
        axes = fig.subplots(1, of.sizes["tuning"], sharex=True, sharey=True)
        for ax, tuning in zip(axes, of.tuning.values, strict=True):
            for noise, marker, colour in zip(
                of.noise_std.values, "o^s", ("#1b3a5c", "#2a7f62", "#d9822b"), strict=True
            ):
                cell = of.sel(tuning=tuning, noise_std=noise).stack(choice=CHOICE)
                hours = np.where(np.isfinite(cell.confirmed), cell.confirmed, 17.0)
                ax.plot(
                    hours, 100 * (cell.low + cell.high), marker, ms=3, mfc="none", color=colour, label=f"{noise:g} K"
                )
            ax.axhline(100 * MOST_FAILURES, color="0.5", lw=0.8, ls=":")
            ax.set_title(str(tuning))
            ax.set_xlabel("confirmed after [h] (17: never)")
        axes[0].set_ylabel("failures [% of days]")
        fig.legend(
            *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, title="noise", frameon=False
        )
    return fig


def quiet() -> None:
    """A day on which nothing changes: what each rule makes of it."""
    ds = results("learning_step").isel(day=0, noise_std=0, buffer=0)
    loop = fc.Loop.from_dataset(
        ds.sel(learning_step=0.007, learning_interval=1800, learning_ratio=2.0, backlash_estimate=0)
    )
    found = fc.simulate(loop, fc.constant_day(hours=16))
    print("### A perfectly quiet day, backlash 7 %, steps of 0.7 % every 30 min: final estimate\n")
    cell = found.sel(backlash=0.07)
    table(
        ["loop", *map(str, found.rule.values)],
        ([str(t)] + [f"{100 * float(cell.estimate_final.sel(tuning=t, rule=r)):.1f} %" for r in found.rule.values]
         for t in found.tuning.values),
    )  # fmt: skip


if __name__ == "__main__":
    ds = results("learning_step")
    of = judged(ds)
    recommendations(ds, of)
    failures(of)
    quiet()
    for path in write({"learning_front": front(of)}, Path(HERE.parent / "results" / "learning_step" / "figures")):
        print(path)
