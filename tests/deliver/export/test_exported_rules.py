"""Estimators and laws of the user, exported: in all three languages they answer as the kernel does, or are refused."""

import math
import re
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from helpers import rules
from helpers.commands import fastcoil
from helpers.exported import WORST_DIFFERENCE, skip_without_compiler
from helpers.full import full_except
from helpers.sentences import assert_worded

import fastcoil as fc

pytestmark = pytest.mark.kernel

STEPS = (0.0, 0.01, 0.03, 0.02)
CLOSE = 0.05


class Parameters(NamedTuple):
    sample_time: float
    ti: float
    plant_gain: float
    rate: float = fc.parameter(2e-4, unit="K-1 s-1", text="how fast the estimate moves")
    exponent: float = fc.parameter(1.0, text="of nothing")


class Memory(NamedTuple):
    level: float = math.nan
    slope: float = 0.0
    N: float = 0.0
    last: float = math.nan
    unread: float = 3.0


def smooth_level(level, slope, x, weight):
    """Level and slope after one more value."""
    if math.isnan(level):
        return x, 0.0
    after = level + slope + weight * (x - level - slope)
    return after, slope + 0.1 * weight * (after - level - slope)


def mean_of(a, b, c=0.5):
    return c * (a + b)


def largest_step(n):
    largest = 0.0
    for k in range(len(STEPS)):
        if k < n:
            largest = max(largest, STEPS[min(max(k, 0), 3)])
    return largest


@fc.estimator(Parameters, Memory)
def by_all_means(now, p, memory):
    """Uses a bit of everything that can be said."""
    weight = p.sample_time / (p.ti + p.sample_time) ** 2 * p.ti  # of a new value
    level, slope = smooth_level(memory.level, memory.slope, now.e, weight)
    turned = 1.0 if now.mode > 0 else -1.0
    # a table, by a whole number
    k = min(max(int(memory.N % 7.0), 0), 3)
    step = STEPS[k] * math.tanh(level) + 1e-3 * np.sqrt(abs(slope))
    close = -CLOSE <= level <= CLOSE and not (slope != 0.0 and abs(slope) > 1.0)
    known = not math.isnan(memory.last) and abs(memory.last - now.T_set) > 0.1
    if now.m_a > 1.1 or known:
        return now.estimate, Memory(level, slope, 0.0, now.T_set)
    x = now.estimate
    for _ in range(2):
        x += 0.1 * p.rate * p.sample_time * (turned * step + (now.t // 600) * 1e-6)
    if close:
        x = mean_of(x, now.estimate) if x > 0.01 else mean_of(b=0.0, a=x)
    elif level > 3.0:
        x = x * p.exponent + largest_step(3) * 0.01
    else:
        x, step = min(x, 0.2), x
    return x, Memory(level, slope, N=memory.N + 1 + (step > 0.5), last=now.T_set)


def move_by(x, by):
    if x > by:
        x -= by
    return x, -x


@fc.estimator(Parameters, Memory)
def by_corners(now, p, memory):
    """Two fields that read one another, an argument that changes, and numbers that come and go."""
    up, down = move_by(now.e, 0.1)
    gone = now.u > 0.5
    level = memory.last if gone else up
    after = level if level > 0.0 and not math.isnan(memory.last) else down
    last = math.nan if gone else memory.slope
    estimate = min(
        0.05 * abs(memory.N - memory.slope) + 0.001 * abs(now.u - up) + (0.0 if math.isnan(memory.level) else 0.001),
        0.1,
    )
    slope = memory.slope if math.isnan(memory.level) else memory.slope + 0.001
    return estimate, Memory(math.nan if gone else after, memory.N + 0.01, slope, last)


class Started(NamedTuple):
    integral: float = 0.0
    before: float = math.nan


class Gains(NamedTuple):
    sample_time: float
    kp: float
    damping: float = fc.parameter(0.5, unit="s K-1", lower=0.0, text="gain of the derivative")


@fc.law(Gains, Started)
def user_pid(now, p, memory):
    slope = 0.0 if math.isnan(memory.before) else (now.e - memory.before) / p.sample_time
    integral = min(max(memory.integral + 0.2 * p.kp * now.e - 0.1 * now.estimate, 0.0), 1.0)
    return p.kp * now.e + integral + p.damping * slope, Started(integral, now.e)


HOSTILE = '*/ *) /* (* """ \' \\ *\\ **// *\n= 1 // {{ 1 }} #: END_VAR "'


class Labelled(NamedTuple):
    gain: float = fc.parameter(0.01, text=HOSTILE)


class Seen(NamedTuple):
    last: float = 0.0
    """What was seen last */ *) /* (* "" \\ *\\"""


@fc.estimator(Labelled, Seen)
def by_words(now, p, memory):
    '''Moves */ *) /* (* ""

    and *\\ ends with ""'''  # noqa: D209, D300, D301, D400 — what is tried
    # a comment */ *) /* (* *\\ with \"\"\" ends \\
    x = p.gain * abs(now.e)  # and another *\\
    return x + 1e-3 * memory.last, Seen(x)


LOOPS = {
    "everything": {"estimator": by_all_means, "plant_gain": 12.0},
    "corners": {"estimator": by_corners, "plant_gain": 12.0},
    "words": {"estimator": by_words},
    "both": {
        "law": user_pid, "estimator": by_all_means, "plant_gain": 12.0, "error_dead_band": 0.1, "estimate_share": 0.9,
        "action": "heating", "T_initial": 30.0,
    },
}  # fmt: skip


BY_DEFAULT = [("python", "everything"), ("c", "corners"), ("st", "corners"), ("st", "words"), ("c", "both")]


@pytest.mark.parametrize(("language", "name"), full_except(list(product(WORST_DIFFERENCE, LOOPS)), BY_DEFAULT))
def test_own_rules_give_the_kernels_numbers(tmp_path, language, name):
    skip_without_compiler(language)
    values = dict(LOOPS[name])
    loop = fc.Loop.preset("heating" if values.pop("action", "") else "paper_like").assign(**values)
    files = fc.export_controller(loop, tmp_path / f"valve{'.py' if language == 'python' else f'.{language}'}", language)
    assert WORST_DIFFERENCE[language](*files) <= 1e-12
    text = files[0].read_text()
    assert text.isascii()
    assert "unread" not in text  # what changes nothing is left out
    if language == "python" and name == "everything":
        assert "Uses a bit of everything that can be said." in text
        assert "RATE = 0.0002  # 1/(K s): how fast the estimate moves" in text


def test_the_command_exports_a_rule_of_a_study_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rule = "def mine(now, p, memory):\n    return p.gain * abs(now.e), memory\n"
    (tmp_path / "mine.py").write_text(rules.RULE_HEADER + rule)
    (tmp_path / "loop.toml").write_text('[loop]\nestimator = "mine:mine"\ngain = 0.02\n')
    result = fastcoil("export", "loop.toml", "--language", "python")
    assert result.exit_code == 0, result.output
    assert result.stderr == f"This study runs its own code: mine from {tmp_path / 'mine.py'}.\n"
    assert WORST_DIFFERENCE["python"](tmp_path / "loop.py", tmp_path / "loop_vectors.csv") == 0.0


def by_while(now, p, memory):
    x = now.estimate
    while x < 0.1:
        x += 0.01
    return x, memory


def by_a_long_loop(now, p, memory):
    x = 0.0
    for k in range(int(now.switches)):
        x += 0.001 * k
    return min(x, 0.1), memory


def by_other_functions(now, p, memory):
    return 0.01 * math.gamma(1.0 + abs(now.u)), memory


def by_division(now, p, memory):
    return 0.01 / now.u if now.u / now.u > 0.0 else 0.02, memory


def by_negative_division(now, p, memory):
    return 0.01 * abs(int(-9.0 * now.u) // 2), memory


def by_bits(now, p, memory):
    return 0.01 * (int(now.switches) & 3), memory


def by_identity(now, p, memory):
    return 0.01 if now.u is now.e else 0.02, memory


def by_lambda(now, p, memory):
    return scaled(now.u), memory


scaled = lambda x: 0.1 * x  # noqa: E731 — what is refused


@pytest.mark.parametrize(
    "function",
    [
        *(by_while, by_a_long_loop, by_other_functions, by_division),
        *(by_negative_division, by_bits, by_identity, by_lambda),
    ],
)
def test_what_the_languages_lack_is_refused_in_a_sentence(tmp_path, function):
    rule = fc.estimator(rules.Parameters, rules.Memory)(function)
    with pytest.raises(fc.InputError) as caught:
        fc.export_controller(fc.Loop(estimator=rule), tmp_path / "valve.c")
    assert (caught.value.field, caught.value.code) == ("estimator", "code")
    assert_worded(re.sub(r"line \d+", "line N", str(caught.value)))
    assert not list(tmp_path.iterdir())
