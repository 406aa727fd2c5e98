"""Stories to begin with: settings that show one thing each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fastcoil.deliver.explore.model.settings import Settings, Value, settings_of
from fastcoil.deliver.explore.model.start import Start

ON = "paper_like"
"""The loop that the stories are told of."""


class Story(NamedTuple):
    """A story: what its button says, and what differs from ``ON``."""

    title: str
    values: Mapping[str, Value]


STORIES = (
    Story("A good valve", {"backlash": 0.0}),
    Story("7 % gap, plain PI", {}),
    Story("With the inverse", {"backlash_estimate": 0.065}),
    Story("Estimate too large", {"backlash_estimate": 0.1, "window": "half"}),
    Story("Learning", {"estimator": "identify", "window": "day"}),
    Story("Slower instead", {"ti": 40.0}),
)


def told(story: Story, starts: Mapping[str, Start]) -> Settings:
    """The settings of a story."""
    return settings_of(ON, starts[ON]).turned(**story.values)
