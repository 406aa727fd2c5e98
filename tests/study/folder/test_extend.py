"""Extending a study: old scenarios are kept to the last bit, only new ones are run, nothing else is touched."""

import copy
import json

import pytest
from helpers import failing_shards
from helpers.commands import fastcoil
from helpers.full import full_except
from helpers.processes import cut_studies
from helpers.refusals import assert_refused
from helpers.studies import copy_run, folder_contents, run_until_stopped

import fastcoil as fc
from fastcoil.base import files
from fastcoil.study import run as runner
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.run import execute

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120)]

BASE = {
    "loop": {"noise_std": 0.02},
    "sweep": {"backlash": [0.02, 0.05, 0.09], "estimate_ratio": [0.0, 1.0]},
    "cases": {"tuning": {"slow": {"kp": 0.02, "ti": 30}, "fast": {"kp": 0.03, "ti": 8}}},
    "boundary": {"hours": 0.25, "seed": [3, 5]},
    "run": {"warm_up": 100, "traces": ["T_sup", "mode"], "trace_interval": 100},
}
N = 24


def toml(tables):
    """The text of a study file."""

    def format_value(value):
        if isinstance(value, dict):
            return "{ " + ", ".join(f"{k} = {format_value(v)}" for k, v in value.items()) + " }"
        return json.dumps(value)

    lines = []
    for name, table in tables.items():
        nested = name == "cases"
        for part, values in table.items() if nested else [(None, table)]:
            lines.append(f"[{name}.{part}]" if part else f"[{name}]")
            lines += [f"{k} = {format_value(v)}" for k, v in values.items()]
    return "\n".join(lines) + "\n"


def run_shards(study, folder, n_shards):
    """Run a study until some shards are done, or else to its end.  Returns how many scenarios were run."""
    if n_shards:
        return run_until_stopped(study, folder, n_shards)
    return execute(study, folder).n_run


_fresh_hashes = {}


def fresh_hash(study, folder):
    """The hash of a study that is run at once, in a folder of its own; the same study is run only once."""
    key = study.title, study.text, study.sha256
    if key not in _fresh_hashes:
        _fresh_hashes[key] = execute(study, folder / "fresh").results.attrs["content_sha256"]
    return _fresh_hashes[key]


def change_tables(**parts):
    """The base study with some tables updated; a value of None takes the entry away."""
    tables = copy.deepcopy(BASE)
    for name, table in parts.items():
        tables[name] = {k: v for k, v in (tables[name] | table).items() if v is not None}
    return tables


@pytest.fixture
def base(tmp_path):
    """The folder ``out`` as a run of the base study leaves it."""
    copy_run(toml(BASE), tmp_path / "out")


@pytest.fixture
def study(tmp_path):
    """Return a function that reads a study from tables; all of them are in one file, as its versions are."""

    def read(tables):
        (tmp_path / "study.toml").write_text(toml(tables), encoding="utf-8")
        return read_study(tmp_path / "study.toml")

    return read


def extend(extension, tmp_path, *, n_kept=N, extend=True):
    """Run an extension: only what is new is run, and the result is that of a fresh run."""
    finished = execute(extension, tmp_path / "out", extend=extend)
    assert finished.n_run == extension.plan.n_scenarios - n_kept
    assert finished.results.attrs["content_sha256"] == fresh_hash(extension, tmp_path)


EXTENSIONS = {
    "middle": change_tables(sweep={"backlash": [0.02, 0.03, 0.04, 0.05, 0.09]}),
    "end": change_tables(sweep={"backlash": [0.02, 0.05, 0.09, 0.15]}),
    "another order": change_tables(sweep={"backlash": [0.09, 0.15, 0.02, 0.05]}),
    "a default that is swept": change_tables(sweep={"n_volumes": [4, 8]}),
    "all at once": change_tables(
        sweep={"backlash": [0.01, 0.02, 0.05, 0.09], "estimate_ratio": [0.0, 0.3, 1.0]},
        cases={"tuning": BASE["cases"]["tuning"] | {"faster": {"kp": 0.1, "ti": 20}}},
        boundary={"seed": [2, 3, 5]},
        run={"replicates": 2},
    ),
}


@pytest.mark.parametrize("name", full_except(EXTENSIONS, ["all at once"]))
def test_only_what_is_new_is_run_and_the_result_is_that_of_a_fresh_run(study, base, tmp_path, name):
    log = tmp_path / "log"
    extension = study(EXTENSIONS[name])
    finished = execute(failing_shards.with_harmful_layout(extension, log=log), tmp_path / "out", extend=True)
    assert finished.n_run == extension.plan.n_scenarios - N
    assert sum(int(line.split()[1]) for line in log.read_text().splitlines()) == finished.n_run
    assert finished.results.attrs["content_sha256"] == fresh_hash(extension, tmp_path)
    assert fc.open_study(tmp_path / "out").attrs["content_sha256"] == finished.results.attrs["content_sha256"]
    assert not (tmp_path / "out" / "shards").exists()
    assert len(list((tmp_path / "out").glob("traces-*.nc"))) == 1
    assert execute(study(EXTENSIONS[name]), tmp_path / "out", extend=True).n_run == 0


@pytest.mark.parametrize("again", [True, pytest.param(False, marks=pytest.mark.full)])
def test_an_extension_that_is_interrupted_goes_on(study, tmp_path, monkeypatch, again):
    done = run_shards(study(BASE), tmp_path / "out", 0)
    extension = study(EXTENSIONS["middle"])
    cut_studies(monkeypatch, 6)
    for _ in range(2):
        done += run_until_stopped(extension, tmp_path / "out", 1, extend=again or done <= N)
        partly = fc.open_study(tmp_path / "out")
        assert int((partly["status"] == 0).sum()) == done
        partly.close()
    extend(extension, tmp_path, n_kept=done, extend=again)


def kill_between_files(monkeypatch, study, out, **options):
    """A run that is killed after it wrote one of the two files that say what is run."""
    write_both, write_file, committed = StudyFolder.write_manifest, files.write_atomically, []

    def commit(path, data):
        if committed:
            raise KeyboardInterrupt
        committed.append(path)
        write_file(path, data)

    def write_one(*words):
        patch.setattr(files, "write_atomically", commit)
        write_both(*words)

    with monkeypatch.context() as patch:
        patch.setattr(StudyFolder, "write_manifest", write_one)
        with pytest.raises(KeyboardInterrupt):
            execute(study, out, **options)


def test_a_run_killed_before_its_first_shard_is_in_nobodys_way(study, tmp_path, monkeypatch):
    kill_between_files(monkeypatch, study(BASE), tmp_path / "out")
    extend(study(EXTENSIONS["end"]), tmp_path, n_kept=0)


def test_an_extension_killed_before_its_first_shard_loses_nothing(study, tmp_path, monkeypatch):
    run_shards(study(BASE), tmp_path / "out", None)
    kill_between_files(monkeypatch, study(EXTENSIONS["middle"]), tmp_path / "out", extend=True)
    with fc.open_study(tmp_path / "out") as results:
        assert int((results["status"] == 0).sum()) == N
        assert results.sizes["backlash"] == 3
    with pytest.raises(fc.IntegrityError, match="add --extend to go on"):
        execute(study(EXTENSIONS["middle"]), tmp_path / "out")
    assert execute(study(BASE), tmp_path / "out").n_run == 0
    kill_between_files(monkeypatch, study(EXTENSIONS["middle"]), tmp_path / "out", extend=True)
    extend(study(EXTENSIONS["end"]), tmp_path)


REFUSED = {
    "a removed value": change_tables(sweep={"backlash": [0.02, 0.09, 0.15]}),
    "a removed case": change_tables(cases={"tuning": {"slow": {"kp": 0.02, "ti": 30}}}),
    "a removed day": change_tables(boundary={"seed": [3, 4]}),
    "a changed constant": change_tables(loop={"noise_std": 0.03}),
    "another seed": change_tables(run={"seed": 1}),
    "another warm-up": change_tables(run={"warm_up": 200}),
    "other traces": change_tables(run={"traces": ["T_sup"]}),
}


@pytest.mark.parametrize("tables", REFUSED.values(), ids=REFUSED)
def test_what_is_no_extension_is_refused_and_nothing_touched(study, base, tmp_path, tables):
    check_refused(study, tmp_path, tables)


def test_an_unfinished_study_is_finished_before_it_is_extended(study, tmp_path, monkeypatch):
    cut_studies(monkeypatch, 8)
    untraced = {"run": {"traces": None, "trace_interval": None}}
    run_shards(study(change_tables(**untraced)), tmp_path / "out", None)
    smaller = study(change_tables(sweep={"backlash": [0.02, 0.03, 0.05, 0.09]}, **untraced))
    run_until_stopped(smaller, tmp_path / "out", 1, extend=True)
    larger = change_tables(sweep={"backlash": [0.02, 0.03, 0.05, 0.09, 0.11]}, **untraced)
    check_refused(study, tmp_path, larger)
    execute(smaller, tmp_path / "out")
    extend(study(larger), tmp_path, n_kept=smaller.plan.n_scenarios)


def check_refused(study, tmp_path, tables):
    before = folder_contents(tmp_path / "out")
    assert_refused("--extend", "conflict", execute, study(tables), tmp_path / "out", extend=True)
    assert folder_contents(tmp_path / "out") == before


@pytest.mark.parametrize("n_shards", [None, 2], ids=["finished", "unfinished"])
def test_without_extend_another_version_is_refused(study, tmp_path, monkeypatch, n_shards):
    cut_studies(monkeypatch, 6)
    run_shards(study(BASE), tmp_path / "out", n_shards)
    before = folder_contents(tmp_path / "out")
    study(EXTENSIONS["end"])
    words = ["run", tmp_path / "study.toml", "-o", tmp_path / "out", "--no-figures"]
    result = fastcoil(*words)
    assert result.exit_code == 2
    assert "add --extend if only values were added" in result.stderr
    assert str(tmp_path / "out" / "study.toml") in result.stderr
    assert "Traceback" not in result.output
    assert folder_contents(tmp_path / "out") == before


def test_traces_with_volumes_grow_with_the_largest_coil(study, tmp_path):
    traces = {"traces": ["T_c", "u"]}
    execute(study(change_tables(run=traces, loop={"n_volumes": 4})), tmp_path / "out")
    extend(study(change_tables(run=traces, sweep={"n_volumes": [8, 4]})), tmp_path)


def test_an_extension_without_new_scenarios_runs_none(study, base, tmp_path, monkeypatch):
    extension = study(change_tables(sweep={"backlash": [0.09, 0.05, 0.02]}))
    fresh_hash(extension, tmp_path)
    monkeypatch.setattr(runner, "make_pool", None)
    extend(extension, tmp_path)
