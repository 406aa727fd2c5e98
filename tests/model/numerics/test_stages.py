"""Stages: compiled apart, called by address, loaded from the cache; named tuples read from rows and stored."""

from typing import NamedTuple

import numpy as np
import pytest

from fastcoil.model.numerics.jit import JIT_ENABLED, kernel
from fastcoil.model.numerics.stages import FLAG, INTEGER, NUMBER, ROW_POINTER, StageSignature, store_if_due, values_at

SCALE_SIGNATURE = StageSignature(S=ROW_POINTER, factor=NUMBER, twice=FLAG, returns=INTEGER)
call_scale = SCALE_SIGNATURE.call


class Pair(NamedTuple):
    a: float
    b: float


def scale_stage(power):
    """A stage that scales the first 4 numbers, and returns how many."""

    def scale(S, factor, twice):
        for j in range(4):
            S[j] *= factor**power * (2.0 if twice else 1.0)
        return 4

    return SCALE_SIGNATURE.compile(scale, f"power {power}")


@kernel
def call_at_address(address, S):
    return call_scale(address, (S, 3, True))


@pytest.mark.kernel
def test_stages_of_one_kind_run_in_one_kernel_by_their_addresses():
    for power in (1, 2):
        S = np.ones(5)
        assert call_at_address(scale_stage(power), S) == 4
        np.testing.assert_array_equal(S, [2.0 * 3.0**power] * 4 + [1.0])
    assert not JIT_ENABLED or len(call_at_address.signatures) == 1


@pytest.mark.kernel
@pytest.mark.skipif(not JIT_ENABLED, reason="nothing is compiled")
def test_closures_that_differ_do_not_meet_in_the_cache():
    """The same code from the same line: only the identity differs, in this process and in the next."""
    first, second = scale_stage(3), scale_stage(4)
    for address, factor in ((first, 27.0), (second, 81.0), (scale_stage(3), 27.0)):
        S = np.ones(5)
        call_at_address(address, S)
        assert S[0] == 2.0 * factor


def test_a_stage_has_the_arguments_of_its_signature():
    with pytest.raises(AssertionError):
        SCALE_SIGNATURE.compile(lambda S, twice, factor: 4, "other order")


SWAP_SIGNATURE = StageSignature(S=ROW_POINTER, due=FLAG, returns=NUMBER)
call_swap = SWAP_SIGNATURE.call


def swap(S, due):
    pair = values_at(Pair, S, 1, 2)
    store_if_due(due, Pair(pair.b, 7), pair, S, 1, 2)
    return pair.a


@kernel
def swap_at_address(address, S, due):
    return call_swap(address, (S, due))


@pytest.mark.kernel
@pytest.mark.parametrize("due", [True, False])
def test_values_are_read_and_kept_at_a_stride_where_due(due):
    S = np.arange(5.0)
    assert swap_at_address(SWAP_SIGNATURE.compile(swap, "swap"), S, due) == 1.0
    np.testing.assert_array_equal(S, [0.0, 3.0, 2.0, 7.0, 4.0] if due else np.arange(5.0))
