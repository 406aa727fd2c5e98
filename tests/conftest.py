"""What several test files share: days, studies and their folders, the references, and what the interpreter skips."""

import csv
import gc
import importlib
import os
import signal
import tempfile
from functools import cache, partial
from pathlib import Path

# each process of pytest-xdist has a core of its own: a second thread of BLAS would only wait there, in a loop
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
import reference
from filelock import FileLock
from helpers import mistakes
from helpers.sentences import is_rewording, rewrite_snapshot
from hypothesis import settings

import fastcoil as fc

# a failed assertion tells in them what it found, as it does in a test
pytest.register_assert_rewrite(
    "helpers.commands", "helpers.dying_pool", "helpers.studies", "helpers.processes", "helpers.refusals"
)

# compiling a formula inside an example takes longer than hypothesis' deadline
settings.register_profile("fastcoil", deadline=None, derandomize=True, database=None)
settings.load_profile("fastcoil")


def pytest_configure(config):
    if is_rewording() and "PYTEST_XDIST_WORKER" not in os.environ:
        handle, os.environ["FASTCOIL_REWORD_FILE"] = tempfile.mkstemp(suffix=".tsv")
        os.close(handle)
    # started in the background of a script, it would be ignored by all processes that the tests interrupt
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # no test cuts the power; processes that tests start wait for the disk as a user's do
    os.fsync = lambda descriptor: None
    config.addinivalue_line("markers", "kernel: runs the lane kernel, which only the compiler makes fast enough")
    config.addinivalue_line("markers", "alone: measures time or signals processes; one such test at a time")
    config.addinivalue_line("markers", "full: takes long, or repeats a path; run by `make test-full`")


def pytest_unconfigure():
    if is_rewording() and "PYTEST_XDIST_WORKER" not in os.environ:
        rewrite_snapshot(Path(os.environ.pop("FASTCOIL_REWORD_FILE")))


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Without the collector of garbage, which would look again and again at modules that stay."""
    gc.disable()
    collected = yield
    gc.enable()
    gc.freeze()
    return collected


def pytest_collection_modifyitems(config, items):
    from fastcoil.model.numerics.jit import JIT_ENABLED

    # while one process compiles the kernel, the others have tests without it; what many tests share is started once
    shared_fixtures = ("forked", "two_workers")
    items.sort(
        key=lambda item: (
            bool(item.get_closest_marker("kernel")),
            *(n not in item.fixturenames for n in shared_fixtures),
        )
    )
    if not os.environ.get("FASTCOIL_FULL"):
        full_items = [item for item in items if item.get_closest_marker("full")]
        config.hook.pytest_deselected(items=full_items)
        items[:] = [item for item in items if item not in full_items]
    else:
        for item in items:
            item.add_marker(pytest.mark.timeout(3600))
    if not JIT_ENABLED:
        skip = pytest.mark.skip(reason="the lane kernel is too slow without the compiler (NUMBA_DISABLE_JIT=1)")
        for item in items:
            if item.get_closest_marker("kernel"):
                item.add_marker(skip)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    """Compile the kernel in one process of pytest-xdist for all, before the clock and the fixtures of a test start."""
    if item.get_closest_marker("kernel") and not item.get_closest_marker("skip"):
        compile_once(shared_folder(item.config._tmp_path_factory))
    return (yield)


@cache
def compile_once(folder):
    from fastcoil.model.engine.lanes import compile_kernel

    with FileLock(folder / "kernel.lock"):
        compile_kernel()


def shared_folder(tmp_path_factory):
    """A folder that all processes of pytest-xdist have in common."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(autouse=True)
def _one_at_a_time(request, tmp_path_factory):
    """Let a test marked ``alone`` wait until no other such test runs in another process of pytest-xdist."""
    if not request.node.get_closest_marker("alone"):
        yield
        return
    with FileLock(shared_folder(tmp_path_factory) / "alone.lock"):
        yield


@pytest.fixture(autouse=True)
def _mistakes_have_field_and_code():
    """Let a test fail in which the package reports a mistake without field or code."""
    mistakes.incomplete.clear()
    yield
    assert not mistakes.incomplete


@pytest.fixture(scope="session")
def one_hour_day():
    """One hour of the paper's kind of day: one set-point change, coil partly wet."""
    return fc.paper_day(hours=1, seed=1)


@pytest.fixture(scope="session")
def working_day():
    """Eight hours of the paper's kind of day."""
    return fc.paper_day(hours=8, seed=1)


@pytest.fixture(scope="session")
def half_hour_day():
    """Half an hour of the paper's kind of day."""
    return fc.paper_day(hours=0.5, seed=1)


@pytest.fixture(scope="session")
def run_reference():
    """Return a function that runs one loop through ``reference``: (traces as arrays like the package's, metrics).

    ``exact`` takes the reference's own Hyland-Wexler saturation instead of the package's.
    """
    from fastcoil.model.physics import saturation_humidity_ratio

    def run(loop, boundary, *, exact=False, **options):
        values = {"plant_gain": None, "estimator": None} | loop.constants
        if "rangeability" in values:
            curve = reference.valve_from_authority(*(values[n] for n in ("rangeability", "authority", "m_full")))
            values |= zip(("m_max", "valve_a", "valve_b", "valve_c"), curve, strict=True)
        if "estimate_ratio" in values:
            values["backlash_estimate"] = values["estimate_ratio"] * values["backlash"]
        parameters = {name: values.get(name, value) for name, value in reference.PAPER_LIKE.items()}
        series = {name: arrays[0].tolist() for name, arrays in boundary.series.items()}
        saturation = None if exact else saturation_humidity_ratio
        traces, metrics = reference.simulate(
            parameters, series, day=int(boundary.day[0]), saturation=saturation, **options
        )
        return {name: np.array(arrays, dtype=float).T for name, arrays in traces.items()}, metrics

    return run


@pytest.fixture(scope="module")
def psychrolib():
    """PsychroLib in SI units."""
    from fastcoil.model.numerics.jit import JIT_ENABLED

    if not JIT_ENABLED:
        pytest.skip("PsychroLib, where it finds Numba, needs the compiler to change its units")
    import psychrolib

    # it may have been imported, and its unit system set, by somebody else
    library = importlib.reload(psychrolib)
    library.SetUnitSystem(library.SI)
    return library


@pytest.fixture(scope="session")
def days():
    """Two quarters of an hour."""
    return fc.paper_day(hours=0.25, seed=[4, 1])


@pytest.fixture(scope="session")
def sweep():
    """Parameters with an axis of their own and zipped ones."""
    return {"backlash": [0.0, 0.07, 0.15], "kp": ("tuning", [0.01, 0.03]), "ti": ("tuning", [20.0, 8.0])}


@pytest.fixture(scope="session")
def swept_result(days, sweep):
    """A result with dims of every kind."""
    loop = fc.Loop(**sweep, noise_std=0.02, n_volumes=[4, 8])
    names = ["T_sup", "mode", "T_c"]
    return fc.simulate(loop, days, traces=names, trace_interval=50, warm_up=100, replicates=2, seed=7)


@pytest.fixture(scope="session")
def simulate_problems():
    """Return a function that gives the sentences with which ``simulate`` refuses its arguments."""
    from helpers.refusals import problems

    return partial(problems, fc.simulate)


@pytest.fixture
def blank_figures(monkeypatch):
    """Save figures with nothing on them: what is drawn takes most of the time, and `make test-full` draws it."""
    from matplotlib.figure import Figure

    if not os.environ.get("FASTCOIL_FULL"):
        save = Figure.savefig
        monkeypatch.setattr(Figure, "savefig", lambda _, *to, **options: save(Figure(figsize=(1, 1)), *to, **options))


@pytest.fixture
def write_log(tmp_path):
    """Return a function that writes a CSV file."""

    def write_csv(header, rows, name="log.csv"):
        path = tmp_path / name
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([header, *rows])
        return path

    return write_csv


@pytest.fixture
def valve_log(tmp_path):
    """Return a function that writes the log of a valve."""
    from helpers.log_files import VALVE_HEADER, write_csv

    return lambda rows, header=VALVE_HEADER: write_csv(tmp_path / "valve.csv", header, rows)


@pytest.fixture
def coil_log(tmp_path):
    """Return a function that writes the log of a coil."""
    from helpers.log_files import COIL_HEADER, write_csv

    return lambda rows, header=COIL_HEADER: write_csv(tmp_path / "coil.csv", header, rows)


@pytest.fixture(scope="session")
def small_study(tmp_path_factory):
    """A study file of 160 scenarios on two days, with traces."""
    from helpers import processes

    path = tmp_path_factory.mktemp("studies") / "small.toml"
    path.write_text(processes.STUDY_TEXT, encoding="utf-8")
    return path


@pytest.fixture
def study(small_study):
    """That study, read."""
    from fastcoil.study.file.spec import read_study

    return read_study(small_study)


@pytest.fixture(scope="session")
def healthy(small_study, tmp_path_factory):
    """The results of that study, when nothing happens to a worker."""
    return fc.run_study(small_study, tmp_path_factory.mktemp("healthy") / "out", n_jobs=1).load()


@pytest.fixture(scope="session")
def golden(healthy):
    """The hash of that study, from one thread."""
    return healthy.attrs["content_sha256"]


@pytest.fixture
def out(tmp_path):
    """The folder of a study."""
    return tmp_path / "out"


@pytest.fixture
def interrupted_folder(out):
    """The folder of a study that was interrupted with one shard to go."""
    from helpers.studies import DAYS, PLAIN_STUDY, copy_run, shard_files

    copy_run(PLAIN_STUDY, out, DAYS - 1)
    assert len(shard_files(out)) == DAYS - 1
    return out


@pytest.fixture(scope="session")
def run_forked():
    """Run a study or a command in a process forked for it, see ``helpers.forks``."""
    from helpers.forks import COMMAND_MODULES, fork_runner

    with fork_runner(*COMMAND_MODULES) as run:
        yield run


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory):
    """A dask scheduler and two workers, as a user starts them; idle, they take 6 % of a core."""
    from helpers import processes

    pytest.importorskip("distributed")
    with processes.run_cluster(tmp_path_factory.mktemp("cluster"), 2, "--no-nanny") as cluster:
        yield cluster
