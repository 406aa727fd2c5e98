"""Numbers as people read them."""

import math

import pytest

from fastcoil.base.text import decimals_for_uncertainty, escape_formulas, format_number


@pytest.mark.parametrize(
    ("uncertainty", "decimals"),
    # of the Particle Data Group's own examples: 0.827 ± 0.119 → 0.83 ± 0.12, 0.827 ± 0.367 → 0.8 ± 0.4
    [(0.119, 2), (0.367, 1), (0.0042, 3), (3.6, 0), (250.0, 0), (0.35, 2), (0.36, 1), (0.0, None), (math.inf, None)],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves(uncertainty, decimals):
    assert decimals_for_uncertainty(uncertainty) == decimals


@pytest.mark.parametrize(
    ("value", "decimals", "sign", "text"),
    [(-22.4, 0, True, "−22"), (3.14, 1, True, "+3.1"), (-0.001, 1, True, "0.0"), (1234.5, None, False, "1,230"),
     (999.7, None, False, "1,000"), (0.000123, None, False, "0.000123"), (1.5e-9, None, True, "+1.5e-09"),
     (math.nan, 1, False, "–"), (-math.inf, None, True, "−∞")],
)  # fmt: skip
def test_a_number_has_a_true_minus_and_words_for_what_is_none(value, decimals, sign, text):
    assert format_number(value, decimals, sign=sign) == text


@pytest.mark.parametrize("start", ["=", "@", " =", "\uff1d", "\u3000+", "\ufeff\uff0d", '"=', "\x0b\ufe6b"])
def test_no_text_starts_a_formula_in_a_spreadsheet(start):
    unseen, sign = start[:-1], start[-1]
    assert escape_formulas(f"{start}1+1") == f"{unseen}'{sign}1+1"
    assert escape_formulas(f"fans,{start}1") == f"fans,{unseen}'{sign}1"
