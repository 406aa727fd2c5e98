"""Axes are named in the units that people read."""

from __future__ import annotations

import pytest

from fastcoil.loops import labels
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("backlash", "%", 100.0),
        ("estimate_ratio", "%", 100.0),
        ("command", "%", 100.0),
        ("learning_step", "%", 100.0),
        ("learn_time_reached", "h", 1 / 3600),
        ("learning_interval", "min", 1 / 60),
        ("water_volume", "m³", 1.0),
        ("kp", "1/K", 1.0),
        ("rmse", "K", 1.0),
        ("learning_ratio", "", 1.0),
    ],
)
def test_a_quantity_has_a_unit_and_the_factor_to_it(name, unit, factor):
    shown = quantity(name)
    assert (shown.unit, shown.factor) == (unit, factor)
    assert shown.axis == (f"{shown.text} [{unit}]" if unit else shown.text)


def test_values_are_written_in_that_unit():
    assert quantity("backlash").equals(0.07) == "backlash = 7 %"
    assert quantity("learning_ratio").number(1.5) == "1.5"
    assert quantity("my_series").axis == "my series"


def test_every_name_with_a_unit_of_its_own_exists():
    known = {*PARAMETERS, *METRICS, *TRACES}
    for names in (labels._PERCENT, labels._HOURS, labels._MINUTES):
        assert names <= known


def test_the_label_of_the_tables_is_shown():
    for name, entry in {**PARAMETERS, **METRICS, **TRACES}.items():
        assert quantity(name).text == entry.label
