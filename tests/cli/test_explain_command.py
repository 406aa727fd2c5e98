"""``fastcoil explain``: a preset, a study file or a folder, one scenario of it, and mistakes in a sentence."""

import pytest
from helpers.commands import assert_command_refused, fastcoil
from helpers.studies import PLAIN_STUDY

import fastcoil as fc
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


def test_the_scenario_of_a_file_and_of_a_folder_is_that_of_the_study(study, folder):
    stored = fc.open_study(folder).sel(backlash=0.07, estimate_ratio=0.9, day=2)
    for target in (study, folder):
        scenario = pick_scenario(target, {"backlash": "0.07", "estimate_ratio": "0.9", "day": "2"}, {})
        result = fc.simulate(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, seed=scenario.seed, n_jobs=1)
        assert float(result["rmse"]) == float(stored["rmse"])
        assert scenario.title == "small; day=2, backlash=0.07, estimate_ratio=0.9"


def test_the_folder_is_explained_on_the_command_line(folder):
    result = fastcoil("explain", folder, *SCENARIO_OPTIONS)
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


def test_the_preset_of_a_room_runs_on_the_winter_day_of_its_air_flow():
    scenario = pick_scenario("reheat", {}, {})
    assert scenario.title == "reheat on constant_day(hours=24, T_a_in=13, T_w_in=60, T_set=21, m_a=0.1)"
    ds = fc.simulate(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, n_jobs=1)
    assert ds.rmse < 0.1


def test_a_label_that_there_is_not_is_answered_with_those_there_are(study):
    assert_command_refused("explain", study, "--at", "backlash=0.05", "--at", "day=9,estimate_ratio=0")
    assert_command_refused("explain", study, "--at", "day=1")


@pytest.mark.parametrize(
    "words",
    [
        *(f"lbnl --set {change}" for change in ("kpp=3", "kp=fast", "ti=0", "kp", "kp=1 --set kp=2")),
        *(f"lbnl {words}" for words in ("--at replicate=1", "--at day=1", "-o figure.gif", "-o nowhere/figure.png")),
        "lbnk",
    ],
)
def test_a_mistake_is_one_sentence(words):
    assert_command_refused("explain", *words.split())
