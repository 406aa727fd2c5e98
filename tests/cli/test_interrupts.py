"""How a command ends where the surroundings are odd: no folder to be in, Python's and matplotlib's own settings."""

import signal
import subprocess
import sys
import warnings

import click
import pytest
from click.testing import CliRunner
from helpers.processes import child_environment
from helpers.studies import PLAIN_STUDY, run_until_interrupted

from fastcoil.base.progress import ProgressDisplay
from fastcoil.cli import terminal
from fastcoil.cli.terminal import CommandGroup, handle_interrupts
from fastcoil.model.numerics.jit import JIT_ENABLED


@pytest.mark.parametrize("kind", [UserWarning, DeprecationWarning, RuntimeWarning])
def test_a_warning_is_a_note_though_python_is_set_to_raise_it(kind):
    def warn():
        warnings.warn("in passing", kind, stacklevel=2)

    commands = CommandGroup(commands=[click.Command("warn", callback=warn)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        before = list(warnings.filters)
        result = CliRunner().invoke(commands, ["warn"])
        assert warnings.filters == before
    assert (result.exit_code, result.stderr) == (0, "fastcoil: note: in passing\n")


RUN_AND_PLOT = """
import sys
from fastcoil.cli.main import main
for words in (["run", "study.toml", "-o", "out", "-j", "1"], ["plot", "out", "-x", "backlash", "--metric", "rmse"]):
    try:
        main(words)
    except SystemExit as end:
        print(words[0], "ends with", end.code or 0, flush=True)
"""


@pytest.mark.kernel
def test_no_setting_of_python_or_matplotlib_stops_a_command(out):
    run_until_interrupted(PLAIN_STUDY.replace("estimate_ratio", "# estimate_ratio"), out, 1)
    (out / "shards" / "notes.txt").write_text("mine")
    env = child_environment(PYTHONWARNINGS="error", MPLBACKEND="no such backend")
    options = {"cwd": out.parent, "capture_output": True, "text": True, "timeout": 120, "env": env}
    process = subprocess.run([sys.executable, "-c", RUN_AND_PLOT], check=False, **options)
    ends = [line for line in process.stdout.splitlines() if "ends with" in line]
    assert ends == ["run ends with 0", "plot ends with 0"], process
    assert "Traceback" not in process.stderr
    assert "/out/shards/notes.txt is not a shard" in process.stderr
    assert (out / "figures" / "rmse_backlash.png").stat().st_size > 1000


@pytest.mark.alone
def test_two_interruptions_at_once_are_one(tmp_path, monkeypatch):
    signal_numbers, unraisable = {signal.SIGINT, signal.SIGTERM}, []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    monkeypatch.setattr(terminal, "_MAX_SHUTDOWN_SECONDS", 3600.0)  # the process is not to end
    signal.pthread_sigmask(signal.SIG_BLOCK, signal_numbers)

    def interrupt():
        with handle_interrupts(ProgressDisplay(), tmp_path / "study.toml", tmp_path):
            for number in signal_numbers:
                signal.raise_signal(number)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, signal_numbers)
            sum(range(1000))

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupt()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signal_numbers)
    assert not unraisable


LINGERING_THREAD = """
import threading, time
from fastcoil import __main__ as entry
def linger():
    time.sleep(0.2)
    print("at its end", flush=True)
    time.sleep(60)
entry.main = lambda: threading.Thread(target=linger).start()
entry.run()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no process there ends by a signal")
def test_ctrl_c_while_a_finished_command_waits_for_a_thread_says_nothing():
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, "-c", LINGERING_THREAD], env=child_environment(), **pipes)
    assert process.stdout.readline() == "at its end\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (-signal.SIGINT, "")


@pytest.mark.alone
@pytest.mark.skipif(not JIT_ENABLED, reason="nothing is compiled")
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_kernels_are_compiled_is_a_sentence(signal_number, tmp_path):
    (tmp_path / "study.toml").write_text(PLAIN_STUDY)
    command = [sys.executable, "-m", "fastcoil", "run", "study.toml", "--no-figures"]
    options = {"env": child_environment(XDG_CACHE_HOME=str(tmp_path)), "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=tmp_path, **options) as process:
        assert process.stderr.readline().startswith("Compiling ")
        process.send_signal(signal_number)
        assert process.stderr.read().startswith("fastcoil: interrupted")
    assert process.returncode == 128 + signal_number
