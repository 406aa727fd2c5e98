"""Studies in their folder: the files of a run, finished studies, and failures that leave nothing."""

import errno
import json
import os
import re
import sys
import threading
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.refusals import refuses

import fastcoil as fc
from fastcoil.base.errors import InputError, StorageError
from fastcoil.study import run as runner
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder import state

pytestmark = pytest.mark.kernel

ROOT = Path(__file__).parents[2]
SMALL = """
title = "small"
question = "does it run?"
[loop]
preset = "paper_like"
[sweep]
backlash = [0.02, 0.07]
estimate_ratio = { linspace = [0.0, 1.5, 4] }
[cases.tuning]
slow = { kp = 0.02, ti = 30 }
fast = { kp = 0.03, ti = 8 }
[boundary]
hours = 1
[run]
traces = ["T_sup", "mode"]
trace_interval = 300
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder and the results of that study."""
    path = tmp_path_factory.mktemp("finished") / "small.toml"
    path.write_text(SMALL)
    return path.with_name("out"), fc.run_study(path, path.with_name("out"))


def test_results_are_labelled_as_an_xarray_user_expects(finished):
    _, ds = finished
    assert ds.rmse.sel(backlash=0.07, estimate_ratio=0.5, tuning="fast", method=None).ndim == 0
    for name, variable in ds.variables.items():
        assert variable.attrs.get("long_name"), name
        if variable.dtype.kind == "f":
            assert variable.attrs.get("units"), name
    assert ds.attrs["title"] == "small"
    assert ds.attrs["study_toml"] == SMALL
    assert json.loads(ds.attrs["parameters"])["C_w"] == 8.8
    assert ds.kp.dims == ("tuning",)
    assert ds.attrs["scenario_days_per_s"] * ds.attrs["wall_time_s"] == pytest.approx(16, rel=0.1)
    np.testing.assert_array_equal(ds.elapsed_time, np.arange(0, 3600, 300))


def test_results_of_other_physics_are_run_again(study, tmp_path, monkeypatch):
    fc.run_study(study, tmp_path / "out")
    monkeypatch.setattr(state, "model_sha256", lambda: "another model")
    with pytest.warns(UserWarning, match="other sources of the model: everything is computed again"):
        finished = runner.execute(read_study(study), tmp_path / "out")
    assert finished.n_run == 16
    assert finished.results.attrs["model_sha256"] == "another model"


def test_a_folder_that_holds_another_study_is_left_alone(study, tmp_path):
    fc.run_study(study, tmp_path / "out")
    before = (tmp_path / "out" / "results.nc").read_bytes()
    study.write_text(SMALL.replace("0.07", "0.08"))
    with refuses(("-o", "conflict")):
        fc.run_study(study, tmp_path / "out")
    assert (tmp_path / "out" / "results.nc").read_bytes() == before


def test_bad_input_leaves_no_folder(study, tmp_path):
    study.write_text(SMALL.replace("0.07", "7"))
    with pytest.raises(InputError):
        fc.run_study(study, tmp_path / "deep" / "out")
    assert not (tmp_path / "deep").exists()


def test_a_run_that_breaks_off_leaves_no_folder(study, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "make_pool", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        fc.run_study(study, tmp_path / "deep" / "out")
    assert not (tmp_path / "deep").exists()


def test_a_result_too_large_for_the_disk_is_refused_before_it_runs(study, tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("usage", (), {"free": 1000})())
    monkeypatch.setattr(runner, "make_pool", None)
    with pytest.raises(InputError, match=r"on disk, 1000 bytes are free"):
        fc.run_study(study, tmp_path / "out")


def test_a_folder_is_the_one_it_was_when_the_run_began(study, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)

    def move(*_):  # as a reduction in another thread may
        os.chdir(tmp_path / "elsewhere")
        return lambda _: None

    ds = runner.execute(read_study(study), Path("out"), progress=move).results
    assert fc.open_study(tmp_path / "out").attrs["content_sha256"] == ds.attrs["content_sha256"]
    assert not any((tmp_path / "elsewhere").iterdir())


def test_an_output_that_is_a_file_is_refused(study, tmp_path):
    with refuses(("-o", "path")):
        fc.run_study(study, study)


def test_a_cell_of_the_result_gives_back_its_loop(finished):
    _, ds = finished
    cell = ds.isel(backlash=1, estimate_ratio=2, tuning=0)
    alone = fc.simulate(fc.Loop.from_dataset(cell), fc.paper_day(hours=1))
    assert float(alone.rmse) == float(cell.rmse)


STUDIES = sorted(path for path in (ROOT / "studies").glob("*/*.toml") if path.parent.name != "year")
"""All but those that need a weather file."""


@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in STUDIES])
def test_every_study_of_the_repository_runs(path, tmp_path):
    text = path.read_text()
    for long, short in (
        (r"hours = \d+", "hours = 0.6"), ("warm_up = 10800", "warm_up = 1800"), (r"(seed = \[\d+).*\]", r"\1]"),
        (r", (15|31|34)\]", ", 3]"), (r"size = \d+", "size = 4"),
        (r"\n(learning_step|learning_interval|learning_ratio) = \[([^,\]]+),.*\]", r"\n\1 = [\2]"),
    ):  # fmt: skip
        text = re.sub(long, short, text)
    (tmp_path / path.name).write_text(text)
    ds = fc.run_study(tmp_path / path.name, tmp_path / "out")
    assert int(ds.status.max()) == 0
    assert bool(np.isfinite(ds.rmse).all())


def test_a_study_on_a_real_weather_year_runs_from_start_to_end(tmp_path):
    weather = ROOT.parent / "shared" / "data" / "san_francisco_tmy3_hourly.csv"
    if not weather.is_file():
        pytest.skip(f"no {weather.name} next to the repository")
    (tmp_path / "weather.csv").write_bytes(weather.read_bytes())
    (tmp_path / "weather.toml").write_text((ROOT / "studies" / "year" / "weather.toml").read_text())
    with pytest.warns(UserWarning, match="interpolated to 1 s"):
        ds = fc.run_study(tmp_path / "weather.toml", tmp_path / "out")
    assert dict(ds.rmse.sizes) == {"day": 4, "backlash": 5, "estimate_ratio": 16}
    assert int(ds.status.max()) == 0
    assert bool((ds.rmse.sel(estimate_ratio=0.9) < ds.rmse.sel(estimate_ratio=0.0)).all())


def test_a_reader_follows_a_study_to_its_results_through_forty_files(tmp_path):
    """Files of the package, without the model, whose functions a small study enters; imports do not count."""
    path, package, entered = tmp_path / "s.toml", Path(fc.__file__).parent, set()
    path.write_text("[loop]\n[sweep]\nbacklash_estimate = [0.0, 0.05]\n[boundary]\nhours = 0.6\n")
    fc.run_study(path, tmp_path / "warm", n_jobs=1)

    def enter(frame, event, _):
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.is_relative_to(package) and frame.f_code.co_name != "<module>":
            entered.add(file.relative_to(package).as_posix())

    threading.setprofile(enter)
    sys.setprofile(enter)
    try:
        fc.run_study(path, tmp_path / "out", n_jobs=1)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    assert len({name for name in entered if not name.startswith("model/")}) <= 40, sorted(entered)


def test_a_folder_that_cannot_be_written_is_refused(study, tmp_path, monkeypatch):
    read_only = OSError(errno.EROFS, os.strerror(errno.EROFS))
    monkeypatch.setattr("fastcoil.study.folder.folder._acquire_lock", Mock(side_effect=read_only))
    with pytest.raises(StorageError, match="Read-only file system; free some space or repair the folder"):
        fc.run_study(study, tmp_path / "other")
