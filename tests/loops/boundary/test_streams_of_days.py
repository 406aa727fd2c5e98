"""Streams of days: the same digest, ranges and samples as in memory, one pass, every mistake by its day."""

import copy
import pickle

import numpy as np
import pytest
from helpers.refusals import assert_mistakes, assert_refused

from fastcoil.loops.boundary import Boundary, days
from fastcoil.loops.boundary.days import heating_day, paper_day
from fastcoil.loops.boundary.series import BOUNDARY_SERIES

N = 900
T_A_IN = np.linspace(20.0, 30.0, N)


def make_day(label):
    """A day that its label decides."""
    m_a, T_set = 1.0 + 0.1 * np.random.default_rng(label).random(N), np.where(np.arange(N) < 450, 13.0, 14.0)
    return {"m_a": m_a, "T_a_in": T_A_IN + label, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": T_set}


def held_boundary(labels, day_maker=make_day):
    days = [{n: np.broadcast_to(v, N) for n, v in day_maker(label).items()} for label in labels]
    return Boundary(**{name: np.stack([day[name] for day in days]) for name in days[0]}, day=labels)


def streamed_boundary(labels=(3, 1, 2), day_maker=make_day, **options):
    return Boundary.from_days(day_maker, day=list(labels), hours=N / 3600, **options)


def test_a_stream_is_the_same_boundary_as_its_days_in_memory():
    stream, held = streamed_boundary(), held_boundary([3, 1, 2])
    assert (stream.is_streamed, held.is_streamed) == (True, False)
    assert (stream.n_days, stream.n_steps, stream.hours, stream.has_day_dim) == (3, N, 0.25, True)
    assert stream == held
    for name in ("sha256", "day_sha256", "extremes"):
        assert getattr(stream, name) == getattr(held, name)
    assert stream.describe() == held.describe()
    for k in range(3):
        of_stream, of_held = stream.of_day(k), held.of_day(k)
        assert list(of_stream) == list(BOUNDARY_SERIES)
        for name, values in of_held.items():
            assert values.shape == of_stream[name].shape == (N,)
            np.testing.assert_array_equal(of_stream[name], values)
            assert not of_stream[name].flags.writeable
            np.testing.assert_array_equal(stream.series[name][k], values)


def test_a_large_boundary_has_one_digest_too_streamed_or_not(monkeypatch):
    small = held_boundary([3, 1, 2]).sha256
    monkeypatch.setattr("fastcoil.loops.boundary.samples.LARGE_BOUNDARY_SAMPLES", 2 * N)
    stream, held = streamed_boundary(), held_boundary([3, 1, 2])
    assert stream.sha256 == held.sha256 != small
    changed = held.assign(T_w_in=np.where(np.arange(N) == 5, 7.5, 7.0))
    assert len({stream.sha256, changed.sha256, streamed_boundary((3, 1, 4)).sha256}) == 3


def test_days_are_made_once_to_be_looked_at_and_then_one_by_one():
    calls = []
    stream = streamed_boundary(day_maker=lambda label: calls.append(label) or make_day(label))
    assert calls == [3]  # tried
    stream.sha256, stream.extremes, stream.day_sha256, stream.describe()  # noqa: B018
    assert calls == [3, 3, 1, 2]
    stream.of_day(1)
    assert calls[4:] == [1]
    assert "sha256" in repr(stream)
    assert "sha256" not in repr(streamed_boundary())


def test_a_stream_goes_to_another_process_with_what_is_known_of_it():
    stream = streamed_boundary(start="2024-01-01", time_zone="UTC")
    for other in (pickle.loads(pickle.dumps(stream)), copy.deepcopy(stream)):
        assert other == stream
        np.testing.assert_array_equal(other.start, stream.start)
    stream.sha256  # noqa: B018
    again = pickle.loads(pickle.dumps(stream))
    again._maker = None  # nothing is made for what is known
    assert again.sha256 == stream.sha256
    held = pickle.loads(pickle.dumps(held_boundary([1])))
    assert not held.of_day(0)["m_a"].flags.writeable


def test_a_function_that_gives_another_day_the_second_time_is_refused():
    rng = np.random.default_rng(0)
    stream = streamed_boundary(day_maker=lambda label: make_day(label) | {"T_w_in": 7.0 + rng.random(N)})
    stream.of_day(1)  # nothing to compare with yet
    stream.sha256  # noqa: B018
    assert_refused("make", "code", stream.of_day, 1)


@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("T_w_in", "missing", None), ("T_a_in", "value", np.full(N, 99.0)), ("T_a_in", "shape", np.ones(N - 1)),
        ("T_a_in", "shape", np.ones((2, N))), ("T_A_in", "name", 3.0),
    ],
)  # fmt: skip
def test_a_bad_day_is_named_when_it_is_made(field, code, value):
    stream = streamed_boundary(day_maker=lambda label: make_day(label) | ({field: value} if label == 1 else {}))
    assert_refused(field, code, lambda: stream.sha256)


def test_bad_arguments_of_from_days():
    mistakes = [("make", "type"), ("hours", "value"), ("day", "duplicate")]
    assert_mistakes(mistakes, Boundary.from_days, "weather", day=[1, 1], hours=-1.0)
    assert_refused("make", "type", Boundary.from_days, lambda label: [label], day=[1], hours=N / 3600)
    assert_refused("make", "code", Boundary.from_days, lambda label: 1 / 0, day=[1], hours=N / 3600)


@pytest.mark.parametrize("make_days", [paper_day, heating_day])
def test_many_days_of_seeds_are_a_stream_of_the_same_days(make_days, monkeypatch):
    held = make_days(hours=0.05, seed=[4, 1, 7])
    monkeypatch.setattr(days, "LARGE_BOUNDARY_SAMPLES", 3 * held.n_steps - 1)
    stream = make_days(hours=0.05, seed=[4, 1, 7])
    assert (held.is_streamed, stream.is_streamed) == (False, True)
    assert stream == held
    assert stream.day_sha256 == held.day_sha256
    assert stream.isel(1).sha256 == make_days(hours=0.05, seed=1).sha256
