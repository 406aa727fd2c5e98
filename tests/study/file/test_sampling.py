"""Sampled parameters: each design and each distribution against what defines it."""

import hashlib
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.refusals import assert_refused
from scipy import stats

import fastcoil as fc
from fastcoil.study.file import sample
from fastcoil.study.file.sample import DISTRIBUTIONS, METHODS, sample_values

SIZE = 4096
UNIFORM = {"backlash": {"uniform": [0.02, 0.15]}, "kp": {"uniform": [0.01, 0.05]}}


def draw(method="latin_hypercube", size=SIZE, seed=0, **shapes):
    """Values by name; of the two samples of a saltelli design the first."""
    drawn = sample_values({"method": method, "size": size, "seed": seed} | (shapes or UNIFORM))
    return {name: (v.sel(design="A") if "design" in v.dims else v).values for name, v in drawn.items()}


# Designs


def to_unit_interval(values, low=0.02, high=0.15):
    return (values - low) / (high - low)


def test_a_latin_hypercube_has_one_point_in_each_stratum_of_every_parameter():
    values = draw("latin_hypercube", 1000)
    for name, (low, high) in {"backlash": (0.02, 0.15), "kp": (0.01, 0.05)}.items():
        strata = np.floor(to_unit_interval(values[name], low, high) * 1000).astype(int)
        np.testing.assert_array_equal(np.sort(strata), np.arange(1000))


def test_a_sobol_design_is_a_net_that_a_latin_hypercube_is_not():
    def fullest_box(method):
        x, y = draw(method, 256).values()
        boxes = np.floor(to_unit_interval(x) * 16) * 16 + np.floor(to_unit_interval(y, 0.01, 0.05) * 16)
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
def test_values_are_the_same_however_many_are_drawn_at_a_time(method, monkeypatch):
    shapes = {
        "backlash": {"uniform": [0.02, 0.15]},
        "kp": {"lognormal": [0.02, 0.4]},
        "ti": {"truncnorm": [10.0, 3.0, 5.0, 30.0]},
        "estimate_ratio": {"choice": [0.0, 0.5, 0.9]},
    }
    whole = draw(method, 64, **shapes)
    monkeypatch.setattr(sample, "_VALUES_AT_ONCE", 7)
    for name, values in draw(method, 64, **shapes).items():
        np.testing.assert_array_equal(values, whole[name])


@pytest.mark.parametrize("method", METHODS)
def test_a_design_depends_on_its_seed_and_on_nothing_else(method):
    first, again, other_seed = (draw(method, 64, seed) for seed in (1, 1, 2))
    largest = draw(method, 64, 2**64 - 1)
    for name in UNIFORM:
        np.testing.assert_array_equal(first[name], again[name])
        assert not np.intersect1d(first[name], other_seed[name]).size
        assert not np.intersect1d(first[name], largest[name]).size
    assert abs(np.corrcoef(*first.values())[0, 1]) < 0.4, "parameters are drawn independently"


def test_random_is_the_generator_by_its_name():
    points = np.random.Generator(np.random.PCG64(5)).random((8, 2))
    drawn = draw("random", 8, 5, backlash={"uniform": [0.0, 0.5]}, buffer={"uniform": [0.0, 0.25]})
    np.testing.assert_allclose(drawn["backlash"], points[:, 0] / 2)
    np.testing.assert_allclose(drawn["buffer"], points[:, 1] / 4)


# Distributions: with one point in each of n strata, the k-th smallest value lies between the quantiles k/n and (k+1)/n


def normal_cdf(x):
    return 0.5 * (1.0 + math.erf(x / math.sqrt(2.0)))


def truncated_normal_cdf(x, mean, std, low, high):
    below, at, above = (normal_cdf((v - mean) / std) for v in (low, x, high))
    return (at - below) / (above - below)


def triangular_cdf(x, low, mode, high):
    if x < mode:
        return (x - low) ** 2 / ((high - low) * (mode - low))
    return 1.0 - (high - x) ** 2 / ((high - low) * (high - mode))


def beta_cdf(x):
    """The regularised incomplete beta function with a = 2, b = 3."""
    return 6.0 * x**2 - 8.0 * x**3 + 3.0 * x**4


LOGS = math.log(0.02 / 0.05), math.log(0.1 / 0.05)
SHARES = {
    "uniform": ([0.02, 0.15], lambda x: (x - 0.02) / 0.13),
    "loguniform": ([0.005, 0.05], lambda x: math.log10(x / 0.005)),
    "truncnorm": ([0.05, 0.02, 0.0, 0.1], lambda x: truncated_normal_cdf(x, 0.05, 0.02, 0.0, 0.1)),
    "triangular": ([0.2, 0.5, 0.8], lambda x: triangular_cdf(x, 0.2, 0.5, 0.8)),
    "normal": ([0.05, 0.02, 0.0, 0.1], lambda x: truncated_normal_cdf(x, 0.05, 0.02, 0.0, 0.1)),
    "lognormal": ([0.05, 0.5, 0.02, 0.1], lambda x: truncated_normal_cdf(math.log(x / 0.05), 0.0, 0.5, *LOGS)),
    "beta": ([2.0, 3.0, 0.1, 0.6], lambda x: beta_cdf((x - 0.1) / 0.5)),
}
LOPSIDED = {
    "triangular": ([0.2, 0.2, 0.8], lambda x: triangular_cdf(x, 0.2, 0.2, 0.8)),
    "truncnorm": ([0.5, 0.1, 0.0, 0.3], lambda x: truncated_normal_cdf(x, 0.5, 0.1, 0.0, 0.3)),
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
    from fastcoil.study.file import sample

    monkeypatch.setattr(sample, "_design_points", lambda _method, size, dims, *_: np.full((size, dims), share))
    arguments = SHARES[kind][0]
    (value,) = draw(size=1, kp={kind: arguments})["kp"]
    end = arguments[-1] if share else arguments[-2] if len(arguments) == 4 else arguments[0]
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


# Cut at the bounds of the parameter, measured, fitted


def test_quantiles_are_those_of_scipy(monkeypatch):
    from fastcoil.study.file import sample

    share = np.linspace(0.001, 0.999, 999)
    monkeypatch.setattr(sample, "_design_points", lambda *_: share[:, np.newaxis])
    for shape, theirs in (
        ({"lognormal": [0.02, 0.4]}, stats.lognorm(0.4, scale=0.02)),
        ({"normal": [0.02, 0.4]}, stats.norm(0.02, 0.4)),
        ({"normal": [0.02, 0.4, 0.0, 1.0]}, stats.truncnorm(-0.05, 2.45, 0.02, 0.4)),
        ({"beta": [0.7, 3, -1, 1]}, stats.beta(0.7, 3, -1.0, 2.0)),
    ):
        np.testing.assert_allclose(draw(size=999, kp=shape)["kp"], theirs.ppf(share), rtol=1e-12)


@pytest.mark.parametrize("kind", ["normal", "lognormal"])
def test_without_ends_a_distribution_is_cut_at_the_bounds_of_its_parameter(kind):
    drawn = draw(backlash={kind: [0.5, 0.8]}, kp=UNIFORM["kp"])
    assert drawn["backlash"].min() > 0.0
    assert drawn["backlash"].max() < 0.9
    np.testing.assert_array_equal(
        drawn["backlash"], draw(backlash={kind: [0.5, 0.8, 0.0, 0.9]}, kp=UNIFORM["kp"])["backlash"]
    )


@pytest.fixture
def gaps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("gaps.csv").write_text("valve,gap [%],stroke [min]\na,7,1.5\nb,2,2\nc,5,1\nd,2,3\n")


def test_measured_values_are_drawn_as_often_as_they_were_measured_in_the_unit_of_their_header(gaps):
    of = {
        "backlash": {"csv": "gaps.csv", "column": "gap"},
        "stroke_time": {"csv": "gaps.csv", "column": "stroke [min]"},
    }
    drawn = draw("sobol", 64, **of)
    counts = dict(zip(*np.unique(drawn["backlash"], return_counts=True), strict=True))
    assert counts == {0.02: 32, 0.05: 16, 0.07: 16}
    assert set(drawn["stroke_time"]) == {60.0, 90.0, 120.0, 180.0}


# Correlations

RANKS = [["kp", "ti", 0.6], ["ti", "backlash", -0.4]]
SHAPES = {"kp": {"lognormal": [0.02, 0.5]}, "noise_std": {"uniform": [0.0, 0.1]}, "ti": {"beta": [2, 5, 10, 300]},
          "backlash": {"normal": [0.05, 0.02]}}  # fmt: skip


@pytest.mark.parametrize("method", ["sobol", "random", "latin_hypercube"])
def test_ranks_correlate_as_asked_and_marginals_stay(method):
    alone, together = (draw(method, **SHAPES, **options) for options in ({}, {"correlation": RANKS}))
    expected = {frozenset(("kp", "ti")): 0.6, frozenset(("ti", "backlash")): -0.4}
    for a, b in itertools.combinations(SHAPES, 2):
        rho = stats.spearmanr(together[a], together[b]).statistic
        assert rho == pytest.approx(expected.get(frozenset((a, b)), 0.0), abs=4.0 / math.sqrt(SIZE)), (a, b)
    for name in ("kp", "noise_std"):  # the first of a pair, and one in none
        np.testing.assert_array_equal(alone[name], together[name])
    for name in SHAPES:
        assert stats.ks_2samp(alone[name], together[name]).pvalue > 1e-3


def test_another_distribution_changes_no_other_parameter():
    for options in ({}, {"correlation": [["kp", "backlash", 0.3]]}):
        before = draw("sobol", **SHAPES, **options)
        after = draw("sobol", **SHAPES | {"noise_std": {"beta": [2, 2, 0, 1]}}, **options)
        for name in ("kp", "ti", "backlash"):
            np.testing.assert_array_equal(before[name], after[name])


def test_a_correlated_design_is_the_beginning_of_a_larger_one():
    small, large = (draw("sobol", size, **SHAPES, correlation=RANKS) for size in (64, 1024))
    for name in SHAPES:
        np.testing.assert_array_equal(small[name], large[name][:64])


# Batches


@pytest.mark.parametrize("method", ["sobol", "random", "latin_hypercube"])
def test_batches_are_independent_designs_of_which_the_first_is_that_of_a_single_one(method):
    table = {"method": method, "size": 64, "seed": 3} | UNIFORM
    one_batch, three_batches, five_batches = (sample_values(table, batches=n)["kp"].values for n in (1, 3, 5))
    np.testing.assert_array_equal(one_batch, three_batches[:64])
    np.testing.assert_array_equal(three_batches, five_batches[:192])
    assert len(set(five_batches)) == 5 * 64


EXISTING = {
    "latin_hypercube": "c0e97ea27e9baac9e960",
    "sobol": "fee984108976a089e0b4",
    "random": "58ed876a55bc013346e4",
    "saltelli": "91b75e2b0d3bd5a4cace",
}


@pytest.mark.parametrize("method", METHODS)
def test_draws_are_those_of_earlier_versions(method):
    shapes = {
        "backlash": {"uniform": [0.02, 0.15]}, "kp": {"loguniform": [0.005, 0.05]}, "ti": {"triangular": [5, 20, 300]},
        "noise_std": {"truncnorm": [0.05, 0.02, 0, 0.1]}, "sample_time": {"choice": [5, 10, 30]},
        "action": {"choice": ["cooling", "heating"]},
    }  # fmt: skip
    digest = hashlib.sha256()
    for name, values in sample_values({"method": method, "size": 64, "seed": 7} | shapes).items():
        # to 9 digits: the logarithm of another processor differs in the last of 16
        texts = [str(v) if isinstance(v, str) else f"{v:.9g}" for v in values.values.ravel().tolist()]
        digest.update(f"{name} {values.dims} {texts}".encode())
    assert digest.hexdigest()[:20] == EXISTING[method]


def test_python_draws_as_a_study_file_does():
    drawn = fc.sample(64, kp=SHAPES["kp"], ti=SHAPES["ti"], correlation=[("kp", "ti", 0.6)])
    for name, values in draw("sobol", 64, kp=SHAPES["kp"], ti=SHAPES["ti"], correlation=[["kp", "ti", 0.6]]).items():
        np.testing.assert_array_equal(drawn[name], values)
    assert fc.Loop().assign(**drawn).sizes == {"sample": 64}


def test_per_cent_that_are_fractions_and_words_in_a_table_are_refused(tmp_path):
    def draw(header, *cells):
        path = tmp_path / "gaps.csv"
        path.write_text("\n".join([f"valve,{header}", *(f"V{k},{cell}" for k, cell in enumerate(cells))]) + "\n")
        return fc.sample(4, backlash={"csv": str(path), "column": "gap"})

    for header in ("gap [%]", "gap (percent)", "gap_pct"):
        assert_refused("backlash", "unit", draw, header, *np.linspace(0.04, 0.12, 12))
        np.testing.assert_allclose(np.sort(draw(header, 4, 5, 6, 7)["backlash"]), [0.04, 0.05, 0.06, 0.07])
    np.testing.assert_allclose(draw("gap [1]", 0.004, 0.004)["backlash"], 0.004)
    for word in ("n/a", "broken"):
        assert_refused("backlash", "value", draw, "gap [%]", 4, 5, 6, word, *range(4, 20))
