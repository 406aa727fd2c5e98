"""Settings in the environment that would make a library fail as it is loaded: refused in a sentence before."""

from __future__ import annotations

import os

from fastcoil.base.errors import InputError, shown

_RANGES = {"NUMBA_NUM_THREADS": (1, 2**16), "SOURCE_DATE_EPOCH": (0, 253_402_300_799)}
"""Least and largest of whole numbers that Numba and matplotlib read; the last is the end of the year 9999."""


def check_environment() -> None:
    """Refuse settings that no library takes.

    Raises
    ------
    InputError
        If there is one.
    """
    problems = []
    for name, (least, most) in _RANGES.items():
        value = os.environ.get(name, "")
        try:
            usable = not value or least <= int(value) <= most
        except ValueError:
            usable = False
        if not usable:
            problems.append(
                f"{name} = {shown(value)} in the environment: unset it, or give a whole number from {least} to {most}"
            )
    if problems:
        raise InputError(problems)
