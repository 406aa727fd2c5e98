"""The figures of the learning study: texts that fit, colours of the palette, whatever the numbers."""

import numpy as np
import pytest
import xarray as xr
from helpers.figure_looks import assert_palette, assert_texts_fit

from studies.learning import maps

TUNINGS = ["paper_like", "paper_like_fast", "lbnl", "g36"]
SMALL_PRINT = "Of all steps, intervals, ratios and buffers the best, over as many learners as there are. " * 3


def make_judgement(**dims):
    """Made-up shares of failures and hours over these dims; some never confirm."""
    rng = np.random.default_rng(1)
    shape = tuple(len(labels) for labels in dims.values())
    low, high = rng.random((2, *shape)) / 2
    values = {"low": low, "high": high, "failed": low + high, "error": rng.random(shape)}
    values["confirmed"] = np.where(rng.random(shape) < 0.2, np.inf, 16 * rng.random(shape))
    return xr.Dataset({name: (tuple(dims), value) for name, value in values.items()}, coords=dims)


@pytest.mark.full
def test_the_figures_fit():
    settings = make_judgement(
        rule=list(maps.RULE_LINES), tuning=TUNINGS, learning_step=[0.0035, 0.028],
        learning_interval=[600, 1800], learning_ratio=[1.25, 2.0],
    )  # fmt: skip
    judgement = settings.expand_dims(noise_std=[0.0, 0.05])
    figure = maps.draw_front(judgement, "failed", "failures [% of learners]", 100.0, 16, SMALL_PRINT)
    assert_palette(figure)
    assert_texts_fit(figure)
    assert_texts_fit(maps.draw_settings(settings, ("literal", "growing"), 16, 0.05, SMALL_PRINT))
    judgement = make_judgement(
        rule=["literal", "growing"], buffer=[1e-9, 0.01], tuning=TUNINGS[:2], noise_std=[0.0, 0.1], sample_time=[1, 30]
    )
    assert_texts_fit(maps.draw_failure_map(judgement, 0.05, SMALL_PRINT))
