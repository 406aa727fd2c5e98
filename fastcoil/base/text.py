"""Text for people: control characters escaped, numbers formatted."""

import math
import re
import unicodedata
from collections.abc import Collection, Sequence

_UNSAFE_CATEGORIES = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories that are escaped: control, format, surrogates, line and paragraph separators."""


def escape_control_characters(text: str) -> str:
    r"""Escape control characters in untrusted text, as Python does: ``\x1b``, ``\u202e``."""
    if text.isprintable():
        return text
    unsafe = {character for character in text if unicodedata.category(character) in _UNSAFE_CATEGORIES}
    return text.translate({ord(character): character.encode("unicode_escape").decode() for character in unsafe})


_UNSEEN = r"[\s\"\x00-\x1f\x7f-\x9f\xad\u180e\u200b-\u200f\u202a-\u202e\u2060-\u206f\ufeff]*"
_FORMULA_START = re.compile(rf"((?:^|[,;\t\r\n]){_UNSEEN})(?=[=+\-@\uff1d\uff0b\uff0d\uff20\ufe66\ufe62\ufe63\ufe6b])")
"""Where a sign of a formula, also a wide or a small one, begins a cell, but for what is not seen or is dropped."""


def escape_formulas(text: str) -> str:
    """Put an apostrophe before each cell of a CSV text that a spreadsheet would take as a formula."""
    return _FORMULA_START.sub(r"\1'", text)


def parse_number_or_word(text: str) -> float | str:
    """Convert a text to a number if it is one; else return it unchanged."""
    try:
        return float(text)
    except ValueError:
        return text


MINUS_SIGN = "\N{MINUS SIGN}"
MISSING_VALUE = "\N{EN DASH}"  # stands for it in tables


def decimals_for_uncertainty(uncertainty: float) -> int | None:
    """Return the number of decimals for a value with this uncertainty; None if it is 0 or not finite.

    An uncertainty whose leading digits are at most 35 gets two digits, another one digit.  Source: Particle Data Group,
    Review of Particle Physics (2024), doi:10.1103/PhysRevD.110.030001, section 5.3.
    """
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return None
    exponent = math.floor(math.log10(uncertainty))
    leading = round(uncertainty / 10.0 ** (exponent - 1), 6)
    return max(0, (1 if leading <= 35 else 0) - exponent)


def format_number(value: float, decimals: int | None = None, *, sign: bool = False) -> str:
    """Format a number with ``decimals`` or three significant digits; ``sign``: write a plus before positive numbers."""
    if math.isnan(value):
        return MISSING_VALUE
    if math.isinf(value):
        text = "∞"
    elif decimals is None or decimals > 6:
        text = f"{abs(value):.3g}"
        if 999.5 <= abs(value) < 1e7:  # written out
            text = f"{float(text):,.0f}"
    else:
        text = f"{abs(value):.{decimals}f}"
    if not text.strip("0."):  # zero has no sign
        return text
    return (MINUS_SIGN if value < 0.0 else "+" if sign else "") + text


def align_columns(rows: Sequence[Sequence[str]], *, right: Collection[int] = ()) -> list[str]:
    """Format rows of cells as lines of text with aligned columns; right: indices of right-aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [c.rjust(w) if k in right else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        lines.append("  ".join(cells).rstrip())
    return lines


def format_count(n: int, noun: str) -> str:
    """Format a number of things: ``1 day``, ``1,080 days``."""
    return f"{n:,} {noun}{'s' * (n != 1)}"


def format_share(share: float, low: float = math.nan, high: float = math.nan, *, decimals: int = 0) -> str:
    """Format a share, with its interval if given: ``12 % (10 to 15)``."""
    value, *ends = (f"{100.0 * fraction:.{decimals}f}" for fraction in (share, low, high))
    if math.isnan(share):
        return MISSING_VALUE
    return f"{value} %" if math.isnan(low) else f"{value} % ({' to '.join(ends)})"


def format_period(value: float) -> str:
    """Format a period in seconds, from 120 s on in minutes."""
    if not math.isfinite(value):
        return "now and then"
    return f"{format_two_digits(value)} s" if value < 120.0 else f"{format_two_digits(value / 60.0)} min"


def format_kelvin(value: float) -> str:
    """Format a temperature difference, K; less than 0.5 mK is written as 0."""
    return f"{format_two_digits(value)} K" if abs(value) >= 5e-4 else "0 K"


def format_swing(peak_to_peak: float) -> str:
    """Format a swing, K from peak to peak, as half of it to both sides: ``± 3.1 K``."""
    return f"± {format_kelvin(0.5 * peak_to_peak)}"


def format_two_digits(value: float) -> str:
    """Format a number with two significant digits, from 100 on as an integer."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def format_percent(value: float) -> str:
    """Format a fraction in per cent, with three significant digits."""
    return f"{100.0 * value:.3g} %"
