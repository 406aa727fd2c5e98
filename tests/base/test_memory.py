"""Memory and processors: the least that machine, control groups and limits of the process leave; odd files are none."""

import os
import resource
import subprocess
import sys

import pytest
from helpers.processes import child_environment

from fastcoil.base import machine as memory

MIB = 2**20
MACHINE = "MemTotal:  8000000 kB\nMemAvailable:  4096000 kB\n"


@pytest.fixture
def write_system_files(tmp_path, monkeypatch):
    """Return a function that writes files of a machine: path → text."""
    monkeypatch.setattr(memory, "PROC", tmp_path / "proc")
    monkeypatch.setattr(memory, "CGROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))

    def write(texts):
        for name, text in ({"proc/meminfo": MACHINE} | texts).items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text if isinstance(text, bytes) else str(text).encode())

    write({})
    return write


def test_a_control_group_of_version_2_counts_what_it_can_take_back(write_system_files):
    assert memory.available_memory() == 4096000 * 1024, "that of the machine"
    group = "cgroup/user.slice/job"
    write_system_files({
        "proc/self/cgroup": "0::/user.slice/job\n",
        f"{group}/memory.max": 700 * MIB, f"{group}/memory.current": 300 * MIB,
        f"{group}/memory.stat": f"anon 5\ninactive_file {50 * MIB}\nactive_file 7\n",
    })  # fmt: skip
    assert memory.available_memory() == 450 * MIB
    write_system_files({f"{group}/memory.high": 600 * MIB})
    assert memory.available_memory() == 350 * MIB
    write_system_files({f"{group}/memory.high": "max", f"{group}/memory.max": "max"})
    assert memory.available_memory() == 4096000 * 1024


@pytest.mark.parametrize("level", ["cgroup/a/b", "cgroup/a", "cgroup"])
def test_the_tightest_level_up_to_the_root_rules(write_system_files, level):
    write_system_files({f"cgroup/a/b/memory.{name}": value for name, value in (("max", "max"), ("current", 1))})
    write_system_files({"proc/self/cgroup": "12:cpu:/x\n0::/a/b\n"})
    write_system_files({f"{level}/memory.max": 200 * MIB, f"{level}/memory.current": 150 * MIB})
    assert memory.available_memory() == 50 * MIB


@pytest.mark.parametrize(("quota", "n"), [("max 100000", 8), ("250000 100000", 3), ("900000 100000", 8)])
def test_the_quota_of_a_container_limits_the_processors(write_system_files, monkeypatch, quota, n):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    write_system_files({"cgroup/cpu.max": f"{quota}\n"})
    assert memory.count_processors() == n


def test_the_limit_of_the_process_less_what_it_has(write_system_files, monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", {resource.RLIMIT_AS: (800 * MIB, resource.RLIM_INFINITY)}.get)
    assert memory.available_memory() == 800 * MIB
    write_system_files({"proc/self/status": f"Name:\tpython\nVmSize:\t {300 * 1024} kB\n"})
    assert memory.available_memory() == 500 * MIB


@pytest.mark.parametrize("odd", [b"", b"\xff\xfe", b"-5", b"9" * 500, b"1.5", b"max 3", b"x" * 2**21, b"\0"])
def test_whatever_is_odd_is_no_limit(write_system_files, odd):
    cgroup = "4:memory:/\n0::/\n:::\n0::\n"
    write_system_files({"proc/self/cgroup": cgroup, "cgroup/memory.max": odd, "cgroup/memory.current": 1})
    assert memory.available_memory() == 4096000 * 1024
    write_system_files({"proc/self/cgroup": odd, "proc/meminfo": odd})
    assert memory.available_memory() == os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@pytest.mark.alone
@pytest.mark.kernel
@pytest.mark.parametrize("mib", [pytest.param(600, marks=pytest.mark.full), 700])
def test_at_a_limit_of_700_mb_a_user_gets_a_sentence(tmp_path, mib):
    (tmp_path / "large.toml").write_text(
        "[loop]\n[sweep]\nkp = { linspace = [0.01, 0.03, 1000] }\nti = { linspace = [5.0, 30.0, 900] }\n"
        "backlash = { linspace = [0.0, 0.1, 40] }\n"
    )
    command = [sys.executable, "-m", "fastcoil", "run", "large.toml", "-j", "2"]
    process = subprocess.run(
        command, check=False, cwd=tmp_path, env=child_environment(), capture_output=True, text=True, timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (mib * MIB, mib * MIB)),
    )  # fmt: skip
    assert process.returncode in (2, 4), process.stderr
    assert process.stderr.startswith("fastcoil: "), process.stderr
    assert "memory" in process.stderr
    assert "Traceback" not in process.stderr
    assert not (tmp_path / "results").exists()
