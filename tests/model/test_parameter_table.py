"""The tables of parameters and outputs: texts and types, what theory makes of each, and that nothing is forgotten."""

import re
from pathlib import Path
from typing import get_origin, get_type_hints

import numpy as np
import pytest
import reference
from helpers.refusals import assert_refused
from helpers.rules import by_error, own_pi

import fastcoil as fc
from fastcoil.design.describing_function import unpredictable_loops
from fastcoil.design.prediction import nearest_linear
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.model import parameter_table
from fastcoil.model.metric_table import COSTS, METRICS, TRACES, read_output
from fastcoil.model.parameter_table import PARAMETERS, STAND_INS, Parameter, Theory, require_parameter_name


def test_a_label_fits_an_axis_and_is_its_own_in_its_table():
    for table in (PARAMETERS, METRICS, TRACES):
        for name, entry in table.items():
            assert 0 < len(entry.label) <= 40, name
            assert not set(entry.label) & set(";[]"), name
        assert len({entry.label for entry in table.values()}) == len(table)


def test_every_parameter_is_explained_in_one_line():
    for parameter in PARAMETERS.values():
        assert parameter.text
        assert "\n" not in parameter.text
        assert not parameter.text.endswith(".")


def test_the_defaults_of_the_coil_are_those_of_the_paper_like_preset():
    coil = {f"beta{k}": beta for k, beta in enumerate([0.32, -0.20, 0.40, -0.45, 0.42, -0.42], 1)}
    coil |= {"C_w": 8.8, "C_c": 30.0, "cp_w": 4.186, "cp_a": 1.02, "pressure": 101325.0, "T_initial": 20.0}
    valve = {"m_max": 2.0, "valve_a": 0.7, "valve_b": 9.0, "valve_c": 0.38, "backlash": 0.07}
    assert {name: PARAMETERS[name].default for name in coil | valve} == coil | valve


def test_a_value_is_shown_with_name_and_unit():
    assert PARAMETERS["kp"].equation(0.05) == "kp = 0.05 K-1"
    assert PARAMETERS["backlash"].equation(0.07) == "backlash = 0.07"
    assert PARAMETERS["action"].equation("heating") == "action = heating"


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [("action", "warming", "choice"), ("action", 1.0, "type"), ("kp", "a", "type"), ("kp", True, "type"),
     ("kp", np.inf, "value"), pytest.param("kp", 10**400, "value", id="many digits"), ("backlash", 0.95, "value"),
     ("valve_c", 5.1, "value"),
     ("ti", 0.0, "value"), ("n_volumes", 2.5, "value"), ("backlsh", 0.1, "name"), ("back lash", 0.1, "name")],
)  # fmt: skip
def test_a_value_that_is_not_admissible_is_refused_with_its_field(name, value, code):
    assert_refused(name, code, lambda: fc.Loop(**{name: value}))


def test_a_name_is_a_text():
    assert_refused("name", "type", require_parameter_name, 3)


FRICTION = {"text": "friction of the stem", "label": "friction", "unit": "1", "default": 0.0, "lower": 0.0}


@pytest.mark.parametrize(
    ("fields", "reason"),
    [({}, "missing 1 required keyword-only argument: 'theory'"),
     ({"theory": "uncovered"}, "must be a mapping, not str"),
     ({"theory": {"nearest": 0.0, "claus": ""}}, "unexpected keyword argument 'claus'"),
     ({"theory": "covered", "lowest": 0.0}, "unexpected keyword argument 'lowest'")],
)  # fmt: skip
def test_a_parameter_with_a_misspelt_key_or_without_theory_does_not_import(fields, reason):
    assert parameter_table.read_parameter("stem_friction", "actuator", theory="covered", **FRICTION).default == 0.0
    with pytest.raises(TypeError, match=reason):
        parameter_table.read_parameter("stem_friction", "actuator", **FRICTION | fields)


def test_an_output_with_a_misspelt_key_or_constant_does_not_import():
    fields = {"long_name": "swing over {HUNTING_SWING_K} K", "unit": "1"}
    assert read_output("large_swings", **fields).long_name == "swing over 0.1 K"
    with pytest.raises(TypeError, match="unexpected keyword argument 'lable'"):
        read_output("large_swings", **fields, lable="swings")
    with pytest.raises(KeyError, match="HUNTING_SWNG_K"):
        read_output("large_swings", **fields, comment="{HUNTING_SWNG_K} K")


def fits(value, hint):
    """Whether a value of a table is what a field is annotated with; an integer is a float, and no flag."""
    if get_origin(hint) is tuple:
        return isinstance(value, tuple) and all(isinstance(word, str) for word in value)
    hint = int | float if hint is float else hint
    return isinstance(value, hint) and (hint is bool or not isinstance(value, bool))


@pytest.mark.parametrize(
    "table", [PARAMETERS, METRICS, COSTS, TRACES], ids=["parameters", "metrics", "costs", "traces"]
)
def test_every_value_of_a_table_has_the_type_of_its_field(table):
    for name, entry in table.items():
        wrong = [f for f, hint in get_type_hints(type(entry)).items() if not fits(getattr(entry, f), hint)]
        assert not wrong, name


def test_every_default_is_admissible():
    for p in PARAMETERS.values():
        assert p.default is None or p.problem(p.default) is None, p.name


def test_the_kernel_and_its_twin_in_plain_python_read_every_parameter():
    table = Path(parameter_table.__file__)
    kernel = "".join(path.read_text() for path in table.parent.rglob("*.py") if path != table)
    twin = "".join(path.read_text() for path in Path(reference.__file__).parent.glob("*.py"))
    for name, p in PARAMETERS.items():
        is_read = re.search(rf'[."]{name}\b|^    {name}: float$', kernel, re.MULTILINE)
        assert is_read, f"model/engine does not read {name}"
        has_twin = f'"{name}"' in twin or p.group == "test" or name in (*STAND_INS, "law", "plant", "dead_time")
        assert has_twin, f"tests/reference does not read {name}"


@pytest.mark.kernel
@pytest.mark.parametrize("name", [p.name for p in PARAMETERS.values() if p.group == "actuator" and p.default == 0.0])
def test_every_option_of_the_actuator_has_an_effect_and_is_that_of_its_twin(name, half_hour_day, run_reference):
    p = PARAMETERS[name]
    motor = {"stroke_time": 60.0} if name == "positioner_band" else {}
    loop = fc.Loop(**motor | {name: 60.0 if p.unit == "s" else 0.4 * min(p.upper, 0.1)})
    options = {"traces": ["opening"], "warm_up": 600}
    opening = fc.simulate(loop, half_hour_day, **options).opening
    assert (opening != fc.simulate(fc.Loop(**motor), half_hour_day, **options).opening).any(), (
        f"{name} in engine/valve.py"
    )
    traces, _ = run_reference(loop, half_hour_day, warm_up=600)
    np.testing.assert_allclose(opening, traces["opening"], rtol=0.0, atol=1e-9, err_msg=f"{name} in tests/reference")


@pytest.fixture
def stem_friction(monkeypatch):
    """A parameter of the actuator that theory does not cover, added to the table alone."""
    theory = Theory(0.0, "a stem_friction makes a dead band: give 0, or simulate it")
    p = Parameter("stem_friction", "actuator", "1", 0.0, "friction of the stem", 0.0, label="friction", theory=theory)
    monkeypatch.setitem(PARAMETERS, p.name, p)
    return fc.Loop.preset("lbnl").assign(stem_friction=[0.0, 0.1])


@pytest.mark.kernel
def test_what_theory_does_not_cover_is_refused_or_simulated_because_the_table_says_so(stem_friction):
    day = fc.paper_day(hours=1)
    with pytest.warns(UserWarning, match="NaN in 1 of 2 scenarios: a stem_friction makes a dead band"):
        assert np.isnan(fc.limit_cycle(stem_friction, day).hunting_index).values.tolist() == [False, True]
    rough = stem_friction.assign(stem_friction=0.1)
    with pytest.raises(fc.InputError, match="a stem_friction makes a dead band: give 0, or simulate it"):
        fc.limit_cycle(rough, day)
    assert "theory cannot tell, since a stem_friction makes a dead band." in fc.explain(rough, day, warm_up=600).why


@pytest.mark.parametrize("name", [name for name, p in PARAMETERS.items() if p.theory.clause])
def test_a_clause_holds_for_its_loop_and_not_for_the_nearest_that_theory_covers(name):
    loop = fc.Loop.preset("lbnl").assign(**{name: {"law": own_pi, "estimator": by_error}.get(name, 0.005)})
    for variant, clauses in ((loop, [PARAMETERS[name].theory.clause]), (nearest_linear(loop), [])):
        columns = parameter_columns(variant, {}, np.zeros(1, dtype=np.int64))
        assert [clause for clause, where in unpredictable_loops(columns).items() if where.any()] == clauses
