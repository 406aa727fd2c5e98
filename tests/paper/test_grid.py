"""The grid of tunings: its size, its presets, its long days; the same for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.paper import grid, runs
from fastcoil.simulation.presets import PRESETS
from fastcoil.simulation.stability import stable

pytestmark = pytest.mark.kernel


def test_results_do_not_depend_on_the_number_of_threads():
    loop = grid.tunings(quick=True)
    one, two = (grid.quiet(loop, n_jobs).attrs["content_sha256"] for n_jobs in (1, 2))
    assert one == two


def test_the_grid_has_at_least_500_tunings_and_the_presets_by_name():
    loop = grid.tunings()
    assert loop.sizes["tuning"] >= 500
    assert grid.named(loop["kp"]["tuning"]) == list(PRESETS)
    lbnl = loop["stroke_time"].sel(tuning="lbnl")
    assert float(lbnl) == fc.Loop.preset("lbnl")["stroke_time"]
    for start, step in grid.STARTS_AND_STEPS:
        updates = np.ceil((runs.BACKLASH - start) / step) + 2
        assert updates * runs.INTERVAL < grid.LONG_HOURS * 3600


def test_stable_says_what_a_simulation_refuses(short):
    loop = fc.Loop(n_volumes=[8, 9])
    assert stable(loop, short).values.tolist() == [True, False]
    with pytest.raises(fc.InputError, match="unstable"):
        fc.simulate(loop, short, warm_up=0)
