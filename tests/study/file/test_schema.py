"""The JSON Schema of study files: it takes what the reader takes, and has the reader's names and bounds."""

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
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


def mistakes(text):
    """What the schema finds wrong in a study file."""
    return [error.message for error in VALIDATOR.iter_errors(tomllib.loads(text))]


def test_the_command_prints_a_schema_of_every_table():
    Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["properties"].keys() == StudyFile.model_fields.keys()
    assert SCHEMA["required"] == ["loop"]
    result = CliRunner().invoke(main, ["schema"])
    assert result.exit_code == 0
    assert json.loads(result.output) == SCHEMA


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.name)
def test_the_studies_of_this_repository_are_valid(path):
    assert mistakes(path.read_text()) == []


def test_the_template_is_valid_also_with_all_that_it_shows_as_comments(tmp_path):
    text = "\n".join(
        line[2:] if line.startswith(("# [", "# reduce")) or " = " in line[:30] and line.startswith("# ") else line
        for line in TEMPLATE.splitlines()
    ).replace("traces = []", 'traces = ["T_sup"]')
    assert mistakes(TEMPLATE) == mistakes(text) == []
    assert tomllib.loads(text).keys() == SCHEMA["properties"].keys()
    (tmp_path / "mine.py").write_text("def overshoot(traces): ...")
    (tmp_path / "valve.toml").write_text("[loop]\nvalve_a = 0.6")
    (tmp_path / "coil.toml").write_text("[loop]\nbeta2 = -0.3")
    (tmp_path / "study.toml").write_text(text.replace("size = 1024", "size = 4"))
    study = read_study(tmp_path / "study.toml")
    assert study.plan.layout.sizes["sample"] == 4
    assert study.reduction.name == "mine:overshoot"


@pytest.mark.parametrize(
    "text",
    [
        "hours = 2\nseed = [1, 2]",
        "kind = 'constant_day'\nT_set = 15.5\nm_a = [1.0, 1.1]\nrelative_humidity = 0.4",
        "kind = 'design_day'\nmode = 'heating'\nT_daily_range = 5\nstart_hour = 7.5",
        "kind = 'csv'\npath = 'log.csv'\nunits = { T_a_in = 'degF' }\nconstants = { T_set = 14 }\nmax_gap = 600",
        "kind = 'weather'\npath = 'w.csv'\nm_a = 1\nT_w_in = 7\nT_set = 14\noutdoor_fraction = 0.3\nT_return = 24\n"
        "W_return = 0.01\nstart_hour = 4000\ndays = [1, 2]",
        "kind = 'weather_year'\npath = 'w.epw'\nyear = 2023\nfirst_date = '06-01'\nfan_hours = [7, 18.5]\n"
        "holidays = ['07-04']\nset_point = 'fixed'\neconomiser = 'fixed'\neconomiser_limit = 21\nwater = 'load'",
        "[sweep]\nlearning_floor = { geomspace = [0.001, 0.1, 3] }\nair_march = ['lagged', 'quasistatic']",
        "[sample]\nmethod = 'sobol'\nsize = 16\nseed = 18446744073709551615\nC_w = { loguniform = [9, 10] }",
        "[tune]\nsearch = { kp = [0.005, 0.1] }\nobjective = 'iae'\nquantile = 'mean'\nholdout = [2]\n"
        "limits = { motor_travel = 20, reversals = [900, 0.9] }",
        "[tariff]\nelectricity = 0\ndemand = 15\nheat = 0.05\nelectric_heat = true\ncurrency = 'EUR'",
        "[cases.controller]\nplain = { estimator = 'none' }\nown = { estimator = 'mine:rule', gain = 1 }",
        "[sweep]\nlaw = ['pi', 'package.mine:rule']\nmost = { geomspace = [1, 10, 3] }",
    ],
)
def test_what_a_study_may_say_is_valid(text):
    table = "" if text.startswith("[") else "[boundary]\n"
    assert mistakes(f"[loop]\n{table}{text}") == []


@pytest.mark.parametrize(
    "text",
    [
        "titel = 'x'\n[loop]",
        "[loop]\npreset = 'paper_lik'",
        "[loop]\nestimator = 'lerner'",
        "[loop]\n[tariff]\nelectricity = 0.1\ndemand = 10",
        "[loop]\n[tariff]\nelectricity = 0.1\ndemand = 10\nheat = -1",
        "[loop]\n[sweep]\nkp = []",
        "[loop]\n[sweep]\nkp = { linspace = [0, 1] }",
        "[loop]\n[sweep]\nkp = { logspace = [0, 1, 3] }",
        "[loop]\n[cases.tuning]\na = { kp = [0.1] }",
        "[loop]\n[sample]\nmethod = 'random'\nsize = 10000001\nkp = { uniform = [0, 1] }",
        "[loop]\n[sample]\nmethod = 'random'\nsize = 8\nkp = { uniform = [0, 1, 2] }",
        "[loop]\n[boundary]\nhourss = 3",
        "[loop]\n[boundary]\nkind = 'constant_day'\nrelative_humidity = 1.1",
        "[loop]\n[run]\nseed = 18446744073709551616",
        "[loop]\n[run]\ntraces = ['T_sup', 'T_supp']",
    ],
)
def test_what_the_schema_refuses_the_reader_refuses_too(tmp_path, text):
    assert mistakes(text)
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InputError):
        read_study(tmp_path / "study.toml")


def test_a_parameter_has_bounds_and_words_of_the_table_and_a_text_with_unit_and_default():
    for name, parameter in PARAMETERS.items():
        values = [*parameter.choices, "neither", True, 0.5, -1, 3]
        for bound in (parameter.lower, parameter.upper):
            if not math.isinf(bound):
                values += [bound, np.nextafter(bound, -np.inf).item(), np.nextafter(bound, np.inf).item()]
        for value in values:
            for tables in ({"loop": {name: value}}, {"loop": {}, "sweep": {name: [value]}}):
                assert VALIDATOR.is_valid(tables) == (not parameter.problem(value)), tables
    text = "proportional gain K_p, stroke per kelvin [K-1]"
    assert SCHEMA["$defs"]["kp"] == {"description": text, "type": "number", "default": 0.03}


def test_every_kind_of_boundary_has_its_arguments_and_the_needed_ones():
    kinds = {table["properties"]["kind"]["const"]: table for table in SCHEMA["properties"]["boundary"]["anyOf"]}
    assert kinds.keys() == BOUNDARY_KINDS.keys()
    assert kinds["csv"]["required"] == ["path", "kind"]
    assert kinds["paper_day"]["properties"].keys() == {"kind", "hours", "seed"}
    assert kinds["paper_day"]["required"] == []
