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

from fastcoil.base.arguments import checking, flag_of, number_of, refuse, text_of
from fastcoil.base.errors import nearest, shown
from fastcoil.loops.scenarios import attributes, check_result
from fastcoil.model.metric_table import COSTS, METRICS, STATUS_OK, YEARLY

COP = 4.0  # of a chiller with its tower, at the mean of a year: 0.6 kW a ton is 5.9, 1.0 kW a ton is 3.5
COP_LIMITS = 0.5, 20.0
CURRENCY = "USD"
LONGEST_CURRENCY = 20
DEAREST = 1e9
PRICES = {
    "electricity": ("the price of a kWh of electricity", 0.13),
    "demand": ("the monthly price of a kW of the highest 15-min demand, 0 for none", 15),
    "heat": ("the price of a kWh of heat, that of gas over the efficiency of the boiler", 0.05),
}
"""Every price: what it is, and an example for messages."""
MONTH = 30  # days of a block where the results have no dates
_MEAN_MONTH = 365.0 / 12.0


@dataclass(frozen=True)
class Tariff:
    """Prices per kWh of electricity and of heat and per kW of monthly demand, in ``currency``.

    cop: kWh that the chiller takes from the water per kWh of electricity.  electric_heat: whether an electric boiler
    makes the water of heating coils, so that they pay for demand.
    """

    electricity: float
    demand: float
    heat: float
    cop: float = COP
    electric_heat: bool = False
    currency: str = CURRENCY


def tariff_of(given: Mapping[str, Any], cure: str = "give it") -> Tariff:
    """The tariff of a table, without its ``baseline``; None stands for what is not given."""
    known = {name: value for name, value in given.items() if value is not None and name != "baseline"}
    limits = {name: (f"give {meaning}", 0.0, DEAREST) for name, (meaning, _) in PRICES.items()}
    low, high = COP_LIMITS
    limits["cop"] = (f"give the coefficient of performance of the chiller, from {low:g} to {high:g}", low, high)
    names = [each.name for each in fields(Tariff)]
    with checking() as check:
        unknown = [name for name in known if name not in names]
        check.problems += [f"{n} is unknown{nearest(n, names)}; known: {', '.join(names)}, baseline" for n in unknown]
        for name, (meaning, example) in PRICES.items():
            if name not in known:
                check.problems.append(f"{name} is missing: {cure}, {meaning}, such as {name} = {example:g}")
        for name, value in known.items():
            if name in limits:
                words, least, most = limits[name]
                known[name] = check(number_of, name, value, words, least=least, most=most)
        if "electric_heat" in known:
            known["electric_heat"] = check(flag_of, "electric_heat", known["electric_heat"])
        if "currency" in known:
            text = check(text_of, "currency", known["currency"])
            if text is not None and not (text.strip() and text.isprintable() and len(text) <= LONGEST_CURRENCY):
                cure = f"give its name in 1 to {LONGEST_CURRENCY} letters, such as 'USD'"
                check.problems.append(f"currency = {shown(text)}: {cure}")
    return Tariff(**known)


def billing_months(n_days: int, start: xr.DataArray | None) -> tuple[list[np.ndarray], dict[str, Any]]:
    """The positions of each month's days, and the coordinates of the months: label, number of days, share of a month.

    start: date and time of the first sample of each day; a day counts in the month in which it starts, and two that
    start on the same date are one.  None: every label is a day, and 30 of them are a month.
    """
    date = np.arange(n_days) if start is None else np.atleast_1d(start.values).astype("datetime64[D]")
    month = date // MONTH if start is None else date.astype("datetime64[M]")
    labels = np.unique(month)
    days = [np.flatnonzero(month == label) for label in labels]
    counts = np.array([np.unique(date[each]).size for each in days])
    said = {"long_name": "billing month"}
    if start is None:
        labels, whole = labels + 1, _MEAN_MONTH
    else:
        first, last = (m.astype("datetime64[D]").astype(int) for m in (labels, labels + np.timedelta64(1, "M")))
        labels, whole = labels.astype("datetime64[s]"), last - first
        said["time_zone"] = start.attrs.get("time_zone", "")
    return days, {
        "month": ("month", labels, said),
        "n_days": ("month", counts, {"long_name": "days of the month that count", "units": "1"}),
        "month_share": ("month", counts / whole, {"long_name": "share of a whole month", "units": "1"}),
    }


SUMS = ("coil_energy", "reheat_energy", "recool_energy", "motor_travel")
"""Metrics that are summed over the days of a month."""
NEEDED = (*SUMS, "coil_peak_power")
TAKEN = {"month", "n_days", "month_share", *SUMS, *COSTS, *(f"{YEARLY}{name}" for name in (*SUMS, *COSTS))}
"""Names in the answer that no dim of a result may have."""


def cost(
    ds: xr.Dataset,
    *,
    electricity: float | None = None,
    demand: float | None = None,
    heat: float | None = None,
    cop: float | None = None,
    electric_heat: bool | None = None,
    currency: str | None = None,
) -> xr.Dataset:
    """Value energy, demand, and supply air off its set-point, per billing month and per year.

    What is not given is taken from the table ``[tariff]`` of the study; without one the three prices are needed.

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
    """
    given = {name: value for name, value in locals().items() if name != "ds" and value is not None}
    check_result(ds)
    _require_billable(ds)
    in_study = tomllib.loads(str(ds.attrs.get("study_toml", ""))).get("tariff", {})
    tariff = tariff_of(in_study | given, "give it, or a table [tariff] in the study file")
    if "start" not in ds.coords:
        warnings.warn(
            f"the results have no dates: {MONTH} days are taken for a month; give the boundary a start to have the "
            "months of the calendar",
            stacklevel=2,
        )
    found = costs_of(ds, tariff)
    gives = int((found["yearly_coil_energy"] < 0.0).sum())
    if gives:
        warnings.warn(
            f"the coil energy of the year is negative in {gives:,} of {found['status'].size:,} loops: their valve acts "
            "the wrong way and their bill is too small; check action and the entering water",
            stacklevel=2,
        )
    return found


def _require_billable(ds: xr.Dataset) -> None:
    """Refuse a result without what the costs are made of, or with a name that they need themselves."""
    problems = []
    missing = [name for name in NEEDED if name not in ds]
    if missing:
        problems.append(f"ds has no {', '.join(missing)}: keep all metrics, or simulate an older result again")
    odd = [name for name in NEEDED if name in ds and set(ds[name].dims) != set(ds["status"].dims)]
    if odd:
        problems.append(f"ds has {', '.join(odd)} over other dims than status: give a whole result, with every day")
    problems += [f"ds has nothing along {dim}: choose a label at least" for dim, size in ds.sizes.items() if not size]
    taken = sorted(str(name) for name in {*ds.dims, *ds.coords} if name in TAKEN)
    problems += [f"ds has a dimension or coordinate {name}, which the costs also have: rename it" for name in taken]
    if not {*np.ravel(np.asarray(_action_of(ds), dtype=object))} <= {"cooling", "heating"}:
        problems.append(
            "ds does not say whether its coils cool or heat: keep its attributes, or give "
            "ds.assign_coords(action='cooling')"
        )
    start = ds.coords.get("start")
    # numbers would be taken for months since 1970
    if start is not None and (start.dtype.kind != "M" or not set(start.dims) <= {"day"} or bool(start.isnull().any())):
        problems.append("start has something else than a date for each day: drop it with ds.drop_vars('start')")
    refuse(problems)


def _action_of(ds: xr.Dataset) -> xr.DataArray:
    """Whether the coils of a result cool or heat, by a coordinate or by its attributes; neither where none says it."""
    constant = json.loads(ds.attrs.get("parameters", "{}")).get("action")
    return ds.coords["action"] if "action" in ds.coords else xr.DataArray(constant)


def costs_of(ds: xr.Dataset, tariff: Tariff) -> xr.Dataset:
    """The costs of a result; see ``cost``."""
    status = ds["status"]
    days = ds[list(NEEDED)].where(status == STATUS_OK).reset_coords(drop=True)
    # a day on which nothing ran for 15 min has no peak
    days["coil_peak_power"] = days["coil_peak_power"].fillna(0.0).where(status == STATUS_OK)
    start = ds.coords.get("start")
    if "day" not in days.dims:
        days, status = days.expand_dims("day"), status.expand_dims("day")
    of_months, months = billing_months(days.sizes["day"], start)
    shares = months["month_share"][1]
    years = math.fsum(shares) / 12.0  # of twelve months
    heating = xr.DataArray(_action_of(ds) == "heating").astype(float).reset_coords(drop=True)
    parts = [_month(days.isel(day=at), share, tariff, heating) for at, share in zip(of_months, shares, strict=True)]
    monthly = xr.concat(parts, "month")
    yearly = monthly.sum("month", skipna=False) / years
    yearly["demand"] = monthly["demand"].max("month", skipna=False)
    result = monthly.assign({f"{YEARLY}{name}": values for name, values in yearly.data_vars.items()})
    for name, values in result.data_vars.items():
        attrs = attributes({**METRICS, **COSTS}[str(name).removeprefix(YEARLY)])
        values.attrs = attrs | ({"units": tariff.currency} if attrs["units"] == "currency" else {})
    result["status"] = status.max("day", keep_attrs=True).reset_coords(drop=True)
    kept = {name: c for name, c in ds.coords.items() if set(c.dims) <= set(result["status"].dims) and name != "start"}
    result = result.assign_coords(kept | months)
    return result.drop_attrs(deep=False).assign_attrs(years=years, tariff=json.dumps(vars(tariff)))


def _month(days: xr.Dataset, share: float, tariff: Tariff, heating: xr.DataArray) -> xr.Dataset:
    """Energies and costs of the days of a month, which are a ``share`` of it."""
    found = days[list(SUMS)].sum("day", skipna=False)
    chilled = tariff.electricity / tariff.cop
    peak = days["coil_peak_power"].max("day", skipna=False)
    chills = 1.0 - heating
    found["demand"] = peak * (chills / tariff.cop + heating * float(tariff.electric_heat))
    found["coil_cost"] = found["coil_energy"] * (chills * chilled + heating * tariff.heat)
    found["demand_cost"] = found["demand"] * tariff.demand * share
    found["reheat_cost"] = found["reheat_energy"] * tariff.heat
    found["recool_cost"] = found["recool_energy"] * chilled
    found["cost"] = sum(found[name] for name in ("coil_cost", "demand_cost", "reheat_cost", "recool_cost"))
    return found
