"""What energy costs: the prices of a bill, and the months that it counts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import checking, flag_of, number_of, text_of
from fastcoil.base.errors import InputError, shown

COP = 4.0
"""Of a chiller with its tower, at the mean of a year: 0.6 kW a ton is 5.9, 1.0 kW a ton is 3.5."""
COP_LIMITS = 0.5, 20.0
CURRENCY = "USD"
LONGEST_CURRENCY = 20
DEAREST = 1e9
PRICES = {
    "electricity": ("the price of a kWh of electricity", 0.13),
    "demand": ("the monthly price of a kW of the highest 15-min demand, 0 for none", 15.0),
    "heat": ("the price of a kWh of heat, that of gas over the efficiency of the boiler", 0.05),
}
"""Every price: what it is, and an example for messages."""
MONTH = 30
"""Days of a block where the results have no dates."""
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
    """The tariff of a table, where None stands for what is not given.

    Raises
    ------
    InputError
        With a sentence for each price that is missing, or negative, or no number, a COP that no chiller has, and a
        currency of no or too many letters.
    """
    known = {name: value for name, value in given.items() if value is not None}
    with checking() as check:
        for name, (meaning, example) in PRICES.items():
            if name in known:
                known[name] = check(number_of, name, known[name], f"give {meaning}", least=0.0, most=DEAREST)
            else:
                check.problems.append(f"{name} is missing: {cure}, {meaning}, such as {name} = {example:g}")
        low, high = COP_LIMITS
        if "cop" in known:
            limits = f"give the coefficient of performance of the chiller, from {low:g} to {high:g}"
            known["cop"] = check(number_of, "cop", known["cop"], limits, least=low, most=high)
        if "electric_heat" in known:
            known["electric_heat"] = check(flag_of, "electric_heat", known["electric_heat"])
        if "currency" in known:
            known["currency"] = check(_currency_of, known["currency"])
    return Tariff(**known)


def _currency_of(value: object) -> str:
    text = text_of("currency", value)
    if not text.strip() or len(text) > LONGEST_CURRENCY or not text.isprintable():
        raise InputError(f"currency = {shown(text)}: give its name in 1 to {LONGEST_CURRENCY} letters, such as 'USD'")
    return text


class Months(NamedTuple):
    """Billing months: labels, the positions of each month's days, their number, and their share of a whole month."""

    labels: np.ndarray
    days: list[np.ndarray]
    n_days: np.ndarray
    share: np.ndarray

    @property
    def years(self) -> float:
        """Length of the sequence in years of twelve months."""
        return math.fsum(self.share) / 12.0


def billing_months(n_days: int, start: np.ndarray | None) -> Months:
    """The months of a sequence of days.

    Parameters
    ----------
    n_days
        Number of labels along ``day``.
    start
        Date and time of the first sample of each day, (n_days,) of datetime64; a day counts in the month in which it
        starts, and two that start on the same date are one.  None: every label is a day, and 30 of them are a month.
    """
    if start is None:
        number = np.arange(n_days) // MONTH
        labels = np.unique(number)
        days = [np.flatnonzero(number == k) for k in labels]
        counts = np.array([each.size for each in days])
        return Months(labels + 1, days, counts, counts / _MEAN_MONTH)
    month, date = start.astype("datetime64[M]"), start.astype("datetime64[D]")
    labels = np.unique(month)
    days = [np.flatnonzero(month == label) for label in labels]
    counts = np.array([np.unique(date[each]).size for each in days])
    first, last = (m.astype("datetime64[D]").astype(int) for m in (labels, labels + np.timedelta64(1, "M")))
    return Months(labels.astype("datetime64[s]"), days, counts, counts / (last - first))
