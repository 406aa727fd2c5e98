"""``fastcoil explore``: from a slider that moves to the page that shows what follows."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import Timed
from helpers.browsers import chromium, explore_page, wait_for_page, why_no_browser
from suite import QUICK

from fastcoil.deliver.explore.loop import Model, Settings, initial_settings

GAPS = 31  # steps of the slider
NOISES = 11
ROUNDS = 3 if QUICK else 60
STAGES = ("curves", "explanation", "map")
MOVE = """
const [name, at, done] = arguments
const before = document.body.dataset.turn, start = performance.now(), painted = [null, null, null]
const then = act => requestAnimationFrame(() => requestAnimationFrame(act))
const watch = new MutationObserver(() => {
  const there = ['words', 'map', ''].indexOf(document.body.dataset.phase)
  if (there === 2 && document.body.dataset.turn === before) return
  for (let k = 0; k <= there; k++) {
    if (painted[k] !== null) continue
    painted[k] = 0
    then(() => { painted[k] = performance.now() - start })
  }
  if (there < 2) return
  watch.disconnect()
  then(() => requestAnimationFrame(() => done(painted)))
})
watch.observe(document.body, {attributes: true})
const slider = Bokeh.documents[0].get_model_by_name(name)
slider.value = slider.categories[at]
"""
"""JavaScript: move a slider; milliseconds until each of ``STAGES`` is painted."""


@pytest.mark.parametrize("stage", ["loop", "explanation", "map", "all"])
def test_server(timed: Timed, stage: str) -> None:
    """All that a move makes new, on one thread."""
    model = Model()
    usual = initial_settings(model.first, model.starts[model.first])
    gaps = itertools.count(1)

    def another() -> tuple[tuple[object, ...], dict[str, object]]:
        return (replace(usual, backlash=0.0001 * next(gaps), noise_std=0.01),), {}

    def everything(settings: Settings) -> tuple[object, ...]:
        return model.run(settings), model.explain(settings), model.map(replace(settings, kp=0.02))

    computations: dict[str, Callable[..., object]] = {
        "loop": model.run, "explanation": model.explain, "map": model.map, "all": everything,
    }  # fmt: skip
    assert timed(computations[stage], 20, setup=another)


@pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
def test_browser(timed: Timed, benchmark: Any) -> None:
    """The same in Chromium, with the server, the wire and the painting; never a loop that was shown before."""
    moves = itertools.product(range(1, NOISES), range(GAPS))
    painted_after: list[list[float]] = []
    with explore_page() as (_, address), chromium(1920, 1080) as driver:
        driver.get(address)
        wait_for_page(driver)

        def move() -> None:
            noise, gap = next(moves)
            if gap == 0:
                driver.execute_async_script(MOVE, "noise_std", noise)
            painted_after.append(driver.execute_async_script(MOVE, "backlash", (7 * gap) % GAPS))

        timed(move, ROUNDS)
    for stage, seconds in zip(STAGES, np.array(painted_after, dtype=float).T / 1000.0, strict=True):
        benchmark.extra_info[stage] = {"median": float(np.median(seconds)), "95 %": float(np.quantile(seconds, 0.95))}
