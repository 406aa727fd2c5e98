"""The size of a study from its tables alone: one that does not fit is refused before any of its values is made."""

from __future__ import annotations

import math

from fastcoil.loops.plan import check_memory
from fastcoil.model.metric_table import METRICS
from fastcoil.study.file.loop import axis_size
from fastcoil.study.file.sampling import design_size
from fastcoil.study.file.tables import StudyFile

_BYTES_PER_SCENARIO = 3 * 8 * (len(METRICS) + 1)
"""Metrics and status: the result, its image on the way to disk, a copy while it is put together."""

_MOST_OF_ANY = 2**32


def require_room(file: StudyFile) -> None:
    """Refuse a study of more scenarios than this machine can hold the metrics of.

    Tables that are wrong in another way count as 1, for whoever reads them to refuse.

    Raises
    ------
    InputError
        With the number of scenarios, what they need and what there is.
    """
    days = next((file.boundary[key] for key in ("seed", "days") if isinstance(file.boundary.get(key), list)), [0])
    sizes = [
        *map(axis_size, file.sweep.values()),
        *map(len, file.cases.values()),
        design_size(file.sample or {}),
        len(days),
        file.run.replicates,
    ]
    # each of them has a bound of its own, which is checked elsewhere
    n_scenarios = math.prod(min(max(1, size), _MOST_OF_ANY) for size in sizes)
    check_memory(n_scenarios * _BYTES_PER_SCENARIO, n_scenarios)
