"""Archives that somebody damaged or forged: one clear sentence, nothing unpacked beside its folder, nothing run."""

import io
import json
import random
import zipfile

import pytest
from helpers.commands import fastcoil
from helpers.damage import damage_bytes
from helpers.studies import PLAIN_STUDY, copy_run

from fastcoil.base.errors import IntegrityError
from fastcoil.study import maintenance
from fastcoil.study.archive import write_archive
from fastcoil.study.folder.stored import checksum

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The bytes of a sound archive of the folder ``out``."""
    folder = tmp_path_factory.mktemp("author") / "out"
    copy_run(PLAIN_STUDY, folder)
    return write_archive(folder)[0].read_bytes()


@pytest.fixture
def members(sound):
    """Name → bytes of its members."""
    with zipfile.ZipFile(io.BytesIO(sound)) as file:
        return {name: file.read(name) for name in file.namelist()}


def write_zip(path, contents, **changes):
    """A ZIP file as fastcoil writes it, but for what ``changes`` changes of a member: attributes of its ZipInfo."""
    with zipfile.ZipFile(path, "w") as file:
        for name, data in contents.items():
            info = zipfile.ZipInfo(name)
            info.external_attr, info.create_system = 0o100644 << 16, 3
            for key, value in changes.get(name, {}).items():
                setattr(info, key, value)
            file.writestr(info, data, compress_type=info.compress_type)
    return path


def only_problem(path):
    """The one sentence on an archive, which the command line gives with its exit code."""
    (problem,) = maintenance.verify(path)
    assert problem.startswith(str(path))
    done = fastcoil("verify", path)
    assert (done.exit_code, done.stderr) == (IntegrityError.exit_code, f"fastcoil: {problem}\n")
    return problem


def test_what_is_written_here_is_what_fastcoil_writes(members, tmp_path):
    """So that every test below fails for what it changes, and for nothing else."""
    assert maintenance.verify(write_zip(tmp_path / "x.zip", members)) == []


@pytest.mark.parametrize(
    "name", ["../evil", "/etc/evil", "out/../../evil", "out//evil", "out/\x1b[2J", "evil", "other/x"]
)
def test_no_name_leads_out_of_the_folder(members, tmp_path, name):
    place = tmp_path / "deep" / "er"
    place.mkdir(parents=True)
    assert only_problem(write_zip(place / "x.zip", members | {name: b"evil"}))
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == ["x.zip"]


def test_a_link_is_a_file_and_a_bomb_is_not_unpacked(members, tmp_path):
    link = {"out/results.nc": {"external_attr": 0o120777 << 16}}
    path = write_zip(tmp_path / "x.zip", members | {"out/results.nc": b"/etc/passwd"}, **link)
    assert "hash of its bytes differs" in only_problem(path)
    path = write_zip(tmp_path / "x.zip", members | {"out/bomb": bytes(10**8)}, **{"out/bomb": {"compress_type": 8}})
    assert path.stat().st_size < 10**6
    assert "nothing is unpacked" in only_problem(path)


def test_members_missing_and_changed(members, tmp_path):
    path = tmp_path / "x.zip"
    for name, sentence in (("results.nc", "results.nc is missing"), ("run.json", "run.json is missing")):
        assert sentence in only_problem(write_zip(path, {n: data for n, data in members.items() if n != f"out/{name}"}))
    changed_members = members | {"out/study.toml": members["out/study.toml"].replace(b"[0.0, 0.9]", b"[0.0, 0.8]")}
    assert "changed since the run was started" in maintenance.verify(write_zip(path, changed_members))[0]
    assert "run.json is missing" in only_problem(write_zip(path, {"out/x": b""}))


def test_a_manifest_that_agrees_with_a_forger_does_not_help(members, tmp_path):
    """A forger can write every hash of ours; what he cannot do is lead us elsewhere or pass other bytes for these."""
    run = json.loads(members["out/run.json"])

    def forged(**changes):
        content = {n: v for n, v in run.items() if n not in ("format", "sha256")} | changes
        data = json.dumps({**content, "format": run["format"], "sha256": checksum(content)}).encode()
        return members | {"out/run.json": data}

    for place in ("/etc", "../..", "inputs/../.."):
        assert "run.json leads out of the archive" in only_problem(
            write_zip(tmp_path / "a.zip", forged(relative_to=place))
        )
    assert "hash of its bytes differs" in only_problem(
        write_zip(tmp_path / "b.zip", forged(outputs={"results.nc": ["0" * 64]}))
    )


def test_whatever_happens_to_its_bytes_what_is_accepted_is_whole(sound, members, tmp_path):
    dice = random.Random(17)
    path = tmp_path / "x.zip"
    for _ in range(60):
        path.write_bytes(damage_bytes(sound, dice))
        problems = maintenance.verify(path)
        assert all("\n" not in problem for problem in problems)
        assert list(tmp_path.iterdir()) == [path]
        if not problems:  # dates, versions and bytes of no member are all that nobody hashes, and the README
            with zipfile.ZipFile(path) as file:
                contents = {name: file.read(name) for name in file.namelist()}
                assert contents | {"out/README.txt": b""} == members | {"out/README.txt": b""}
