"""Scenarios that harm their worker, in a file that workers can import."""

import ctypes
import os
import resource
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.loops.scenarios import Layout


def kill_worker():
    os.kill(os.getpid(), signal.SIGKILL)


def exit_worker():
    os._exit(1)


def crash_worker():
    ctypes.string_at(0)


def raise_memory_error():
    raise MemoryError


def refuse_input():
    raise InputError("this reduction cannot be applied: give another")


def exhaust_memory():
    """Limit the memory of this process, then allocate more."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**20, resource.RLIM_INFINITY))
    np.ones(2**26)


def exit_at_start(*_):
    os._exit(1)


def sleep_briefly():
    time.sleep(0.5)


class HarmfulLayout(Layout):
    """A layout that harms the process, always a worker, that reads one of the scenarios ``culprits``.

    once: a file whose existence shows that the harm was done, and is not repeated.
    log: a file with a line for each shard: process, number of scenarios.
    """

    def __init__(self, layout, harm=None, culprits=(), once=None, log=None):
        self.__dict__.update(layout.__dict__)
        self._harm, self._culprits, self._once, self._log = harm, frozenset(culprits), once, log

    def columns(self, index):
        if self._log:
            with open(self._log, "a") as file:
                file.write(f"{os.getpid()} {index.size}\n")
        if self._harm and not self._culprits.isdisjoint(index.tolist()) and not self._is_done():
            self._harm()
        return super().columns(index)

    def _is_done(self):
        if self._once is None:
            return False
        try:
            Path(self._once).touch(exist_ok=False)
        except FileExistsError:
            return True
        return False


def with_harmful_layout(study, *arguments, **options):
    """Return the study with a ``HarmfulLayout``."""
    return replace(study, plan=replace(study.plan, layout=HarmfulLayout(study.plan.layout, *arguments, **options)))


def harm_every_study(monkeypatch, *arguments, **options):
    """Make every study that is read harm its workers."""
    from fastcoil.study.file import spec

    def read_study(*words, read=spec.read_study, **more):
        return with_harmful_layout(read(*words, **more), *arguments, **options)

    monkeypatch.setattr(spec, "read_study", read_study)
