"""The schema of study files says the same to an editor of either draft, and never less than the reader."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from helpers.commands import fastcoil
from jsonschema import Draft4Validator, Draft202012Validator

from fastcoil.cli.study import shipped_studies
from fastcoil.study.file.schema import SCHEMA_FILE, schema_text

DRAFTS = {"draft 4": Draft4Validator, "2020-12": Draft202012Validator}
WRONG = {
    "a value that no valve has": ("[loop]\nbacklash = 1.5", "backlash"),
    "a number in quotes": ("[loop]\nkp = '0.1'", "kp"),
    "a word that is no choice": ("[loop]\nair_march = 'laged'", "air_march"),
    "an unknown preset": ("[loop]\npreset = 'lbln'", "preset"),
    "one value in a list": ("[loop]\n[sweep]\nti = [30, -1]", "ti"),
    "a spacing of two numbers": ("[loop]\n[sweep]\nti = { linspace = [0, 1] }", "ti"),
    "an unknown distribution": ("[loop]\n[sample]\nsize = 4\nti = { unifrom = [0, 1] }", "ti"),
    "a kind of day": ("[loop]\n[boundary]\nkind = 'paperday'", "kind"),
    "an unknown key": ("[loop]\n[run]\nwarmup = 3", "run"),
    "an unknown table": ("[loop]\n[bondary]", ""),
    "a trace": ("[loop]\n[run]\ntraces = ['T_supp']", "traces"),
    "a metric": ("[loop]\n[run]\nprecision = { metric = 'rmsse', half_width = 0.1 }", "precision"),
    "no [loop]": ("title = 'x'", ""),
}


@pytest.fixture(scope="module", params=DRAFTS)
def validator(request):
    schema = json.loads(schema_text())
    DRAFTS[request.param].check_schema(schema)
    return DRAFTS[request.param](schema)


def test_every_shipped_study_and_the_template_are_valid(validator, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fastcoil("init")
    texts = {"template": (tmp_path / "study.toml").read_text(encoding="utf-8"), **shipped_studies()}
    messages = {name: [e.message for e in validator.iter_errors(tomllib.loads(text))] for name, text in texts.items()}
    assert messages == dict.fromkeys(texts, [])


@pytest.mark.parametrize("what", WRONG)
def test_wrong_values_are_marked_where_they_stand(validator, what):
    text, place = WRONG[what]
    errors = list(validator.iter_errors(tomllib.loads(text)))
    assert errors
    assert place in ["", *(str(key) for error in errors for key in error.absolute_path)]


def test_a_rule_and_its_parameters_are_left_to_the_reader(validator):
    assert validator.is_valid({"loop": {"estimator": "mine:asymmetric", "lash_up": 0.1}, "sweep": {"lash_down": [1]}})
    assert not validator.is_valid({"loop": {"estimator": "learnr"}})


def test_taplo_finds_the_schema_by_the_first_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fastcoil("init").exit_code == 0
    assert (tmp_path / SCHEMA_FILE).read_text(encoding="utf-8") == schema_text()

    def lint():
        taplo = Path(sys.executable).with_name("taplo")
        return subprocess.run([taplo, "lint", "study.toml"], check=False, capture_output=True, text=True, timeout=60)

    assert lint().returncode == 0, lint().stderr
    study = tmp_path / "study.toml"
    study.write_text(study.read_text(encoding="utf-8").replace("[0.02, ", "[1.02, "), encoding="utf-8")
    lint_result = lint()
    assert lint_result.returncode == 1
    assert "1.02" in lint_result.stderr
