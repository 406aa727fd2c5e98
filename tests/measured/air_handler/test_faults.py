"""Faults of an air handler: made-up logs of each, and of sound units; no coil is accused of what it cannot do."""

import numpy as np
import pytest
from helpers.air_handler_logs import kinds_of, make_unit_log

import fastcoil as fc


def in_hours(first, last, value, otherwise=0.0):
    return lambda h: np.where((h % 24 >= first) & (h % 24 < last), value, otherwise)


def test_a_sound_unit_has_no_finding():
    unit = fc.inspect(make_unit_log(2.0, cooling=in_hours(10, 17, 0.4), heating=in_hours(0, 8, 0.2)))
    assert unit.findings == []
    assert unit.headline.startswith("No fault of valves, loops or sensors found.")


@pytest.mark.parametrize(("leak", "component", "size"), [
    ((0.3, 0.0), "cooling valve", 4.2), ((0.0, 0.3), "heating valve", 5.4),
])  # fmt: skip
def test_a_valve_that_passes_water_while_shut_is_named_with_its_effect(leak, component, size):
    [finding] = fc.inspect(make_unit_log(0.5, leak=leak)).findings
    assert (finding.component, finding.kind) == (component, "leak")
    assert finding.size == pytest.approx(size, abs=0.1)
    assert finding.hours == pytest.approx(11.5, abs=0.1)  # half an hour after the start of the log
    [(first, last)] = finding.windows
    assert str(first) == "2026-03-02T00:30:00"
    assert str(last) == "2026-03-02T12:00:00"


def test_a_valve_shut_as_warm_as_open_is_stuck_open():
    log = make_unit_log(1.0, heating=in_hours(0, 6, 1.0), leak=(0.0, 0.95), T_set=40.0)
    assert ("heating valve", "stuck_open") in kinds_of(fc.inspect(log))


def test_the_healthy_valve_is_not_accused_of_what_the_other_one_does():
    # the heating valve is open: cooling, wide open, does not reach its set-point
    log = make_unit_log(1.0, cooling=1.0, leak=(0.0, 1.3), T_set=13.0)
    assert kinds_of(fc.inspect(log)) == [("heating valve", "leak")]
    # cooling is open: heating, wide open, does not reach its set-point
    log = make_unit_log(1.0, heating=1.0, leak=(1.6, 0.0), T_set=30.0)
    assert kinds_of(fc.inspect(log)) == [("cooling valve", "leak")]


def test_heating_never_cools_and_cooling_never_heats():
    for leak, other in (((0.5, 0.0), "heating"), ((0.0, 0.5), "cooling")):
        assert not any(other in component for component, _ in kinds_of(fc.inspect(make_unit_log(1.0, leak=leak))))


def test_preheat_and_heating_that_may_both_leak_are_named_together():
    log = make_unit_log(0.5, leak=(0.0, 0.4), **{"Preheat Valve": 0.0})
    assert kinds_of(fc.inspect(log)) == [("heating or preheat valve", "leak")]
    # preheat that is open explains the warmth
    assert fc.inspect(make_unit_log(0.5, leak=(0.0, 0.4), **{"Preheat Valve": 0.5})).findings == []


def test_a_valve_wide_open_without_effect_is_stuck_or_without_water():
    log = make_unit_log(1.0, cooling=in_hours(8, 18, 1.0), T_set=13.0)
    log["AHU-3 Supply Air Temp"] = 18.2
    log.loc[::2, "AHU-3 Supply Air Temp"] = 18.25
    [finding] = fc.inspect(log).findings
    assert (finding.component, finding.kind) == ("cooling valve", "stuck_shut")
    assert finding.size == pytest.approx(5.2, abs=0.1)
    assert finding.hours == pytest.approx(9.5, abs=0.1)


def test_a_coil_with_too_little_effect_is_told_from_a_stuck_valve():
    log = make_unit_log(1.0, cooling=in_hours(8, 18, 1.0), T_set=13.0)
    log["AHU-3 Supply Air Temp"] = np.where(log["AHU-3 CHW Valve"] > 0.5, 15.0, 18.0) + 0.01 * (np.arange(1440) % 2)
    [finding] = fc.inspect(log).findings
    assert (finding.component, finding.kind) == ("cooling coil", "not_met")


def test_a_valve_that_works_later_on_the_day_lacked_water():
    log = make_unit_log(1.0, cooling=in_hours(8, 18, 1.0), T_set=13.0)
    is_dry = (np.arange(1440) < 720) & (log["AHU-3 CHW Valve"] > 0.5)
    log["AHU-3 Supply Air Temp"] = log["AHU-3 Supply Air Temp"].where(~is_dry, log["AHU-3 Mixed Air Temp"] + 0.1)
    [finding] = fc.inspect(log).findings
    assert (finding.component, finding.kind) == ("chilled water", "not_met")
    assert finding.hours == pytest.approx(3.5, abs=0.2)
    assert "wide open without effect, and works at other times of the same day; for 3.4 of the 10.0 h" in finding.text


def test_a_command_that_rests_off_the_set_point_is_named():
    [finding] = fc.inspect(make_unit_log(1.0, cooling=0.3, T_set=17.0)).findings
    assert (finding.component, finding.kind) == ("controller", "not_met")
    assert finding.text.startswith("the cooling command stays near 30 % while T_sup is 3.2 K off the set-point; ")


def test_heating_and_cooling_at_once_is_the_controllers_fault():
    kinds = kinds_of(fc.inspect(make_unit_log(1.0, cooling=in_hours(8, 18, 0.4), heating=in_hours(9, 17, 0.3))))
    assert kinds == [("controller", "fight")]


def test_faults_are_counted_by_day_of_many_days():
    """A leak on two days of five is not averaged away."""
    leak = (lambda h: np.where(np.isin(h // 24, (1, 3)), 0.4, 0.0), 0.0)
    [finding] = fc.inspect(make_unit_log(5.0, leak=leak)).findings
    assert "on 2 of 5 days (03-03, 05)" in finding.text
    assert {str(first)[:10] for first, _ in finding.windows} == {"2026-03-03", "2026-03-05"}


def test_sensors_off_by_two_kelvin_are_no_leak():
    assert fc.inspect(make_unit_log(2.0, T_mixed=18.0, **{"AHU-3 Supply Air Temp": 16.0})).findings == []


def test_the_offset_that_days_show_makes_smaller_leaks_visible():
    leak = (lambda h: np.where(h // 24 == 5, 0.19, 0.0), 0.0)  # 2.7 K
    assert kinds_of(fc.inspect(make_unit_log(6.0, leak=leak))) == [("cooling valve", "leak")]
    assert fc.inspect(make_unit_log(1.0, leak=(0.19, 0.0))).findings == []


def test_a_sensor_that_stands_still_is_named_first():
    log = make_unit_log(1.0, cooling=lambda h: 0.3 + 0.2 * np.sin(h), T_mixed=lambda h: 18.0 + 2.0 * np.sin(h / 3))
    log["AHU-3 Supply Air Temp"] = 14.2
    assert kinds_of(fc.inspect(log))[0] == ("supply air", "sensor_stuck")


def test_mixed_air_beyond_what_it_is_mixed_from_is_a_sensor():
    series = {"T_mixed": 27.0, "T_return": 22.0, "T_out": lambda h: 15.0 + 0.1 * np.sin(h)}
    assert ("entering air", "sensor_offset") in kinds_of(fc.inspect(make_unit_log(1.0, **series)))


def test_running_while_unoccupied_comes_last():
    unit = fc.inspect(make_unit_log(1.0, heating=0.3, leak=(0.5, 0.0), occupied=in_hours(7, 19, 1.0)))
    assert kinds_of(unit)[-1] == ("fan", "unoccupied")
    assert unit.findings[-1].size == pytest.approx(12.0, abs=0.1)


def test_without_entering_air_the_log_says_what_is_missing():
    log = make_unit_log(1.0, leak=(0.5, 0.0)).drop(columns="AHU-3 Mixed Air Temp")
    unit = fc.inspect(log)
    assert unit.findings == []
    assert any("log one of them" in note for note in unit.notes)
    # between return and outdoor air the entering air is known well enough
    unit = fc.inspect(log.assign(**{"Return Air Temp": 20.0, "OA Temp": 17.0}))
    assert ("cooling valve", "leak") in kinds_of(unit)


def test_a_low_air_flow_needs_more_before_a_valve_is_accused():
    night = {"fan_speed": in_hours(8, 18, 0.9, 0.1)}
    leak = (in_hours(8, 18, 0.0, 0.3), 0.0)  # 4.2 K at night
    assert fc.inspect(make_unit_log(1.0, leak=leak, **night)).findings == []
    leak = (in_hours(8, 18, 0.0, 0.6), 0.0)  # 8.4 K
    assert kinds_of(fc.inspect(make_unit_log(1.0, leak=leak, **night))) == [("cooling valve", "leak")]


def test_a_log_without_a_clock_gives_seconds():
    log = make_unit_log(0.5, leak=(0.5, 0.0))
    log = log.drop(columns="Timestamp").assign(**{"elapsed_time [s]": 60.0 * np.arange(len(log))})
    [finding] = fc.inspect(log).findings
    assert finding.windows == [(1800.0, 43200.0)]


def test_commands_of_other_hours_accuse_no_valve():
    """A leak is not claimed where the commands of other hours, or of the other valve, explain the air."""
    frame = make_unit_log(1.0, cooling=in_hours(9, 17, 0.6), heating=in_hours(1, 7, 0.4), T_mixed=18.0)
    commands = ["AHU-3 CHW Valve", "AHU-3 HHW Valve"]
    assert fc.inspect(frame).findings == []
    late = frame.assign(**{name: np.roll(frame[name], 360) for name in commands})
    [finding] = fc.inspect(late).findings
    assert (finding.component, finding.kind) == ("log", "mismatch")
    assert "6 h" in finding.text
    exchanged = frame.rename(columns=dict(zip(commands, commands[::-1], strict=True)))
    [finding] = fc.inspect(exchanged).findings
    assert finding.kind == "mismatch"
    assert "exchanged" in finding.text
