"""run.json, study.toml and the files a study reads: damage and changes are reported, and no result is lost."""

import json

import pytest
from helpers.full import full_but
from helpers.studies import (
    DAYS,
    PLAIN,
    contents,
    copied,
    golden,
    larger,
    quarantined,
    resume,
    run,
    run_until_interrupted,
    shards,
    verify,
    write_study,
)

from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.model.numerics.jit import compiled_for
from fastcoil.study import maintenance
from fastcoil.study import run as runner
from fastcoil.study.file import spec
from fastcoil.study.folder import stored
from fastcoil.study.folder.results import open_study

pytestmark = pytest.mark.kernel


def test_a_damaged_run_json_is_refused_and_nothing_is_lost(broken_off):
    path = broken_off / "run.json"
    good = path.read_bytes()
    for data, sentence in (
        *((data, "run.json is damaged") for data in (b"", b'{"study_sha', b"\xff\xfe", b"[1]", b"[" * 100_000)),
        (b'{"format": 1}', "another version of fastcoil"),
        (b'{"format": 2}', "run.json is damaged"),
        (b'{"format": 3}', "another version of fastcoil"),
    ):
        path.write_bytes(data)
        before = {name: found for name, found in contents(broken_off).items() if name != ".lock"}
        for what in (lambda out: run(PLAIN, out), maintenance.verify, maintenance.status):
            with pytest.raises(IntegrityError, match=sentence) as refused:
                what(broken_off)
            assert refused.value.exit_code == 6
        assert {name: found for name, found in contents(broken_off).items() if name != ".lock"} == before
    path.write_bytes(good)
    assert resume(broken_off) == []


def test_without_run_json_the_shards_are_found_by_their_key(broken_off, monkeypatch):
    (broken_off / "run.json").unlink()
    asked = []
    monkeypatch.setattr(runner, "compile_kernel", lambda: asked.append(True))
    finished = runner.execute(write_study(PLAIN, broken_off), broken_off, n_jobs=1)
    assert finished.n_run == finished.results["status"].size // DAYS
    assert finished.results.attrs["content_sha256"] == golden(PLAIN)
    assert verify(broken_off) == []


@pytest.mark.parametrize("data", full_but([None, b"", b"[loop", b"\xff", b"[loop]\n"], [None, b"[loop"]), ids=str)
def test_a_damaged_study_toml_is_reported_and_written_again(broken_off, data):
    path = broken_off / "study.toml"
    path.unlink() if data is None else path.write_bytes(data)
    assert len(verify(broken_off)) >= 1
    for what in (maintenance.status, open_study):
        with pytest.raises(IntegrityError):
            what(broken_off)
    with pytest.raises(IntegrityError if data in (None, b"\xff") else InputError):
        run(larger(PLAIN), broken_off)
    assert resume(broken_off) == []
    assert path.read_text() == PLAIN


def test_a_boundary_file_that_changes_between_a_run_and_its_resume_is_refused(out, tmp_path):
    log = tmp_path / "log.csv"
    head = "elapsed_time [s],m_a [kg/s],T_a_in [degC],W_a_in [g/kg],T_w_in [degC],T_set [degC]\n"
    good = head + "".join(f"{t},1.2,25,10,7,14\n" for t in range(0, 960, 60))
    log.write_text(good)
    text = PLAIN.replace("hours = 0.25", "kind = 'csv'\npath = 'log.csv'")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("seed"))
    text = text.replace("[run]", "[run]\nreplicates = 33")  # two blocks
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastcoil.loops.plan._LANE_STEPS_PER_SHARD", 1)
        run_until_interrupted(text, out, 1)
    before = [p.read_bytes() for p in shards(out)]
    log.write_text(good.replace(",25,", ",26,", 1))
    with pytest.raises(IntegrityError, match="a file that the study reads changed") as refused:
        run(text, out)
    assert refused.value.exit_code == 6
    assert "the series of its [boundary] changed" in " ".join(verify(out))
    assert [p.read_bytes() for p in shards(out)] == before
    log.unlink()
    assert "log.csv" in " ".join(verify(out))
    log.write_text(good)
    assert run(text, out)
    assert verify(out) == []


def test_other_sources_of_the_model_between_run_and_resume_run_everything_again(broken_off, monkeypatch):
    done = [p.name for p in shards(broken_off)]
    monkeypatch.setattr(spec, "model_sha256", lambda estimators: "another model")
    with pytest.warns(UserWarning, match="other sources of the model|another version of the model") as warned:
        finished = runner.execute(write_study(PLAIN, broken_off), broken_off, n_jobs=1)
    assert "other sources of the model" in str(warned[0].message)
    assert len(warned) == 1 + len(done)
    assert finished.n_run == finished.results["status"].size
    assert quarantined(broken_off) == done


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
    found = json.loads((out / "run.json").read_text()) | {name: value}
    content = {n: v for n, v in found.items() if n not in ("format", "sha256")}
    (out / "run.json").write_text(json.dumps(found | {"sha256": stored.checksum(content)}))
    with pytest.raises(IntegrityError, match=r"run\.json is damaged"):
        open_study(out)


def test_an_edited_run_json_is_found_by_its_checksum(out):
    copied(PLAIN, out)
    path = out / "run.json"
    path.write_text(path.read_text().replace('"finished": true', '"finished": false'))
    for what in (open_study, maintenance.verify, lambda folder: run(PLAIN, folder)):
        with pytest.raises(IntegrityError, match=r"run\.json is damaged \(its checksum differs\): delete it"):
            what(out)
    path.unlink()
    resume(out)


# --- where it was computed --------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(monkeypatch):
    """Another processor."""
    here = compiled_for()
    monkeypatch.setattr("fastcoil.loops.simulate.compiled_for", lambda: here | {"cpu": "another"})
    return [here, here | {"cpu": "another"}]


def test_a_run_says_where_it_was_computed(out):
    copied(PLAIN, out)
    assert stored.Manifest.read(out).computed_on == [compiled_for()]
    assert json.loads(open_study(out).attrs["computed_on"]) == [compiled_for()]


def test_a_run_that_is_resumed_on_another_processor_says_so(broken_off, elsewhere):
    (warned,) = resume(broken_off)
    assert f"a part of {broken_off} was computed elsewhere (cpu {elsewhere[0]['cpu']}, now another)" in warned
    assert stored.Manifest.read(broken_off).computed_on == elsewhere
    assert json.loads(open_study(broken_off).attrs["computed_on"]) == elsewhere


# --- study.toml -------------------------------------------------------------------------------------------------------
