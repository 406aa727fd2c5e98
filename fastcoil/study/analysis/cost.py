"""``cost``: what the energy of a result costs by a tariff, month by month and in a year."""

import json
import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, raise_problems, require_flag, require_number, require_text
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.loops.scenarios import cf_attributes, check_counted_result
from fastcoil.model.metric_table import COSTS, METRICS, STATUS_OK, YEARLY_PREFIX

MAX_PRICE = 1e9
PRICES = {
    "electricity": "the price of a kWh of electricity",
    "demand": "the monthly price of a kW of the highest 15-min demand, 0 for none",
    "heat": "the price of a kWh of heat, that of gas over the efficiency of the boiler",
}
COP_CURE = "give the coefficient of performance of the chiller, from 0.5 to 20"
MAX_CURRENCY_CHARACTERS = 20
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
    cop: float
    electric_heat: bool
    currency: str


def _require_currency(name: str, value: object) -> str:
    text = require_text(name, value)
    if not (text.strip() and text.isprintable() and len(text) <= MAX_CURRENCY_CHARACTERS):
        cure = f"give its name in 1 to {MAX_CURRENCY_CHARACTERS} letters, such as 'USD'"
        raise InputError(f"{name} = {short_repr(text)}: {cure}", name, "value")
    return text


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
    ds: xr.Dataset, *, electricity: float, demand: float, heat: float, cop: float = 4.0, electric_heat: bool = False,
    currency: str = "USD",
) -> xr.Dataset:  # fmt: skip
    """Value energy, demand, and supply air off its set-point, per billing month and per year.

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
        Coefficient of performance of the chiller with its tower, mean of a year: 0.6 kW a ton is 5.9, 1.0 kW a ton is
        3.5.
    electric_heat
        Whether an electric boiler makes the water of heating coils, so that they pay for demand.
    currency
        Unit of the prices.

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
        If a price is impossible, or ``ds`` lacks a metric.

    Examples
    --------
    >>> import numpy as np, fastcoil as fc
    >>> ds = fc.simulate(fc.Loop(), fc.constant_day(hours=0.6), warm_up=600, n_jobs=1)
    >>> ds = ds.assign_coords(start=np.datetime64("2026-07-01"))
    >>> costs = fc.cost(ds, electricity=0.13, demand=15, heat=0.05)
    >>> costs.cost.attrs["units"]
    'USD'
    """
    given = locals()
    with argument_checks() as check:
        check(check_counted_result, ds)
        prices = {
            name: check(require_number, name, given[name], f"give {meaning}", least=0.0, most=MAX_PRICE)
            for name, meaning in PRICES.items()
        }
        cop = check(require_number, "cop", cop, COP_CURE, least=0.5, most=20.0)
        electric_heat = check(require_flag, "electric_heat", electric_heat)
        currency = check(_require_currency, "currency", currency)
    _require_billable(ds)
    tariff = Tariff(**prices, cop=cop, electric_heat=electric_heat, currency=currency)
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
