"""A study in one file: what is in it, that it is the same everywhere, and that it works where it is unpacked."""

import shutil
import zipfile

import pytest
from helpers.commands import fastcoil
from helpers.studies import DAYS, PLAIN_STUDY, TRACED_STUDY, copy_run, folder_contents, run, undisturbed_hash

import fastcoil as fc
from fastcoil.study import maintenance
from fastcoil.study.archive import write_archive

pytestmark = pytest.mark.kernel

AT = "backlash=0.07,estimate_ratio=0.9,day=2"


def unpack(path, folder):
    """Unpack as a stranger does, on a machine that has nothing else of it."""
    with zipfile.ZipFile(path) as file:
        file.extractall(folder)
    (name,) = folder.iterdir()
    return name


def member_names(path):
    with zipfile.ZipFile(path) as file:
        return file.namelist()


def test_it_holds_study_results_traces_and_hashes_and_nothing_of_its_author(out, tmp_path):
    copy_run(TRACED_STUDY, out)
    fastcoil("rerun", out, "--at", AT)
    done = fastcoil("archive", out)
    path = out.with_name("out.zip")
    assert done.exit_code == 0, done.output
    assert done.output.startswith(f"Archive: {path} (")
    assert undisturbed_hash(TRACED_STUDY) in done.output
    (traces,) = (p.name for p in out.glob("traces-*.nc"))
    kept = ["README.txt", "results.nc", "run.json", "study.toml", traces]
    assert member_names(path) == [f"out/{name}" for name in kept]
    assert str(tmp_path).encode() not in path.read_bytes()
    with zipfile.ZipFile(path) as file:
        assert {info.date_time for info in file.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_the_same_results_give_the_same_bytes_wherever_they_lie(out, tmp_path):
    copy_run(PLAIN_STUDY, out)
    first = write_archive(out)[0].read_bytes()
    other = tmp_path / "elsewhere" / "out"
    other.parent.mkdir()
    shutil.copytree(out, other)
    assert write_archive(other, tmp_path / "two.zip")[0].read_bytes() == first


def test_it_is_accepted_elsewhere_and_what_is_unpacked_verifies_reruns_and_reports(out, tmp_path):
    copy_run(TRACED_STUDY, out)
    path = write_archive(out, tmp_path / "given.zip")[0]
    shutil.rmtree(out)
    (tmp_path / "study.toml").unlink()
    before = path.read_bytes()
    assert fastcoil("verify", path).output == f"{path} is sound.\n"
    assert path.read_bytes() == before
    folder = unpack(path, tmp_path / "there")
    assert maintenance.verify(folder) == []
    done = fastcoil("rerun", folder, "--at", AT)
    assert "Equal to the study's result to the last bit." in done.output
    assert fc.open_study(folder)["T_sup"].notnull().all()
    second_run = fastcoil("run", folder / "study.toml", "-o", folder, "-j", 1, "--no-figures")
    assert "finished: nothing to do" in second_run.output
    assert maintenance.verify(folder) == []


CODE = """
def warmest(ds):
    return ds[["T_sup"]].max("elapsed_time").rename(T_sup="warmest")
"""
READING = """
[loop]
include = ["fitted/valve.toml", "../shared/coil.toml"]
[sweep]
backlash_estimate = [0.0, 0.05]
[boundary]
kind = "csv"
path = "../../logs/day one.csv"
[run]
warm_up = 100
traces = ["T_sup"]
reduce = "mine:warmest"
"""


@pytest.fixture
def reading(tmp_path):
    """The folder of a study that reads files around it, and its own code."""
    home = tmp_path / "author" / "work" / "studies"
    for folder in (home / "fitted", home.parent / "shared", tmp_path / "author" / "logs"):
        folder.mkdir(parents=True)
    (home / "fitted" / "valve.toml").write_text("[loop]\nbacklash = 0.06\n")
    (home.parent / "shared" / "coil.toml").write_text("[loop]\nC_c = 25.0\n")
    (home / "mine.py").write_text(CODE)
    log = fc.paper_day(hours=0.25).to_dataset().to_dataframe()[["m_a", "T_a_in", "W_a_in", "T_w_in", "T_set"]]
    log.columns = ["m_a [kg/s]", "T_a_in [degC]", "W_a_in [kg/kg]", "T_w_in [degC]", "T_set [degC]"]
    log.index.name = "elapsed_time [s]"
    log.to_csv(tmp_path / "author" / "logs" / "day one.csv")
    (home / "study.toml").write_text(READING)
    out = tmp_path / "author" / "results" / "mine"
    done = fastcoil("run", home / "study.toml", "-o", out, "-j", 1, "--no-figures")
    assert done.exit_code == 0, done.output
    return out


def test_files_and_code_that_the_study_reads_are_packed_where_its_paths_lead(reading, tmp_path):
    done = fastcoil("archive", reading, "-o", tmp_path / "mine.zip")
    inputs = {line.split(":")[1].strip() for line in done.output.splitlines() if line.startswith("Input:")}
    base = "inputs/study/study"
    assert inputs == {
        *(f"{base}/{name}" for name in ("study.toml", "fitted/valve.toml", "mine.py")),
        "inputs/study/shared/coil.toml",
        "inputs/logs/day one.csv",
    }
    shutil.rmtree(tmp_path / "author")
    assert maintenance.verify(tmp_path / "mine.zip") == []
    folder = unpack(tmp_path / "mine.zip", tmp_path / "there")
    assert maintenance.verify(folder) == []
    done = fastcoil("rerun", folder, "--at", "backlash_estimate=0.05")
    assert "Equal to the study's result to the last bit." in done.output, done.output
    second_run = fastcoil("run", folder / base / "study.toml", "-o", tmp_path / "again", "-j", 1, "--no-figures")
    assert second_run.exit_code == 0, second_run.output
    hashes = {fc.open_study(f).attrs["content_sha256"] for f in (folder, tmp_path / "again")}
    assert len(hashes) == 1
    readme = (folder / "README.txt").read_text()
    assert f"fastcoil run mine/{base}/study.toml -o again" in readme
    (folder / "inputs" / "study" / "shared" / "coil.toml").write_text("[loop]\nC_c = 26.0\n")
    assert "changed since the run was started" in maintenance.verify(folder)[0]


def test_a_file_with_a_path_of_its_authors_machine_is_packed_and_told(tmp_path):
    log = tmp_path / "logs" / "valve.toml"
    log.parent.mkdir()
    log.write_text("[loop]\nbacklash_estimate = 0.05\n")
    text = PLAIN_STUDY.replace("[loop]", f'[loop]\ninclude = ["{log}"]').replace(
        "estimate_ratio = [0.0, 0.9]", "kp = [0.02, 0.03]"
    )
    out = tmp_path / "out"
    run(text, out)
    done = fastcoil("archive", out)
    assert f"the study reads {log}, which other machines do not have; packed as inputs/elsewhere/valve.toml" in (
        done.stderr
    )
    assert maintenance.verify(tmp_path / "out.zip") == []
    folder = unpack(tmp_path / "out.zip", tmp_path / "there")
    assert f"{log}   from inputs/elsewhere/valve.toml" in (folder / "README.txt").read_text()
    assert maintenance.verify(folder) == []
    log.unlink()
    assert "restore the files that it reads" in maintenance.verify(folder)[0]
    assert maintenance.verify(tmp_path / "out.zip") == []


def test_an_unfinished_study_is_not_packed(out):
    copy_run(PLAIN_STUDY, out, DAYS - 1)
    before = folder_contents(out.parent)
    done = fastcoil("archive", out)
    assert done.exit_code == 2
    assert "is unfinished: 8 of 12 scenarios are done" in done.stderr
    assert folder_contents(out.parent) == before


@pytest.mark.parametrize(
    ("name", "said"), [("out.zip", "exists: choose another name"), ("out.tar", "give a file NAME.zip")]
)
def test_nothing_is_replaced(out, name, said):
    copy_run(PLAIN_STUDY, out)
    path = out.with_name(name)
    path.write_text("mine")
    done = fastcoil("archive", out, "-o", path)
    assert done.exit_code == 2
    assert said in done.stderr
    assert path.read_text() == "mine"


@pytest.mark.parametrize("command", ["report", "plot", "cite", "status", "archive", ("rerun", "--at", AT), "export"])
def test_where_a_folder_is_wanted_an_archive_is_to_be_unpacked_first(out, tmp_path, command):
    copy_run(PLAIN_STUDY, out)
    path = write_archive(out, tmp_path / "given.zip")[0]
    name, *options = [command] if isinstance(command, str) else command
    done = fastcoil(name, path, *options, *(["--csv"] if name == "export" else []))
    assert done.exit_code == 2
    assert f"{path} is an archive: unpack it with `unzip {path}`" in done.output
