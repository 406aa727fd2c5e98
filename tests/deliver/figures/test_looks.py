"""Colours are those of one scheme, texts are broken to fit, quantities have their labels and units."""

from fastcoil.base.figures import STYLE, apply_style
from fastcoil.loops import labels
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS


def test_the_style_is_applied_and_taken_back():
    from matplotlib import rcParams

    before = rcParams["font.size"], rcParams["axes.grid"]
    with apply_style(axes_grid=False):
        assert (rcParams["font.size"], rcParams["axes.grid"]) == (STYLE["font.size"], False)
    assert (rcParams["font.size"], rcParams["axes.grid"]) == before


def test_a_quantity_has_the_label_of_its_table_and_the_unit_and_factor_of_readers():
    for name, entry in {**PARAMETERS, **METRICS, **TRACES}.items():
        assert quantity(name).text == entry.label
    assert labels._DISPLAY_UNITS.keys() <= {*PARAMETERS, *METRICS, *TRACES}
    for name, unit, factor in (
        ("backlash", "%", 100.0), ("command", "%", 100.0), ("learn_time_reached", "h", 1 / 3600),
        ("learning_interval", "min", 1 / 60), ("water_volume", "m³", 1.0), ("kp", "1/K", 1.0), ("rmse", "K", 1.0),
    ):  # fmt: skip
        shown = quantity(name)
        assert (shown.unit, shown.factor, shown.axis) == (unit, factor, f"{shown.text} [{unit}]")
    assert quantity("learning_ratio").axis == quantity("learning_ratio").text
    assert quantity("backlash").equals(0.07) == "backlash = 7 %"
    assert quantity("learning_ratio").number(1.5) == "1.5"
    assert quantity("my_series").axis == "my series"
