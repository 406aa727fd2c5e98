"""``fastcoil explain``: a preset, a study file or a folder, one scenario of it, and mistakes in a sentence."""

import pytest
from click.testing import CliRunner
from helpers.studies import PLAIN_STUDY

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.study.maintenance import pick_scenario

pytestmark = pytest.mark.kernel

SCENARIO_OPTIONS = ("--at", "backlash=0.07,estimate_ratio=0.9", "--at", "day=2")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study file."""
    path = tmp_path_factory.mktemp("explained") / "small.toml"
    path.write_text(PLAIN_STUDY)
    return path


@pytest.fixture(scope="module")
def folder(study):
    """That study, run."""
    fc.run_study(study, study.parent / "out", n_jobs=1).close()
    return study.parent / "out"


def explain(*words):
    return CliRunner().invoke(main, ["explain", *map(str, words)])


def refusal_message(*words):
    """The message of a call that is refused."""
    result = explain(*words)
    assert result.exit_code == 2, result.output
    return result.output.replace("fastcoil: ", "").strip()


def test_the_scenario_of_a_file_and_of_a_folder_is_that_of_the_study(study, folder):
    stored = fc.open_study(folder).sel(backlash=0.07, estimate_ratio=0.9, day=2)
    for target in (study, folder):
        scenario = pick_scenario(target, {"backlash": "0.07", "estimate_ratio": "0.9", "day": "2"}, {})
        result = fc.simulate(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, seed=scenario.seed, n_jobs=1)
        assert float(result["rmse"]) == float(stored["rmse"])
        assert scenario.title == "small; day=2, backlash=0.07, estimate_ratio=0.9"


def test_the_folder_is_explained_on_the_command_line(folder):
    result = explain(folder, *SCENARIO_OPTIONS)
    assert result.exit_code == 0, result.output
    title, answer = result.output.splitlines()[:2]
    assert title == "small; day=2, backlash=0.07, estimate_ratio=0.9"
    assert answer.startswith("This loop ")


def test_a_loop_has_not_what_only_its_neighbours_in_the_study_read(tmp_path):
    """Alone, it would be refused for it."""
    path = tmp_path / "mixed.toml"
    path.write_text(
        '[loop]\nplant_gain = 20\nbuffer_noise = "measured"\nbuffer_swing = 0.1\nlearning_step = 0.01\n'
        "identify_memory = 28800\nestimate_share = 0.9\n[cases.controller]\n"
        'pi = { estimator = "none", buffer_ratio = 0.0 }\nlearner = { estimator = "learner", buffer_ratio = 6.0 }\n'
        'identify = { estimator = "identify", buffer_ratio = 6.0 }\n[boundary]\nhours = 1\n'
    )
    scenario = pick_scenario(path, {"controller": "pi"}, {})
    plain_result = fc.simulate(fc.Loop(), scenario.boundary, n_jobs=1)
    assert float(fc.simulate(scenario.loop, scenario.boundary, n_jobs=1)["rmse"]) == float(plain_result["rmse"])
    with pytest.raises(fc.InputError, match="estimate_share without an estimator"):
        fc.simulate(pick_scenario(path, {"controller": "pi"}, {"estimate_share": "0.5"}).loop, scenario.boundary)


def test_a_preset_runs_on_the_generic_day():
    scenario = pick_scenario("lbnl", {}, {"kp": "0.03"})
    assert scenario.loop == fc.Loop.preset("lbnl").assign(kp=0.03)
    assert scenario.boundary.series["T_set"].tolist() == fc.paper_day().series["T_set"].tolist()


def test_a_preset_that_heats_runs_on_a_heating_day_with_its_water():
    scenario = pick_scenario("heating_45", {}, {})
    assert scenario.title == "heating_45 on heating_day(T_w_in=45)"
    assert scenario.boundary.sha256 == fc.heating_day(T_w_in=45.0).sha256


def test_a_label_that_there_is_not_is_answered_with_those_there_are(study):
    assert refusal_message(study, "--at", "backlash=0.05", "--at", "day=9,estimate_ratio=0") == (
        "--at backlash=0.05: choose one of 0.02, 0.07\n--at day=9: choose one of 1, 2, 3"
    )
    assert refusal_message(study, "--at", "day=1") == (
        "--at: backlash is missing, choose one of 0.02, 0.07\n--at: estimate_ratio is missing, choose one of 0.0, 0.9"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["lbnk"], "lbnk: no such file, folder or preset, did you mean 'lbnl'?; give a study file"),
        (["lbnl", "--set", "kpp=3"], "--set kpp is not a parameter, did you mean 'kp'?"),
        (["lbnl", "--set", "kp=fast"], "--set kp = 'fast': give a number"),
        (["lbnl", "--set", "ti=0"], "--set ti = 0 s: must be above 0"),
        (["lbnl", "--set", "kp"], "--set kp: give NAME=VALUE"),
        (["lbnl", "--set", "kp=1", "--set", "kp=2"], "--set: 'kp' is given twice"),
        (["lbnl", "--at", "replicate=1"], "--at replicate: replicates differ by their noise alone"),
        (["lbnl", "--at", "day=1"], "--at day: no label of this study; it has none"),
        (["lbnl", "-o", "figure.gif"], "-o figure.gif: give a file NAME.png or NAME.pdf or NAME.svg"),
        (["lbnl", "-o", "nowhere/figure.png"], "-o nowhere/figure.png: give a file"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence(words, said):
    assert said in refusal_message(*words)
