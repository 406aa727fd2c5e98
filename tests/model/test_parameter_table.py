"""Texts and labels of parameters, metrics and traces, which help, results and figures show."""

import pytest

from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS


def test_a_label_fits_an_axis_and_is_its_own_in_its_table():
    for table in (PARAMETERS, METRICS, TRACES):
        for name, entry in table.items():
            assert 0 < len(entry.label) <= 40, name
            assert not set(entry.label) & set(";[]"), name
        assert len({entry.label for entry in table.values()}) == len(table)


def test_every_parameter_is_explained_in_one_line():
    for parameter in PARAMETERS.values():
        assert parameter.text
        assert "\n" not in parameter.text
        assert not parameter.text.endswith(".")


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [("kp", 0.05, "kp = 0.05 K-1"), ("backlash", 0.07, "backlash = 0.07"), ("action", "heating", "action = heating")],
)
def test_a_value_is_shown_with_name_and_unit(name, value, shown):
    assert PARAMETERS[name].equation(value) == shown
