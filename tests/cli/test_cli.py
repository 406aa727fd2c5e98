"""The command line: exit codes, messages without traceback, and that nothing is left after a mistake."""

import pytest
from helpers.commands import assert_command_refused, fastcoil

pytestmark = pytest.mark.kernel

SMALL_STUDY = "[loop]\n[sweep]\nbacklash = [0.02, 0.07]\nestimate_ratio = [0.0, 0.5, 1.2]\n[boundary]\nhours = 1\n"


@pytest.fixture(autouse=True)
def write_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL_STUDY)


def test_run_writes_results_and_figures_and_says_where(tmp_path):
    result = fastcoil("run", "small.toml")
    assert result.exit_code == 0, result.output
    for path in ("results.nc", "figures/bands.png"):
        assert f"results/small/{path}" in result.output
        assert (tmp_path / "results" / "small" / path).stat().st_size > 1000
    assert "6 scenario-days (2 values of backlash × 3 values of estimate_ratio)" in result.output
    assert "Do this: " in result.output
    again = fastcoil("run", "small.toml", "--no-figures")
    assert again.exit_code == 0
    assert "finished: nothing to do" in again.output


def test_plan_says_how_large_and_writes_nothing(tmp_path):
    result = fastcoil("plan", "small.toml")
    assert result.exit_code == 0, result.output
    assert "6 (2 values of backlash × 3 values of estimate_ratio)" in result.output
    assert all(part in result.output for part in ("3,600 s each, 21,600 in total", "Time:", "Memory:", "Disk:"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small.toml"]


@pytest.mark.parametrize(
    "words",
    [
        *(("run", "small.toml", *option) for option in (("-j", "0"), ("-o", "small.toml"), ("-o", ""))),
        *(("plot", *arguments) for arguments in (("",), ("nowhere",), ("nowhere", "--by", "kp"))),
        ("run", "absent.toml"),
        ("plan", "."),
    ],
)
def test_a_mistake_exits_with_2_and_one_sentence(tmp_path, words):
    assert_command_refused(*words)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small.toml"]


def test_a_label_with_commas_is_a_scenario_to_run_again(tmp_path):
    cases = '[cases.tuning]\n"slow, old" = { kp = 0.02 }\n"fast,new,1" = { kp = 0.03 }\n'
    text = f"[loop]\n{cases}[sweep]\nbacklash = [0.02, 0.07]\n[boundary]\nhours = 0.1\n[run]\nwarm_up = 60\n"
    (tmp_path / "cases.toml").write_text(text)
    assert fastcoil("run", "cases.toml", "--no-figures", "-j", "1").exit_code == 0
    for at in ("tuning=slow, old,backlash=0.07", "backlash=0.02,tuning=fast,new,1"):
        again = fastcoil("rerun", "results/cases", "--at", at)
        assert again.exit_code == 0, again.output
        assert "Equal to the study's result to the last bit." in again.output
    assert_command_refused("rerun", "results/cases", "--at", "tuning=slow, old,new=,backlash=0.07")
    assert_command_refused("rerun", "results/cases", "--at", "tuning=slow, old,backlash=0.07,backlash=0.02")


def test_failed_scenarios_exit_with_3(monkeypatch):
    from fastcoil.loops import simulate as simulation

    original = simulation.run_block

    def failing(*arguments):
        metrics, status, traces = original(*arguments)
        status[0] = 1
        metrics[:, 0] = float("nan")
        return metrics, status, traces

    monkeypatch.setattr(simulation, "run_block", failing)
    result = fastcoil("run", "small.toml", "-j", "1", "--no-figures")
    assert result.exit_code == 3
    assert "scenarios failed" in result.output


def test_an_interrupt_exits_with_130(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("fastcoil.study.run.make_pool", interrupted)
    result = fastcoil("run", "small.toml")
    assert result.exit_code == 130
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small.toml"]


def test_the_step_test_is_printed_without_a_target():
    result = fastcoil("explain", "--step-test")
    assert result.exit_code == 0
    assert "Ti of at least (kp K)^0.7 (T + 2 theta) / 4" in result.output


@pytest.mark.parametrize("command", ["export", "run"])
def test_a_preset_in_place_of_a_study_file_is_refused_with_the_file_to_write(command):
    assert_command_refused(command, "lbnl")
