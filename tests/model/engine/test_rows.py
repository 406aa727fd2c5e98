"""The rows of a block's state: groups that neither overlap nor leave a gap, and who may read what."""

import ast
import inspect
from itertools import pairwise

import numba
import numpy as np
import pytest

from fastcoil.model.engine import controller, recorded, rows
from fastcoil.model.engine.lanes import default_block, work_space
from fastcoil.model.engine.rows import LANES, ROWS, SUM_ROWS, R
from fastcoil.model.numerics.jit import FLAGS

GROUPS = (rows.PARAMETER_ROWS, rows.DERIVED_ROWS, rows.STATE_ROWS, rows.SUM_ROWS)


def test_groups_follow_one_another_and_name_every_row_once():
    names = [name for group in GROUPS for name in group]
    assert list(ROWS) == names
    assert len(set(names)) == len(names)
    assert {after - before for before, after in pairwise(getattr(R, name) for name in names)} == {LANES}
    assert rows.SUMS_START == getattr(R, rows.SUM_ROWS[0])
    assert getattr(R, rows.STATE_ROWS[0]) == rows.STATE_START


@pytest.mark.kernel
@pytest.mark.full
def test_each_group_is_filled_by_its_own_function_alone():
    """So that a later day can start with new sums from the state of the day before."""
    block = default_block()
    edges = [0, rows.STATE_START, rows.SUMS_START, len(ROWS) * LANES]
    sections = (rows.derive_rows, rows.set_initial_state, rows.reset_sums)
    derive, set_initial_state, reset_sums = (numba.njit(**FLAGS)(section.py_func) for section in sections)
    fill = (
        lambda S: derive(S, block.rows, block.config.n_volumes),
        lambda S: set_initial_state(S, False),
        lambda S: reset_sums(S, False),
    )
    S, *_ = work_space(block)
    S[:] = -7.0
    for k, (start, end) in enumerate(pairwise(edges)):
        before = S[:start].copy()
        fill[k](S)
        assert not np.any(S[start:end] == -7.0)
        assert np.all(S[end:] == -7.0)
        np.testing.assert_array_equal(S[:start], before)


@pytest.mark.parametrize("part", [controller, recorded.replay_controllers], ids=["control", "replay"])
def test_the_controller_knows_no_true_backlash_and_reads_no_sum(part):
    tree = ast.parse(inspect.getsource(getattr(part, "py_func", part)))
    used_rows = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "R"}
    assert not used_rows & {"backlash", "worn_backlash", "gap", "backlash_scale"}
    assert used_rows & set(SUM_ROWS) <= {"sum_switches"}
