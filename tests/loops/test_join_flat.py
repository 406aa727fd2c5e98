"""Parts joined into one result: all of the same form."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.loops.dataset import join_flat
from fastcoil.model.metric_table import STATUS_CRASHED

FORMS = {
    "the type": "np.array([1, 2]) if first else np.array([1.5, 2.5])",
    "the labels": "xr.DataArray(np.ones((2, 2)), {'bin': [0, 1] if first else [5, 6]}, ['scenario', 'bin'])",
    "the dim": "xr.DataArray(np.ones((2, 2)), dims=['scenario', 'a' if first else 'b'])",
    "the shape": "xr.DataArray(np.ones((2, 2 if first else 3)), dims=['scenario', 'bin'])",
}


def flat(score, start, status=0):
    score = score if isinstance(score, xr.DataArray) else ("scenario", score)
    index = np.arange(start, start + 2)
    variables = {"rmse": ("scenario", np.ones(2)), "status": ("scenario", np.full(2, status, dtype=np.int8))}
    return xr.Dataset(variables | {"score": score}, coords={"scenario": index})


@pytest.mark.parametrize("source", FORMS.values(), ids=FORMS)
def test_answers_of_another_form_for_other_scenarios_are_refused(source):
    first, second = (eval(source, {"np": np, "xr": xr, "first": first}) for first in (True, False))
    with pytest.raises(InputError, match="the reduction gives score as .* for some scenarios"):
        join_flat(4, [flat(first, 0), flat(second, 2)])
    joined = join_flat(4, [flat(first, 0), flat(first, 2)])
    assert joined["score"].dtype == flat(first, 0)["score"].dtype


def test_scenarios_that_crashed_need_no_answer():
    answered = flat(np.array([1, 2]), 2)
    crashed = flat(np.array([1, 2]), 0, STATUS_CRASHED).drop_vars("score")
    for parts in ([crashed, answered], [answered, crashed]):
        assert join_flat(4, parts)["score"].values.tolist() == [0, 0, 1, 2]


def test_an_answer_that_some_scenarios_lack_is_refused():
    with pytest.raises(InputError, match="score as nothing|score as .* nothing"):
        join_flat(4, [flat(np.array([1, 2]), 0), flat(np.array([1, 2]), 2).drop_vars("score")])
