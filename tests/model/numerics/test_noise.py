"""Philox4x32-10, Box-Muller and the low-pass filter: known answers, distribution, independence, noise of a scenario."""

import math

import numpy as np
import pytest
import reference
from scipy import stats
from scipy.signal import lfilter

import fastcoil as fc
from fastcoil.model.numerics.jit import JIT_ENABLED
from fastcoil.model.numerics.noise import low_pass, normal_pair, philox, uniform

N_PAIRS = 20000 if JIT_ENABLED else 1000


def philox_words(counter, key):
    return tuple(int(word) for word in philox(*map(np.uint64, (*counter, *key))))


def normals(n_pairs=N_PAIRS, channel=0, replicate=0, day=0, seed=0, first=0):
    key = np.uint64(seed & 0xFFFFFFFF), np.uint64(seed >> 32)
    stream = np.uint64(channel), np.uint64(replicate), np.uint64(day)
    return np.array([normal_pair(np.uint64(first + k), *stream, *key) for k in range(n_pairs)]).ravel()


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ],
)
def test_known_answers_of_random123(counter, key, expected):
    answer = philox_words([int(word, 16) for word in counter.split()], [int(word, 16) for word in key.split()])
    assert [f"{word:08x}" for word in answer] == expected.split()


def test_words_are_the_references():
    rng = np.random.default_rng(12)
    for _ in range(50):
        counter, key = rng.integers(0, 2**32, 4).tolist(), rng.integers(0, 2**32, 2).tolist()
        assert philox_words(counter, key) == reference.philox4x32(counter, key)


def test_uniform_never_reaches_0_nor_1():
    low, high = np.uint64(0), np.uint64(0xFFFFFFFF)
    assert uniform(low, low) == 2.0**-53
    assert uniform(high, high) == 1.0 - 2.0**-53


def test_normals_are_the_references():
    seed, channel, replicate, day = 2**63 + 12345, 3, 7, 20160712
    normals_found = normals(200, channel, replicate, day, seed, first=2**20)
    expected = [reference.standard_normal(seed, 2**21 + k, channel, replicate, day) for k in range(400)]
    np.testing.assert_allclose(normals_found, expected, rtol=0.0, atol=1e-14)


def test_distribution_is_normal():
    assert stats.kstest(normals(), "norm").pvalue > 0.001


@pytest.mark.parametrize("stream", [{"channel": 1}, {"replicate": 1}, {"day": 1}, {"seed": 1}, {"seed": 2**32}])
def test_neighbouring_streams_are_uncorrelated(stream):
    z, neighbour = normals(), normals(**stream)
    assert abs(np.corrcoef(z, neighbour)[0, 1]) < 4 / math.sqrt(z.size)


# What a scenario gets


def noise_in(ds):
    """The noise in a run without lag and resolution."""
    return (ds.T_measured - ds.T_sup).values


def simulate_noise(half_hour_day, loop, **options):
    return fc.simulate(fc.Loop(**loop), half_hour_day, traces=["T_sup", "T_measured"], warm_up=60, **options)


@pytest.mark.kernel
@pytest.mark.parametrize("sample_time", [1, 7, 30])
def test_noise_is_drawn_at_the_samples_and_held_between(half_hour_day, sample_time):
    seed = 2**35 + 3
    noise = noise_in(simulate_noise(half_hour_day, {"noise_std": 0.1, "sample_time": sample_time}, seed=seed))
    samples = np.arange(half_hour_day.n_steps) // sample_time
    # the label of the day is its seed
    z = np.array([reference.standard_normal(seed, k, 0, 0, int(half_hour_day.day[0])) for k in range(samples[-1] + 1)])
    np.testing.assert_allclose(noise, 0.1 * z[samples], rtol=0.0, atol=1e-13)


@pytest.mark.kernel
def test_every_scenario_gets_the_same_noise(half_hour_day):
    loop = {"noise_std": 0.1, "backlash": [0.0, 0.07, 0.15], "kp": [0.01, 0.03], "backlash_estimate": [0.0, 0.05]}
    noise = noise_in(simulate_noise(half_hour_day, loop))
    np.testing.assert_allclose(noise, np.broadcast_to(noise[0, 0, 0], noise.shape), rtol=0.0, atol=1e-13)


@pytest.mark.kernel
def test_replicates_and_seeds_differ(half_hour_day):
    by_replicate = noise_in(simulate_noise(half_hour_day, {"noise_std": 0.1, "sample_time": 1}, replicates=3))
    other_seed = noise_in(simulate_noise(half_hour_day, {"noise_std": 0.1, "sample_time": 1}, seed=1))
    correlations = np.corrcoef([*by_replicate, other_seed])[np.triu_indices(4, 1)]
    assert np.all(np.abs(correlations) < 4 / math.sqrt(half_hour_day.n_steps))


@pytest.mark.kernel
def test_days_have_their_own_noise_by_label(half_hour_day):
    rows = {name: np.repeat(values, 3, axis=0) for name, values in half_hour_day.series.items()}
    days = fc.Boundary(**rows, day=[5, 2, 9])
    noise = noise_in(simulate_noise(days, {"noise_std": 0.1, "sample_time": 1}))
    alone = fc.Boundary(**{name: values[:1] for name, values in half_hour_day.series.items()}, day=[2])
    np.testing.assert_array_equal(noise[1], noise_in(simulate_noise(alone, {"noise_std": 0.1, "sample_time": 1}))[0])
    assert abs(np.corrcoef(noise[0], noise[1])[0, 1]) < 4 / math.sqrt(half_hour_day.n_steps)


@pytest.mark.kernel
def test_noise_std_0_is_no_noise_to_the_bit(half_hour_day):
    quiet = simulate_noise(half_hour_day, {"noise_std": [0.0, 0.1]})
    alone = simulate_noise(half_hour_day, {})
    np.testing.assert_array_equal(quiet.T_sup.sel(noise_std=0.0).values, alone.T_sup.values)
    np.testing.assert_array_equal(alone.T_measured.values, alone.T_sup.values)


@pytest.mark.parametrize("tau", [1, 60, 120, 300, 1e4])
def test_it_equals_lfilter_to_the_bit(tau):
    x, decay = np.random.default_rng(3).standard_normal(5000), np.exp(-1.0 / tau)
    y = np.empty_like(x)
    low_pass(x, decay, y)
    np.testing.assert_array_equal(y, lfilter([1.0 - decay], [1.0, -decay], x))


def test_it_may_filter_in_place():
    x = np.random.default_rng(4).standard_normal(100)
    y = np.empty_like(x)
    low_pass(x, 0.9, y)
    low_pass(x, 0.9, x)
    np.testing.assert_array_equal(x, y)
