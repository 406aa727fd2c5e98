"""The reports of diagnoses, fits, tunings and explanations, in Python and as an option of their commands."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from helpers.commands import fastcoil
from helpers.loop_logs import loop_log, write_log
from helpers.pages import Page
from helpers.simulated_logs import coil_log, flows, log_of, noisy, walk

import fastcoil as fc
from fastcoil.base.errors import InputError, InputTypeError
from fastcoil.deliver.report import page as pictures

pytestmark = pytest.mark.kernel


@pytest.fixture(autouse=True)
def _coarse_pictures(monkeypatch):
    """What is drawn does not matter here, and takes most of the time."""
    monkeypatch.setattr(pictures, "DPI", 40)


@pytest.fixture(scope="module")
def valve():
    """A fitted valve, whose log has a name that a browser would take for a script."""
    rng = np.random.default_rng(3)
    command = walk(rng, 300)
    return fc.fit_valve(log_of(command, noisy(rng, flows(command, backlash=0.06), 0.01)))


def page_of(result, path):
    page = Page(fc.report(result, path))
    page.require_alone()
    assert len(page.pictures) == 1
    assert fc.__version__ in page.text
    assert "Cai, Jie and Braun, James E. (2016)" in page.text
    return page.text


def test_a_fit_says_its_size_its_error_held_back_and_what_a_study_takes(valve, tmp_path):
    text = page_of(valve, tmp_path / "valve.html")
    low, high = valve.intervals["backlash"]
    assert (
        f"The gap is {100 * valve.parameters['backlash']:.2f} % of the stroke (95 %: {100 * low:.2f} to "
        f"{100 * high:.2f} %)."
    ) in text
    assert f"it never saw, the model errs by {valve.rmse['validation']:#.3g} kg/s (RMS)" in text
    assert all(name in text for name in valve.parameters)
    assert " ".join(valve.to_toml().split()) in text


def test_a_fit_that_is_not_identified_says_so_first_and_names_from_a_log_are_shown_and_not_run(valve, tmp_path):
    parameters = {n: v for n, v in valve.parameters.items() if n != "backlash"}
    intervals = {n: v for n, v in valve.intervals.items() if n != "backlash"}
    odd = {"source": "<script>x</script>.csv", "notes": ["</pre><img src=http://example.org/>"]}
    held = {"backlash": "not identified: too few turns"}
    text = page_of(replace(valve, parameters=parameters, intervals=intervals, held=held, **odd), tmp_path / "odd.html")
    assert text.index("Read this first backlash: not identified: too few turns") < text.index("Answer")
    assert "The log does not identify the size of the gap" in text
    assert "Valve fitted to <script>x</script>.csv" in text
    assert "</pre><img src=http://example.org/>" in text


@pytest.mark.full
def test_a_coil_and_a_loop_without_flow_meter_have_pages_too(tmp_path):
    assert "[fit.interval_95] C_w = " in page_of(fc.fit_coil(coil_log(hours=1.0)), tmp_path / "coil.html")
    day = fc.paper_day(hours=5, seed=1)
    loop = fc.Loop.preset("lbnl").assign(backlash=0.09, noise_std=0.02)
    log = fc.simulate(loop, day, traces=["command", "T_measured"])[["command", "T_measured"]]
    log = log.rename(T_measured="T_sup").isel(elapsed_time=slice(None, None, 30))
    for name in ("m_a", "T_a_in", "W_a_in", "T_w_in"):
        log[name] = day.to_dataset()[name].sel(elapsed_time=log["elapsed_time"])
    fit = fc.fit_loop(log, fc.Loop.preset("lbnl"))
    text = page_of(fit, tmp_path / "loop.html")
    assert f"The gap is {100 * fit.backlash:.2f} % of the stroke" in text
    assert "Which backlash does this valve have, seen from the supply air temperature?" in text


def test_a_diagnosis_on_the_command_line(tmp_path):
    write_log(loop_log(hours=1.0), tmp_path / "log.csv")
    page = tmp_path / "diagnosis.html"
    done = fastcoil("diagnose", tmp_path / "log.csv", "--report", page)
    assert done.exit_code == 0, done.output
    assert f"Report:  {page}" in done.output
    found = Page(page)
    found.require_alone()
    assert done.output.splitlines()[1] in found.text
    assert "Is it the valve? log.csv" in found.text
    assert "[fit.indices]" in found.text


@pytest.mark.full
def test_a_tuning_says_what_it_does_on_the_hold_out(tmp_path):
    loop = fc.Loop.preset("lbnl").assign(backlash=("sample", [0.0, 0.03, 0.06, 0.09]), noise_std=0.02)
    found = fc.tune(
        loop, fc.paper_day(hours=0.5, seed=[1, 2]), search={"kp": (0.01, 0.1)}, limits={"motor_travel": "now"},
        evaluations=20, warm_up=600, n_jobs=1,
    )  # fmt: skip
    text = page_of(found, tmp_path / "tuning.html")
    assert all(note in text for note in found.notes)
    value = found.held_out["change"].sel(tuning="chosen", edge="value")
    assert f"{float(value):+.0%} against now" in text
    assert tomllib.loads(found.to_toml())["loop"] == found.parameters
    assert " ".join(found.to_toml().split()) in text


@pytest.mark.full
def test_an_explanation_says_what_to_do(tmp_path):
    found = fc.explain(fc.Loop.preset("lbnl").assign(kp=0.03, ti=5), fc.paper_day(hours=2))
    text = page_of(found, tmp_path / "explanation.html")
    assert text.index(found.text.splitlines()[0]) < text.index("In one figure")
    assert "Do this: " in text
    assert all(words in text for words in found.cures["words"].values)
    done = fastcoil("explain", "lbnl", "--report", tmp_path / "lbnl.html")
    assert done.exit_code == 0, done.output
    assert "Will this loop hunt? kp = 0.018 1/K, ti = 30 s" in Page(tmp_path / "lbnl.html").text


@pytest.mark.parametrize(
    "words",
    [("diagnose", "log.csv"), ("fit", "valve", "log.csv"), ("fit", "coil", "log.csv"), ("explain", "lbnl"),
     ("fit", "loop", "log.csv", "--loop", "lbnl"), ("tune", "study.toml")],
)  # fmt: skip
def test_a_path_that_cannot_be_written_is_refused_before_anything_is_read(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = fastcoil(*words, "--report", "absent/page.html")
    assert done.exit_code == 2
    assert "--report absent/page.html: give a file NAME.html or NAME.htm in a folder that exists" in done.stderr
    assert not list(tmp_path.iterdir())


def test_what_has_no_page_is_refused_in_a_sentence(valve, tmp_path):
    with pytest.raises(InputTypeError, match="what is a Loop: give the folder of a study"):
        fc.report(fc.Loop(), tmp_path / "x.html")
    (tmp_path / "mine.html").write_text("<p>mine</p>")
    with pytest.raises(InputError, match=r"mine\.html: this file exists and is no report"):
        fc.report(valve, tmp_path / "mine.html")
    with pytest.raises(InputError, match=r"path is missing: give a file NAME.html, such as 'report.html'"):
        fc.report(valve)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.html"]
