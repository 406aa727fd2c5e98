"""Text for people: control characters escaped, numbers formatted."""

import math
import re
import unicodedata
from collections.abc import Collection, Sequence

_UNSAFE_CATEGORIES = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories: control, format (including bidirectional), surrogates, line and paragraph separators."""


def escape_control_characters(text: str) -> str:
    r"""Escape control characters in untrusted text, as Python does: ``\x1b``, ``\u202e``."""
    if text.isprintable():
        return text
    return "".join(
        character.encode("unicode_escape").decode()
        if unicodedata.category(character) in _UNSAFE_CATEGORIES
        else character
        for character in text
    )


_FORMULA_START = re.compile(r"(^|[,;\t]\s*)(?=[=+\-@])")


def escape_formulas(text: str) -> str:
    """Text for a CSV file: an apostrophe stands before what a spreadsheet would take as a formula."""
    return _FORMULA_START.sub(r"\1'", text)


def parse_number_or_word(text: str) -> float | str:
    """The number that a text is, or the text itself."""
    try:
        return float(text)
    except ValueError:
        return text


MINUS_SIGN = "\N{MINUS SIGN}"
MISSING_VALUE = "\N{EN DASH}"
"""Stands for a missing value."""
_MAX_TWO_DIGIT_UNCERTAINTY = 35
"""An uncertainty whose leading digits are at most this gets two digits, otherwise one (Particle Data Group)."""
_MAX_DECIMALS = 6
_THOUSANDS_RANGE = 999.5, 1e7  # range of numbers written out with thousands separators


def decimals_for_uncertainty(uncertainty: float) -> int | None:
    """Number of decimals for a value with this uncertainty; None if the uncertainty is 0 or not finite.

    Source: Particle Data Group, Review of Particle Physics (2024), doi:10.1103/PhysRevD.110.030001, section 5.3.
    """
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return None
    exponent = math.floor(math.log10(uncertainty))
    leading = round(uncertainty / 10.0 ** (exponent - 1), 6)
    return max(0, (1 if leading <= _MAX_TWO_DIGIT_UNCERTAINTY else 0) - exponent)


def format_number(value: float, decimals: int | None = None, *, sign: bool = False) -> str:
    """Format a number with ``decimals``, or with three significant digits.

    sign: write a plus before positive numbers.
    """
    if math.isnan(value):
        return MISSING_VALUE
    if math.isinf(value):
        text = "∞"
    elif decimals is None or decimals > _MAX_DECIMALS:
        text = _format_three_digits(abs(value))
    else:
        text = f"{abs(value):.{decimals}f}"
    is_zero = not text.strip("0.")
    if is_zero:
        return text
    return (MINUS_SIGN if value < 0.0 else "+" if sign else "") + text


def align_columns(rows: Sequence[Sequence[str]], *, right: Collection[int] = ()) -> list[str]:
    """Rows of cells as lines of text with aligned columns, two spaces apart; columns ``right`` are set to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [c.rjust(w) if k in right else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        lines.append("  ".join(cells).rstrip())
    return lines


def format_share(share: float, low: float = math.nan, high: float = math.nan, *, decimals: int = 0) -> str:
    """Format a share, with its interval if given: ``12 % (10 to 15)``."""
    value, *ends = (f"{100.0 * fraction:.{decimals}f}" for fraction in (share, low, high))
    if math.isnan(share):
        return MISSING_VALUE
    return f"{value} %" if math.isnan(low) else f"{value} % ({' to '.join(ends)})"


_MINUTES_FROM_SECONDS = 120.0  # seconds from which a period is given in minutes
_NEGLIGIBLE_KELVIN = 5e-4  # temperature difference that nobody sees, K


def format_period(value: float) -> str:
    """A period in words."""
    if not math.isfinite(value):
        return "now and then"
    return (
        f"{format_two_digits(value)} s" if value < _MINUTES_FROM_SECONDS else f"{format_two_digits(value / 60.0)} min"
    )


def format_kelvin(value: float) -> str:
    """A temperature difference in words."""
    return f"{format_two_digits(value)} K" if abs(value) >= _NEGLIGIBLE_KELVIN else "0 K"


def format_two_digits(value: float) -> str:
    """Two digits, without an exponent where it is large."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def format_percent(value: float) -> str:
    """A fraction in percent, with three digits."""
    return f"{100.0 * value:.3g} %"


def _format_three_digits(size: float) -> str:
    return f"{float(f'{size:.3g}'):,.0f}" if _THOUSANDS_RANGE[0] <= size < _THOUSANDS_RANGE[1] else f"{size:.3g}"
