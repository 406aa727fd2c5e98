"""A study's own code does not change the rest of the run: what the process shares with it is given back."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest

from fastcoil.study.workers.user_code import surroundings_restored

UPWARD = {"x86_64": 0x800, "aarch64": 0x400000}
"""The direction of rounding, as the C library numbers it."""


def look():
    return (
        os.getcwd(), sys.stdout, sys.stderr, sys.getrecursionlimit(), signal.getsignal(signal.SIGTERM), np.geterr(),
        warnings.showwarning, [each for each in warnings.filters if each[0] == "error"],
        float(np.add(1.0, np.array([2.0**-60]))[0]),
    )  # fmt: skip


def disturb_and_fail():
    os.chdir("/")
    sys.stdout = sys.stderr = None
    sys.setrecursionlimit(sys.getrecursionlimit() - 100)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    np.seterr(all="raise")
    warnings.showwarning = print
    warnings.simplefilter("error")
    ctypes.CDLL(None).fesetround(UPWARD.get(os.uname().machine, 0))
    raise ZeroDivisionError


def test_what_the_process_shares_is_as_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.resetwarnings()
        before = look()
        with pytest.raises(ZeroDivisionError), surroundings_restored():
            disturb_and_fail()
        assert look() == before


def test_deeper_recursion_and_silence_are_left(monkeypatch):
    before = sys.getrecursionlimit()
    with warnings.catch_warnings():
        with surroundings_restored():
            sys.setrecursionlimit(before + 100)
            warnings.filterwarnings("ignore", "of no interest")
        assert sys.getrecursionlimit() == before + 100
        assert warnings.filters[0][0] == "ignore"
    sys.setrecursionlimit(before)


def test_a_thread_that_enters_a_disturbed_process_does_not_keep_it_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    disturbed, entered = threading.Event(), threading.Event()

    def first():
        with surroundings_restored():
            os.chdir("/")
            disturbed.set()
            entered.wait(10)

    thread = threading.Thread(target=first)
    thread.start()
    assert disturbed.wait(10)
    with surroundings_restored():
        entered.set()
        thread.join()
        os.chdir("/")
    assert Path.cwd() == tmp_path
