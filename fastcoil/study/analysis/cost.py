"""``cost``: what the energy of a result costs by a tariff, month by month and in a year."""

import json
import math
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, raise_problems, require_flag, require_number, require_text
from fastcoil.base.errors import Problem, did_you_mean, short_repr
from fastcoil.loops.scenarios import cf_attributes, check_counted_result
from fastcoil.model.metric_table import COSTS, METRICS, STATUS_OK, YEARLY_PREFIX

DEFAULT_COP = 4.0  # of a chiller with its tower, mean of a year: 0.6 kW a ton is 5.9, 1.0 kW a ton is 3.5
COP_LIMITS = 0.5, 20.0
DEFAULT_CURRENCY = "USD"
MAX_CURRENCY_CHARACTERS = 20
MAX_PRICE = 1e9
PRICES = {
    "electricity": ("the price of a kWh of electricity", 0.13),
    "demand": ("the monthly price of a kW of the highest 15-min demand, 0 for none", 15),
    "heat": ("the price of a kWh of heat, that of gas over the efficiency of the boiler", 0.05),
}
"""Every price: what it is, and an example for messages."""
MONTH_DAYS = 30  # of a block where the results have no dates


@dataclass(frozen=True)
class Tariff:
    """Prices per kWh of electricity and of heat and per kW of monthly demand, in ``currency``.

    cop: kWh that the chiller takes from the water per kWh of electricity.  electric_heat: whether an electric boiler
    makes the water of heating coils, so that they pay for demand.
    """

    electricity: float
    demand: float
    heat: float
    cop: float = DEFAULT_COP
    electric_heat: bool = False
    currency: str = DEFAULT_CURRENCY


def parse_tariff(table: Mapping[str, Any], cure: str = "give it") -> Tariff:
    """Parse the tariff of a table without its ``baseline``; None stands for a missing entry."""
    entries = {name: value for name, value in table.items() if value is not None and name != "baseline"}
    limits = {name: (f"give {meaning}", 0.0, MAX_PRICE) for name, (meaning, _) in PRICES.items()}
    low, high = COP_LIMITS
    limits["cop"] = (f"give the coefficient of performance of the chiller, from {low:g} to {high:g}", low, high)
    names = [each.name for each in fields(Tariff)]
    with argument_checks() as check:
        for n in [n for n in entries if n not in names]:
            sentence = f"{n} is unknown{did_you_mean(n, names)}; known: {', '.join(names)}, baseline"
            check.problems.append(Problem(sentence, n, "name"))
        for name, (meaning, example) in PRICES.items():
            if name not in entries:
                sentence = f"{name} is missing: {cure}, {meaning}, such as {name} = {example:g}"
                check.problems.append(Problem(sentence, name, "missing"))
        for name, value in entries.items():
            if name in limits:
                words, least, most = limits[name]
                entries[name] = check(require_number, name, value, words, least=least, most=most)
        if "electric_heat" in entries:
            entries["electric_heat"] = check(require_flag, "electric_heat", entries["electric_heat"])
        if "currency" in entries:
            text = check(require_text, "currency", entries["currency"])
            if text is not None and not (text.strip() and text.isprintable() and len(text) <= MAX_CURRENCY_CHARACTERS):
                cure = f"give its name in 1 to {MAX_CURRENCY_CHARACTERS} letters, such as 'USD'"
                check.problems.append(Problem(f"currency = {short_repr(text)}: {cure}", "currency", "value"))
    return Tariff(**entries)


def billing_months(n_days: int, start: xr.DataArray | None) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Return the positions of each month's days, and the coordinates of the months: label, days, share of a month.

    start: date and time of the first sample of each day; a day counts in the month in which it starts, and two that
    start on the same date are one; one for all is that of the first of consecutive days, as of ``Boundary``.  None:
    every label is a day, and 30 of them are a month.
    """
    date: np.ndarray = np.arange(n_days)
    if start is not None:
        date = start.values.astype("datetime64[D]") + (date if start.ndim == 0 else 0)
    month = date // MONTH_DAYS if start is None else date.astype("datetime64[M]")
    labels = np.unique(month)
    days = [np.flatnonzero(month == label) for label in labels]
    counts = np.array([np.unique(date[each]).size for each in days])
    attrs = {"long_name": "billing month"}
    if start is None:
        labels, month_days = labels + 1, 365.0 / 12.0
    else:
        first, last = (m.astype("datetime64[D]").astype(int) for m in (labels, labels + np.timedelta64(1, "M")))
        labels, month_days = labels.astype("datetime64[s]"), last - first
        attrs["time_zone"] = start.attrs.get("time_zone", "")
    return days, {
        "month": ("month", labels, attrs),
        "n_days": ("month", counts, {"long_name": "days of the month that count", "units": "1"}),
        "month_share": ("month", counts / month_days, {"long_name": "share of a whole month", "units": "1"}),
    }


SUMMED_METRICS = ("coil_energy", "reheat_energy", "recool_energy", "motor_travel")  # over the days of a month
REQUIRED_METRICS = (*SUMMED_METRICS, "coil_peak_power")
COST_NAMES = {"month", "n_days", "month_share", *SUMMED_METRICS, *COSTS}
COST_NAMES |= {f"{YEARLY_PREFIX}{name}" for name in (*SUMMED_METRICS, *COSTS)}  # no dim of a result may have one


def cost(
    ds: xr.Dataset, *, electricity: float | None = None, demand: float | None = None, heat: float | None = None,
    cop: float | None = None, electric_heat: bool | None = None, currency: str | None = None,
) -> xr.Dataset:  # fmt: skip
    """Value energy, demand, and supply air off its set-point, per billing month and per year.

    A missing price is taken from the table ``[tariff]`` of the study; without one the three prices are required.

    Parameters
    ----------
    ds
        A result of ``simulate`` or ``open_study``; of each of its days the whole load counts, whatever its hours.
    electricity
        Price of a kWh of electricity.
    demand
        Price of a kW of the highest 15-min mean of a month, per month.
    heat
        Price of a kWh of heat, for reheat and for heating coils: that of gas over the efficiency of the boiler.
    cop
        Coefficient of performance of the chiller; 4 by default.
    electric_heat
        Whether an electric boiler makes the water of heating coils, so that they pay for demand; no by default.
    currency
        Unit of the prices; ``"USD"`` by default.

    Returns
    -------
    xarray.Dataset
        Over the dims of ``ds`` without ``day``, and ``month``: ``coil_energy``, ``reheat_energy``, ``recool_energy``
        (kWh) and ``motor_travel`` (strokes), summed; ``demand`` (kW); and ``coil_cost``, ``demand_cost``,
        ``reheat_cost``, ``recool_cost`` and their sum ``cost``, in ``currency``.  The coordinates ``n_days`` and
        ``month_share`` say how much of a month its days are.  The same names with ``yearly_`` before them, without
        ``month``, are the whole sequence scaled to twelve months; ``yearly_demand`` is the highest, not scaled.
        ``status`` is the worst of the days; where it is not 0, all is NaN.

        The months are those of the calendar where ``ds`` has a coordinate ``start``, in its own time zone; a day
        belongs to the month in which it starts.  Without one they are blocks of 30 days, with a warning.  An incomplete
        month pays its share of the demand price, and its demand is the highest of the days that it has.

    Raises
    ------
    InputError
        If a price is missing or impossible, or ``ds`` lacks a metric.

    Examples
    --------
    >>> import numpy as np, fastcoil as fc
    >>> ds = fc.simulate(fc.Loop(), fc.constant_day(hours=0.6), warm_up=600, n_jobs=1)
    >>> ds = ds.assign_coords(start=np.datetime64("2026-07-01"))
    >>> costs = fc.cost(ds, electricity=0.13, demand=15, heat=0.05)
    >>> costs.cost.attrs["units"]
    'USD'
    """
    prices = {name: value for name, value in locals().items() if name != "ds" and value is not None}
    check_counted_result(ds)
    _require_billable(ds)
    study_prices = tomllib.loads(str(ds.attrs.get("study_toml", ""))).get("tariff", {})
    tariff = parse_tariff(study_prices | prices, "give it, or a table [tariff] in the study file")
    if "start" not in ds.coords:
        cure = "give the boundary a start to have the months of the calendar"
        warnings.warn(f"the results have no dates: {MONTH_DAYS} days are taken for a month; {cure}", stacklevel=2)
    costs = compute_costs(ds, tariff)
    if n_negative := int((costs["yearly_coil_energy"] < 0.0).sum()):
        sentence = f"the coil energy of the year is negative in {n_negative:,} of {costs['status'].size:,} loops"
        reason = "their valve acts the wrong way and their bill is too small; check action and the entering water"
        warnings.warn(f"{sentence}: {reason}", stacklevel=2)
    return costs


def _require_billable(ds: xr.Dataset) -> None:
    """Refuse a result without what the costs are made of, or with a name that they have themselves."""
    problems: list[Problem] = []

    def add(sentence: str, field: str, code: str) -> None:
        problems.append(Problem(sentence, field, code))

    if missing := [name for name in REQUIRED_METRICS if name not in ds]:
        add(f"ds has no {', '.join(missing)}: keep all metrics, or simulate an older result again", "ds", "missing")
    dims = set(ds["status"].dims)
    if misshapen := [name for name in REQUIRED_METRICS if name in ds and set(ds[name].dims) != dims]:
        cure = "give a whole result, with every day"
        add(f"ds has {', '.join(misshapen)} over other dims than status: {cure}", "ds", "shape")
    for name in sorted(str(name) for name in {*ds.dims, *ds.coords} if name in COST_NAMES):
        add(f"ds has a dimension or coordinate {name}, which the costs also have: rename it", name, "name")
    if not {*np.ravel(np.asarray(_coil_action(ds), dtype=object))} <= {"cooling", "heating"}:
        cure = "keep its attributes, or give ds.assign_coords(action='cooling')"
        add(f"ds does not say whether its coils cool or heat: {cure}", "action", "missing")
    start = ds.coords.get("start")
    # numbers would be taken for months since 1970
    if start is not None and (start.dtype.kind != "M" or not set(start.dims) <= {"day"} or bool(start.isnull().any())):
        cure = "drop it with ds.drop_vars('start')"
        add(f"start has something else than a date for each day: {cure}", "start", "time")
    raise_problems(problems)


def _coil_action(ds: xr.Dataset) -> xr.DataArray:
    """Return whether the coils of a result cool or heat, by a coordinate or an attribute; None without either."""
    constant = json.loads(ds.attrs.get("parameters", "{}")).get("action")
    return ds.coords["action"] if "action" in ds.coords else xr.DataArray(constant)


def compute_costs(ds: xr.Dataset, tariff: Tariff) -> xr.Dataset:
    """Compute the costs of a result; see ``cost``."""
    status = ds["status"]
    days = ds[list(REQUIRED_METRICS)].where(status == STATUS_OK).reset_coords(drop=True)
    # a day on which nothing ran for 15 min has no peak
    days["coil_peak_power"] = days["coil_peak_power"].fillna(0.0).where(status == STATUS_OK)
    start = ds.coords.get("start")
    if "day" not in days.dims:
        days, status = days.expand_dims("day"), status.expand_dims("day")
    days_of_months, months = billing_months(days.sizes["day"], start)
    shares = months["month_share"][1]
    years = math.fsum(shares) / 12.0  # of twelve months
    heating = xr.DataArray(_coil_action(ds) == "heating").astype(float).reset_coords(drop=True)
    by_month = zip(days_of_months, shares, strict=True)
    monthly = xr.concat([_month_costs(days.isel(day=at), share, tariff, heating) for at, share in by_month], "month")
    yearly = monthly.sum("month", skipna=False) / years
    yearly["demand"] = monthly["demand"].max("month", skipna=False)
    result = monthly.assign({f"{YEARLY_PREFIX}{name}": values for name, values in yearly.data_vars.items()})
    for name, values in result.data_vars.items():
        attrs = cf_attributes({**METRICS, **COSTS}[str(name).removeprefix(YEARLY_PREFIX)])
        values.attrs = attrs | ({"units": tariff.currency} if attrs["units"] == "currency" else {})
    result["status"] = status.max("day", keep_attrs=True).reset_coords(drop=True)
    kept = {name: c for name, c in ds.coords.items() if set(c.dims) <= set(result["status"].dims) and name != "start"}
    result = result.assign_coords(kept | months)
    return result.drop_attrs(deep=False).assign_attrs(years=years, tariff=json.dumps(vars(tariff)))


def _month_costs(days: xr.Dataset, share: float, tariff: Tariff, heating: xr.DataArray) -> xr.Dataset:
    """Compute energies and costs of the days of a month, which are a ``share`` of it."""
    costs = days[list(SUMMED_METRICS)].sum("day", skipna=False)
    cooling_price = tariff.electricity / tariff.cop
    peak = days["coil_peak_power"].max("day", skipna=False)
    cooling = 1.0 - heating
    costs["demand"] = peak * (cooling / tariff.cop + heating * float(tariff.electric_heat))
    costs["coil_cost"] = costs["coil_energy"] * (cooling * cooling_price + heating * tariff.heat)
    costs["demand_cost"] = costs["demand"] * tariff.demand * share
    costs["reheat_cost"] = costs["reheat_energy"] * tariff.heat
    costs["recool_cost"] = costs["recool_energy"] * cooling_price
    costs["cost"] = sum(costs[name] for name in ("coil_cost", "demand_cost", "reheat_cost", "recool_cost"))
    return costs
