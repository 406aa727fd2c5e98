"""Numbers on a page: three digits, spoken units, a dash where there is none."""

import math

import pytest

from fastcoil.deliver.report.page import change, left_out, number, picked, setting, share, span


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.1, "0.100"), (3, "3.00"), (0.99999, "1.00"), (-0.04567, "−0.0457"), (12345, "12,300"), (0, "0"),
     (9.996, "10.0"), (1e-9, "1.00e-09"), (math.nan, "–"), (math.inf, "–"), (159.4, "159")],
)  # fmt: skip
def test_a_measured_number_has_three_digits(value, shown):
    assert number(value) == shown


def test_shares_and_changes():
    assert [change(x) for x in (-0.431, 0.004, -0.004, 1.87, math.nan)] == ["−43 %", "0 %", "0 %", "+187 %", "–"]
    assert span(-0.7, 0.2) == "−70 to +20 %"
    assert span(math.nan, 0.2) == "–"
    assert [share(x) for x in (0.0, 0.001, 0.5, 0.999, 1.0)] == ["0 %", "< 1 %", "50 %", "> 99 %", "100 %"]


def test_settings_have_the_unit_that_is_spoken():
    assert setting("backlash", 0.07) == "7 %"
    assert setting("kp", 0.03) == "0.03 1/K"
    assert setting("n_volumes", 8.0) == "8"
    assert setting("action", "heating") == "heating"


def test_long_tables_are_cut_with_ends_and_kept_rows():
    assert picked(16) == list(range(16))
    rows = picked(200, (57,))
    assert len(rows) <= 12
    assert {0, 57, 199} <= set(rows)
    assert rows == sorted(rows)
    assert left_out(200, len(rows), "values") == f"{len(rows)} of 200 values are shown; all of them are in results.nc."
    assert left_out(3, 3, "values") == ""
