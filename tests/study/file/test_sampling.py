"""Sampled parameters: each design and each distribution against what defines it."""

import math

import numpy as np
import pytest

from fastcoil.study.file.loop import DISTRIBUTIONS, METHODS, sample_values

SIZE = 4096
UNIFORM = {"backlash": {"uniform": [0.02, 0.15]}, "kp": {"uniform": [0.01, 0.05]}}


def draw(method="latin_hypercube", size=SIZE, seed=0, **shapes):
    """Values by name; of the two samples of a saltelli design the first."""
    drawn = sample_values({"method": method, "size": size, "seed": seed} | (shapes or UNIFORM))
    return {name: (v.sel(design="A") if "design" in v.dims else v).values for name, v in drawn.items()}


# Designs


def unit(values, low=0.02, high=0.15):
    return (values - low) / (high - low)


def test_a_latin_hypercube_has_one_point_in_each_stratum_of_every_parameter():
    values = draw("latin_hypercube", 1000)
    for name, (low, high) in {"backlash": (0.02, 0.15), "kp": (0.01, 0.05)}.items():
        strata = np.floor(unit(values[name], low, high) * 1000).astype(int)
        np.testing.assert_array_equal(np.sort(strata), np.arange(1000))


def test_a_sobol_design_is_a_net_that_a_latin_hypercube_is_not():
    def fullest_box(method):
        x, y = draw(method, 256).values()
        boxes = np.floor(unit(x) * 16) * 16 + np.floor(unit(y, 0.01, 0.05) * 16)
        return np.bincount(boxes.astype(int), minlength=256).max()

    assert fullest_box("sobol") == 1, "each of 16 x 16 boxes holds one of 256 points"
    assert fullest_box("latin_hypercube") > 1
    assert fullest_box("random") > 1


@pytest.mark.parametrize("method", ["sobol", "random"])
def test_a_design_is_the_beginning_of_one_twice_as_large(method):
    small, large = draw(method, 64), draw(method, 128)
    for name in UNIFORM:
        np.testing.assert_array_equal(small[name], large[name][:64])
        assert len(set(large[name])) == 128


@pytest.mark.parametrize("method", METHODS)
def test_a_design_depends_on_its_seed_and_on_nothing_else(method):
    one, again, other = (draw(method, 64, seed) for seed in (1, 1, 2))
    largest = draw(method, 64, 2**64 - 1)
    for name in UNIFORM:
        np.testing.assert_array_equal(one[name], again[name])
        assert not np.intersect1d(one[name], other[name]).size
        assert not np.intersect1d(one[name], largest[name]).size
    assert abs(np.corrcoef(*one.values())[0, 1]) < 0.4, "parameters are drawn independently"


def test_random_is_the_generator_by_its_name():
    points = np.random.Generator(np.random.PCG64(5)).random((8, 2))
    drawn = draw("random", 8, 5, backlash={"uniform": [0.0, 0.5]}, buffer={"uniform": [0.0, 0.25]})
    np.testing.assert_allclose(drawn["backlash"], points[:, 0] / 2)
    np.testing.assert_allclose(drawn["buffer"], points[:, 1] / 4)


# Distributions: with one point in each of n strata, the k-th smallest value lies between the quantiles k/n and (k+1)/n


def normal(x):
    return 0.5 * (1.0 + math.erf(x / math.sqrt(2.0)))


def truncated(x, mean, std, low, high):
    below, at, above = (normal((v - mean) / std) for v in (low, x, high))
    return (at - below) / (above - below)


def triangle(x, low, mode, high):
    if x < mode:
        return (x - low) ** 2 / ((high - low) * (mode - low))
    return 1.0 - (high - x) ** 2 / ((high - low) * (high - mode))


SHARES = {
    "uniform": ([0.02, 0.15], lambda x: (x - 0.02) / 0.13),
    "loguniform": ([0.005, 0.05], lambda x: math.log10(x / 0.005)),
    "truncnorm": ([0.05, 0.02, 0.0, 0.1], lambda x: truncated(x, 0.05, 0.02, 0.0, 0.1)),
    "triangular": ([0.2, 0.5, 0.8], lambda x: triangle(x, 0.2, 0.5, 0.8)),
}
LOPSIDED = {
    "triangular": ([0.2, 0.2, 0.8], lambda x: triangle(x, 0.2, 0.2, 0.8)),
    "truncnorm": ([0.5, 0.1, 0.0, 0.3], lambda x: truncated(x, 0.5, 0.1, 0.0, 0.3)),
}


@pytest.mark.parametrize(("kind", "case"), [*SHARES.items(), *LOPSIDED.items()])
def test_shares_of_a_sample_are_those_of_its_distribution(kind, case):
    arguments, share_below = case
    values = np.sort(draw(kp={kind: arguments})["kp"])
    shares = np.array([share_below(v) for v in values]) * SIZE
    assert (shares >= np.arange(SIZE) - 1e-6).all()
    assert (shares <= np.arange(SIZE) + 1 + 1e-6).all()


@pytest.mark.parametrize("kind", DISTRIBUTIONS)
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_values_lie_strictly_inside_even_at_the_ends_of_the_unit_cube(kind, share, monkeypatch):
    from fastcoil.study.file import loop

    monkeypatch.setattr(loop, "_points", lambda _method, size, dims, _seed: np.full((size, dims), share))
    arguments = SHARES[kind][0]
    (value,) = draw(size=1, kp={kind: arguments})["kp"]
    end = arguments[-1] if share else {"truncnorm": 0.0}.get(kind, arguments[0])
    assert value == pytest.approx(end, abs=2e-5)
    assert value < end if share else value > end
    assert draw(size=1, sample_time={"choice": [5, 10]})["sample_time"] == [10 if share else 5]
    assert draw(size=1, ti={"uniform": [0.0, 1.0]})["ti"] >= 2.0**-32, "not a number that nothing can divide by"


def test_a_choice_is_of_equally_likely_numbers_or_words():
    times, words = {"choice": [5, 10, 30, 60]}, {"choice": ["cooling", "heating"]}
    drawn = draw("sobol", 64, sample_time=times, action=words, kp={"choice": [0.01]})
    assert {v: int((drawn["sample_time"] == v).sum()) for v in (5, 10, 30, 60)} == {5: 16, 10: 16, 30: 16, 60: 16}
    assert {v: int((drawn["action"] == v).sum()) for v in ("cooling", "heating")} == {"cooling": 32, "heating": 32}
    assert (drawn["kp"] == 0.01).all()
