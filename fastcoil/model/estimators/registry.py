"""Estimators of the package by number: a file for each, with an ``ESTIMATOR``, and a word among the choices."""

from importlib import import_module

from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.parameter_table import PARAMETERS

ESTIMATORS: tuple[Estimator | None, ...] = tuple(
    None if name == "none" else import_module(f"fastcoil.model.estimators.{name}").ESTIMATOR
    for name in PARAMETERS["estimator"].choices
)
"""By number of the choice; ``None`` for the choice none."""
