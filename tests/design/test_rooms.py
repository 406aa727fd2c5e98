"""Rooms behind the coil: the closed form at a constant supply, theory beside the simulation, and what is refused."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc

pytestmark = pytest.mark.kernel

WINTER = {"m_a": 0.1, "T_a_in": 13.0, "W_a_in": 0.007, "T_w_in": 60.0, "T_set": 21.0, "T_out": 2.0, "Q_room": 0.2}
ROOM = {"room_capacity": 450.0, "room_ua": 0.05}


def test_at_a_constant_supply_the_room_is_the_geometric_series_of_its_recursion():
    day = fc.constant_day(hours=4, **{**WINTER, "T_w_in": 13.0})  # water as warm as the air: T_sup is 13 °C
    loop = fc.Loop.preset("reheat").assign(T_initial=13.0)
    T_room = fc.simulate(loop, day, traces=["T_room"], command=np.zeros(14400)).T_room.values
    C_air = 0.1 * 1.02
    rest = (C_air * 13.0 + 0.05 * 2.0 + 0.2) / (C_air + 0.05)
    decay = 1.0 - (C_air + 0.05) / 450.0
    np.testing.assert_allclose(T_room, rest + (13.0 - rest) * decay ** np.arange(14400), rtol=0.0, atol=1e-9)


def test_the_response_of_a_controlled_room_is_that_of_the_emulator_to_a_small_step():
    day = fc.constant_day(hours=18, **WINTER)
    loop = fc.Loop.preset("reheat").assign(backlash=0.0, stroke_time=0.0, sensor_time_constant=0.0, sample_time=1)
    w = np.geomspace(1e-4, 3e-2, 7)
    linear = fc.linearise(loop, day, frequency=w)
    change, is_late = 1e-5, np.arange(64800) >= 28800  # at rest by then
    commands = [linear.opening.item() + sign * change * is_late for sign in (1.0, -1.0)]
    up, down = (fc.simulate(loop, day, traces=["T_room"], command=each).T_room.values for each in commands)
    changes = np.diff(up - down)[28799:] / (2.0 * change)
    response = changes @ np.exp(-1j * np.outer(np.arange(1, changes.size + 1), w))
    np.testing.assert_allclose(np.abs(response) / linear.plant_magnitude, 1.0, atol=1e-4)
    assert float(linear.T_sup) == pytest.approx(21.0, abs=1e-6)


def test_theory_tells_which_gains_make_a_room_hunt():
    day = fc.constant_day(hours=24, **WINTER)
    gains = {"kp": ("gains", [0.1, 0.3, 0.1]), "ti": ("gains", [900.0, 300.0, 100.0])}
    loop = fc.Loop.preset("reheat").assign(backlash=[0.0, 0.07], **gains)
    simulated = fc.simulate(loop, day, warm_up=43200)
    np.testing.assert_array_equal(fc.limit_cycle(loop, day).hunts, simulated.hunts)
    assert set(np.unique(simulated.hunts)) == {0.0, 1.0}


def test_explain_names_the_room():
    loop = fc.Loop.preset("reheat").assign(ti=100.0, backlash=0.07)
    text = str(fc.explain(loop, fc.constant_day(hours=12, **WINTER)))
    assert "too fast for the coil and room" in text
    assert "  coil and room " in text


def test_explain_says_which_numbers_are_of_the_room_and_draws_it():
    loop = fc.Loop.preset("reheat").assign(kp=0.3, ti=300.0, backlash=0.1, noise_std=0.02)
    explanation = fc.explain(loop, fc.constant_day(hours=12, **WINTER), warm_up=7200)
    lines, cures = str(explanation).splitlines(), explanation.cures
    assert ": supply air " in lines[0]
    assert lines[2].startswith("Predicted: the room up to ± ")
    assert ", the room at most ± " in lines[2]
    heads = next(line for line in lines if "hunting index  RMSE" in line)
    assert "  RMSE of room  supply air  motor travel  " in heads
    still = cures["hunts"] > 0.0
    is_less = cures["hunting_swing"] < 0.95 * cures["hunting_swing"][0]
    for words, less in zip(cures["verdict"].values[still], is_less.values[still], strict=True):
        assert ("but less" in words) == less
    assert str(cures["verdict"].sel(cure="repaired_valve").values) == "noise still swings it, but less"
    day = explanation.plot().axes[-1]
    assert day.get_ylabel() == "room [°C]"
    assert all(np.abs(line.get_ydata() - 21.0).max() < 2.0 for line in day.lines)


def test_errors_are_those_of_the_room_and_swings_those_of_the_supply_air():
    day = fc.constant_day(hours=8, **WINTER)
    loop = fc.Loop.preset("reheat").assign(kp=0.3, ti=300.0, backlash=0.07)
    ds = fc.simulate(loop, day, traces=["T_room", "T_sup"], warm_up=14400)
    error = ds.T_room.values[14400:] - 21.0
    assert float(ds.rmse) == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert float(ds.settled_range) == pytest.approx(np.ptp(error), rel=1e-9)
    assert np.ptp(ds.T_sup.values[14400:]) > 5.0 * float(ds.settled_range)
    assert float(ds.hunting_swing) > float(ds.settled_range)
    assert ds.reheat_energy.isnull()
    assert ds.coil_energy > 0.0


def test_pressure_takes_the_flow_with_its_root_and_the_opening_with_it():
    day = fc.constant_day(hours=1, dp_ratio=0.25)
    linear = fc.linearise(fc.Loop.preset("lbnl").assign(pressure_independent=[0, 1]), day)
    assert np.ptp(linear.m_w.values) < 1e-9, "the same heat needs the same water"
    assert np.ptp(linear.opening.values) < 1e-9
    more = fc.linearise(fc.Loop.preset("lbnl").assign(pressure_independent=[0, 1]), day.assign(dp_ratio=4.0))
    plain = fc.linearise(fc.Loop.preset("lbnl"), day.assign(dp_ratio=1.0))
    assert float(more.opening[0]) < float(plain.opening)
    assert float(more.opening[1]) == pytest.approx(float(plain.opening), abs=1e-9)


def test_a_band_that_the_motor_may_jump_over_is_warned_of_and_makes_it_run_to_and_fro():
    loop, day, least = fc.Loop.preset("lbnl").assign(backlash=0.0), fc.constant_day(hours=1), 0.5 / 90.0
    with pytest.warns(UserWarning, match=r"down to 0\.005, less than half .* give 0\.0056 or more"):
        narrow = fc.simulate(loop.assign(positioner_band=0.9 * least), day)
    wide = fc.simulate(loop.assign(positioner_band=1.1 * least), day)
    assert narrow.motor_travel > 10.0 * wide.motor_travel


@pytest.mark.parametrize(
    ("values", "field", "code"),
    [({"controlled": "T_room"}, "room_capacity", "missing"), ({"room_ua": 0.1}, "room_capacity", "missing"),
     (ROOM | {"controlled": "T_room", "test_start": 3600.0}, "test_start", "unsupported"),
     ({"room_capacity": 0.5}, "room_capacity", "value"),
     ({"curve": "linear", "rangeability": 50.0, "authority": 0.5, "m_full": 1.0}, "curve", "conflict"),
     ({"positioner_band": 0.01}, "stroke_time", "missing"),
     ({"positioner_band": 0.01, "neutral_zone": 0.01, "stroke_time": 60.0}, "neutral_zone", "conflict")],
)  # fmt: skip
def test_what_a_loop_does_not_have_is_refused(values, field, code):
    assert_refused(field, code, fc.simulate, fc.Loop(**values), fc.constant_day(hours=2))


def test_a_tuning_of_rooms_is_judged_by_what_simulate_gives():
    setback = np.where(np.arange(8 * 3600) < 4 * 3600, 19.0, 21.0)
    day, other_day = (fc.constant_day(hours=8, **{**WINTER, "T_set": setback, "T_out": T}) for T in (2.0, -1.0))
    loop = fc.Loop.preset("reheat").assign(backlash=0.07, kp=0.02, ti=3600.0)
    search = {"kp": (0.02, 0.5), "ti": (300.0, 3600.0)}
    tuning = fc.tune(loop, day, search=search, holdout=other_day, warm_up=3600, evaluations=12, n_jobs=1)
    errors = {
        name: float(fc.simulate(each, other_day, warm_up=3600, n_jobs=1).rmse)
        for name, each in {"now": loop, "chosen": loop.assign(**tuning.parameters)}.items()
    }
    held_out = tuning.held_out["rmse_p95"].sel(edge="value")
    assert {name: float(held_out.sel(tuning=name)) for name in errors} == pytest.approx(errors, rel=1e-12)
    assert errors["chosen"] < 0.8 * errors["now"]
