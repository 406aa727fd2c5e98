"""A gap that grows: who follows it, what that saves and wears, how long the motor lasts, and who notices first.

The valves and controllers are those of ``wear.toml``; a weather file (see ``weather.toml``) adds days of a real year.
``runs.py`` has the year, ``detect.py`` the detectors, ``whole.py`` the check against 365 days.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from studies.common import change_in_words, compare_rows, failures_in_words, save_figure, share_of, write_table
from studies.days import CONSTANT, STEPPED
from studies.learning.learners_runs import HARM_RISE_GOOD
from studies.wear import detect
from studies.wear import runs as wear_runs
from studies.wear.detect import (
    AT_ONCE,
    DAY_HOURS,
    DAYS_BEFORE,
    KINDS,
    NO_GAP,
    SEQUENCE_DAYS,
    SLOWLY,
    STEADY,
    Estimates,
    alarm_hours,
    choose_threshold,
)
from studies.wear.runs import (
    DAYS,
    DAYS_OF_YEAR,
    GROWTHS,
    KNOWN_ONCE,
    PI,
    Run,
    actual_growth,
    is_wrong,
    relative_change,
    yearly_change,
)

CONTROLLER_LABELS = {
    PI: "plain PI",
    KNOWN_ONCE: "95 % of the gap of the first day",
    "paper": "paper's rule",
    "hagglund": "Hägglund",
    "gradient": "gradient",
    "identify": "identify",
    "identify_8h": "identify, memory 8 h",
}
"""The names of the controllers for readers."""
LAST_DAYS = 4  # days at the end of each third that count
RATED_STROKES, RATED_STARTS = 20_000, 1_800_000
"""What an actuator of up to 125 N m endures after EN 15714-2: 10,000 cycles of open and close (classes A and B), and
starts where it modulates (class C)."""
FEWEST_VALVES = 5  # valves of which something is said
HUNTING_SHARE = 0.5  # share of the days on which a loop hunts that is said to hunt
DETECTOR_LABELS = {
    "bank, plant known": "bank of models, plant known",
    "bank, plant 5 % off": "bank of models, plant 5 % off",
    "bank, plant 15 % off": "bank of models, plant 15 % off",
    "identify": "identify",
    "hagglund": "Hägglund",
    "paper": "paper's rule",
    "gradient": "gradient",
}


def other_controllers() -> list[str]:
    """All controllers but the one they are compared with."""
    return [name for name in CONTROLLER_LABELS if name != PI]


def follow_rows(runs: list[Run]) -> list[list[str]]:
    """Wrong estimates at the end of the year, or of the thirds in which the gap was larger and smaller."""
    rows = []
    for run in runs:
        third = run.ds.sizes["day"] // 3
        ends = {"": 3 * third}
        if run.sequence.in_steps:
            ends = {": loose": 2 * third, ": repaired": 3 * third}
        for label, end in ends.items():
            days = slice(max(end - LAST_DAYS, 0), end)
            name = run.sequence.name.removesuffix(", loose and repaired")
            rows.append(
                [f"{name}{label}", *(str(share_of(is_wrong(run, c).isel(day=days))) for c in other_controllers())]
            )
    return rows


def cost_rows(runs: list[Run]) -> list[list[str]]:
    """What each controller does to the error, to the motor and to the gap, against plain PI."""
    rows = []
    for name in other_controllers():
        cells = []
        for run in runs:
            counted_days = run.ds.isel(day=np.flatnonzero(run.ds.rmse.notnull().all(["controller", "sample"])))
            travel = 1.0 + float(yearly_change(run, name, "motor_travel").median())
            growth_ratio = (actual_growth(run, name) / actual_growth(run, PI)).where(run.growth > 0.0)
            cells.append(
                f"{change_in_words(counted_days, name, PI)}, × {travel:.2f}, × {float(growth_ratio.median()):.2f}"
            )
        rows.append([CONTROLLER_LABELS[name], *cells])
    return rows


def energy_rows(runs: list[Run]) -> list[list[str]]:
    """Heat at the coil, and heat that the air lacks or has too much, in the whole year."""
    rows = []
    for run in runs:
        total = run.ds.sum("day")
        reheat_share = (total.reheat_energy + total.recool_energy) / total.coil_energy.sel(controller=PI)
        cells = [f"{100 * float(reheat_share.sel(controller=PI).median()):.1f} %"]
        for name in other_controllers():
            share_change = 100 * float((reheat_share.sel(controller=name) - reheat_share.sel(controller=PI)).median())
            cells.append(f"{100 * float(yearly_change(run, name, 'coil_energy').median()):+.2f} %, {share_change:+.2f}")
        rows.append([run.sequence.name, *cells])
    return rows


def life_rows(runs: list[Run]) -> list[list[str]]:
    """Strokes and reversals in a year, and shares of what an actuator endures: the median valve, and 95 % of them."""
    rows = []
    for run in runs:
        for hunts, label in ((False, ""), (True, ", loops that hunt")):
            is_member = (run.plain.hunts.mean("day") > HUNTING_SHARE) == hunts
            if int(is_member.sum()) < FEWEST_VALVES:
                continue
            for name in (PI, "identify", "gradient"):
                year = run.ds.sel(controller=name).sum("day") * DAYS_OF_YEAR / DAYS
                strokes, motor, turns = (
                    year[metric].where(is_member).quantile([0.5, 0.95]).values
                    for metric in ("stem_travel", "motor_travel", "reversals")
                )
                counts = (f"{a:,.0f}, {b:,.0f}" for a, b in (strokes, motor, turns))
                rows.append([
                    f"{run.sequence.name}{label}", CONTROLLER_LABELS[name], *counts,
                    f"{100 * motor[0] / RATED_STROKES:.1f}, {100 * motor[1] / RATED_STROKES:.0f} %",
                    f"{100 * turns[0] / RATED_STARTS:.1f}, {100 * turns[1] / RATED_STARTS:.0f} %",
                ])  # fmt: skip
    return rows


def feedback_rows(runs: list[Run]) -> list[list[str]]:
    """Growth under plain PI against what it would be if a larger gap did not move the stem more."""
    rows = []
    for run in runs:
        growth_ratio = (actual_growth(run, PI) / run.growth).where(run.growth > 0.0)
        hunts = run.plain.hunts.mean("day") > HUNTING_SHARE
        cells = []
        for group in (growth_ratio.where(~hunts), growth_ratio.where(hunts)):
            n = int(group.count())
            if n < FEWEST_VALVES:
                cells.append("—")
                continue
            low, middle, high = group.quantile([0.05, 0.5, 0.95]).values
            cells.append(f"× {middle:.2f} ({low:.2f} to {high:.2f}), {n} valves")
        rows.append([run.sequence.name, *cells])
    return rows


def good_rows(runs: list[Run]) -> list[list[str]]:
    """Valves without gap and without wear: those that get worse, and what becomes of their RMSE."""
    rows = []
    for run in runs:
        changes = {name: relative_change(run, name).mean("day") for name in other_controllers()}
        cells = (
            f"{share_of(valve_changes > HARM_RISE_GOOD)}, {100 * float(valve_changes.median()):+.1f} %"
            for valve_changes in changes.values()
        )
        rows.append([run.sequence.kind, *cells])
    return rows


def noticed_rows(choice_estimates: Estimates, fresh_estimates: Estimates) -> list[list[str]]:
    """Alarms of each detector: false ones, true ones, and how long they take."""
    rows = []
    for name, label in DETECTOR_LABELS.items():
        threshold = choose_threshold(choice_estimates, name)
        if np.isnan(threshold):
            rows.append([label, "none", *["—"] * 6])
            continue
        alarms_by_case = {
            key: alarm_hours(gap_estimates, threshold).sel(detector=name)
            for key, gap_estimates in fresh_estimates.items()
        }
        false_alarms = [
            share_of(xr.concat([np.isfinite(alarms_by_case[case, kind]) for kind in KINDS], "day"))
            for case in (STEADY, NO_GAP)
        ]
        true_alarms = []
        for kind in KINDS:
            for case in (AT_ONCE, SLOWLY):
                hours = alarms_by_case[case, kind]
                middle = float(np.sort(hours.values.ravel())[(hours.size - 1) // 2])
                true_alarms.append(
                    f"{share_of(np.isfinite(hours))}, " + (f"{middle:.1f} h" if np.isfinite(middle) else "—")
                )
        rows.append([label, f"{100 * threshold:g} %", *map(str, false_alarms), *true_alarms])
    return rows


def write_tables(runs: list[Run], choice_estimates: Estimates, fresh_estimates: Estimates) -> None:
    """Write every table."""
    good_runs = [run for run in runs if run.sequence.is_good]
    worn_runs = [run for run in runs if not run.sequence.is_good]
    wearing_runs = [run for run in worn_runs if not run.sequence.in_steps]
    names = [CONTROLLER_LABELS[name] for name in other_controllers()]
    sizes = f"{runs[0].ds.sizes['sample']} valves × {DAYS} days that represent a year"
    write_table(
        "wear/wear_follow",
        f"Wrong estimates in the last {LAST_DAYS} days: off by more than 20 % of the gap and 1 % of the stroke; "
        f"{sizes} "
        f"({failures_in_words(run.ds for run in runs)})",
        ["days", *names],
        follow_rows(worn_runs),
    )
    write_table(
        "wear/wear_cost",
        f"Against plain PI on the same valves: RMSE, mean over the year (95 %); motor travel and growth of the gap of "
        f"the median valve; {sizes}",
        ["controller", *(run.sequence.name for run in wearing_runs)],
        cost_rows(wearing_runs),
    )
    write_table(
        "wear/wear_energy",
        "Under plain PI: heat needed to bring the supply air to its set-point (reheat plus recooling), as a share of "
        "the coil's heat.  Other controllers: change of the coil's heat, and change of that share in percentage "
        "points; a year of the median valve",
        ["days", CONTROLLER_LABELS[PI], *names],
        energy_rows(wearing_runs),
    )
    write_table(
        "wear/wear_life",
        "One year, median and 95th percentile of the valves: strokes of stem and motor, reversals; "
        "motor strokes as a share of 20,000, reversals as a share of 1.8 million",
        ["days", "controller", "stem, strokes", "motor, strokes", "reversals", "of the strokes", "of the starts"],
        life_rows(wearing_runs),
    )
    write_table(
        "wear/wear_feedback",
        "Growth of the gap over the year under plain PI, relative to the growth if the gap did not change the travel: "
        "median (5 to 95 % of the valves)",
        ["days", "loops that do not hunt", "loops that hunt"],
        feedback_rows(wearing_runs),
    )
    write_table(
        "wear/wear_good",
        "Valves without gap and wear: loops whose RMSE rises by more than 1 % in the year, and its median change",
        ["days", *names],
        good_rows(good_runs),
    )
    heads = [f"{case}, {kind}" for kind in KINDS for case in (AT_ONCE, SLOWLY)]
    first_estimates = next(iter(fresh_estimates.values()))
    write_table(
        "wear/wear_noticed",
        f"A gap that triples: share of sequences with an alarm within 5 days of 6 h, and median hours until the alarm; "
        f"{first_estimates.sizes['sample']} fresh valves × {first_estimates.sizes['day']} sequences",
        ["detector", "alarm at", "false: constant gap", "false: no gap", *heads],
        noticed_rows(choice_estimates, fresh_estimates),
    )


COLOURS = {PI: "black", "paper": YELLOW, "gradient": RED, "identify": BLUE, "identify_8h": BLUE, "hagglund": "0.55"}
DRAWN_DETECTORS = {"bank, plant known": "black", "bank, plant 15 % off": "0.55", "identify": BLUE, "gradient": RED}
"""The detectors that are shown."""
MONTHS = 12
WORN_GAP = 0.02  # gap from which on a loose linkage is shown, fraction of stroke


@apply_style()
def draw(runs: list[Run], choice_estimates: Estimates, fresh_estimates: Estimates) -> None:
    """Draw the three panels."""
    by_name = {run.sequence.name: run for run in runs}
    figure, panels = plt.subplots(1, 3, figsize=(12.0, 4.6), layout="constrained")
    _draw_growth(panels[0], by_name[STEPPED])
    _draw_loose(panels[1], by_name[f"{STEPPED}, loose and repaired"])
    _draw_noticed(panels[2], choice_estimates, fresh_estimates)
    save_figure(figure, "wear/wear.png")


def _month_axis(n: int) -> np.ndarray:
    return (np.arange(n) + 1.0) * MONTHS / n


def _mean_gap(gap: xr.DataArray, among: xr.DataArray) -> xr.DataArray:
    """Mean gap of some valves, by day; % of stroke."""
    return 100 * gap.where(among).mean("sample")


def _draw_legend(panel: Axes) -> None:
    """Draw the legend below the panel, which the lines fill."""
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8, frameon=False)


def _draw_growth(panel: Axes, run: Run) -> None:
    """Draw the mean gap under each controller, and the estimate of `identify`."""
    among = run.growth == max(GROWTHS)
    months = _month_axis(run.ds.sizes["day"])
    for name in (PI, "identify", "paper", "gradient"):
        gap = _mean_gap(run.ds.backlash_final.sel(controller=name), among)
        panel.plot(months, gap, color=COLOURS[name], label=f"gap under {CONTROLLER_LABELS[name]}")
    estimate = _mean_gap(run.ds.estimate_final.sel(controller="identify"), among)
    panel.plot(months, estimate, "o", ms=3, color=BLUE, mfc="white", label="estimate of identify")
    panel.set(xlabel="time [months]", ylabel="gap, mean [% of stroke]", xlim=(0, MONTHS), ylim=(0, None))
    panel.set_title("Wear: set-point steps, the valves that wear most", fontsize=9)
    _draw_legend(panel)


def _draw_loose(panel: Axes, run: Run) -> None:
    """Draw the mean gap of a linkage that comes loose and is repaired, and each estimate."""
    among = run.first_gap >= WORN_GAP
    months = _month_axis(run.ds.sizes["day"])
    gap = _mean_gap(run.ds.backlash_final.sel(controller=PI), among)
    panel.step(months, gap, color="black", where="mid", label="gap")
    for name, line in (("identify", "-"), ("identify_8h", "--"), ("hagglund", "-"), ("paper", "-")):
        estimate = _mean_gap(run.ds.estimate_final.sel(controller=name), among)
        panel.plot(months, estimate, line, color=COLOURS[name], label=CONTROLLER_LABELS[name])
    panel.set(xlabel="time [months]", ylabel="gap, mean [% of stroke]", xlim=(0, MONTHS), ylim=(0, None))
    panel.set_title("A linkage comes loose, and is repaired", fontsize=9)
    _draw_legend(panel)


def _draw_noticed(panel: Axes, choice_estimates: Estimates, fresh_estimates: Estimates) -> None:
    """Draw the share of loops whose loose linkage is noticed, over the hours of operation since."""
    hours = np.linspace(0.0, (SEQUENCE_DAYS - DAYS_BEFORE) * DAY_HOURS, 200)
    for name, colour in DRAWN_DETECTORS.items():
        threshold = choose_threshold(choice_estimates, name)
        if np.isnan(threshold):
            continue
        for kind, line in ((STEPPED, "-"), (CONSTANT, "--")):
            hours_to_alarm = alarm_hours(fresh_estimates[AT_ONCE, kind], threshold).sel(detector=name).values.ravel()
            shares = [100 * float((hours_to_alarm <= hour).mean()) for hour in hours]
            panel.plot(hours, shares, line, color=colour, label=DETECTOR_LABELS[name] if line == "-" else None)
    panel.plot([], [], "--", color="0.3", label="dashed: constant set-point")
    panel.set(xlabel="operation since it came loose [h]", ylabel="noticed [% of the loops]", ylim=(-3, 103))
    panel.set_title("Three times the gap at once", fontsize=9)
    _draw_legend(panel)


def sample() -> None:
    """Run a sample of the study: a linkage that comes loose and is repaired, and valves without a gap."""
    runs = wear_runs.run(names=[f"{STEPPED}, loose and repaired", f"{CONSTANT}, no gap"])
    compare_rows("wear/wear_follow", follow_rows(runs[:1]))
    compare_rows("wear/wear_good", good_rows(runs[1:]))


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many valves."""
    runs = wear_runs.run(size)
    choice_estimates, fresh_estimates = detect.run(detect.CHOICE_FIRST_DAYS), detect.run(detect.FRESH_FIRST_DAYS)
    write_tables(runs, choice_estimates, fresh_estimates)
    draw(runs, choice_estimates, fresh_estimates)
