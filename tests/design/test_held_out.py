"""Who is held out: other valves and other days, always, and good valves on both sides."""

import itertools

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.design.tuning_plan import draw_held_out, select_valves, split_population

DAYS = fc.paper_day(hours=0.1, seed=[1, 2, 3, 4])


def population_with_backlash(values):
    return fc.Loop(backlash=("sample", np.asarray(values, float)))


@pytest.mark.parametrize("n", [3, 7, 30])
def test_valves_are_on_one_side_only_and_none_is_lost(n):
    x = np.random.default_rng(n).random(n) * 0.15
    training, held = split_population(population_with_backlash(x), DAYS, None, 0)
    assert not set(training.members) & set(held.members)
    assert sorted(training.members + held.members) == list(range(n))
    assert len(held.members) == n // 3
    for group in (training, held):
        assert np.array_equal(group.loop["backlash"], x[list(group.members)])


def test_one_of_every_three_valves_in_the_order_of_their_backlash_is_held_out():
    x = np.random.default_rng(0).random(31)
    held = draw_held_out(x, 5)
    assert sorted(np.argsort(np.argsort(x))[held] // 3) == list(range(10))
    assert not np.array_equal(held, draw_held_out(x, 6)), "drawn"
    assert np.array_equal(held, draw_held_out(x, 5)), "by the seed"


def test_a_population_of_several_dims_keeps_what_belongs_together():
    coils = {"C_c": ("coil", [10.0, 20.0]), "C_w": ("coil", [8.0, 9.0])}
    loop = fc.Loop(backlash=[0.0, 0.05, 0.1], air_march=["lagged", "quasistatic"], **coils)
    training, held = split_population(loop, DAYS, None, 1)
    valves = set()
    for group in (training, held):
        columns = (np.asarray(group.loop[n]).tolist() for n in ("backlash", "C_c", "C_w", "air_march"))
        valves |= set(zip(*columns, strict=True))
        assert group.loop.sizes == {"sample": len(group.members)}
    combinations = itertools.product((0.0, 0.05, 0.1), ((10.0, 8.0), (20.0, 9.0)), ("lagged", "quasistatic"))
    assert valves == {(x, *coil, march) for x, coil, march in combinations}
    assert select_valves(fc.Loop(), np.array([0])) == fc.Loop()


def test_the_last_third_of_the_days_is_held_out_or_those_that_are_asked_for():
    def labels(holdout):
        return [group.boundary.day.tolist() for group in split_population(fc.Loop(), DAYS, holdout, 0)]

    assert (labels(None), labels([2, 1])) == ([[1, 2, 3], [4]], [[3, 4], [1, 2]])
    assert labels(fc.paper_day(hours=0.1, seed=[8])) == [[1, 2, 3, 4], [8]]


def test_one_or_two_valves_are_tried_on_other_days_only():
    training, held = split_population(population_with_backlash([0.05, 0.1]), DAYS, None, 0)
    assert training.members == held.members == (0, 1)
    assert set(training.boundary.day) & set(held.boundary.day) == set()


@pytest.mark.parametrize(
    ("holdout", "code"),
    [
        ([5], "name"), ([], "name"), ("tomorrow", "name"), ([1, 2, 3, 4], "missing"),
        (fc.paper_day(hours=0.2, seed=[9]), "shape"), (fc.paper_day(hours=0.1, seed=[9, 3]), "duplicate"),
    ],
)  # fmt: skip
def test_days_that_hold_nothing_out_are_refused(holdout, code):
    assert_refused("holdout", code, split_population, fc.Loop(), DAYS, holdout, 0)
