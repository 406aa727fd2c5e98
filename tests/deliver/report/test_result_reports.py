"""The reports of diagnoses, fits, tunings and explanations, in Python and as an option of their commands."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.commands import assert_command_refused, fastcoil
from helpers.loop_logs import make_loop_log, write_log
from helpers.pages import Page
from helpers.refusals import assert_refused
from helpers.simulated_logs import add_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.usefixtures("blank_figures")]


@pytest.fixture(scope="module")
def valve():
    """A fitted valve, whose log has a name that a browser would take for a script."""
    rng = np.random.default_rng(3)
    command = random_walk(rng, 300)
    return fc.fit_valve(make_valve_log(command, add_noise(rng, valve_flows(command, backlash=0.06), 0.01)))


def report_text(result, path):
    page = Page(fc.report(result, path))
    page.assert_self_contained()
    assert len(page.pictures) == 1
    assert fc.__version__ in page.text
    assert "Cai, Jie and Braun, James E. (2016)" in page.text
    return page.text


def test_a_fit_says_its_size_its_error_held_back_and_what_a_study_takes(valve, tmp_path):
    text = report_text(valve, tmp_path / "valve.html")
    gap, low, high = (f"{100 * value:.2f}" for value in (valve.parameters["backlash"], *valve.intervals["backlash"]))
    assert f"The gap is {gap} % of the stroke (95 %: {low} to {high} %)." in text
    assert f"held back, the RMS error of the model is {valve.rmse['validation']:#.3g} kg/s" in text
    assert all(name in text for name in valve.parameters)
    assert " ".join(valve.to_toml().split()) in text


def test_a_fit_that_is_not_identified_says_so_first_and_names_from_a_log_are_shown_and_not_run(valve, tmp_path):
    parameters = {n: v for n, v in valve.parameters.items() if n != "backlash"}
    intervals = {n: v for n, v in valve.intervals.items() if n != "backlash"}
    hostile_texts = {"source": "<script>x</script>.csv", "notes": ["</pre><img src=http://example.org/>"]}
    held = {"backlash": "not identified: too few turns"}
    fit = replace(valve, parameters=parameters, intervals=intervals, held=held, **hostile_texts)
    text = report_text(fit, tmp_path / "odd.html")
    assert text.index("Read this first backlash: not identified: too few turns") < text.index("Answer")
    assert "The log does not identify the size of the gap" in text
    assert "Valve fitted to <script>x</script>.csv" in text
    assert "</pre><img src=http://example.org/>" in text


def test_a_diagnosis_on_the_command_line(tmp_path):
    write_log(make_loop_log(hours=1.0), tmp_path / "log.csv")
    page = tmp_path / "diagnosis.html"
    result = fastcoil("diagnose", tmp_path / "log.csv", "--report", page)
    assert result.exit_code == 0, result.output
    assert f"Report:  {page}" in result.output
    parsed_page = Page(page)
    parsed_page.assert_self_contained()
    assert result.output.splitlines()[1] in parsed_page.text
    assert "Is it the valve? log.csv" in parsed_page.text
    assert "[fit.indices]" in parsed_page.text


@pytest.mark.parametrize(
    "words",
    [("diagnose", "log.csv"), ("fit", "valve", "log.csv"), ("fit", "coil", "log.csv"), ("explain", "lbnl"),
     ("tune", "study.toml")],
)  # fmt: skip
def test_a_path_that_cannot_be_written_is_refused_before_anything_is_read(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_command_refused(*words, "--report", "absent/page.html")
    assert not list(tmp_path.iterdir())


def test_what_has_no_page_is_refused_in_a_sentence(valve, tmp_path):
    assert_refused("what", "type", fc.report, fc.Loop(), tmp_path / "x.html")
    (tmp_path / "mine.html").write_text("<p>mine</p>")
    assert_refused("path", "path", fc.report, valve, tmp_path / "mine.html")
    assert_refused("path", "missing", fc.report, valve)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.html"]
