"""Arrays cut into pieces."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fastcoil.loops.netcdf import pieces_of


@given(st.lists(st.integers(1, 6), max_size=4), st.integers(1, 40))
def test_pieces_are_all_values_in_their_order_and_none_is_too_large(shape, most):
    values = np.arange(np.prod(shape, dtype=int)).reshape(shape)
    pieces = [values[piece] for piece in pieces_of(tuple(shape), most)]
    assert max(piece.size for piece in pieces) <= most
    assert all(piece.ndim == len(shape) for piece in pieces)
    assert np.concatenate([piece.ravel() for piece in pieces]).tolist() == values.ravel().tolist()
    assert len(pieces) <= values.size // most * 2 ** len(shape) + 1 or most == 1
