"""run.json, study.toml and the files a study reads: damage and changes are reported, and no result is lost."""

import json

import pytest
from helpers.full import full_except
from helpers.studies import (
    DAYS,
    PLAIN_STUDY,
    copy_run,
    folder_contents,
    quarantined_names,
    resume_to_end,
    run,
    run_until_interrupted,
    shard_files,
    undisturbed_hash,
    verify_unchanged,
    with_larger_sweep,
    write_study,
)

from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.model.numerics.jit import numeric_environment
from fastcoil.study import maintenance
from fastcoil.study import run as runner
from fastcoil.study.folder import state, stored
from fastcoil.study.folder.results import open_study

pytestmark = pytest.mark.kernel


def test_a_damaged_run_json_is_refused_and_nothing_is_lost(interrupted_folder):
    path = interrupted_folder / "run.json"
    good = path.read_bytes()
    for data, sentence in (
        *((data, "run.json is damaged") for data in (b"", b'{"study_sha', b"\xff\xfe", b"[1]", b"[" * 100_000)),
        (b'{"format": 1}', "another version of fastcoil"),
        (b'{"format": 2}', "run.json is damaged"),
        (b'{"format": 3}', "another version of fastcoil"),
    ):
        path.write_bytes(data)
        before = folder_contents(interrupted_folder)
        for what in (lambda out: run(PLAIN_STUDY, out), maintenance.verify, maintenance.status):
            with pytest.raises(IntegrityError, match=sentence) as refused:
                what(interrupted_folder)
            assert refused.value.exit_code == 6
        assert folder_contents(interrupted_folder) == before
    path.write_bytes(good)
    assert resume_to_end(interrupted_folder) == []


def test_without_run_json_the_shards_are_found_by_their_key(interrupted_folder, monkeypatch):
    (interrupted_folder / "run.json").unlink()
    compiled = []
    monkeypatch.setattr(runner, "compile_kernel", lambda: compiled.append(True))
    finished = runner.execute(write_study(PLAIN_STUDY, interrupted_folder), interrupted_folder, n_jobs=1)
    assert finished.n_run == finished.results["status"].size // DAYS
    assert finished.results.attrs["content_sha256"] == undisturbed_hash(PLAIN_STUDY)
    assert verify_unchanged(interrupted_folder) == []


@pytest.mark.parametrize("data", full_except([None, b"", b"[loop", b"\xff", b"[loop]\n"], [None, b"[loop"]), ids=str)
def test_a_damaged_study_toml_is_reported_and_written_again(interrupted_folder, data):
    path = interrupted_folder / "study.toml"
    path.unlink() if data is None else path.write_bytes(data)
    assert len(verify_unchanged(interrupted_folder)) >= 1
    for what in (maintenance.status, open_study):
        with pytest.raises(IntegrityError):
            what(interrupted_folder)
    with pytest.raises(IntegrityError if data in (None, b"\xff") else InputError):
        run(with_larger_sweep(PLAIN_STUDY), interrupted_folder)
    assert resume_to_end(interrupted_folder) == []
    assert path.read_text() == PLAIN_STUDY


def test_a_boundary_file_that_changes_between_a_run_and_its_resume_is_refused(out, tmp_path):
    log = tmp_path / "log.csv"
    head = "elapsed_time [s],m_a [kg/s],T_a_in [degC],W_a_in [g/kg],T_w_in [degC],T_set [degC]\n"
    good = head + "".join(f"{t},1.2,25,10,7,14\n" for t in range(0, 960, 60))
    log.write_text(good)
    text = PLAIN_STUDY.replace("hours = 0.25", "kind = 'csv'\npath = 'log.csv'")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("seed"))
    text = text.replace("[run]", "[run]\nreplicates = 33")  # two blocks
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastcoil.loops.plan._LANE_STEPS_PER_SHARD", 1)
        run_until_interrupted(text, out, 1)
    before = [p.read_bytes() for p in shard_files(out)]
    log.write_text(good.replace(",25,", ",26,", 1))
    with pytest.raises(IntegrityError, match="a file that the study reads changed") as refused:
        run(text, out)
    assert refused.value.exit_code == 6
    assert "the series of its [boundary] changed" in " ".join(verify_unchanged(out))
    assert [p.read_bytes() for p in shard_files(out)] == before
    log.unlink()
    assert "log.csv" in " ".join(verify_unchanged(out))
    log.write_text(good)
    assert run(text, out)
    assert verify_unchanged(out) == []


def test_other_sources_of_the_model_between_run_and_resume_run_everything_again(interrupted_folder, monkeypatch):
    done = [p.name for p in shard_files(interrupted_folder)]
    monkeypatch.setattr(state, "model_sha256", lambda: "another model")
    with pytest.warns(UserWarning, match="other sources of the model|another version of the model") as warned:
        finished = runner.execute(write_study(PLAIN_STUDY, interrupted_folder), interrupted_folder, n_jobs=1)
    assert "other sources of the model" in str(warned[0].message)
    assert len(warned) == 1 + len(done)
    assert finished.n_run == finished.results["status"].size
    assert quarantined_names(interrupted_folder) == done


WRONG = {
    "relative_to": [None, 5, [], "\ud800"],
    "model_sha256": [None, 1, "\ud800"],
    "computed_on": [None, 3, [1], [{"cpu": 1}]],
    "outputs": [None, [], {"results.nc": "text"}, {"results.nc": [1]}],
    "finished": ["yes", 3],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_a_value_of_the_wrong_type_in_run_json_is_reported(out, name, value):
    out.mkdir()
    stored.Manifest("a", "b", "c", "d").write(out)
    manifest = json.loads((out / "run.json").read_text()) | {name: value}
    content = {n: v for n, v in manifest.items() if n not in ("format", "sha256")}
    (out / "run.json").write_text(json.dumps(manifest | {"sha256": stored.checksum(content)}))
    with pytest.raises(IntegrityError, match=r"run\.json is damaged"):
        open_study(out)


def test_an_edited_run_json_is_found_by_its_checksum(out):
    copy_run(PLAIN_STUDY, out)
    path = out / "run.json"
    path.write_text(path.read_text().replace('"finished": true', '"finished": false'))
    for what in (open_study, maintenance.verify, lambda folder: run(PLAIN_STUDY, folder)):
        with pytest.raises(IntegrityError, match=r"run\.json is damaged \(its checksum differs\): move it away"):
            what(out)
    path.unlink()
    resume_to_end(out)


# --- where it was computed --------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(monkeypatch):
    """Another processor."""
    here = numeric_environment()
    monkeypatch.setattr("fastcoil.loops.simulate.numeric_environment", lambda: here | {"cpu": "another"})
    return [here, here | {"cpu": "another"}]


def test_a_run_says_where_it_was_computed(out):
    copy_run(PLAIN_STUDY, out)
    assert stored.Manifest.read(out).computed_on == [numeric_environment()]
    assert json.loads(open_study(out).attrs["computed_on"]) == [numeric_environment()]


def test_a_run_that_is_resumed_on_another_processor_says_so(interrupted_folder, elsewhere):
    (warned,) = resume_to_end(interrupted_folder)
    assert f"a part of {interrupted_folder} was computed elsewhere (cpu {elsewhere[0]['cpu']}, now another)" in warned
    assert stored.Manifest.read(interrupted_folder).computed_on == elsewhere
    assert json.loads(open_study(interrupted_folder).attrs["computed_on"]) == elsewhere
