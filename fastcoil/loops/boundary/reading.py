"""What a user gives for a boundary, checked as a whole: series, labels and clock."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fastcoil.base.errors import InputError, collecting
from fastcoil.loops.boundary.air_flow import enabled_by, warn_of_stops
from fastcoil.loops.boundary.clock import Clock, clock_of
from fastcoil.loops.boundary.rearranged import Parts
from fastcoil.loops.boundary.series import (
    BOUNDARY_SERIES,
    Given,
    Values,
    carried_labels,
    common_size,
    label_array,
    read,
    value_problems,
)
from fastcoil.loops.boundary.source import Held


def checked(series: Mapping[str, Values], day: Values, start: Values, time_zone: Values) -> Parts:
    """Samples and clock of a boundary; arguments as of `fastcoil.Boundary`, all series by name, None if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    problems: list[str] = []
    given: dict[str, Given] = {}
    for name, one in BOUNDARY_SERIES.items():
        with collecting(problems):
            given[name] = read(one, series[name])
    n_steps = common_size("elapsed_time", "samples", given, problems)
    n_days = common_size("day", "days", given, problems)
    if n_steps is None and not problems:
        problems.append("every series is a number: give at least one as 1-s samples, or use constant_day")
    labels = carried_labels(given, problems) if day is None else label_array(day, problems)
    if labels is None:
        labels = np.arange(n_days) if n_days else np.asarray(0)
    elif n_days is not None and labels.size != n_days:
        problems.append(f"day has {labels.size} labels for {n_days} days: give one label for each day")
    for name, values in given.items():
        problems += value_problems(BOUNDARY_SERIES[name], values, labels)
    shape, clock = (labels.size, n_steps or 0), Clock()
    with collecting(problems):
        clock = clock_of(start, time_zone, *shape)
    if problems:
        # Series that share a coordinate share its mistakes.
        raise InputError(list(dict.fromkeys(problems)))
    whole = {name: values.spread(*shape) for name, values in given.items()}
    by_air = series["enabled"] is None
    if by_air:
        whole["enabled"], stopped = enabled_by(whole["m_a"])
        warn_of_stops(stopped, stacklevel=4)
    return Parts(Held(whole, np.atleast_1d(labels).astype(np.int64), bool(n_days or labels.ndim)), clock, by_air)
