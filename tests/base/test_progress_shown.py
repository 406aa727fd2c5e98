"""Progress is shown where someone looks, of work that takes a while, and ends with a whole line."""

import io
import logging
import multiprocessing
import sys
import threading
import time
import types

import pytest
from helpers.processes import wait_for

from fastcoil.base import progress as progress_module
from fastcoil.base.progress import ProgressDisplay, display_for_call


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def without_test_variables(monkeypatch):
    monkeypatch.setattr(progress_module, "_TEST_VARIABLES", ())


@pytest.fixture
def make_stderr_terminal(without_test_variables, monkeypatch):
    """Makes stderr a terminal, in the test itself: pytest sets it anew when a test begins."""

    def terminal():
        stderr = Terminal()
        monkeypatch.setattr(sys, "stderr", stderr)
        return stderr

    return terminal


@pytest.fixture
def short_delay(monkeypatch):
    """What takes long takes this test an instant."""
    monkeypatch.setattr(progress_module, "SECONDS_BEFORE_DISPLAY", 0.02)


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test sets."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_work_done_at_once_shows_nothing(make_stderr_terminal):
    terminal = make_stderr_terminal()
    for context in (display_for_call(None), ProgressDisplay()):
        with context as progress:
            progress.start(3)(3)
    assert terminal.getvalue() == ""
    assert progress_module.SECONDS_BEFORE_DISPLAY == 2.0


@pytest.mark.parametrize("start", [lambda: display_for_call(None), lambda: ProgressDisplay(delay=0.02)])
def test_a_bar_appears_before_anything_is_finished_and_says_what_is_done(make_stderr_terminal, short_delay, start):
    terminal = make_stderr_terminal()
    with start() as progress:
        advance = progress.start(6_000, 1_000)
        wait_for(lambda: "1000/6000" in terminal.getvalue())
        assert "\x1b[?25l" in terminal.getvalue()  # the cursor is hidden
        advance(2_000)
        wait_for(lambda: "3000/6000" in terminal.getvalue())
        advance(3_000)
        assert terminal.getvalue().endswith("\n\x1b[?25h")  # it is back, on a new line, before anything else is said
    assert "6000/6000" in terminal.getvalue()
    assert "scenario-days" in terminal.getvalue()


def test_a_script_is_told_only_on_request_in_lines_of_ten_seconds(without_test_variables, clock, capsys):
    for progress, lines in ((None, []), (False, []), (True, ["4 of 8 scenario-days, 11 s to go"])):
        with display_for_call(progress) as display:
            advance = display.start(8)
            clock[0] += 9.0
            advance(2)
            assert capsys.readouterr().err == ""
            clock[0] += 2.0
            advance(2)
            assert capsys.readouterr().err.splitlines() == lines
            clock[0] += 9.0
            advance(4)
        assert capsys.readouterr().err.splitlines() == ["8 scenario-days in 20 s"] * bool(lines)


def is_displayed_by_default():
    """Whether a call that did not ask shows anything here."""
    with display_for_call(None) as progress:
        return not progress.silent


def test_nobody_looks_at_a_test_a_worker_or_a_thread(make_stderr_terminal, monkeypatch):
    make_stderr_terminal()
    assert is_displayed_by_default()
    with monkeypatch.context() as patch:
        patch.setattr(progress_module, "_TEST_VARIABLES", ("PYTEST_CURRENT_TEST",))
        assert not is_displayed_by_default()
    with monkeypatch.context() as patch:
        patch.setattr(multiprocessing, "current_process", lambda: types.SimpleNamespace(name="LokyProcess-1"))
        assert not is_displayed_by_default()
    displayed_in_thread = []
    thread = threading.Thread(target=lambda: displayed_in_thread.append(is_displayed_by_default()))
    thread.start()
    thread.join()
    assert displayed_in_thread == [False]
    monkeypatch.setattr(sys, "stderr", None)
    assert not is_displayed_by_default()


def test_a_stderr_that_nobody_reads_ends_no_run(without_test_variables, monkeypatch):
    class ClosedStream(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stderr", ClosedStream())
    with display_for_call(True) as progress:
        progress.start(1)(1)


@pytest.mark.parametrize("progress", [False, True])
def test_a_program_gets_lines_from_the_logger_fastcoil_and_none_of_short_work(clock, caplog, progress):
    caplog.set_level(logging.INFO, "fastcoil")
    with display_for_call(progress) as display:
        advance = display.start(8)
        for seconds, n in ((9.0, 2), (2.0, 2), (11.0, 4)):
            clock[0] += seconds
            advance(n)
        display.start(1)(1)
    lines = ["4 of 8 scenario-days, 11 s to go", "8 scenario-days in 22 s"]
    assert [(record.name, record.levelname, record.getMessage()) for record in caplog.records] == [
        ("fastcoil", "INFO", w) for w in lines
    ]
