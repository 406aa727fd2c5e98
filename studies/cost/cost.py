"""What backlash costs: whether it raises power, demand and the cost of energy, as the paper's introduction has it.

Valves and loops that the studies of hunting have not seen run without and with a gap, under plain PI as found, PI with
the gains of SIMC, and an inverse of 95 % of the gap, on days of every kind.  ``fc.cost`` values them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import concat_along, failures_in_words, progress_printer, share_of, write_table
from studies.days import CONSTANT, HEATING, kinds, make_days
from studies.hunting.loops import adapt_to_kind, valves
from studies.robustness.best_pi import simc_gains

TARIFF = {"electricity": 0.13, "demand": 15.0, "heat": 0.05, "cop": 4.0, "currency": "USD"}
"""Round numbers near those of commercial customers in the United States; see ``docs/findings/cost.md``."""
HEAT, PEAK, AIR_HEAT, WITHOUT_REHEAT, EVENED_BILL, BILL, MONEY = (
    "heat",
    "peak",
    "air",
    "without",
    "evened",
    "bill",
    "money",
)
RESAMPLES = 200  # resamples of the bootstrap
RESAMPLE_BATCH = 20  # resamples that are computed together
COUNTED_HOURS = 7.5  # of a day, after the warm-up


def bills(ds: xr.Dataset) -> xr.Dataset:
    """Per valve and year: heat of the coil (kWh), highest 15 min (kW), heat between air and set-point (kWh), money.

    without: what is paid if air off its set-point costs nothing.  evened: if rooms even it out over a day, so that only
    the day's mean has to be made up for.  Of several kinds of days along ``kind`` the mean.
    """
    net = ds.reheat_energy - ds.recool_energy
    evened = ds.assign(reheat_energy=net.clip(min=0.0), recool_energy=(-net).clip(min=0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # days of a kind have no dates
        costs, evened_costs = fc.cost(ds, **TARIFF), fc.cost(evened, **TARIFF)
    yearly = xr.Dataset(
        {
            HEAT: costs.yearly_coil_energy,
            PEAK: ds.coil_peak_power.max("day"),
            AIR_HEAT: costs.yearly_reheat_energy + costs.yearly_recool_energy,
            WITHOUT_REHEAT: costs.yearly_coil_cost + costs.yearly_demand_cost,
            EVENED_BILL: evened_costs.yearly_cost,
            BILL: costs.yearly_cost,
        }
    ).reset_coords(drop=True)
    return yearly.mean("kind") if "kind" in yearly.dims else yearly


def bill_changes(bill: xr.Dataset, base: xr.Dataset) -> xr.Dataset:
    """Changes against the base, of the same valves.

    heat, peak, without, evened, bill: per cent of the base; air: per cent of the heat of its coil; money: of a year.
    """
    difference = bill - base
    relative = [HEAT, PEAK, WITHOUT_REHEAT, EVENED_BILL, BILL]
    return (100.0 * difference[relative] / base[relative]).assign(
        {AIR_HEAT: 100.0 * difference[AIR_HEAT] / base[HEAT], MONEY: difference[BILL]}
    )


def changes_against_sound(ds: xr.Dataset) -> xr.Dataset:
    """Changes with each gap against the same valve and controller without one: (sample, controller, backlash)."""
    bill = bills(ds)
    return bill_changes(bill, bill.sel(backlash=0.0, drop=True))


def changes_against_pi(ds: xr.Dataset, plain: str, backlash: float) -> xr.Dataset:
    """Changes with each controller against plain PI as found, of valves with this gap: (sample, controller)."""
    bill = bills(ds.sel(backlash=backlash, drop=True))
    return bill_changes(bill, bill.sel(controller=plain, drop=True))


def spread_over_valves(ds: xr.Dataset, measure, among: xr.DataArray | None = None, *arguments: object) -> xr.Dataset:
    """Median over valves with its interval, and what 5 and 95 % of the valves stay below, along ``statistic``.

    measure: makes changes per valve from metrics by day.  among: the valves that count.  The interval comes from
    valves and days drawn anew.
    """
    ds = ds if among is None else ds.isel(sample=np.flatnonzero(among.values))
    per_valve, rng = measure(ds, *arguments), np.random.default_rng(16499)
    n_days, n = ds.sizes["day"], ds.sizes["sample"]
    medians = []
    for _ in range(RESAMPLES // RESAMPLE_BATCH):
        days = xr.DataArray(rng.integers(n_days, size=(RESAMPLE_BATCH, n_days)), dims=("resample", "day"))
        resampled = measure(ds.drop_vars("day", errors="ignore").isel(day=days), *arguments)
        for k in range(RESAMPLE_BATCH):
            medians.append(resampled.isel(resample=k, sample=rng.integers(n, size=n)).median("sample"))
    low, high = (xr.concat(medians, "resample").quantile(q, "resample", skipna=True) for q in (0.025, 0.975))
    parts = [
        per_valve.median("sample"),
        low,
        high,
        *(per_valve.quantile(q, "sample", skipna=True) for q in (0.05, 0.95)),
    ]
    names = xr.DataArray(["median", "low", "high", "q05", "q95"], dims="statistic", name="statistic")
    return xr.concat([part.drop_vars("quantile", errors="ignore") for part in parts], names, coords="minimal")


def format_median(values: xr.DataArray, digits: int = 1, unit: str = " %") -> str:
    """A median with its interval, from a cell of ``spread_over_valves``."""
    value, low, high = (float(values.sel(statistic=s)) for s in ("median", "low", "high"))
    return f"{_format_signed(value, digits)}{unit} ({_format_signed(low, digits)} to {_format_signed(high, digits)})"


def format_range(values: xr.DataArray, digits: int = 1) -> str:
    """Format what 5 and 95 % of the valves stay below."""
    return " to ".join(_format_signed(float(values.sel(statistic=s)), digits) for s in ("q05", "q95"))


def _format_signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text


GAP = 0.07  # backlash of the paper, fraction of stroke
_GAP_TEXT = f"a gap of {100.0 * GAP:.0f} %"
NOTABLE_RISE = 1.0  # per cent by which something must rise to count, as in the scorecard of the paper
PLAIN_INDEX = 0  # place of plain PI as found along ``controller``
HUNTING_SHARE = 0.5  # share of the days on which a loop that counts as hunting hunts
_SUM_LABELS = {HEAT: "heat of the coil", PEAK: "peak of 15 min", AIR_HEAT: "reheat and recooling, of the coil's heat",
         WITHOUT_REHEAT: "bill without reheat", EVENED_BILL: "bill, rooms even out a day",
         BILL: "bill with reheat"}  # fmt: skip


def is_hunting_by_gap(ds: xr.Dataset) -> xr.DataArray:
    """Valves whose loop hunts with the gap under plain PI as found, and does not without: (sample)."""
    hunts = ds.hunts.isel(controller=PLAIN_INDEX, drop=True).mean("day")
    return ((hunts.sel(backlash=GAP) >= HUNTING_SHARE) & (hunts.sel(backlash=0.0) < HUNTING_SHARE)).reset_coords(
        drop=True
    )


def valve_groups(ds: xr.Dataset) -> Iterator[tuple[str, xr.DataArray]]:
    """All valves, and those that hunt because of the gap, if there are enough for a median."""
    hunts = is_hunting_by_gap(ds)
    for name, among in (("all", hunts | True), ("hunt by the gap", hunts)):
        if int(among.sum()) >= 10:
            yield f"{name}: {int(among.sum())}", among


def _sizes_text(by_kind: Mapping[str, xr.Dataset]) -> str:
    ds = next(iter(by_kind.values()))
    return f"{ds.sizes['sample']} valves × {ds.sizes['day']} days of each kind ({failures_in_words(by_kind.values())})"


def write_claim(by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write the share of valves whose bill the gap of the paper raises, by kind of day."""
    rows = []
    for kind, ds in by_kind.items():
        change = changes_against_sound(ds.isel(controller=[PLAIN_INDEX])).sel(backlash=GAP).isel(controller=0)
        for name, among in valve_groups(ds):
            cells = [str(share_of(change[m] > NOTABLE_RISE, among)) for m in _SUM_LABELS if m != AIR_HEAT]
            rows.append([kind, name, *cells])
    write_table(
        "cost/cost_claim",
        f"Share of the valves for which {_GAP_TEXT} raises each quantity by more than {NOTABLE_RISE:g} %, compared "
        "with the same "
        f"valve without a gap under the same plain PI (95 % over valves): {_sizes_text(by_kind)}",
        ["days", "valves", *(text for m, text in _SUM_LABELS.items() if m != AIR_HEAT)],
        rows,
    )


def write_sums(by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write by how much the gap of the paper raises each quantity, by kind of day."""
    rows = []
    for kind, ds in by_kind.items():
        plain = ds.isel(controller=[PLAIN_INDEX]).sel(backlash=[0.0, GAP])
        for name, among in valve_groups(ds):
            medians = spread_over_valves(plain, changes_against_sound, among).sel(backlash=GAP).isel(controller=0)
            rows.append(
                [kind, name, *(format_median(medians[m]) for m in _SUM_LABELS), f"{format_range(medians[BILL])} %"]
            )
    write_table(
        "cost/cost_sums",
        f"Effect of {_GAP_TEXT} under plain PI with existing gains: median over the valves (95 % over valves and "
        "days), "
        f"compared with the same valve without a gap; {_sizes_text(by_kind)}",
        ["days", "valves", *_SUM_LABELS.values(), "bill with reheat, 5 to 95 % of the valves"],
        rows,
    )


def write_by_backlash(by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write the bill and the valve's travel by size of the gap, over all kinds of cooling days."""
    joined = _join_cooling(by_kind)
    plain = joined.isel(controller=[PLAIN_INDEX])
    medians = spread_over_valves(plain, changes_against_sound).isel(controller=0)
    travel = plain.motor_travel.mean(["kind", "day"]).isel(controller=0, drop=True)
    hours_off = COUNTED_HOURS * plain.share_off.mean(["kind", "day"]).isel(controller=0, drop=True)
    base = float(bills(plain.sel(backlash=0.0)).isel(controller=0)[BILL].median())
    rows = [
        [
            f"{100.0 * X:.0f} %",
            format_median(medians[PEAK].sel(backlash=X)),
            format_median(medians[BILL].sel(backlash=X), 2),
            format_median(medians[MONEY].sel(backlash=X), 0, ""),
            format_range(medians[MONEY].sel(backlash=X), 0),
            str(
                share_of(
                    changes_against_sound(plain)[BILL].sel(backlash=X).isel(controller=0, drop=True) > NOTABLE_RISE
                )
            ),
            f"× {float((travel.sel(backlash=X) / travel.sel(backlash=0.0)).median()):.2f}",
            f"{float(hours_off.sel(backlash=X).median()):.2f}",
        ]
        for X in map(float, joined.backlash.values)
    ]
    write_table(
        "cost/cost_backlash",
        f"Plain PI with existing gains, by size of the gap; mean of all kinds of cooling days: median over "
        f"{joined.sizes['sample']} valves (95 % over valves and {joined.sizes['day']} days of each kind).  Without a "
        f"gap a valve pays {base:,.0f} USD a year of 365 such days",
        ["gap", "peak of 15 min", "bill", "USD a year", "5 to 95 % of the valves", f"bill over {NOTABLE_RISE:g} % up",
         "motor travel", "hours off by 0.5 K a day"],
        rows,
    )  # fmt: skip


def write_remedies(by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write what better control of the same worn valve saves, and what a valve without a gap saves."""
    rows = []
    for kind, ds in by_kind.items():
        plain = str(ds.controller.values[PLAIN_INDEX])
        medians = spread_over_valves(ds.sel(backlash=[GAP]), changes_against_pi, None, plain, GAP)
        sound = spread_over_valves(ds.isel(controller=[PLAIN_INDEX]), _changes_without_gap).isel(controller=0)
        worn = ds.sel(backlash=GAP)
        base = worn.isel(controller=PLAIN_INDEX, drop=True)
        columns = {
            name: (medians.sel(controller=name), worn.sel(controller=name)) for name in map(str, ds.controller.values)
        }
        columns["a valve without a gap"] = (sound, ds.sel(backlash=0.0).isel(controller=PLAIN_INDEX))
        for name, (change, metrics) in columns.items():
            travel = metrics.motor_travel.mean("day") / base.motor_travel.mean("day")
            rows.append(
                [
                    kind,
                    name,
                    *(
                        ("0",) * 4
                        if name == plain
                        else (format_median(change[m], 2) for m in (PEAK, WITHOUT_REHEAT, EVENED_BILL, BILL))
                    ),
                    "0" if name == plain else format_median(change[MONEY], 0, ""),
                    f"× {float(travel.median()):.2f}",
                    f"{COUNTED_HOURS * float(metrics.share_off.mean('day').median()):.2f}",
                ]
            )
    write_table(
        "cost/cost_remedies",
        f"Effect of other controls of a valve with {_GAP_TEXT}, compared with plain PI with existing gains: median "
        "over the "
        f"valves (95 % over valves and days); {_sizes_text(by_kind)}",
        [
            "days",
            "control",
            *(_SUM_LABELS[m] for m in (PEAK, WITHOUT_REHEAT, EVENED_BILL, BILL)),
            "USD a year",
            "motor travel",
            "hours off by 0.5 K a day",
        ],
        rows,
    )


def _changes_without_gap(ds: xr.Dataset) -> xr.Dataset:
    """Changes without a gap against the gap of the paper."""
    bill = bills(ds)
    return bill_changes(bill.sel(backlash=0.0, drop=True), bill.sel(backlash=GAP, drop=True))


def _join_cooling(by_kind: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """All cooling days: (kind, day, …)."""
    parts = {kind: ds.drop_vars("day") for kind, ds in by_kind.items() if kind != HEATING}
    return concat_along("kind", parts, data_vars="all", coords="minimal", compat="override", combine_attrs="override")


SEED = 16401
FRESH_DAYS = range(16411, 16421)
BACKLASH_SIZES = (0.0, 0.02, 0.05, 0.07, 0.10, 0.15)
AS_FOUND, SIMC, INVERSE = "PI as found", "PI by SIMC", "inverse of 95 %"
INVERSE_BUFFER = 0.0025  # of the inverse, fraction of stroke
NOISE_RANGE = (0.0, 0.05)  # between which the noise of a sensor is drawn, K
KEPT_METRICS = (
    *("coil_energy", "coil_peak_power", "reheat_energy", "recool_energy"),
    "motor_travel",
    "share_off",
    "hunts",
)


def loops(seed: int, size: int, kind: str) -> fc.Loop:
    """Valves and loops along ``sample``, with every gap, under every controller."""
    noise = np.random.default_rng([seed, 7]).uniform(*NOISE_RANGE, size)
    loop = adapt_to_kind(valves(seed, size), kind).assign(noise_std=("sample", noise), backlash=0.0)
    # a step of the command finds the plant, and the gap is no part of it
    simc = simc_gains(loop, HEATING if kind == HEATING else CONSTANT)
    own_gains = xr.Dataset({name: xr.DataArray(loop[name]) for name in ("kp", "ti")})
    gains = concat_along("controller", {AS_FOUND: own_gains, SIMC: simc[["kp", "ti"]], INVERSE: own_gains})
    return loop.assign(
        backlash=list(BACKLASH_SIZES),
        estimate_ratio=xr.DataArray([0.0, 0.0, 0.95], dims="controller"),
        buffer=xr.DataArray([1e-9, 1e-9, INVERSE_BUFFER], dims="controller"),
        kp=gains.kp,
        ti=gains.ti,
    )


def simulate_days(seed: int, size: int, kind: str) -> xr.Dataset:
    """Metrics on fresh days of a kind: (day, sample, controller, backlash)."""
    ds = fc.simulate(loops(seed, size, kind), make_days(kind, FRESH_DAYS), seed=seed)
    return ds[[*KEPT_METRICS, "status"]]


def sample(size: int = 384) -> None:
    """Write the table of one kind of day."""
    write_claim({CONSTANT: simulate_days(SEED, size, CONSTANT)})


def main(size: int = 384) -> None:
    """Run every kind of day and write the tables."""
    report = progress_printer()
    by_kind = {}
    for kind in kinds():
        by_kind[kind] = simulate_days(SEED, size, kind)
        report(f"ran {kind}")
    write_claim(by_kind)
    write_sums(by_kind)
    write_by_backlash(by_kind)
    write_remedies(by_kind)
