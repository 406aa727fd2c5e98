"""``fastcoil parameters`` and ``presets``."""

from helpers.commands import fastcoil

import fastcoil as fc
from fastcoil.model.parameter_table import PARAMETERS


def test_parameters_lists_every_one_with_unit_and_bounds():
    output = fastcoil("parameters").output
    for name in PARAMETERS:
        assert name in output
    assert "did you mean 'kp'" in fastcoil("parameters", "kpp").output


def test_presets_are_listed_as_in_python():
    assert fastcoil("presets").output == f"{fc.presets()!r}\n"
