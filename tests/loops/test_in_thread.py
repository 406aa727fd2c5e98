"""What a user's rule does not end, Ctrl-C does."""

import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest
from helpers.processes import child_environment
from helpers.rules import RULE_HEADER

from fastcoil.loops import simulate as running
from fastcoil.loops.simulate import call_with_timeout, run_interruptibly, run_on_threads


def test_only_blocks_with_rules_of_the_user_and_of_the_main_thread_get_a_thread(monkeypatch):
    monkeypatch.setattr(running, "run_block", lambda block, *_: threading.current_thread() is this_thread)
    this_thread = threading.current_thread()
    package_rule, user_rule = SimpleNamespace(fingerprint=""), SimpleNamespace(fingerprint="user")
    cases = ((None, None, True), (None, package_rule, True), (None, user_rule, False), (user_rule, None, False))
    for law, estimator, stays in cases:
        assert run_interruptibly(SimpleNamespace(law=law, estimator=estimator), None, None) is stays
    assert call_with_timeout(10.0, lambda: run_interruptibly(SimpleNamespace(law=user_rule), None, None)) is False
    assert call_with_timeout(10.0, lambda: threading.current_thread().daemon)


def test_threads_share_the_calls_and_the_first_error_ends_them():
    met, gate, begun, seen = threading.Barrier(2, timeout=10.0), threading.Event(), [], set()

    def call(k):
        seen.add(threading.current_thread())
        if k < 2:
            met.wait()  # two calls at once

    with run_on_threads(2, call, range(6)):
        pass
    assert len(seen) == 2
    assert all(thread.daemon for thread in seen)

    def failing(k):
        begun.append(k)
        if k == 0:
            raise ZeroDivisionError
        gate.wait(10.0)

    with pytest.raises(ZeroDivisionError), run_on_threads(2, failing, range(100)):
        pass
    gate.set()
    time.sleep(0.05)
    assert len(begun) == 2


ENDLESS_PROGRAM = f"""import math{RULE_HEADER}\
def endless(now, p, memory):
    x = 0.0
    while now.t > 100.0:
        x = math.sin(x) + 1e-9
    return p.gain + x, memory

endless.check()
print("ready", flush=True)
fc.simulate(fc.Loop(estimator=endless), fc.constant_day(hours=1), n_jobs=1)
"""


@pytest.mark.kernel
@pytest.mark.alone
def test_ctrl_c_ends_a_program_whose_rule_loops_for_ever():
    program = [sys.executable, "-c", ENDLESS_PROGRAM]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=child_environment()) as process:
        assert process.stdout.readline() == b"ready\n"
        time.sleep(2.0)
        assert process.poll() is None
        os.kill(process.pid, signal.SIGINT)
        try:
            _, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert b"KeyboardInterrupt" in err
    assert process.returncode in (-signal.SIGINT, 130)
