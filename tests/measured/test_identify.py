"""Backlash from a trend log: found where the log can tell it, never claimed where it cannot."""

import numpy as np
import pytest
from helpers.full import full_except
from helpers.loop_logs import make_loop_log
from helpers.shared_data import measured_file

import fastcoil as fc
from fastcoil.measured.agreement import ImpliedPI, plausible_lags
from fastcoil.measured.diagnose import _require_survival
from fastcoil.measured.identify import CANDIDATES, DayEvidence, Likelihood, combine_days, identify_backlash

pytestmark = pytest.mark.kernel
INTERVAL = 10.0


def assert_identified(identification, backlash, tolerance):
    assert identification.identified
    assert not identification.reason
    assert identification.backlash == pytest.approx(backlash, abs=tolerance)


def assert_withheld(identification, words):
    """Nothing is claimed, for a reason with these words, and any size remains possible."""
    assert not identification.identified
    assert words in identification.reason
    assert (identification.low, identification.high) == (0.0, CANDIDATES[-1])


def simulate_plant(command, backlash, noise=0.01, seed=0, gain=-20.0, tau=90.0, stroke_time=90.0):
    """A first-order plant behind motor and play, written here step by step."""
    draw = np.random.default_rng(seed)
    position = q = float(command[0])
    q *= 1.0 - backlash
    T, drift, temperatures = 24.0 + gain * q / (1.0 - backlash), 0.0, []
    for target in command:
        temperatures.append(T + noise * draw.standard_normal())
        step = INTERVAL / stroke_time
        position += min(max(target - position, -step), step)
        q = min(max(q, position - backlash), position)
        drift += 0.002 * draw.standard_normal()
        T += (24.0 + drift + gain * q / (1.0 - backlash) - T) * INTERVAL / tau
    return np.array(temperatures)


def stepped_day(hours=6, seed=1):
    """A command that steps up and down every 10 min, and set-points that say so."""
    command = np.repeat(np.random.default_rng(seed).uniform(0.2, 0.8, hours * 6), int(600 / INTERVAL))
    return command, 24.0 - 20.0 * command


@pytest.mark.parametrize("backlash", [0.0, 0.063, 0.15])
def test_the_true_backlash_is_found_claimed_and_covered(backlash):
    command, T_set = stepped_day()
    identification = identify_backlash(command, simulate_plant(command, backlash), INTERVAL, T_set)
    assert_identified(identification, backlash, 0.005)
    assert identification.low <= backlash <= identification.high
    assert identification.probability.sum() == pytest.approx(1.0)


def test_neither_the_stroke_time_nor_resolution_of_command_and_sensor_matters_much():
    command, T_set = stepped_day()
    coarse, T_fast = np.round(command, 2), simulate_plant(command, 0.06, stroke_time=60.0)
    logs = ((command, T_fast, None), (command, T_fast, 0.0), (coarse, np.round(simulate_plant(coarse, 0.06), 1), None))
    for command_seen, T, stroke_time in logs:
        assert_identified(identify_backlash(command_seen, T, INTERVAL, T_set, stroke_time=stroke_time), 0.06, 0.012)


def test_gaps_and_times_off_are_left_out():
    command, T_set = stepped_day()
    T = simulate_plant(command, 0.08)
    enabled = np.ones(T.size, bool)
    enabled[700:900] = False
    T[700:900] = 35.0  # the fan stands still
    T[300:305] = np.nan
    command[1200:1203] = np.nan
    assert_identified(identify_backlash(command, T, INTERVAL, T_set, enabled=enabled), 0.08, 0.01)
    assert not identify_backlash(command, T, INTERVAL, T_set, enabled=np.zeros(T.size, bool)).identified


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"interval": 61.0}, "every 30 s or faster"),
        ({"command": np.linspace(0.2, 0.8, 2160)}, "never reverses"),
        ({"command": np.full(2160, 0.5)}, "never reverses"),
        ({"temperature": np.full(2160, 14.0)}, "too little"),
        ({"temperature": np.full(2160, np.nan)}, "no sample"),
    ],
)
def test_what_cannot_tell_says_why(change, says):
    command, T_set = stepped_day()
    log = {"command": command, "temperature": simulate_plant(command, 0.05), "interval": INTERVAL, "T_set": T_set}
    assert_withheld(identify_backlash(**(log | change)), says)


def test_no_relation_between_command_and_temperature_is_not_claimed():
    command, T_set = stepped_day()
    is_claimed = [
        identify_backlash(command, 14.0 + np.cumsum(draw.normal(0, 0.02, command.size)), INTERVAL, T_set).identified
        for draw in map(np.random.default_rng, range(10))
    ]
    assert sum(is_claimed) <= 1


def test_a_stuck_stem_under_a_command_that_follows_the_temperature_is_not_called_good():
    """The temperature wanders; the command follows its noise and drift, the stem never moves."""
    for seed in range(3):
        draw = np.random.default_rng(seed)
        drift = np.convolve(np.cumsum(draw.normal(0, 0.01, 2400)), np.ones(30) / 30, "same")[:2160]
        T = 14.0 + drift + draw.normal(0, 0.03, drift.size)
        command = np.clip(0.5 + 0.03 * (T - T.mean()) + 0.0005 * np.cumsum(T - T.mean()), 0.0, 1.0)
        identification = identify_backlash(command, T, INTERVAL, np.full(T.size, 14.0))
        assert not (identification.identified and identification.backlash <= 0.01)
        assert not identify_backlash(command, T, INTERVAL).identified


def peak(size, width=0.001):
    """A log-likelihood with its maximum at a size."""
    return -(((CANDIDATES - size) / width) ** 2)


def make_day(without_command, with_command=None, **fields):
    """Evidence of a day on which the valve reversed often, by default one with steps of the set-point."""
    likelihood = Likelihood(without_command, without_command if with_command is None else with_command, 900)
    return DayEvidence(**{"likelihoods": [likelihood], "provoked": True, "positions": np.tile([0.2, 0.8], 8)} | fields)


def judge_day(*likelihoods, **fields):
    return combine_days([make_day(*likelihoods, **fields)])


def make_steady_days(n, without_command, with_command):
    return [make_day(without_command, with_command, provoked=False) for _ in range(n)]


def test_a_good_valve_is_claimed_only_if_something_else_than_the_temperature_moved_the_command():
    assert judge_day(peak(0.0)).identified
    assert_withheld(judge_day(peak(0.0), provoked=False), "stem that stands still")
    assert judge_day(peak(0.0), peak(0.08), provoked=False).backlash == pytest.approx(0.08)


def test_a_valve_is_called_worse_than_good_only_at_odds_of_300_to_1():
    """0.8 of the log-likelihood counts: a gain of 6 is 121 to 1, one of 8 is 602 to 1."""
    for gain, claimed in ((6.0, False), (8.0, True)):
        best, good = np.isclose(CANDIDATES, 0.0125), np.isclose(CANDIDATES, 0.005)
        identification = judge_day(np.where(best, 0.0, np.where(good, -gain, -50.0)))
        assert identification.backlash == pytest.approx(0.0125)
        assert identification.identified == claimed
        assert (identification.low == 0.0) == (not claimed)


def test_of_sizes_that_explain_alike_the_one_that_is_surely_right_is_named():
    """0, 1 and 2 % are as probable: within 1 % of all of them lies 1 % alone."""
    is_likely = np.isclose(CANDIDATES[:, np.newaxis], [0.0, 0.01, 0.02]).any(axis=1)
    assert_identified(judge_day(np.where(is_likely, 0.0, -50.0) + 1e-3 * np.isclose(CANDIDATES, 0.0)), 0.01, 1e-6)


def test_doubt_the_largest_size_and_what_counts_for_less_are_not_claimed():
    assert judge_day(peak(0.1)).identified
    assert judge_day(peak(0.1), doubt="because").reason == "because"
    assert "larger gaps are not tested" in judge_day(peak(0.25)).reason
    assert "larger gaps are not tested" in judge_day(peak(0.245, 0.003)).reason
    assert not judge_day(peak(0.1, 0.012), weight=0.5).identified
    assert judge_day(peak(0.1, 0.012)).identified


def test_readings_of_columns_that_do_not_agree_are_not_claimed():
    small, large = (Likelihood(peak(size), peak(size), 900) for size in (0.03, 0.1))
    assert not judge_day(peak(0.03), likelihoods=[small, large]).identified
    assert judge_day(peak(0.03), likelihoods=[small, small]).identified


def simulate_control(backlash, samples=0):
    """A loop with steps of the set-point: (command, temperatures logged so many samples late, T_set)."""
    log = make_loop_log(hours=6.0, backlash=backlash, kp=0.03, ti=150.0, sample_time=10.0, noise=0.01)
    command, T, T_set = (log[name].values for name in ("command", "T_sup", "T_set"))
    return command, np.roll(T, samples), T_set


def test_temperatures_that_stand_late_are_moved_back():
    command, T, T_set = simulate_control(0.07, 2)
    identification = identify_backlash(command, T, INTERVAL, T_set)
    assert identification.temperature_lag == 2 * INTERVAL
    assert identification.identified
    in_time = simulate_control(0.07)
    n = command.size - 2
    assert identification[:5] == identify_backlash(in_time[0][:n], in_time[1][:n], INTERVAL, T_set[2:])[:5]


def test_commands_that_stand_late_or_answer_slowly_are_reckoned_with_as_both(monkeypatch):
    command, T, T_set = simulate_control(0.07, -2)
    identification = identify_backlash(command, T, INTERVAL, T_set)
    assert identification.temperature_lag == -2 * INTERVAL
    assert identification.backlash == pytest.approx(0.07, abs=0.014)
    monkeypatch.setattr("fastcoil.measured.identify.imply_pi", lambda *_: ImpliedPI(0, np.nan, 0.0))
    both = [identify_backlash(command[cut:], T[: T.size - cut], INTERVAL, T_set[cut:]).probability for cut in (0, 2)]
    np.testing.assert_allclose(identification.probability, np.mean(both, axis=0), atol=1e-9)


def test_a_command_that_jumps_to_and_fro_needs_the_sample_time_and_counts_for_less(monkeypatch):
    command, T_set = stepped_day()
    chatter = command + 0.04 * (np.random.default_rng(9).random(command.size) < 0.5)
    log = (chatter, simulate_plant(chatter, 0.05), INTERVAL, T_set)
    assert "back and forth" in identify_backlash(*log).reason
    assert "back and forth" in identify_backlash(*log, sample_time=15.0).reason
    identification = identify_backlash(*log, sample_time=10.0)
    assert identification.backlash == pytest.approx(0.05, abs=0.01)
    assert "back and forth" not in identification.reason
    monkeypatch.setattr("fastcoil.measured.identify.back_and_forth_share", lambda *_: 0.0)
    root = np.sqrt(identify_backlash(*log, sample_time=10.0).probability)
    np.testing.assert_allclose(identification.probability, root / root.sum(), atol=1e-9)


def test_a_log_coarser_than_the_controller_counts_for_less(monkeypatch):
    command, T_set = stepped_day(hours=12)
    T = simulate_plant(command, 0.06, noise=0.04)
    monkeypatch.setattr("fastcoil.measured.identify.imply_pi", lambda *_: ImpliedPI(0, np.nan, 0.0))  # no controller
    log = (command[::6], T[::6], 60.0, T_set[::6])
    coarse, fine = identify_backlash(*log), identify_backlash(*log, sample_time=60.0)
    assert fine.identified
    assert coarse.backlash == fine.backlash == pytest.approx(0.06, abs=0.012)
    assert coarse.high - coarse.low > fine.high - fine.low


@pytest.mark.parametrize(("start", "hours"), full_except([(0, 8), (24, 8), (48, 8), (72, 8), (0, 105)], [(0, 8)]))
def test_a_measured_loop_without_backlash_is_never_accused(start, hours):
    """105 h of a loop that hunts for another reason, whole and a third of each day, with and without its set-point."""
    path = measured_file("b33_ahu2_5s.csv")
    rows = np.genfromtxt(path, delimiter=",", skip_header=1 + 720 * start, max_rows=720 * hours)
    command, T, T_set, on = rows[:, 1] / 100, rows[:, 2], rows[:, 3], rows[:, 6]
    for set_point in (T_set, None):
        identification = identify_backlash(command, T, 5.0, set_point, enabled=on > 0)
        assert not (identification.identified and identification.backlash > 0.02), identification


def test_days_of_one_valve_show_together_what_none_of_them_shows_alone():
    days = [make_day(peak(0.08, 0.02 + 0.001 * k)) for k in range(8)]
    assert not any(combine_days([day]).identified for day in days)
    assert_identified(combine_days(days), 0.08, 1e-6)


def test_a_gap_is_claimed_from_three_reversals_beyond_it_on_all_days_together():
    """Two reversals a day, of 9 % of the stroke, and gaps below and above that."""
    for gap, n_days, n_reversals in ((0.05, 1, 2), (0.05, 2, 4), (0.12, 3, 0)):
        identification = combine_days(n_days * [make_day(peak(gap, 0.004), positions=np.array([0.4, 0.49, 0.4, 0.49]))])
        assert identification.identified == (n_reversals > 2)
        if n_reversals < 3:
            assert_withheld(identification, f"reversed only {n_reversals} times by more than such a gap")


def test_a_day_with_a_doubt_does_not_count_beside_others():
    doubted = make_day(peak(0.2), doubt="because", temperature_lag=30.0)
    sound = make_day(peak(0.05))
    assert combine_days([doubted, sound])[:5] == combine_days([sound])[:5]
    assert combine_days([doubted, doubted, sound]).reason == "because"
    assert combine_days([make_day(peak(0.05), likelihoods=[], doubt="nothing"), sound]).backlash == pytest.approx(0.05)


def test_days_of_a_command_that_jumps_count_where_there_are_four():
    jumpy = make_day(peak(0.05), is_jumpy=True)
    assert "back and forth" in combine_days(3 * [jumpy]).reason
    assert_identified(combine_days(4 * [jumpy]), 0.05, 1e-6)


def test_steady_days_acquit_no_valve_that_stepped_days_accuse():
    """A command that only follows the temperature predicts it as well as an opening without a gap."""
    trap = np.where(CANDIDATES <= 0.01, 0.0, -80.0)
    assert combine_days([make_day(peak(0.05, 0.01)), *make_steady_days(8, trap, trap)]).backlash == pytest.approx(0.05)


def test_steady_days_that_differ_from_each_other_show_no_gap():
    def combine_sizes(*sizes):
        return combine_days([make_day(peak(0.0), peak(size), provoked=False) for size in sizes])

    assert combine_sizes(0.06, 0.065, 0.06, 0.055, 0.06, 0.065).backlash == pytest.approx(0.06, abs=0.0025)
    assert "the days show different gaps" in combine_sizes(0.06, 0.06, 0.06, 0.12, 0.06, 0.02).reason


def test_more_steady_days_than_ten_count_as_ten():
    """What the linear model gets wrong is wrong every day."""
    five, ten, thirty = (combine_days(make_steady_days(n, peak(0.0), peak(0.06))).probability for n in (5, 10, 30))
    np.testing.assert_allclose(ten, thirty)
    assert five.max() < ten.max()


def test_steady_days_alone_never_show_a_good_valve():
    steady = make_steady_days(3, peak(0.0), peak(0.0))
    assert "stem that stands still" in combine_days(steady).reason
    assert combine_days([*steady, make_day(peak(0.0))]).identified


def test_a_log_backwards_in_time_shows_no_gap(monkeypatch):
    command, T, T_set = simulate_control(0.07)
    assert identify_backlash(command, T, INTERVAL, T_set).identified
    backwards = command[::-1], T[::-1], INTERVAL, T_set[::-1]
    assert "moves before the temperature change that it responds to" in identify_backlash(*backwards).reason
    monkeypatch.setattr("fastcoil.measured.identify.imply_pi", lambda *_: ImpliedPI(0, np.nan, 0.0))
    assert "backwards" in identify_backlash(*backwards).reason


def test_a_lag_that_is_given_is_taken_in_place_of_the_one_found():
    command, T, T_set = simulate_control(0.07, 3)
    identification = identify_backlash(command, T, INTERVAL, T_set, lag=3 * INTERVAL)
    assert identification.temperature_lag == 3 * INTERVAL
    assert identification.backlash == pytest.approx(0.07, abs=0.005)
    assert identify_backlash(command, T, INTERVAL, T_set, lag=0.0).temperature_lag == 0.0


def test_temperatures_of_other_hours_that_answer_as_well_show_no_gap(monkeypatch):
    """A day whose commands and temperatures come back every quarter: any quarter belongs to any other."""
    monkeypatch.setattr("fastcoil.measured.identify.CLOCK_SHIFTS_S", (0.0,))  # cuts nothing off: quarters stay whole
    command, T, T_set = simulate_control(0.07)
    quarter = T.size // 4
    command, T, T_set = (np.tile(series[quarter : 2 * quarter], 4) for series in (command, T, T_set))
    assert "other hours" in identify_backlash(command, T, INTERVAL, T_set).reason


def test_a_day_that_fits_backwards_or_other_hours_weighs_against_all_days():
    """Margins of the log-likelihood add up: nine days in order do not outweigh one that fits far better backwards."""
    in_order = [make_day(peak(0.08), placebo_margin=20.0)] * 9
    for margin, claimed in ((-100.0, True), (-250.0, False)):
        backwards = make_day(peak(0.02), placebo_margin=margin, doubt="fits as well backwards")
        identification = combine_days([*in_order, backwards])
        assert identification.identified == claimed
        assert identification.reason == ("" if claimed else "fits as well backwards")


@pytest.mark.parametrize("n_misplaced", [2, 3])
def test_days_on_another_clock_are_left_out_up_to_a_fifth_and_weigh_beyond(n_misplaced):
    late = make_day(peak(0.02), doubt="moves before", is_misplaced=True)
    days = [late] * n_misplaced + [make_day(peak(0.08))] * (10 - n_misplaced)
    assert combine_days(days).identified == (n_misplaced == 2)


def moving_loop(late, seed, n=480, interval=60.0):
    """A PI under a set-point that moves in each row, and its temperature ``late`` samples later."""
    draw = np.random.default_rng(seed)
    T = 14.0 + np.convolve(draw.normal(0.0, 0.3, n + 40), np.ones(8) / 8, "same")[:n]
    T_set = 14.0 + np.cumsum(draw.normal(0.0, 0.02, n))
    command = 0.5 + 0.02 * (T - T_set) + 0.02 / 300.0 * interval * np.cumsum(T - T_set)
    return command, np.roll(T, late), T_set, np.ones(n, bool)


@pytest.mark.parametrize("late", [0, 5, -4])
def test_the_clock_of_all_days_is_that_on_which_their_controller_answers(late):
    lags, is_right = plausible_lags([moving_loop(late, seed) for seed in range(4)], 60.0, 0.0)
    assert (lags, is_right) == (([], True) if late == 0 else ([60.0 * late], False))


def test_a_claim_has_to_survive_the_clock_of_all_days():
    claim, other = judge_day(peak(0.08)), judge_day(peak(0.02))
    assert _require_survival(claim, judge_day(peak(0.085)), 300.0) == claim
    assert_withheld(_require_survival(claim, other, 300.0), "fits T_sup 300 s later than the command")


def test_a_swing_of_the_entering_air_is_no_gap_unless_it_is_logged():
    day = fc.paper_day(hours=8, seed=4)
    seconds = np.arange(day.series["T_a_in"].shape[-1])
    air = day.series["T_a_in"] + 1.5 * np.sign(np.sin(2.0 * np.pi * seconds / 540.0))
    loop = fc.Loop.preset("lbnl").assign(noise_std=0.02)
    ds = fc.simulate(loop, day.assign(T_a_in=air), traces=["command", "T_measured"], trace_interval=10)
    command, T = (np.squeeze(ds[name].values).astype(float) for name in ("command", "T_measured"))
    T_set, m_a, T_a_in = (np.squeeze(x)[::10][: T.size] for x in (day.series["T_set"], day.series["m_a"], air))
    assert_withheld(identify_backlash(command, T, INTERVAL, T_set), "swings the temperature every 9 min")
    assert "log the entering air" in identify_backlash(command, T, INTERVAL, T_set).reason
    assert "swings" not in identify_backlash(command, T, INTERVAL, T_set, (m_a, T_a_in)).reason
