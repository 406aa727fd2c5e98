"""One sample of the valve test after another, on made-up errors: the script's commands, its limits, its ends."""

import itertools
import math

import numpy as np
import pytest
from reference.valve_test import valve_test as script

import fastcoil as fc
from fastcoil.model import valve_test
from fastcoil.model.metric_table import TEST_ABORTED_MEANINGS

DEFAULTS = {name.removeprefix("test_"): value for name, value in fc.ValveTest().parameters().items()}
del DEFAULTS["start"], DEFAULTS["every"]


def run_test(errors, command=0.5, sample_time=5.0, air_flows=None, **changes):
    """(Commands, memories after them, why it ended) on given errors; equal to those of the script."""
    settings = DEFAULTS | changes
    p = valve_test.Parameters(sample_time, **{f"test_{name}": value for name, value in settings.items()})
    memory, first_command, commands, memories = valve_test.begin_test(14.0, p, valve_test.Memory()), command, [], []
    flows = [math.nan] * len(errors) if air_flows is None else air_flows
    for e, m_a in zip(errors, flows, strict=True):
        command, memory = valve_test.step_test(e, command, m_a, True, p, memory)
        if memory.phase == valve_test.PHASE_OFF:
            break
        commands.append(command)
        memories.append(memory)
    expected, reason = script(errors, first_command, sample_time, air_flows=air_flows, **settings)
    np.testing.assert_allclose(commands, expected, rtol=0.0, atol=1e-12)
    assert TEST_ABORTED_MEANINGS[int(memory.aborted)] == (reason if reason in TEST_ABORTED_MEANINGS else "no")
    return commands, memories, reason


def wandering_errors(seed, n, size):
    """Errors that go to and fro."""
    rng, e = np.random.default_rng(seed), [0.0]
    for _ in range(n):
        e.append(0.97 * e[-1] + rng.normal(0.0, size))
    return e


@pytest.mark.parametrize("sample_time", [5.0, 10.0, 30.0])
@pytest.mark.parametrize("size", [0.02, 0.06, 0.15])
def test_the_commands_are_those_of_the_script_on_errors_that_wander(size, sample_time):
    reasons = set()
    for seed in range(40):
        times = {"settle": 60.0 * (1 + seed % 4), "hold": 60.0 * (1 + seed % 2)}
        errors = wandering_errors(seed, int(1200 / sample_time), size * (sample_time / 5.0) ** 0.5)
        command, threshold = (0.5, 0.03, 0.98)[seed % 3], (0.1, 0.3)[seed % 3 // 2]
        reasons.add(run_test(errors, command, sample_time, threshold=threshold, **times)[-1])
    assert "" in reasons if size < 0.1 else reasons >= {"swing", "end_of_stroke"}


def test_ramps_have_between_a_fifth_and_four_times_the_given_rate():
    """Errors that answer the command by much or little: the next ramp is slower or faster, but never more than that."""
    rates = set()
    for gain, seed in itertools.product((0.2, 1.0, 5.0), range(8)):
        errors = [gain * e for e in wandering_errors(seed, 500, 0.1)]
        commands, memories, _ = run_test(errors, minutes=40, excursion=50.0, settle=0.0, hold=30.0)
        moves = np.abs(np.diff(commands))
        ends = (np.array(commands[1:]) == 0.0) | (np.array(commands[1:]) == 1.0)
        assert (moves <= valve_test.LARGEST_RATE_RATIO * DEFAULTS["rate"] * 5.0 + 1e-12).all()
        assert (moves[(moves > 0.0) & ~ends] >= valve_test.LEAST_RATE_RATIO * DEFAULTS["rate"] * 5.0 - 1e-12).all()
        rates |= {memory.ramp_rate for memory in memories}
    assert min(rates) == pytest.approx(valve_test.LEAST_RATE_RATIO * DEFAULTS["rate"])
    assert max(rates) == pytest.approx(valve_test.LARGEST_RATE_RATIO * DEFAULTS["rate"])


@pytest.mark.parametrize(("ran_on", "share"), [(0.5, 1.0), (1.0, 0.5), (0.1, 2.0), (-0.2, 2.0), (9.0, 0.2)])
def test_the_next_ramp_has_the_rate_at_which_the_temperature_runs_on_by_half_a_kelvin(ran_on, share):
    p = valve_test.Parameters(5.0, **{f"test_{name}": value for name, value in DEFAULTS.items()})
    assert valve_test.next_ramp_rate(DEFAULTS["rate"], ran_on, p) == pytest.approx(share * DEFAULTS["rate"])


CALM_ERRORS = [0.1] * 13
ABORTED_RUNS = {
    "excursion": ([*CALM_ERRORS, *[0.2] * 10, *[-0.5] * 5, -1.51], 0.5),
    "end_of_stroke": ([0.2] * 60, 0.95),
    "swing": ([0.2, -0.11] * 20, 0.5),
}


@pytest.mark.parametrize("reason", ABORTED_RUNS)
def test_a_test_is_aborted(reason):
    assert run_test(*ABORTED_RUNS[reason])[-1] == reason


@pytest.mark.parametrize(("command", "error"), [(0.0, -0.1), (1.0, 0.1)])
def test_a_test_does_not_begin_where_the_valve_has_no_room(command, error):
    assert run_test([error] * 60, command)[0] == []
    assert run_test([error] * 60, command)[-1] == "end_of_stroke"
    assert run_test([-error] * 60, command)[-1] == "no more errors"


def test_an_end_of_the_stroke_that_brings_the_temperature_back_turns_the_ramp():
    commands, _, why = run_test([*CALM_ERRORS, *[0.2] * 5, *[-0.1] * 60], command=0.98)
    assert why == "no more errors"
    assert commands[-1] < 1.0 == max(commands)


def test_before_the_first_ramp_has_ended_the_error_may_be_twice_as_large():
    assert run_test([*CALM_ERRORS, *[2.99] * 5])[-1] == "no more errors"
    assert run_test([*CALM_ERRORS, *[3.01] * 5])[-1] == "excursion"


@pytest.mark.parametrize(
    ("jump", "error", "reason"),
    [
        (1.0, 1.51, "excursion"), (1.2, 1.51, "no more errors"), (1.2, 2.99, "no more errors"),
        (1.2, 3.01, "excursion"), (1.2, -1.51, "excursion"), (0.8, -1.51, "no more errors"), (1.04, 1.51, "excursion"),
    ],
)  # fmt: skip
def test_an_error_that_the_measured_air_explains_may_be_twice_as_large(jump, error, reason):
    """More air needs a more open valve, so its error is positive; the first ramp has ended before."""
    errors = [*CALM_ERRORS, *[0.2] * 10, *[-0.5] * 5, *[error] * 3]
    assert run_test(errors, air_flows=[1.2] * 28 + [1.2 * jump] * 3)[-1] == reason


def test_long_after_a_change_of_the_air_the_limit_is_the_usual_one():
    errors = [*CALM_ERRORS, *[0.2] * 10, *[-0.5] * 5, *[0.1] * 120, 1.6]
    for seconds, reason in ((200, "no more errors"), (600, "excursion")):
        flows = [1.2] * (149 - seconds // 5) + [1.44] * (seconds // 5)
        assert run_test(errors, air_flows=flows)[-1] == reason, seconds


@pytest.mark.parametrize("m_a", [math.nan, 0.0, -1.0])
def test_air_that_is_not_known_neither_delays_a_test_nor_widens_its_limit(m_a):
    p = valve_test.Parameters(5.0, **{f"test_{name}": value for name, value in DEFAULTS.items()})
    memory = valve_test.Memory()
    for flow in (1.2, 1.2, m_a, m_a):
        begins, memory = valve_test.watch_loop(0.5, flow, True, False, p, memory)
        assert not begins
    assert valve_test.watch_loop(0.5, m_a, True, True, p, memory)[0]
    assert memory.air_flow == 1.2
    assert valve_test.change_of_air(m_a, 1.2) == valve_test.change_of_air(1.2, 0.0) == 0.0
