"""Estimators of the package by number: each has a file of its name here, and a word among the choices.

Another one needs a file with an ``ESTIMATOR`` and its word in the parameter ``estimator``; its parameters, if it has
any, are rows of the same table.  Blocks, checks, replay and export of a controller find it by that word.
"""

from importlib import import_module

from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.parameter_table import PARAMETERS

ESTIMATORS: tuple[Estimator | None, ...] = tuple(
    None if name == "none" else import_module(f"fastcoil.model.estimators.{name}").ESTIMATOR
    for name in PARAMETERS["estimator"].choices
)
"""By number of the choice; ``None`` for the choice none."""
