"""The figures of `fastcoil run`: those of these results, whatever happened before; `verify` tells those of others."""

import shutil

import pytest
from helpers.commands import fastcoil

from fastcoil.base.figures import current_figures, stale_figures
from fastcoil.study.folder.results import open_study

pytestmark = [pytest.mark.kernel, pytest.mark.usefixtures("blank_figures")]

SMALL_STUDY = """[loop]
[sweep]
backlash = [0.02, 0.07]
[cases.tuning]
slow = { kp = 0.02, ti = 30 }
fast = { kp = 0.03, ti = 8 }
[boundary]
hours = 0.25
[run]
warm_up = 100
"""
LARGER_STUDY = SMALL_STUDY.replace("[0.02, 0.07]", "[0.02, 0.05, 0.07]")
FIGURE_NAMES = ["bands.png", "tuning.png"]


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(SMALL_STUDY)
    return path


def run(study, *words):
    """Run the study in its folder.  Returns the names of the figures that the command names."""
    result = fastcoil("run", study, "-o", study.with_name("out"), "-j", 1, *words)
    assert result.exit_code == 0, result.output
    figures = [line.removeprefix("Figure:  ") for line in result.output.splitlines() if line.startswith("Figure:")]
    assert all(path.startswith(str(study.with_name("out") / "figures")) for path in figures)
    return [path.rpartition("/")[2] for path in figures]


def content_hash(study):
    return open_study(study.with_name("out")).attrs["content_sha256"]


def figure_times(study):
    return {path.name: path.stat().st_mtime_ns for path in (study.with_name("out") / "figures").iterdir()}


def test_a_finished_study_names_its_figures_and_draws_none_again(study):
    assert run(study) == FIGURE_NAMES
    before = figure_times(study)
    assert run(study) == FIGURE_NAMES
    assert figure_times(study) == before
    assert fastcoil("plot", study.with_name("out")).exit_code == 0
    after = figure_times(study)
    assert after.keys() == before.keys()
    assert all(after[name] > before[name] for name in before), "plot draws whatever is there"


def test_figures_of_the_smaller_study_are_never_named_once_it_is_extended(study):
    run(study)
    first = content_hash(study)
    study.write_text(LARGER_STUDY)
    assert run(study, "--extend", "--no-figures") == []
    out = study.with_name("out")
    assert [path.name for path in current_figures(out, first)] == FIGURE_NAMES
    verified = fastcoil("verify", out)
    assert verified.exit_code == 6
    cure = f"was drawn from other results: run `fastcoil plot {out}`, or delete it"
    assert verified.output.splitlines() == [f"fastcoil: {out / 'figures' / name} {cure}" for name in FIGURE_NAMES]
    assert run(study) == FIGURE_NAMES
    assert [path.name for path in current_figures(out, content_hash(study))] == FIGURE_NAMES
    assert fastcoil("verify", out).exit_code == 0


def test_other_figures_of_these_results_are_named_and_stale_ones_are_not(study):
    run(study, "--no-figures")
    out = study.with_name("out")
    assert fastcoil("plot", out, "-x", "backlash", "--metric", "iae").exit_code == 0
    assert fastcoil("plot", out, "--format", "pdf").exit_code == 0
    (out / "figures" / "own.png").write_bytes(b"by hand")
    assert run(study) == ["bands.png", "iae_backlash.png", "tuning.png"]
    study.write_text(LARGER_STUDY)
    assert run(study, "--extend") == FIGURE_NAMES
    assert [p.name for p in stale_figures(out, content_hash(study))] == ["bands.pdf", "iae_backlash.png", "tuning.pdf"]


@pytest.mark.full
@pytest.mark.alone
def test_a_kill_anywhere_loses_no_figure(study, run_forked):
    """Before its n-th operation on files, the last ones first: the figures of an extension are drawn last."""
    out, start = study.with_name("out"), study.with_name("start")
    run(study)
    shutil.copytree(out, start)
    study.write_text(LARGER_STUDY)
    order = {"arguments": ["run", str(study), "-o", str(out), "-j", "1", "--extend"]}
    code, n, output = run_forked(LARGER_STUDY, out, **order)
    assert code == 0, output
    assert run(study) == FIGURE_NAMES
    expected = {path.name: path.read_bytes() for path in (out / "figures").glob("*.png")}
    while n > 0:
        shutil.rmtree(out)
        shutil.copytree(start, out)
        assert run_forked(LARGER_STUDY, out, **order, kill_before=n)[:2] == (-9, n)
        assert run(study, "--extend", "--no-figures") == []
        assert run(study) == FIGURE_NAMES
        assert {path.name: path.read_bytes() for path in (out / "figures").glob("[!.]*")} == expected
        assert fastcoil("verify", out).exit_code == 0
        n -= 1
