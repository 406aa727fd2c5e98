"""``buffer.py``: turns by noise and the cycle of the buffer against plain Python; its tables."""

import math

import numpy as np
import pytest

import fastcoil as fc
from studies import days as kinds
from studies.buffer import buffer, runs
from studies.buffer import rule as buffer_rule
from studies.buffer.rule import Plant


def hold_extremes(signal, buffer):
    """Hold the extreme of a series since the last turn, as the inverse does; also count the turns."""
    extreme, rising, turns, out = signal[0], True, 0, []
    for u in signal:
        if (u < extreme - buffer) if rising else (u > extreme + buffer):
            extreme, rising, turns = u, not rising, turns + 1
        elif (u > extreme) if rising else (u < extreme):
            extreme = u
        out.append(extreme)
    return np.array(out), turns


@pytest.mark.parametrize("c", [0.0, 1.5, 3.0])
def test_white_noise_turns_an_inverse_as_often_as_the_integral_says(c):
    n = 60_000
    _, turns = hold_extremes(np.random.default_rng(3).standard_normal(n).tolist(), c)
    expected = buffer_rule.turns_per_sample(c)
    assert turns / n == pytest.approx(expected, abs=4.0 * math.sqrt(expected / n))
    assert buffer_rule.turns_per_sample(0.0) == pytest.approx(2.0 / 3.0, abs=1e-6)


@pytest.mark.kernel
@pytest.mark.filterwarnings("ignore:T_set is 19 degC at best")
def test_the_kernel_turns_on_noise_as_often_as_the_integral_says():
    """A valve that lets no water through, and hardly any integral part: u is white noise around 0.5."""
    c = np.array([1.0, 2.0, 3.0])
    loop = fc.Loop(m_max=1e-9, kp=0.5, ti=1e7, sample_time=2.0, noise_std=0.05, buffer=c * 0.5 * 0.05, backlash=0.0)
    n, constants = 3600 * 3, {"m_a": 1.0, "T_a_in": 20.0, "W_a_in": 0.005, "T_w_in": 20.0}
    ds = fc.simulate(loop, fc.Boundary(**constants, T_set=np.full(n, 19.0)), replicates=8)
    turns = ds.switch_frequency.mean("replicate") / 300.0
    np.testing.assert_allclose(turns.values, [buffer_rule.turns_per_sample(x) for x in c], rtol=0.06)


@pytest.mark.parametrize("amplitude", [0.4, 0.55, 1.0, 4.0])
def test_the_describing_function_is_the_first_harmonic_of_a_held_sine(amplitude):
    angle = np.arange(6 * 4000) * 2.0 * np.pi / 4000
    signal = amplitude * np.sin(angle)
    out, _ = hold_extremes(signal.tolist(), 1.0)
    last_period = slice(-4000, None)
    wave = out[last_period] - out[last_period].mean() if amplitude > 0.5 else np.zeros(4000)
    n = 2.0 * np.mean(wave * np.exp(-1j * angle[last_period])) * 1j / amplitude
    assert complex(buffer_rule.describing_function(amplitude)) == pytest.approx(n, abs=5e-3)


def simulate_first_order(plant, kp, ti, b, dt=0.25, seconds=8000.0):
    """Swing of T, peak to peak, and period of a loop of first order with dead time behind the buffer."""
    delay, T, integral, extreme, rising = [0.0] * round(plant.theta / dt), 1.0, 0.0, 0.0, True
    temperatures = []
    for _ in range(round(seconds / dt)):
        integral -= kp * dt / ti * T
        u = integral - kp * T
        if (u < extreme - b) if rising else (u > extreme + b):
            extreme, rising = u, not rising
        elif (u > extreme) if rising else (u < extreme):
            extreme = u
        delay.append(extreme)
        T += dt / plant.tau * (plant.gain * delay.pop(0) - T)
        temperatures.append(T)
    last_half = np.array(temperatures[len(temperatures) // 2 :])
    crossings = np.flatnonzero((last_half[1:] >= 0.0) & (last_half[:-1] < 0.0))
    return np.ptp(last_half), dt * np.diff(crossings).mean() if crossings.size > 1 else np.nan


@pytest.mark.parametrize(("kp", "ti"), [(0.08, 40.0), (0.1, 60.0)])
def test_the_cycle_of_the_buffer_is_that_of_a_simulated_loop(kp, ti):
    plant, b = Plant(12.0, 60.0, 30.0), 0.01
    swing, period = simulate_first_order(plant, kp, ti, b)
    assert swing == pytest.approx(simulate_first_order(plant, kp, ti, 2.0 * b)[0] / 2.0, rel=0.1)
    theory = buffer_rule.predict_cycle(*(Plant(*(np.array([v]) for v in plant)), np.array([kp]), np.array([ti])))
    assert float(theory.swing[0]) * b == pytest.approx(swing, rel=0.2)
    assert float(theory.period[0]) == pytest.approx(period, rel=0.2)
    swing_per_buffer = buffer_rule.swing_per_buffer(plant, kp, ti)
    assert swing_per_buffer * b == pytest.approx(swing, rel=0.3)
    assert swing_per_buffer * buffer_rule.largest_buffer(plant, kp, ti, 0.1) == pytest.approx(0.1)
    w = buffer_rule.cycle_frequency(plant, kp, ti)
    assert abs(buffer_rule.loop_response(plant, kp, ti, w)) == pytest.approx(math.pi / 4)


@pytest.mark.kernel
@pytest.mark.full
def test_the_study_writes_its_tables(read_table, monkeypatch, tmp_path):
    monkeypatch.setattr(kinds, "HOURS", 2)
    monkeypatch.setattr(runs, "STILL_HOURS", 4)
    monkeypatch.setattr(buffer, "kinds", lambda: (kinds.CONSTANT, kinds.HEATING))
    buffer.main(12)
    assert (tmp_path / "studies" / "buffer" / "buffer.png").is_file()
    _, (head, *rows) = read_table("buffer_rules")
    assert [row[0] for row in rows] == list(runs.RULES)
    assert rows[0][head.index("RMSE")] == "0"
    _, (_, *rows) = read_table("buffer_lower")
    assert [row[0] for row in rows][:3] == ["constant", "heating", "all"]
    for name in ("noise", "allowed", "constants", "cycle", "upper", "rules_by_days", "crossing"):
        assert read_table(f"buffer_{name}")[1]
