"""Numbers as a reader wants them: three digits, the unit that is spoken, a dash where there is none."""

from __future__ import annotations

import math

import numpy as np

from fastcoil.base.text import MINUS, NONE, written
from fastcoil.loops.labels import quantity
from fastcoil.model.parameter_table import PARAMETERS

MOST_ROWS, _A_FEW_MORE = 12, 4
"""Of a table along a swept parameter; whoever wants all of them opens the results."""


def number(value: float, digits: int = 3) -> str:
    """A measured number of so many digits, zeros at its end too, without an exponent as far as it can be read."""
    if not math.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    if abs(rounded) >= 1e7 or abs(rounded) < 1e-4:
        return f"{value:.{digits - 1}e}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    text = f"{rounded:.{places}f}".replace("-", MINUS)
    return f"{rounded:,.0f}".replace("-", MINUS) if abs(rounded) >= 1e4 else text


def exact(value: float) -> str:
    """A number that somebody gave, as short as it can be written."""
    return f"{value:.6g}"


def change(share: float) -> str:
    """A difference as a share of what it is compared with: ``−43 %``."""
    if not math.isfinite(share):
        return NONE
    return f"{written(100.0 * share, 0, sign=True)} %"


def span(low: float, high: float) -> str:
    """An interval of such shares."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return NONE
    return f"{change(low).removesuffix(' %')} to {change(high)}"


def share(value: float) -> str:
    """``12 %``; neither 0 nor 100 unless it is all or nothing."""
    if not math.isfinite(value):
        return NONE
    if 0.0 < value < 0.005:
        return "< 1 %"
    return "> 99 %" if 0.995 < value < 1.0 else f"{100 * value:.0f} %"


def setting(name: str, value: object) -> str:
    """The value of a parameter with its unit: ``7 %``, ``0.03 1/K``, ``cooling``."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    shown = quantity(name)
    entry = PARAMETERS.get(name)
    if shown.factor == 1.0 and entry is not None and entry.whole:
        return str(int(value))
    return f"{exact(value * shown.factor)} {shown.unit}".rstrip()


def picked(n: int, keep: tuple[int, ...] = (), most: int = MOST_ROWS) -> list[int]:
    """Rows to show of ``n``: all, or evenly spaced ones with the first, the last and those to ``keep``."""
    if n <= most + _A_FEW_MORE:
        return list(range(n))
    spaced = np.linspace(0, n - 1, most - len(keep)).round().astype(int).tolist()
    return sorted({*spaced, *keep})


def left_out(n: int, shown: int, what: str) -> str:
    """A note on rows that are not shown; empty if all are."""
    return "" if shown == n else f"{shown} of {n:,} {what} are shown; all of them are in results.nc."
