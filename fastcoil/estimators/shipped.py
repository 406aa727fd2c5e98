"""The estimators that come with the package, in the order of the choices of the parameter ``estimator``."""

from __future__ import annotations

from fastcoil.estimators.family import Estimator
from fastcoil.estimators.gradient import GRADIENT
from fastcoil.estimators.hagglund import HAGGLUND
from fastcoil.estimators.identify import IDENTIFY
from fastcoil.estimators.learner import LEARNER
from fastcoil.parameter_table import PARAMETERS

_KNOWN = (LEARNER, HAGGLUND, GRADIENT, IDENTIFY)
ESTIMATORS: tuple[Estimator | None, ...] = tuple(
    next((e for e in _KNOWN if e.name == name), None) for name in PARAMETERS["estimator"].choices
)
"""By number of the choice; ``None`` for the choice none."""
