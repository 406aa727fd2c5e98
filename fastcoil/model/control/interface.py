"""What a control law of the user's own is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Law:
    """A rule that decides the opening u that the controller asks for, in place of the PI.

    name: the word in ``law = …``.
    Parameters, Memory: named tuples of floats, as of an estimator.
    step: (Sample, Parameters, Memory) → (u, Memory), called at every controller sample.
    identity: all that decides what it does, in words.
    """

    name: str
    Parameters: Any
    Memory: Any
    step: Any
    identity: str
