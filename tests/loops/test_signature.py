"""What completion and help show of ``Loop``: every parameter, from the parameter table."""

import inspect

import pytest

import fastcoil as fc
from fastcoil.loops.keywords import UNCHANGED
from fastcoil.model.parameter_table import PARAMETERS


def test_a_loop_shows_every_parameter_as_a_keyword_with_its_default():
    shown = inspect.signature(fc.Loop).parameters
    assert list(shown) == [*PARAMETERS, "converged"]
    for name, parameter in shown.items():
        assert parameter.kind is inspect.Parameter.KEYWORD_ONLY
        assert parameter.default == (PARAMETERS[name].default if name in PARAMETERS else False)
    given = {name: p.default for name, p in shown.items() if p.default is not None}
    assert fc.Loop(**given) == fc.Loop()


def test_assign_shows_every_parameter_as_unchanged():
    shown = inspect.signature(fc.Loop().assign).parameters
    assert list(shown) == [*PARAMETERS, "converged"]
    assert all(p.kind is inspect.Parameter.KEYWORD_ONLY and p.default is UNCHANGED for p in shown.values())
    assert "kp=unchanged" in str(inspect.signature(fc.Loop.assign))


def test_help_lists_every_parameter_with_unit_text_and_bounds():
    lines = inspect.getdoc(fc.Loop).splitlines()
    for name, parameter in PARAMETERS.items():
        row = next(k for k, line in enumerate(lines) if line.startswith(f"{name} : "))
        assert parameter.unit in ("", "1") or lines[row].endswith(parameter.unit)
        assert lines[row + 1].strip() == f"{parameter.text} ({parameter.bounds})."
    assert lines.index("Parameters") < lines.index("Examples")


def test_calls_are_as_strict_as_before():
    with pytest.raises(TypeError):
        fc.Loop(0.03)
    with pytest.raises(fc.InputError, match="kp = None"):
        fc.Loop(kp=None)
