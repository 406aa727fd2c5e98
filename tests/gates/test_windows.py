"""Windows as far as Linux can play it: without what it lacks, every entry works and gives the same numbers.

Emulated, see ``helpers.windows``: the compiler, HDF5 and the locks are those of Linux.  ``.github/workflows`` has the
real one.
"""

import json
import subprocess
import sys
from pathlib import Path, PureWindowsPath

import pytest
from helpers import day_on_windows, windows
from helpers.processes import child_environment

from fastcoil.base import machine
from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import _URL_START
from fastcoil.loops import netcdf

is_linux = pytest.mark.skipif(sys.platform != "linux", reason="open files are looked up in /proc")
pytestmark = [pytest.mark.kernel, is_linux]


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    """What came of each step of a user there."""
    folder = tmp_path_factory.mktemp("windows")
    command = "-X", "warn_default_encoding", "-W", "ignore::EncodingWarning", "-m", "helpers.day_on_windows", folder
    process = subprocess.run(
        [sys.executable, *map(str, command)], check=False, cwd=folder, env=child_environment(PYTHONIOENCODING="cp1252"),
        capture_output=True, timeout=280, encoding="cp1252",
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout.splitlines()[-1]) | {"stderr": process.stderr}


@pytest.mark.parametrize("name", day_on_windows.STEPS)
def test_nothing_fails_there_and_nothing_is_warned_of(day, name):
    assert "Traceback" not in str(day[name]), day[name]
    assert not day[f"{name}: warnings"]


@pytest.mark.parametrize("name", ["simulate", "explain", "diagnose", "export_controller"])
def test_what_is_computed_is_the_same_there(day, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = day_on_windows.STEPS[name]()
    assert day[name] == json.loads(json.dumps(here))


def test_a_study_is_interrupted_resumed_and_sound_there(day, golden, healthy):
    assert day["interrupted_study"] == [1, False]
    digest, total, problems = day["resumed_study"]
    assert (digest, problems) == (golden, [])
    assert total == pytest.approx(float(healthy.T_sup.sum()))


def test_results_that_somebody_reads_are_replaced_after_that_or_a_sentence_says_why_not(day):
    assert day["results_that_somebody_looks_at"] == ["Getriebespiel – Länge Δ", True]
    sentence = "results.nc cannot be written: Access is denied; close the program that has it open"
    assert sentence in day["results_that_stay_open"]


def test_a_file_without_a_recorded_hash_is_probed_there(day):
    total, probed, refused = day["unknown_netcdf"]
    assert total > 0.0
    assert probed
    assert "damaged.nc cannot be read as NetCDF" in refused


def test_memory_commands_and_signals_are_those_of_windows_and_a_folder_whose_mode_says_nothing_keeps_kernels(day):
    assert day["kernels_are_kept"] == [True, True]
    typed = 'fastcoil run "my study.toml" -o C:\\results\\a'
    assert day["machine"] == [windows.MEMORY_BYTES, typed, 1, False]


def test_the_command_works_there_and_says_what_its_code_page_has_no_letter_for(day):
    assert "Traceback" not in day["stderr"], day["stderr"]
    assert day["commands"] == [[0, 0, 2], True]


# ------------------------------------------------------------------------------------------------------ alone, in part


def test_a_crash_of_the_library_is_told_from_a_signal_and_by_its_code(tmp_path, monkeypatch):
    path = tmp_path / "foreign.nc"
    for code, words in ((-11, "signal 11"), (0xC0000005, "code 0xc0000005")):
        path.write_bytes(code.to_bytes(8, "little", signed=True))
        process = subprocess.CompletedProcess([], code, b"", b"")
        monkeypatch.setattr(netcdf.subprocess, "run", lambda *_, process=process, **__: process)
        with pytest.raises(IntegrityError, match=f"the library ended with {words}"):
            netcdf.probe_file(path, "delete it")


def test_only_windows_is_patient_with_a_refused_change(monkeypatch):
    tries = []

    def refused():
        tries.append(1)
        if len(tries) < 4:
            raise PermissionError
        return "done"

    with pytest.raises(PermissionError):
        machine.retry_while_locked(refused)
    monkeypatch.setattr(machine, "IS_POSIX", False)
    assert machine.retry_while_locked(refused) == "done"
    monkeypatch.setattr(machine, "_MAX_LOCKED_SECONDS", 0.0)
    del tries[:]
    with pytest.raises(PermissionError):
        machine.retry_while_locked(refused)


def test_a_worker_waits_there_for_the_process_itself(monkeypatch):
    calls = []

    class Win:
        OpenProcess = staticmethod(lambda *words: calls.append(words) or 7)
        WaitForSingleObject = staticmethod(lambda *words: calls.append(words))

    monkeypatch.setitem(sys.modules, "_winapi", Win)
    monkeypatch.setattr(machine.sys, "platform", "win32")
    machine.wait_for_parent_exit(42)
    assert calls == [(0x100000, False, 42), (7, -1)]


@pytest.mark.parametrize("path", [r"C:\results\a", "C:/results/a", r"\\server\share\a", r"results\a"])
def test_drive_letters_and_backslashes_are_no_addresses_and_no_names(path):
    assert not _URL_START.match(path)
    assert "\\" not in PureWindowsPath(path).as_posix()


def test_no_file_but_machine_asks_for_what_only_unix_has():
    words = (*(f"os.{n}" for n in windows.MISSING_OS_NAMES), *(f"import {n}" for n in windows.MISSING_MODULES),
             "signal.SIGHUP", "signal.SIGKILL", "import msvcrt", "sys.platform ==", "os.name")  # fmt: skip
    package = Path(machine.__file__).parents[1]
    texts = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py") if path.name != "machine.py"}
    uses = [(path, word) for path, text in texts.items() for word in words if word in text]
    places = {f"{path.relative_to(package).as_posix()}: {word}" for path, word in uses}
    # guarded there: the package loads nothing else, and the lock is the library's
    assert places == {"__init__.py: os.register_at_fork", "loops/netcdf.py: os.register_at_fork"}
