"""How units are spelled, and what is suggested for an unknown one."""

import pytest
from helpers.refusals import only_problem

from fastcoil.logs.series import AIR_FLOW, TEMPERATURE, WATER_FLOW, spelled


@pytest.mark.parametrize(
    ("unit", "units", "known"),
    [("°C", TEMPERATURE, "degC"), ("l/s", WATER_FLOW, "L/s"), ("GPM", WATER_FLOW, "gpm"), ("CFM", AIR_FLOW, "cfm")],
)
def test_a_unit_is_understood_in_any_case_and_with_a_degree_sign(unit, units, known):
    assert spelled("x", unit, units) == known


@pytest.mark.parametrize(
    ("unit", "units", "hint"),
    [
        ("lpm", WATER_FLOW, ", did you mean 'L/min'? ("),
        ("LPH", WATER_FLOW, ", did you mean 'L/h'? ("),
        ("cmh", AIR_FLOW, ", did you mean 'm3/h'? ("),
        ("kg/min", AIR_FLOW, ", did you mean 'kg/"),
        ("lpm", TEMPERATURE, "'lpm' ("),
    ],
)
def test_an_abbreviation_suggests_the_unit_it_means(unit, units, hint):
    message = only_problem(spelled, "x", unit, units)
    assert message.startswith(f"x is in {unit!r}")
    assert hint in message
    assert message.endswith(f"(known units: {', '.join(units)})")
