"""The tables of ``energy_cost.py``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import xarray as xr

from fastcoil.study.analysis.paired import share_of
from studies.common import write_table
from studies.cost.bills import (
    AIR,
    BILL,
    EVENED,
    HEAT,
    HOURS,
    MONEY,
    PEAK,
    WITHOUT,
    against_found,
    against_sound,
    between,
    bills,
    changes,
    spread,
    written,
)
from studies.days import HEATING

GAP = 0.07
"""Of the paper."""
_GAP = f"a gap of {100.0 * GAP:.0f} %"
NOTABLE = 1.0
"""Per cent by which something must rise to count, as in the scorecard of the paper."""
PLAIN = 0
"""Place of plain PI as found along ``controller``."""
HALF = 0.5
"""Share of the days on which a loop that counts as hunting hunts."""
_SUMS = {HEAT: "heat of the coil", PEAK: "peak of 15 min", AIR: "reheat and recooling, of the coil's heat",
         WITHOUT: "bill without reheat", EVENED: "bill, rooms even out a day", BILL: "bill with reheat"}  # fmt: skip


def hunting(ds: xr.Dataset) -> xr.DataArray:
    """Valves whose loop hunts with the gap under plain PI as found, and does not without: (sample)."""
    hunts = ds.hunts.isel(controller=PLAIN, drop=True).mean("day")
    return ((hunts.sel(backlash=GAP) >= HALF) & (hunts.sel(backlash=0.0) < HALF)).reset_coords(drop=True)


def groups(ds: xr.Dataset) -> Iterator[tuple[str, xr.DataArray]]:
    """All valves, and those that hunt because of the gap, if there are enough for a median."""
    hunts = hunting(ds)
    for name, among in (("all", hunts | True), ("hunt by the gap", hunts)):
        if int(among.sum()) >= 10:
            yield f"{name}: {int(among.sum())}", among


def _sizes(found: Mapping[str, xr.Dataset]) -> str:
    ds = next(iter(found.values()))
    failed, n = (
        sum(int(f(of)) for of in found.values()) for f in (lambda d: (d.status > 0).sum(), lambda d: d.status.size)
    )
    return f"{ds.sizes['sample']} valves × {ds.sizes['day']} days of each kind ({failed} of {n:,} days failed)"


def write_claim(found: Mapping[str, xr.Dataset]) -> None:
    """How many valves pay for the gap of the paper, by kind of day."""
    rows = []
    for kind, ds in found.items():
        change = against_sound(ds.isel(controller=[PLAIN])).sel(backlash=GAP).isel(controller=0)
        for name, among in groups(ds):
            cells = [str(share_of(change[m] > NOTABLE, among)) for m in _SUMS if m != AIR]
            rows.append([kind, name, *cells])
    write_table(
        "cost/cost_claim",
        f"Does {_GAP} raise it by more than {NOTABLE:g} %?  Share of the valves, against the same valve "
        f"without a gap under the same plain PI (95 % over valves): {_sizes(found)}",
        ["days", "valves", *(text for m, text in _SUMS.items() if m != AIR)],
        rows,
    )


def write_sums(found: Mapping[str, xr.Dataset]) -> None:
    """By how much the gap of the paper raises everything, by kind of day."""
    rows = []
    for kind, ds in found.items():
        plain = ds.isel(controller=[PLAIN]).sel(backlash=[0.0, GAP])
        for name, among in groups(ds):
            at = spread(plain, against_sound, among).sel(backlash=GAP).isel(controller=0)
            rows.append([kind, name, *(written(at[m]) for m in _SUMS), f"{between(at[BILL])} %"])
    write_table(
        "cost/cost_sums",
        f"What {_GAP} changes under plain PI as found: median over the valves (95 % over valves and days), "
        f"against the same valve without a gap; {_sizes(found)}",
        ["days", "valves", *_SUMS.values(), "bill with reheat, 5 to 95 % of the valves"],
        rows,
    )


def write_by_backlash(found: Mapping[str, xr.Dataset]) -> None:
    """The bill by the size of the gap, and what the valve does meanwhile; all kinds of cooling days together."""
    joined = _cooling(found)
    plain = joined.isel(controller=[PLAIN])
    at = spread(plain, against_sound).isel(controller=0)
    travel = plain.motor_travel.mean(["kind", "day"]).isel(controller=0, drop=True)
    off = HOURS * plain.share_off.mean(["kind", "day"]).isel(controller=0, drop=True)
    base = float(bills(plain.sel(backlash=0.0)).isel(controller=0)[BILL].median())
    rows = [
        [
            f"{100.0 * X:.0f} %",
            written(at[PEAK].sel(backlash=X)),
            written(at[BILL].sel(backlash=X), 2),
            written(at[MONEY].sel(backlash=X), 0, ""),
            between(at[MONEY].sel(backlash=X), 0),
            str(share_of(against_sound(plain)[BILL].sel(backlash=X).isel(controller=0, drop=True) > NOTABLE)),
            f"× {float((travel.sel(backlash=X) / travel.sel(backlash=0.0)).median()):.2f}",
            f"{float(off.sel(backlash=X).median()):.2f}",
        ]
        for X in map(float, joined.backlash.values)
    ]
    write_table(
        "cost/cost_backlash",
        f"Plain PI as found by the size of the gap, mean of all kinds of cooling days: median over "
        f"{joined.sizes['sample']} valves (95 % over valves and {joined.sizes['day']} days of each kind).  Without a "
        f"gap a valve pays {base:,.0f} USD a year of 365 such days",
        ["gap", "peak of 15 min", "bill", "USD a year", "5 to 95 % of the valves", f"bill over {NOTABLE:g} % up",
         "motor travel", "hours off by 0.5 K a day"],
        rows,
    )  # fmt: skip


def write_remedies(found: Mapping[str, xr.Dataset]) -> None:
    """What better control of the same worn valve saves; and a valve without a gap."""
    rows = []
    for kind, ds in found.items():
        plain = str(ds.controller.values[PLAIN])
        at = spread(ds.sel(backlash=[GAP]), against_found, None, plain, GAP)
        sound = spread(ds.isel(controller=[PLAIN]), _mended).isel(controller=0)
        worn = ds.sel(backlash=GAP)
        base = worn.isel(controller=PLAIN, drop=True)
        columns = {
            name: (at.sel(controller=name), worn.sel(controller=name)) for name in map(str, ds.controller.values)
        }
        columns["a valve without a gap"] = (sound, ds.sel(backlash=0.0).isel(controller=PLAIN))
        for name, (change, metrics) in columns.items():
            travel = metrics.motor_travel.mean("day") / base.motor_travel.mean("day")
            rows.append(
                [
                    kind,
                    name,
                    *(("0",) * 4 if name == plain else (written(change[m], 2) for m in (PEAK, WITHOUT, EVENED, BILL))),
                    "0" if name == plain else written(change[MONEY], 0, ""),
                    f"× {float(travel.median()):.2f}",
                    f"{HOURS * float(metrics.share_off.mean('day').median()):.2f}",
                ]
            )
    write_table(
        "cost/cost_remedies",
        f"What other control of a valve with {_GAP} changes, against plain PI as found: median over the "
        f"valves (95 % over valves and days); {_sizes(found)}",
        ["days", "control", *(_SUMS[m] for m in (PEAK, WITHOUT, EVENED, BILL)), "USD a year", "motor travel",
         "hours off by 0.5 K a day"],
        rows,
    )  # fmt: skip


def _mended(ds: xr.Dataset) -> xr.Dataset:
    """Changes without a gap against the gap of the paper."""
    bill = bills(ds)
    return changes(bill.sel(backlash=0.0, drop=True), bill.sel(backlash=GAP, drop=True))


def _cooling(found: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """All cooling days: (kind, day, …)."""
    parts = {kind: ds.drop_vars("day") for kind, ds in found.items() if kind != HEATING}
    names = xr.DataArray(list(parts), dims="kind", name="kind")
    return xr.concat(
        parts.values(), names, data_vars="all", coords="minimal", compat="override", combine_attrs="override"
    )
