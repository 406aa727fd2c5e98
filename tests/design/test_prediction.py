"""Distance from hunting and shares of the phase, on plants whose answers are known."""

import math

import numpy as np
import pytest
from helpers.first_order_plants import first_order_plants, join_plants

import fastcoil as fc
from fastcoil.design import prediction
from fastcoil.design.limit_cycle import HUNTING_INDEX_LIMIT, predict_cycles
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.loops.scenarios import parameter_columns

GAIN, LAG = -15.0, 100.0


def predict_at_delay(loop, delay):
    """A loop around a plant of first order at a single operating point."""
    return predict_at_plants(loop, first_order_plants(GAIN, LAG, delay))


def predict_at_plants(loop, *plants):
    """A loop at an operating point for each plant."""
    nothing = np.zeros(len(plants), dtype=np.int64)
    cycles = predict_cycles(parameter_columns(loop, {}, nothing), join_plants(*plants))
    points = PointsOfDay(nothing, nothing + 1, {"T_set": nothing + 14.0})
    worst = int(np.argmax(cycles.hunting_index))
    return prediction.Prediction(loop, points, join_plants(*plants), cycles, np.arange(len(plants)), worst)


def loop_with_ratios(kappa, rho, **changes):
    """kp and ti as multiples of 1/gain and of the lag; the backlash's 1/(1 - X) counted as plant."""
    return fc.Loop(kp=0.93 * kappa / -GAIN, ti=rho * LAG, sample_time=1, backlash=0.07, **changes)


@pytest.mark.parametrize(
    ("rho", "theta", "kappa"),
    [
        (0.3, 10, 1.6),
        *(pytest.param(*row, marks=pytest.mark.full) for row in ((0.5, 20, 3.3), (0.2, 20, 0.67), (0.5, 50, 1.5))),
    ],
)
def test_the_shortest_ti_is_that_of_the_published_table(rho, theta, kappa):
    """literature: critical gain of a first-order lag with delay behind any backlash, by ti/lag and delay/lag."""
    loop = loop_with_ratios(kappa, 0.05)
    assert prediction.shortest_ti(predict_at_delay(loop, theta), 1.0) == pytest.approx(rho * LAG, rel=0.06)


def test_the_shortest_ti_holds_where_the_loop_is_worst_then_and_not_only_where_it_is_worst_now():
    strong, late = first_order_plants(-6.0, 100.0, 3), first_order_plants(-4.0, 20.0, 40)
    loop = fc.Loop(kp=0.1, ti=3.0, sample_time=1)
    both = predict_at_plants(loop, strong, late)
    assert both.worst_point == 0
    alone = [prediction.shortest_ti(predict_at_plants(loop, plant), 0.33) for plant in (strong, late)]
    assert alone[1] > 1.2 * alone[0]
    assert prediction.shortest_ti(both, 0.33) == pytest.approx(alone[1], rel=1e-3)


def test_the_margins_of_a_sweep_are_those_of_its_loops_point_by_point():
    plants = [first_order_plants(GAIN, LAG, delay) for delay in (5, 20, 60)]
    loops = [loop_with_ratios(kappa, 0.3) for kappa in (0.5, 2.0)]
    swept = loops[0].assign(kp=("tuning", [loop["kp"] for loop in loops]))
    margins = prediction.predict_cycles_at(swept, join_plants(*plants), np.array([2, 0])).hunting_index
    expected = [[predict_at_plants(loop, plant).hunting_index for plant in (plants[2], plants[0])] for loop in loops]
    assert margins == pytest.approx(np.array(expected), rel=1e-4)


def test_the_hunting_index_is_that_of_a_step_of_the_command():
    """(kp K)^0.7 (T + 2 θ)/ti, θ with half of the sample time; of several operating points the largest."""
    loop = loop_with_ratios(1.6, 0.3, noise_std=0.02)
    expected = 1.6**0.7 * (LAG + 2.0 * (20.0 + 0.5)) / (0.3 * LAG)
    assert prediction.largest_integral_speed(predict_at_delay(loop, 20)) == pytest.approx(expected, rel=0.02)
    slower = first_order_plants(GAIN, LAG, 50.0)
    assert (
        prediction.largest_integral_speed(predict_at_plants(loop, first_order_plants(GAIN, LAG, 20.0), slower))
        > 1.2 * expected
    )
    (clause,) = prediction.hunting_index_omissions(predict_at_delay(loop, 20))
    assert clause.startswith("the noise of 0.02 K")
    assert clause.endswith(f"here it is {prediction.largest_integral_speed(predict_at_delay(loop, 20)):.2g}")
    assert prediction.hunting_index_omissions(predict_at_delay(loop_with_ratios(1.6, 0.3, noise_std=0.0), 20)) == ()


def test_twice_the_kp_is_twice_the_margin_and_needs_a_longer_ti():
    near, far = (predict_at_delay(loop_with_ratios(kappa, 0.5), 20) for kappa in (2.0, 1.0))
    assert near.hunting_index == pytest.approx(2.0 * far.hunting_index, rel=1e-6)
    assert prediction.shortest_ti(near, HUNTING_INDEX_LIMIT) > prediction.shortest_ti(far, HUNTING_INDEX_LIMIT)


def test_the_parts_take_180_degrees_each_what_its_formula_says():
    shares = prediction.phase_shares(predict_at_delay(loop_with_ratios(4.0, 0.3, sensor_time_constant=20.0), 10))
    w = 2.0 * math.pi / shares.attrs["period"]
    assert tuple(shares["part"].values) == tuple(prediction.PHASE_PARTS)
    assert float(shares.sum()) == pytest.approx(180.0)
    assert float(shares.sel(part="integral")) == pytest.approx(90.0 - math.degrees(math.atan(30.0 * w)), abs=2.0)
    assert float(shares.sel(part="sensor")) == pytest.approx(math.degrees(math.atan(20.0 * w)), abs=2.0)
    assert float(shares.sel(part="sampling")) == pytest.approx(math.degrees(0.5 * w), abs=1e-9)
    assert float(shares.sel(part="plant")) == pytest.approx(math.degrees(math.atan(LAG * w) + 10.0 * w), abs=2.0)
