"""Everybody can tell the colours apart, on a screen and in a grey print; texts are broken to fit."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from fastcoil.base.figures import COLOURS, FAINT, GREY, STYLE, apply_style, wrapped
from fastcoil.loops import labels
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS

# Machado, Oliveira and Fernandes (2009), A Physiologically-based Model for Simulation of Color Vision Deficiency,
# IEEE TVCG 15(6), severity 1.0, on linear RGB
SEEN_BY = {
    "all": np.eye(3),
    "deuteranopes": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopes": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
XYZ_OF_RGB = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
                       [0.0193339, 0.1191920, 0.9503041]])  # fmt: skip
"""IEC 61966-2-1 (sRGB), white point D65."""
LEAST = 15.0
"""Colour difference that cannot be overlooked on a thin line; 2.3 is just noticeable side by side."""


def lab(colour, seen=SEEN_BY["all"]):
    """CIE 1976 L*a*b* of a colour, as seen by somebody."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    ratio = XYZ_OF_RGB @ np.clip(seen @ linear, 0.0, 1.0) / XYZ_OF_RGB.sum(axis=1)
    x, y, z = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def difference(one, other, seen=SEEN_BY["all"]):
    return float(np.linalg.norm(lab(one, seen) - lab(other, seen)))


@pytest.mark.parametrize("who", SEEN_BY)
def test_colours_differ_from_each_other_and_from_the_greys_for_everybody(who):
    for one, other in combinations([*COLOURS, GREY, "black", "white"], 2):
        assert difference(one, other, SEEN_BY[who]) >= LEAST, (one, other)
    for colour in [*COLOURS, GREY, "black"]:
        assert difference(colour, FAINT, SEEN_BY[who]) >= LEAST


def test_a_grey_print_shows_the_colours_from_dark_to_light():
    lightness = [lab(colour)[0] for colour in ("black", *COLOURS, "white")]
    assert (np.diff(lightness) > LEAST).all()


@pytest.mark.parametrize("inches", [3.0, 9.6])
def test_a_wrapped_text_is_no_wider_than_asked_for(inches):
    words = (
        "Line: median of 15 values of backlash (1 to 15 %) × 24 tunings × 100 days = 36,000 scenarios; WIDE MEANS WIDE "
    )
    figure = Figure(figsize=(inches, 2.0))
    text = figure.text(0.0, 0.0, wrapped(words * 3, inches, 9), fontsize=9)
    extent = text.get_window_extent(FigureCanvasAgg(figure).get_renderer())
    assert extent.width <= figure.bbox.width
    assert extent.width >= 0.7 * figure.bbox.width
    assert wrapped("one\ntwo", inches, 9) == "one\ntwo"


def test_the_style_is_applied_and_taken_back():
    from matplotlib import rcParams

    before = rcParams["font.size"], rcParams["axes.grid"]
    with apply_style(axes_grid=False):
        assert (rcParams["font.size"], rcParams["axes.grid"]) == (STYLE["font.size"], False)
    assert (rcParams["font.size"], rcParams["axes.grid"]) == before


def test_a_quantity_has_the_label_of_its_table_and_the_unit_and_factor_of_readers():
    for name, entry in {**PARAMETERS, **METRICS, **TRACES}.items():
        assert quantity(name).text == entry.label
    assert labels._READ_IN.keys() <= {*PARAMETERS, *METRICS, *TRACES}
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
