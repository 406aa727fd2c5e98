"""Threads and processes: the same bits from each."""

import pytest
import xarray as xr
from helpers.full import full_except
from helpers.processes import cut_studies, start_python, wait_for_end

import fastcoil as fc
from fastcoil.loops import plan

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


def hash_of(results):
    return results.attrs["content_sha256"]


@pytest.mark.parametrize(
    ("backend", "n_jobs"), full_except([("threads", 2), ("threads", 3), ("loky", 1), ("loky", 2), ("loky", 3)], [])
)
def test_every_backend_with_any_number_of_workers_gives_the_same_bits(small_study, golden, tmp_path, backend, n_jobs):
    assert hash_of(fc.run_study(small_study, tmp_path / "out", backend=backend, n_jobs=n_jobs)) == golden
    assert hash_of(fc.open_study(tmp_path / "out")) == golden


@pytest.mark.parametrize("lane_steps", full_except([1.0, 1e12], [1e12]))
def test_the_size_of_shards_does_not_show(small_study, golden, tmp_path, monkeypatch, lane_steps):
    monkeypatch.setattr(plan, "_LANE_STEPS_PER_SHARD", lane_steps)
    assert hash_of(fc.run_study(small_study, tmp_path / "out", n_jobs=2)) == golden


@pytest.mark.parametrize(
    ("largest", "seed"), full_except([(1, 1), (9, 2), (20, 6), (40, 3), (64, 4), (80, 5)], [(64, 4)])
)
def test_the_order_and_cut_of_shards_does_not_show(small_study, golden, tmp_path, monkeypatch, largest, seed):
    cut_studies(monkeypatch, largest, seed)
    assert hash_of(fc.run_study(small_study, tmp_path / "out", n_jobs=2)) == golden


COMMAND = """
import sys
from fastcoil.cli.main import main
try:
    main()
finally:
    print("distributed:", "distributed" in sys.modules)
"""


@pytest.mark.parametrize(
    ("backend", "env"),
    [
        ("threads", {"PYTHONHASHSEED": "1"}),
        pytest.param("threads", {"PYTHONHASHSEED": "2", "NUMBA_NUM_THREADS": "1"}, marks=pytest.mark.full),
        pytest.param("loky", {"PYTHONHASHSEED": "3"}, marks=pytest.mark.full),
    ],
)
def test_the_environment_does_not_show_and_dask_is_not_loaded(small_study, golden, tmp_path, backend, env):
    words = ("-c", COMMAND, "run", small_study, "-o", "out", "--backend", backend, "-j", "2", "--no-figures")
    env |= {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    env |= {"OMP_NUM_THREADS": "99", "TZ": "Asia/Kathmandu"}
    code, out, err = wait_for_end(start_python(*words, cwd=tmp_path, **env))
    assert code == 0, err
    # it takes a second to load
    assert out.splitlines()[-1] == "distributed: False"
    assert (tmp_path / "out" / "study.toml").read_bytes() == small_study.read_bytes()
    with xr.open_dataset(tmp_path / "out" / "results.nc") as ds:
        assert hash_of(ds) == golden


@pytest.mark.full
def test_a_script_with_processes_needs_no_guard_around_its_main_part(small_study, golden, tmp_path):
    (tmp_path / "script.py").write_text(
        "import fastcoil as fc\n"
        f"ds = fc.run_study({str(small_study)!r}, 'out', backend='loky', n_jobs=1)\n"
        "print(ds.attrs['content_sha256'])\n"
    )
    code, out, err = wait_for_end(start_python("script.py", cwd=tmp_path))
    assert code == 0, err
    assert out.split() == [golden]
