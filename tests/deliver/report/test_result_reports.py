"""The reports of diagnoses, tunings and explanations, in Python and as an option of their commands."""

from dataclasses import replace

import pytest
from helpers.commands import assert_command_refused, fastcoil
from helpers.loop_logs import make_loop_log, write_log
from helpers.pages import Page
from helpers.refusals import assert_refused

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.usefixtures("blank_figures")]


@pytest.fixture(scope="module")
def diagnosis():
    return fc.diagnose(make_loop_log(hours=1.0))


def report_text(result, path):
    page = Page(fc.report(result, path))
    page.assert_self_contained()
    assert len(page.pictures) == 1
    assert fc.__version__ in page.text
    assert "Cai, Jie and Braun, James E. (2016)" in page.text
    return page.text


def test_names_from_a_log_are_shown_and_not_run(diagnosis, tmp_path):
    hostile_texts = {"source": "<script>x</script>.csv", "notes": ["</pre><img src=http://example.org/>"]}
    text = report_text(replace(diagnosis, **hostile_texts), tmp_path / "odd.html")
    assert "Is it the valve? <script>x</script>.csv" in text
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


@pytest.mark.parametrize("words", [("diagnose", "log.csv"), ("explain", "lbnl"), ("tune", "study.toml")])
def test_a_path_that_cannot_be_written_is_refused_before_anything_is_read(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_command_refused(*words, "--report", "absent/page.html")
    assert not list(tmp_path.iterdir())


def test_what_has_no_page_is_refused_in_a_sentence(diagnosis, tmp_path):
    assert_refused("what", "type", fc.report, fc.Loop(), tmp_path / "x.html")
    (tmp_path / "mine.html").write_text("<p>mine</p>")
    assert_refused("path", "path", fc.report, diagnosis, tmp_path / "mine.html")
    assert_refused("path", "missing", fc.report, diagnosis)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.html"]
