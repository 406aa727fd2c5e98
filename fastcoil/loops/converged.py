"""The word ``converged``: how the coil is marched where the numbers should be those of its equations.

Which march and how many substeps: ``studies/convergence.py``, docs/numerics.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastcoil.base.arguments import flag_of
from fastcoil.base.errors import InputError

WORD = "converged"
CONVERGED: Mapping[str, Any] = {"air_march": "quasistatic", "substeps": 8}
"""What it stands for."""
MEANING = " and ".join(f"{name} = {value!r}" for name, value in CONVERGED.items())


def expanded(changes: Mapping[str, Any]) -> dict[str, Any]:
    """The changes of a loop with the parameters that ``converged`` stands for; False changes nothing.

    Raises
    ------
    InputError
        Unless it is True or False, or with those parameters beside it.
    """
    rest = {name: value for name, value in changes.items() if name != WORD}
    if WORD not in changes or not flag_of(WORD, changes[WORD]):
        return rest
    given = [name for name in CONVERGED if name in rest]
    if given:
        raise InputError(f"converged stands for {MEANING}: leave it out, or leave out {' and '.join(given)}")
    return rest | dict(CONVERGED)
