"""The estimators that come with the package, in the order of the choices of the parameter ``estimator``."""

from __future__ import annotations

from fastcoil.model.estimators.gradient import GRADIENT
from fastcoil.model.estimators.hagglund import HAGGLUND
from fastcoil.model.estimators.identify import IDENTIFY
from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.estimators.learner import LEARNER
from fastcoil.model.parameter_table import PARAMETERS

_KNOWN = (LEARNER, HAGGLUND, GRADIENT, IDENTIFY)
ESTIMATORS: tuple[Estimator | None, ...] = tuple(
    next((e for e in _KNOWN if e.name == name), None) for name in PARAMETERS["estimator"].choices
)
"""By number of the choice; ``None`` for the choice none."""
