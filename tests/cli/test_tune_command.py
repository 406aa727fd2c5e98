"""``fastcoil tune`` and the table ``[tune]`` of a study: what is written, resumed and refused, and what stays."""

import tomllib

import pytest
from helpers.commands import fastcoil
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.design import tune as module
from fastcoil.study.file.spec import read_study, read_tuning

STUDY = """
title = "Tune me"
[loop]
noise_std = 0.02
[sample]
method = "latin_hypercube"
size = 6
backlash = { uniform = [0.0, 0.12] }
[boundary]
hours = 0.1
seed = [1, 2]
[run]
warm_up = 60
"""
TUNE = """
[tune]
search = { kp = [0.005, 0.2], buffer = [0, 0.01] }
limits = { motor_travel = 50, rmse = [9.0, "mean"] }
evaluations = 24
"""


AT = ["--at", "sample=0,day=1"]


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.toml"
    path.write_text(STUDY + TUNE)
    return path


def read(path, table):
    path.write_text(STUDY + table)
    return read_tuning(path)


@pytest.mark.kernel
@pytest.mark.usefixtures("blank_figures")
def test_it_writes_what_fc_tune_finds_and_a_file_to_include(study, tmp_path):
    result = fastcoil("tune", study, "-j", 1)
    assert result.exit_code == 0, result.output
    folder = tmp_path / "results" / "mine"
    assert {path.name for path in folder.iterdir()} >= {"tuning.toml", "tuning.png"}
    spec = read_study(study)
    tuning = fc.tune(
        spec.plan.layout.loop, spec.plan.layout.boundary, search={"kp": (0.005, 0.2), "buffer": (0, 0.01)},
        limits={"motor_travel": 50, "rmse": (9.0, "mean")}, evaluations=24, warm_up=60, n_jobs=1,
    )  # fmt: skip
    assert tomllib.loads((folder / "tuning.toml").read_text())["loop"] == tuning.parameters
    assert "\n".join(tuning.summary()) in result.output
    including = tmp_path / "next.toml"
    including.write_text('[loop]\ninclude = ["results/mine/tuning.toml"]\n')
    assert read_study(including).plan.layout.loop["kp"] == tuning.parameters["kp"]


@pytest.mark.kernel
@pytest.mark.usefixtures("blank_figures")
def test_settings_that_the_advice_leaves_are_not_offered_to_a_study(study):
    study.write_text(STUDY + "[tune]\nsearch = { kp = [0.5, 2.0] }\nlimits = { rmse = 0.001 }\nevaluations = 8\n")
    result = fastcoil("tune", study, "-o", "out", "-j", 1)
    assert result.exit_code == 0, result.output
    assert "Leave it: " in result.output
    line = next(line for line in result.output.splitlines() if line.startswith("Written:"))
    assert line == "Written: out/tuning.toml (the advice is to leave the settings as they are; it has no parameter)"


@pytest.mark.kernel
def test_plan_run_and_explain_leave_the_contents_of_the_table_to_tune(study):
    study.write_text(STUDY + "[tune]\nsearch = { backlash = [0.0, 0.1] }\nlimit = 3\n")
    for command in (["plan", study], ["run", study, "-j", 1, "--no-figures"], ["explain", study, *AT]):
        assert fastcoil(*command).exit_code == 0
    assert fastcoil("tune", study).exit_code == 2
    study.write_text("tune = 3\n" + STUDY)
    assert fastcoil("plan", study).exit_code == 2


@pytest.mark.kernel
def test_an_interrupted_search_writes_nothing(study, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "simulate_group", interrupted)
    stopped = fastcoil("tune", study, "-o", "out", "-j", 1)
    assert stopped.exit_code == 130
    assert "resume" not in stopped.output
    assert not (tmp_path / "out" / "tuning.toml").exists()


def test_a_study_without_the_table_is_refused_with_an_example(study):
    study.write_text(STUDY)
    result = fastcoil("tune", study)
    assert result.exit_code == 2
    assert "has no table [tune]: add one, such as search = { kp" in result.output


def test_days_to_try_it_on_are_labels_or_a_boundary(study):
    table = "[tune]\nsearch = { kp = [0.01, 0.1] }\nholdout = "
    request = read(study, table + "[1]")
    assert (request.training.boundary.day.tolist(), request.holdout.boundary.day.tolist()) == ([2], [1])
    request = read(study, table + '{ kind = "paper_day", hours = 0.1, seed = [7, 8] }')
    assert request.holdout.boundary == fc.paper_day(hours=0.1, seed=[7, 8])


@pytest.mark.parametrize(
    "table",
    [
        "",
        "serch = { kp = [0.01, 0.1] }",
        "search = { backlash = [0.0, 0.1] }",
        "search = { kp = 0.1 }",
        *(
            f"search = {{ kp = [0.01, 0.1] }}\n{line}"
            for line in ("objective = 3", "evaluations = 0", "holdout = { seed = -1 }", "holdout = [3]", "holdout = 3",
                         "holdout = ['a']", "limits = { travel = 3 }")
        ),
    ],
)  # fmt: skip
def test_mistakes_in_the_table_name_it(study, table):
    study.write_text(f"{STUDY}[tune]\n{table}")
    with pytest.raises(fc.InputError) as raised:
        read_tuning(study)
    assert all("[tune]" in problem for problem in raised.value.problems)
    assert_worded(*raised.value.problems)
