"""``fc.plot.traces``: what is drawn is what was simulated, in readable units, with the set-point of its day."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.refusals import assert_refused
from matplotlib.figure import Figure

import fastcoil as fc

pytestmark = pytest.mark.kernel
DRAWN_TRACES = ["T_sup", "command", "opening", "estimate"]
DAY = fc.paper_day(hours=1)


@pytest.fixture(scope="module")
def ds():
    return fc.simulate(fc.Loop(backlash=[0.0, 0.03, 0.07, 0.1]), DAY, traces=DRAWN_TRACES, trace_interval=20, n_jobs=1)


def lines_by_label(axes):
    return {line.get_label(): line for line in axes.lines}


def test_a_scenario_has_its_temperature_with_the_set_point_and_its_valve_in_per_cent(ds):
    above, below = fc.plot.traces(ds.isel(backlash=2), DAY)
    lines = lines_by_label(above)
    assert set(lines) == {"supply air", "set-point"}
    np.testing.assert_array_equal(lines["supply air"].get_xdata(), ds.elapsed_time / 3600)
    np.testing.assert_array_equal(lines["supply air"].get_ydata(), ds.T_sup[2])
    np.testing.assert_array_equal(lines["set-point"].get_ydata(), DAY.series["T_set"][0, ::20])
    np.testing.assert_array_equal(lines_by_label(below)["opening"].get_ydata(), 100 * ds.opening[2])
    assert (above.get_ylabel(), below.get_ylabel()) == ("supply air [°C]", "valve [%]")
    assert below.get_xlabel() == "time from the start [h]"
    assert [text.get_text() for text in below.get_legend().get_texts()] == ["command", "opening"]


def test_up_to_three_scenarios_are_named_by_what_differs_and_the_set_point_is_drawn_once(ds):
    above, below = fc.plot.traces(ds.isel(backlash=[0, 2]), DAY)
    names = [text.get_text() for text in above.get_legend().get_texts()]
    assert names == ["backlash = 0 %", "backlash = 7 %", "set-point"]
    np.testing.assert_array_equal(above.lines[1].get_ydata(), ds.T_sup[2])
    assert below.get_ylabel() == "opening [%]"
    assert len(above.lines) == 3


def test_several_days_have_their_own_set_points():
    days = fc.Boundary.concat([fc.constant_day(1, T_set=13), fc.constant_day(1, T_set=15).assign(day=5)])
    ds = fc.simulate(fc.Loop(), days, traces=["T_sup"], trace_interval=60, n_jobs=1)
    (axes,) = fc.plot.traces(ds, days)
    assert [line.get_ydata()[0] for line in axes.lines[-2:]] == [13, 15]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["day 0", "day 5", "set-point"]
    assert fc.plot.traces(ds.isel(day=1), days)[0].lines[-1].get_ydata()[0] == 15


def test_a_figure_of_its_own_is_a_column_wide_legible_of_our_colours_and_leaves_the_settings_of_the_user(ds):
    with plt.rc_context({"font.size": 11.5, "axes.grid": False, "lines.linewidth": 3.5}):
        before = dict(plt.rcParams)
        figures = [fc.plot.traces(part, DAY)[0].figure for part in (ds.isel(backlash=0), ds.isel(backlash=[0, 1, 2]))]
        assert dict(plt.rcParams) == before
    for figure in figures:
        assert figure.get_figwidth() == 3.5
        assert figure.get_layout_engine() is not None
        assert_texts_fit(figure)
        assert_palette(figure)


draw = fc.plot.traces
OTHER_DAYS = fc.paper_day(hours=0.5), fc.paper_day(hours=1, seed=2)


@pytest.mark.parametrize(
    ("call", "field", "code"),
    [
        (draw, "data", "shape"),
        (lambda ds: draw(ds.drop_vars(DRAWN_TRACES)), "data", "missing"),
        (lambda ds: draw(ds.rmse), "data", "type"),
        (lambda ds: draw(ds, show="Tsup"), "show", "choice"),
        (lambda ds: draw(ds[{"backlash": 0}], OTHER_DAYS[0]), "boundary", "conflict"),
        (lambda ds: draw(ds[{"backlash": 0}], OTHER_DAYS[1]), "boundary", "conflict"),
        (lambda ds: draw(ds.assign(T_sup=ds.T_sup.assign_attrs(units="K"))), "ds.T_sup", "unit"),
        (lambda ds: draw(ds.assign_coords(elapsed_time=ds.elapsed_time.assign_attrs(units="min"))), "ds.elapsed_time",
         "unit"),
        (lambda ds: fc.plot.learning(ds.assign(estimate=ds.estimate.assign_attrs(units="%"))), "ds.estimate", "unit"),
        (lambda ds: draw(ds[{"backlash": 0}], ax=Figure().subplots()), "ax", "type"),
        (lambda ds: draw(ds[{"backlash": 0}], ax="left"), "ax", "type"),
        (lambda ds: draw(ds[{"backlash": []}]), "backlash", "shape"),
    ],
    ids=["many", "none", "array", "name", "short day", "other day", "K", "min", "%", "one axes", "text", "empty"],
)  # fmt: skip
def test_what_cannot_be_drawn_gets_a_sentence(ds, call, field, code):
    assert_refused(field, code, call, ds)
