"""What does the log of a whole air handler show?  Faults of valves, sensors and loops in units never seen before.

Each fault is put into fresh units of ``units.py`` for some of their days, and ``fc.inspect`` reads the log by its
headers alone.  *Shows*: the fault has signs in the log, see ``truth.py``; other units cannot be found and only count
where another component is accused.  Seeds below 10000 are for development: the thresholds of ``fastcoil.measured`` may
be chosen on such units.  Those here are ``SEED`` and above.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from studies.air_handler.placebos import PLACEBOS
from studies.air_handler.units import GAP, INTEGRAL, LOAD, Unit, simulate_unit
from studies.common import compare_rows, progress_printer, share_of, write_table

from studies.air_handler.truth import (  # isort: skip
    COOLING, ENTERING, FAN, FIGHT, FROZEN, HEATING, HUNT, LEAK, NO_WATER, OFFSET, SET_POINT, SIDES, STUCK, STUCK_OPEN,
    STUCK_SHUT, SUPPLY, SWINGS, UNDERSIZED, UNOCCUPIED,
)  # fmt: skip

SEED = 60000
FAULT_UNITS, HEALTHY_UNITS, PLACEBO_UNITS = 32, 160, 64
DAYS = 4


class Case(NamedTuple):
    """A fault to put into units."""

    fault: str | None = None
    component: str = COOLING
    size: float = 0.0
    cause: str = ""


HEALTHY = Case()
HUNTING = [Case(HUNT, valve, cause=cause) for valve in SIDES for cause in (LOAD, INTEGRAL, GAP)]
CASES = [
    *(Case(LEAK, valve, size) for valve in SIDES for size in (0.05, 0.1, 0.2, 0.4, 0.5)),
    *(Case(fault, valve) for valve in SIDES for fault in (STUCK_OPEN, STUCK_SHUT)),
    *(Case(STUCK, valve, 0.5) for valve in SIDES),
    *(Case(UNDERSIZED, valve, 0.3) for valve in SIDES),
    Case(NO_WATER),
    *(Case(FIGHT, size=overlap) for overlap in (1.0, 3.0)),
    *(Case(SWINGS, size=amplitude, cause=SWINGS) for amplitude in (1.5, 3.0)),
    *(Case(FROZEN, sensor) for sensor in (SUPPLY, ENTERING)),
    *(Case(OFFSET, ENTERING, error) for error in (-6.0, -4.0, 4.0, 6.0)),
    Case(UNOCCUPIED),
    *HUNTING,
]
SAMPLE_CASES = (Case(LEAK, COOLING, 0.4), Case(STUCK_OPEN, HEATING))
PASSES, LACKS = {"leak", "stuck_open"}, {"stuck_shut", "not_met"}
"""Kinds that one log cannot tell apart: a valve that passes when shut, one that has no effect when open."""
RIGHT_KINDS = {LEAK: PASSES, STUCK_OPEN: PASSES, STUCK: PASSES | LACKS, STUCK_SHUT: LACKS, UNDERSIZED: LACKS,
               NO_WATER: LACKS}  # fmt: skip
DEFECTS = {"leak", "stuck_open", "stuck_shut", "stuck"}
SENSOR_KINDS = {"sensor_stuck", "sensor_offset"}
ACCUSATIONS = DEFECTS | SENSOR_KINDS | {"fight"}
"""Kinds that no healthy unit has.  Others, such as a set-point that is not met, happen in healthy units too."""
NO_PART = {FIGHT, SWINGS, UNOCCUPIED, HUNT}
"""Faults of control, with which every accusation of a valve or sensor is wrong."""
CAUSES = {
    LOAD: {"load", "gain"}, INTEGRAL: {"integral", "integral_or_gap"}, GAP: {"gap", "integral_or_gap"},
    SWINGS: {"outer loop"},
}  # fmt: skip
"""Words of ``fc.inspect`` that are right for each true cause of hunting."""
OUTER_LOOP = "outer loop"
UNSAID = {"", "unknown"}


class Result(NamedTuple):
    """A unit of a case and what was found in its log."""

    case: Case
    unit: Unit
    findings: list[Any]

    @property
    def shows(self) -> bool:
        """Whether its fault has signs in the log."""
        return self.unit.truth is not None and bool(self.unit.truth.shown_days)

    @property
    def is_right(self) -> bool:
        """Whether a finding names component and group of kinds, at a time when the fault shows."""
        return any(self._names_fault(f) and self._overlaps(f) for f in self.findings)

    @property
    def is_wrong(self) -> bool:
        """Whether a finding accuses a valve or a sensor that is healthy."""
        others = (f for f in self.findings if f.kind in DEFECTS | SENSOR_KINDS)
        return any(f.component != self.case.component or self.case.fault in NO_PART for f in others)

    def _names_fault(self, finding: Any) -> bool:
        fault, component = str(self.case.fault), self.case.component
        named = {FIGHT: finding.component, UNOCCUPIED: finding.component, SWINGS: SET_POINT}.get(fault, component)
        is_right_component = finding.component == named or finding.kind == "not_met"
        return is_right_component and finding.kind in RIGHT_KINDS.get(fault, {fault})

    def _overlaps(self, finding: Any) -> bool:
        truth = self.unit.truth
        return truth is not None and any(
            a <= end and start <= b for a, b in windows_of(finding, self.unit) for start, end in truth.windows
        )


def windows_of(finding: Any, unit: Unit) -> list[tuple[pd.Timestamp, pd.Timestamp]]:
    """Windows of a finding; numbers are seconds from the start of the log."""
    start = unit.signals.index[0]

    def when(time: Any) -> pd.Timestamp:
        return start + pd.Timedelta(seconds=float(time)) if isinstance(time, int | float) else pd.Timestamp(time)

    return [(when(a), when(b)) for a, b in finding.windows]


def days_of(findings: Iterable[Any], unit: Unit) -> set[int]:
    """Days that the windows of findings touch, from 0."""
    first = unit.signals.index[0].normalize()
    windows = [window for finding in findings for window in windows_of(finding, unit)]
    return {k for a, b in windows for k in range((a - first).days, (b - first).days + 1)}


def inspect_log(log: pd.DataFrame) -> list[Any]:
    """What ``fc.inspect`` finds in a log, by its headers alone."""
    return list(fc.inspect(log).findings)


def run_unit(case: Case, seed: int) -> Result:
    """Simulate a unit and inspect its log."""
    unit = simulate_unit(seed, case.fault, case.size, case.component, DAYS, case.cause)
    return Result(case, unit, inspect_log(unit.log))


def run_case(case: Case, n: int) -> list[Result]:
    """Run fresh units of a case; each case has seeds of its own."""
    number = 1 + CASES.index(case) if case.fault else 0
    seeds = range(SEED + 1000 * number, SEED + 1000 * number + n)
    return Parallel(n_jobs=-1)(delayed(run_unit)(case, seed) for seed in seeds)


def format_shares(holds: Iterable[bool]) -> str:
    """Format a share of units with its interval."""
    values = [*holds]
    return str(share_of(xr.DataArray(values, dims="sample"))) if values else "none"


def fault_rows(by_case: dict[Case, list[Result]]) -> list[list[str]]:
    """A row for each case, those that are found least first."""
    rows = []
    for case, results in by_case.items():
        shown = [r for r in results if r.shows]
        size = f"{case.size:+g} K" if case.fault in (OFFSET, SWINGS, FIGHT) else f"{100 * case.size:g} %"
        component = {FIGHT: "both valves", SWINGS: SET_POINT, UNOCCUPIED: FAN}.get(str(case.fault), case.component)
        share = float(np.mean([r.is_right for r in shown])) if shown else 2.0
        rows.append((share, [
            str(case.fault), component, case.cause or (size if case.size else "—"), f"{len(shown)} of {len(results)}",
            format_shares(r.is_right for r in shown), format_shares(r.is_wrong for r in shown),
            format_shares(not r.is_right and not r.is_wrong for r in shown),
            f"{sum(r.is_wrong for r in results if not r.shows)} of {len(results) - len(shown)}",
        ]))  # fmt: skip
    return [row for _, row in sorted(rows, key=lambda pair: pair[0])]


def healthy_rows(results: list[Result]) -> list[list[str]]:
    """Healthy units accused, by component and kind, and what is said of set-points that are met."""
    accusations = [
        {
            (f.component, f.kind)
            for f in r.findings
            if f.kind in ACCUSATIONS and not (f.kind == FIGHT and r.unit.observed.fighting)
        }
        for r in results
    ]
    rows = [["any", "any", format_shares(bool(a) for a in accusations)]]
    rows += [[*pair, format_shares(pair in a for a in accusations)] for pair in sorted(set().union(*accusations))]
    met = [r for r in results if not any(r.unit.observed.unmet.values())]
    return [*rows, ["set-point", "not_met, though met", format_shares(
        any(f.kind == "not_met" for f in r.findings) for r in met)]]  # fmt: skip


def hunting_rows(results: list[Result]) -> list[list[str]]:
    """Days on which each valve's loop, or the set-point, swings and is calm, and those that are called so."""
    rows = []
    for component in (*SIDES, SET_POINT):
        kind = SWINGS if component == SET_POINT else HUNT
        cells = []
        for days in ("hunting", "calm"):
            among, holds = (np.zeros((len(results), DAYS), bool) for _ in range(2))
            for k, r in enumerate(results):
                among[k, list(getattr(r.unit.observed, days)[component])] = True
                said = days_of((f for f in r.findings if f.kind == kind and f.component == component), r.unit)
                holds[k, sorted(said & set(range(DAYS)))] = True
            holds, among = (xr.DataArray(x, dims=("sample", "day")) for x in (holds, among))
            cells += [f"{int(among.sum())}", str(share_of(holds, among)) if among.any() else "none"]
        rows.append([component, *cells])
    return rows


def cause_rows(by_case: dict[Case, list[Result]]) -> list[list[str]]:
    """For each cause of hunting: loops found to hunt, and causes that are named and right."""
    rows = []
    for cause, words in CAUSES.items():
        shown = [r for case, results in by_case.items() if case.cause == cause for r in results if r.shows]
        found = [r for r in shown if r.is_right]
        said = [next((str(getattr(f, "cause", "") or "") for f in r.findings if r._names_fault(f)), "") for r in found]
        if cause == SWINGS:  # the set-point is named, and no valve blamed for it
            blamed = [any(f.kind == HUNT and f.component in SIDES for f in r.findings) for r in found]
            said = ["loop" if is_blamed else OUTER_LOOP for is_blamed in blamed]
        named = [s for s in said if s not in UNSAID]
        name = OUTER_LOOP if cause == SWINGS else cause
        rows.append([name, f"{len(shown)}", format_shares(r.is_right for r in shown),
                     format_shares(s in words for s in named), format_shares(s not in UNSAID for s in said),
                     ", ".join(f"{s} {said.count(s)}" for s in sorted(set(named) - words)) or "—"])  # fmt: skip
    return rows


def is_impossible(finding: Any, unit: Unit, log: pd.DataFrame) -> bool:
    """Whether a valve is said to pass while the air in its windows changed the other way, in the mean of the log."""
    sign = {COOLING: 1.0, HEATING: -1.0}.get(finding.component, 0.0)
    if finding.kind not in PASSES or not sign:
        return False
    times, change = pd.to_datetime(log.iloc[:, 0]), log[unit.columns["T_sup"]] - log[unit.columns["T_mixed"]]
    inside = np.any([times.between(a, b) for a, b in windows_of(finding, unit)], axis=0)
    return sign * float(change[inside].mean()) > 0.0


def placebo_rows(n: int) -> list[list[str]]:
    """Healthy units whose logs are disordered: units accused, and those in which a coil is that cannot be it."""
    units = [simulate_unit(SEED + 900_000 + k, days=DAYS) for k in range(n)]
    rows = []
    for name, disorder in PLACEBOS.items():
        logs = [disorder(unit) for unit in units]
        found = Parallel(n_jobs=-1)(delayed(inspect_log)(log) for log in logs)
        accused = [[f for f in findings if f.kind in ACCUSATIONS] for findings in found]
        impossible = [
            any(is_impossible(f, unit, log) for f in a) for a, unit, log in zip(accused, units, logs, strict=True)
        ]
        rows.append([name, format_shares(map(bool, accused)), f"{sum(map(len, accused))}", format_shares(impossible)])
    return rows


def write_tables(n: int, n_healthy: int, n_placebos: int, cases: Sequence[Case] = tuple(CASES)) -> None:
    """Run so many units of every case and write the tables."""
    report = progress_printer()
    healthy = run_case(HEALTHY, n_healthy)
    report("healthy units")
    by_case = {case: run_case(case, n) for case in cases}
    report("faults")
    write_table(
        "air_handler/air_handler",
        f"Faults of air handlers in logs of {DAYS} days, {n} units each, those least found first; shares of the units "
        "in which the fault shows",
        ["fault", "component", "size or cause", "shows in", "component and kind right", "another component accused",
         "silent", "another accused where it does not show"],
        fault_rows(by_case),
    )  # fmt: skip
    write_table("air_handler/air_handler_healthy", f"What {n_healthy} healthy units are accused of",
                ["component", "kind", "units"], healthy_rows(healthy))  # fmt: skip
    hunting = [*healthy, *(r for case, results in by_case.items() if case.fault in (HUNT, SWINGS) for r in results)]
    write_table(
        "air_handler/air_handler_hunting", "Days on which a loop or a set-point swings, and on which it is calm",
        ["component", "days that swing", "found", "calm days", "called swinging"], hunting_rows(hunting),
    )  # fmt: skip
    write_table(
        "air_handler/air_handler_causes", "Why loops hunt: units in which it shows",
        ["true cause", "units", "found to swing", "of the causes named, right", "cause named", "named wrongly"],
        cause_rows(by_case),
    )  # fmt: skip
    write_table(
        "air_handler/air_handler_placebos",
        f"Logs of {n_placebos} healthy units in order and in disorder",
        ["log", "units accused", "accusations", "of a coil that cannot be it"], placebo_rows(n_placebos),
    )  # fmt: skip


def sample() -> None:
    """Compute the rows of two faults."""
    compare_rows("air_handler/air_handler", fault_rows({case: run_case(case, FAULT_UNITS) for case in SAMPLE_CASES}))


def main() -> None:
    """Write the tables."""
    write_tables(FAULT_UNITS, HEALTHY_UNITS, PLACEBO_UNITS)


if __name__ == "__main__":
    main()
