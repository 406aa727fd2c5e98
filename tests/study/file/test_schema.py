"""The JSON Schema of study files: it takes what the reader takes, and names of its own it has none."""

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from helpers.refusals import seen_by_schema
from jsonschema import Draft202012Validator

from fastcoil.base.errors import InputError
from fastcoil.cli.main import main
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.file.schema import study_schema
from fastcoil.study.file.spec import BOUNDARY_KINDS, read_study
from fastcoil.study.file.starters import TEMPLATE
from fastcoil.study.file.tables import StudyFile

STUDIES = sorted((Path(__file__).parents[3] / "studies").glob("*/*.toml"))
SCHEMA = study_schema()
VALIDATOR = Draft202012Validator(SCHEMA)


def test_it_is_a_schema_and_knows_every_table():
    Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["properties"].keys() == StudyFile.model_fields.keys()
    assert SCHEMA["required"] == ["loop"]


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.name)
def test_the_studies_of_this_repository_are_valid(path):
    assert seen_by_schema(path.read_text()) == []


def uncommented(template):
    """The template with every setting that stands there as a comment."""
    return "\n".join(
        line[2:] if line.startswith(("# [", "# reduce")) or " = " in line[:30] and line.startswith("# ") else line
        for line in template.splitlines()
    ).replace("traces = []", 'traces = ["T_sup"]')


def test_the_template_is_valid_also_with_all_that_it_shows_as_comments(tmp_path):
    assert seen_by_schema(TEMPLATE) == []
    text = uncommented(TEMPLATE)
    assert seen_by_schema(text) == []
    assert tomllib.loads(text).keys() == SCHEMA["properties"].keys()
    (tmp_path / "mine.py").write_text("def overshoot(traces): ...")
    (tmp_path / "valve.toml").write_text("[loop]\nvalve_a = 0.6")
    (tmp_path / "coil.toml").write_text("[loop]\nbeta2 = -0.3")
    (tmp_path / "study.toml").write_text(text.replace("size = 1024", "size = 4"))
    study = read_study(tmp_path / "study.toml")
    assert study.plan.layout.sizes["sample"] == 4
    assert study.reduction.name == "mine:overshoot"


@pytest.mark.parametrize(
    "boundary",
    [
        "hours = 2",
        "seed = 3",
        "kind = 'paper_day'\nseed = [1, 2]",
        "kind = 'constant_day'\nT_set = 15.5\nm_a = [1.0, 1.1]\nrelative_humidity = 0.4",
        "kind = 'design_day'\nmode = 'heating'\nT_daily_range = 5\nstart_hour = 7.5",
        "kind = 'csv'\npath = 'log.csv'\nunits = { T_a_in = 'degF' }\nconstants = { T_set = 14 }\nmax_gap = 600",
        "kind = 'weather'\npath = 'w.csv'\nm_a = 1\nT_w_in = 7\nT_set = 14\noutdoor_fraction = 0.3\nT_return = 24\n"
        "W_return = 0.01\nstart_hour = 4000\ndays = [1, 2]",
        "kind = 'weather_year'\npath = 'w.epw'\nyear = 2023\nfirst_date = '06-01'\nfan_hours = [7, 18.5]\n"
        "holidays = ['07-04']\nset_point = 'fixed'\neconomiser = 'fixed'\neconomiser_limit = 21\nwater = 'load'",
    ],
)
def test_arguments_of_every_kind_of_boundary_are_known(boundary):
    assert seen_by_schema(f"[loop]\n[boundary]\n{boundary}") == []


@pytest.mark.parametrize(
    "text",
    [
        "[loop]\nrangeability = 50\nn_volumes = 8\naction = 'cooling'\n[sweep]\nauthority = [0.5]\nm_full = [1.0, 1.2]",
        "[loop]\n[sweep]\nlearning_floor = { geomspace = [0.001, 0.1, 3] }\nair_march = ['lagged', 'quasistatic']",
        "[loop]\n[cases.learner]\non = { learning_step = 0.007, learning_stop = 'first_step_down' }\noff = {}",
        "[loop]\n[sample]\nmethod = 'sobol'\nsize = 16\nseed = 18446744073709551615\nC_w = { loguniform = [9, 10] }",
        "[loop]\n[boundary]\nhours = 1\nseed = [1, 2]\n[tune]\nsearch = { kp = [0.005, 0.1] }\nobjective = 'iae'\n"
        "quantile = 'mean'\nlimits = { motor_travel = 20, reversals = [900, 0.9] }\nholdout = [2]\nevaluations = 60",
        "[loop]\n[tariff]\nelectricity = 0\ndemand = 15\nheat = 0.05\nelectric_heat = true\ncurrency = 'EUR'",
    ],
)
def test_other_ways_to_write_a_value_are_valid_and_are_read(tmp_path, text):
    assert seen_by_schema(text) == []
    (tmp_path / "study.toml").write_text(text)
    assert read_study(tmp_path / "study.toml").plan.n_scenarios >= 1


def test_every_kind_of_boundary_has_its_arguments_and_the_needed_ones():
    kinds = {}
    for rule in SCHEMA["properties"]["boundary"]["allOf"]:
        kinds[rule["if"]["properties"]["kind"]["const"]] = rule["then"]
    assert kinds.keys() == BOUNDARY_KINDS.keys()
    assert kinds["csv"]["required"] == ["path"]
    assert kinds["weather"]["required"] == ["path", "m_a", "T_w_in", "T_set", "outdoor_fraction", "T_return"]
    assert kinds["weather_year"]["required"] == ["path"]
    assert kinds["paper_day"]["properties"].keys() == {"kind", "hours", "seed"}


@pytest.mark.parametrize(
    "text",
    [
        "title = 3\n[loop]",
        "titel = 'x'\n[loop]",
        "[loop]\n[tariff]\nelectricity = 0.1\ndemand = 10",
        "[loop]\n[tariff]\nelectricity = 0.1\ndemand = 10\nheat = -1",
        "[loop]\n[tariff]\nelectricity = 0.1\ndemand = 10\nheat = 0.1\ncop = 0",
        "[loop]\n[tariff]\nelectricity = 0.1\ndemand = 10\nheat = 0.1\nheating = 0.1",
        "[loop]\nkpp = 0.1",
        "[loop]\npreset = 'paper_lik'",
        "[loop]\n[sweep]\nkp = []",
        "[loop]\n[sweep]\nkp = {}",
        "[loop]\n[sweep]\nkp = { linspace = [0, 1] }",
        "[loop]\n[sweep]\nkp = { linspace = [0, 1, 10000001] }",
        "[loop]\n[sweep]\nkp = { linspace = [0, 1, 2, 3] }",
        "[loop]\n[sweep]\nkp = { logspace = [0, 1, 3] }",
        "[loop]\n[sweep]\naction = { linspace = [0, 1, 3] }",
        "[loop]\n[cases.tuning]\na = { kpp = 0.1 }",
        "[loop]\n[cases.tuning]\na = 3",
        "[loop]\n[tune]\nsearch = { kpp = [0, 1] }",
        "[loop]\n[cases.rmse]\na = { kp = 0.1 }",
        "[loop]\n[cases.'a b']\na = { kp = 0.1 }",
        "[loop]\n[sample]\nmethod = 'random'\nsize = 10000001\nkp = { uniform = [0, 1] }",
        "[loop]\n[sample]\nmethod = 'random'\nsize = 8\nkp = { uniform = [0, 1, 2] }",
        "[loop]\n[boundary]\nhourss = 3",
        "[loop]\n[boundary]\nhours = 0",
        "[loop]\n[boundary]\nhours = 'all'",
        "[loop]\n[boundary]\nT_set = 14",
        "[loop]\n[boundary]\nkind = 'constant_day'\nseed = 1",
        "[loop]\n[boundary]\nkind = 'design_day'\nmode = 'warming'",
        "[loop]\n[boundary]\nkind = 'constant_day'\nrelative_humidity = 1.1",
        *(
            f"[loop]\n[run]\n{run}"
            for run in (
                "seed = 1.5",
                "seed = 18446744073709551616",
                "warm_up = -1",
                "trace_interval = 0",
                "traces = 'T_sup'",
                "traces = ['T_sup', 'T_sup']",
                "trace = ['T_sup']",
                "reduce = 'mine:f'",
                "traces = ['T_sup']\nreduce = 'mine'",
            )
        ),
    ],
)
def test_what_the_schema_refuses_the_reader_refuses_too(tmp_path, text):
    assert seen_by_schema(text)
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InputError):
        read_study(tmp_path / "study.toml")


@pytest.mark.parametrize("name", PARAMETERS)
def test_bounds_are_those_of_the_table(name):
    parameter = PARAMETERS[name]
    values = [*parameter.choices, "neither", True, 0.5, -1, 3]
    for bound in (parameter.lower, parameter.upper):
        if not math.isinf(bound):
            values += [bound, np.nextafter(bound, -np.inf), np.nextafter(bound, np.inf), bound - 1, bound + 1]
    for value in (v.item() if isinstance(v, np.generic) else v for v in values):
        accepted = not parameter.problem(value)
        for tables in (
            {"loop": {name: value}},
            {"loop": {}, "sweep": {name: [value]}},
            {"loop": {}, "cases": {"x": {"a": {name: value}}}},
            {"loop": {}, "sample": {"method": "random", "size": 1, name: {"choice": [value]}}},
        ):
            assert VALIDATOR.is_valid(tables) == accepted, tables


def test_a_parameter_is_described_with_unit_and_default():
    assert SCHEMA["$defs"]["kp"] == {
        "description": "proportional gain K_p, stroke per kelvin [K-1]",
        "type": "number",
        "default": 0.03,
    }
    assert "default" not in SCHEMA["$defs"]["rangeability"]


def test_the_command_prints_it_as_json():
    result = CliRunner().invoke(main, ["schema"])
    assert result.exit_code == 0
    assert json.loads(result.output) == SCHEMA


# A study's own rules may stand in any table, and bring parameters which the schema cannot know

SOURCE = """
from typing import NamedTuple
import fastcoil as fc

class Parameters(NamedTuple):
    sample_time: float
    gain: float = 3e-4
    most: float = 10.0

class Memory(NamedTuple):
    last: float = 0.0

@fc.estimator(Parameters, Memory)
def rule(now, p, memory):
    return p.gain * p.most, memory

@fc.law(Parameters, Memory)
def own_law(now, p, memory):
    return p.gain * p.most, memory
"""
RULE, SAMPLED = "estimator = 'mine:rule'\n", "method = 'sobol'\nsize = 8\n"
PLACES = {
    "loop": "[loop]\nestimator = 'mine:rule'",
    "law": "[loop]\nlaw = 'mine:own_law'",
    "sweep": "[loop]\n[sweep]\nestimator = ['none', 'mine:rule']",
    "case": "[loop]\n[cases.controller]\nplain = { estimator = 'none' }\nown = { estimator = 'mine:rule', gain = 1 }",
    "sample": f"[loop]\n[sample]\n{SAMPLED}estimator = {{ choice = ['none', 'mine:rule'] }}",
}
OWN = [
    "[loop]\nestimator = 'mine:rule'\ngain = 1e-3",
    "[loop]\nlaw = 'mine:own_law'\n[sweep]\ngain = [1e-3, 2e-3]\nmost = { geomspace = [1, 10, 3] }",
    f"[loop]\n{RULE}[sample]\n{SAMPLED}gain = {{ uniform = [0, 1] }}\nmost = {{ choice = [1, 2] }}",
    f"[loop]\n{RULE}[cases.tuning]\nslow = {{ gain = 1e-4 }}\nfast = {{ gain = 1e-3 }}",
]


@pytest.fixture
def read(tmp_path):
    """Return a function that says whether the reader takes a study."""
    (tmp_path / "mine.py").write_text(SOURCE)

    def is_read(text):
        (tmp_path / "study.toml").write_text(text)
        try:
            read_study(tmp_path / "study.toml")
        except InputError:
            return False
        return True

    return is_read


@pytest.mark.parametrize(
    ("estimator", "is_right"), [("learner", True), ("mine:rule", True), ("package.mine:rule", True), ("lerner", False)]
)
def test_an_estimator_is_a_word_or_a_function(estimator, is_right):
    for table in ({"loop": {"estimator": estimator}}, {"loop": {}, "sweep": {"estimator": ["none", estimator]}}):
        assert VALIDATOR.is_valid(table) == is_right


@pytest.mark.parametrize("text", OWN)
def test_a_study_with_a_rule_may_have_parameters_of_its_own_in_every_table(text, read):
    assert read(text)
    assert not seen_by_schema(text)


@pytest.mark.parametrize("text", PLACES.values(), ids=PLACES)
def test_a_rule_is_found_wherever_it_is_named(text, read):
    with_own = text.replace("[loop]", "[loop]\nmost = 5")
    assert read(with_own)
    assert not seen_by_schema(with_own)


@pytest.mark.parametrize("text", OWN + [text.replace("[loop]", "[loop]\nmost = 5") for text in PLACES.values()])
def test_without_a_rule_the_same_names_are_wrong(text, read):
    without = text.replace("mine:rule", "learner").replace("mine:own_law", "pi")
    assert seen_by_schema(without)
    assert not read(without)


@pytest.mark.parametrize(
    "text",
    [
        "[loop]\nestimator = 'mine:rule'\ngain = 'much'",
        "[loop]\nestimator = 'mine:rule'\n'the gain' = 1",
        "[loop]\nestimator = 'mine:rule'\n[sweep]\ngain = 3",
        f"[loop]\n{RULE}[cases.tuning]\nslow = {{ gain = [1, 2] }}",
        f"[loop]\n{RULE}[sample]\n{SAMPLED}gain = {{ between = [0, 1] }}",
        f"[loop]\n{RULE}[sample]\n{SAMPLED}",
        f"titel = 'a rule makes no table of it'\n[loop]\n{RULE}",
        f"[loop]\n{RULE}[run]\ngain = 3",
    ],
)
def test_a_parameter_of_its_own_is_a_number_under_a_name_like_any_other(text, read):
    assert seen_by_schema(text)
    assert not read(text)
