"""``fastcoil parameters`` and ``presets``."""

import pytest
from click.testing import CliRunner

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.model.parameter_table import PARAMETERS


@pytest.fixture
def fastcoil():
    return lambda *words: CliRunner().invoke(main, words)


def test_parameters_lists_every_one_with_unit_and_bounds(fastcoil):
    output = fastcoil("parameters").output
    for name in PARAMETERS:
        assert name in output
    assert "did you mean 'kp'" in fastcoil("parameters", "kpp").output


def test_presets_are_listed_as_in_python(fastcoil):
    assert fastcoil("presets").output == f"{fc.presets()!r}\n"
