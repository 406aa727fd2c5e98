"""Steps of a user in a process as on Windows: prints as JSON a value or a traceback for each."""

import json
import os
import sys
import threading
import time
import traceback
import warnings
from pathlib import Path

import numpy as np

STEPS = {}


def study_text(title="Größe"):
    from helpers.processes import STUDY_TEXT

    return STUDY_TEXT.replace("Größe", title)


def step(function):
    STEPS[function.__name__] = function
    return function


def example_loop_and_day():
    import fastcoil as fc

    return fc.Loop.preset("paper_like").assign(backlash=[0.03, 0.07], noise_std=0.01), fc.paper_day(hours=1, seed=1)


@step
def simulate():
    import fastcoil as fc

    return fc.simulate(*example_loop_and_day(), traces=["T_sup"]).attrs["content_sha256"]


@step
def explain():
    import fastcoil as fc

    loop, day = example_loop_and_day()
    return str(fc.explain(loop.assign(backlash=0.07), day))


@step
def diagnose():
    import fastcoil as fc

    day = fc.paper_day(hours=4, seed=2)
    loop = fc.Loop.preset("paper_like").assign(backlash=0.07)
    ds = fc.simulate(loop, day, traces=["T_sup", "command"], trace_interval=10)
    t, T_set = ds.elapsed_time.values, day.to_dataset().T_set.sel(elapsed_time=ds.elapsed_time).values
    rows = np.column_stack([t, 100 * ds.command, ds.T_sup, T_set])
    header = "elapsed_time [s],command [%],T_sup [degC],T_set [degC]"
    np.savetxt("log.csv", rows, "%.3f", delimiter=",", header=header, comments="")
    diagnosis = fc.diagnose("log.csv", stroke_time=90)
    return [diagnosis.backlash, diagnosis.cause, str(diagnosis)]


@step
def export_controller():
    import fastcoil as fc

    fc.export_controller(fc.Loop.preset("lbnl"), "inverse.c", language="c")
    return Path("inverse.c").read_text(encoding="utf-8")


@step
def interrupted_study():
    """Interrupt after the first shard: there are shards and no results."""
    from fastcoil.loops import plan
    from fastcoil.study import run
    from fastcoil.study.file.spec import read_study

    Path("small.toml").write_text(study_text(), encoding="utf-8")
    run.cut_into_shards = lambda *words: [part for shard in plan.cut_into_shards(*words) for part in shard.halves()]

    def stop(n):
        raise KeyboardInterrupt

    try:
        run.execute(read_study(Path("small.toml")), Path("out"), n_jobs=1, progress=lambda *_: stop)
    except KeyboardInterrupt:
        return [len(list(Path("out/shards").glob("*.nc"))), Path("out/results.nc").exists()]


@step
def resumed_study():
    import fastcoil as fc
    from fastcoil.study import maintenance

    ds = fc.run_study("small.toml", "out", n_jobs=2)
    traced = fc.open_study("out")
    return [ds.attrs["content_sha256"], float(traced.T_sup.sum()), maintenance.verify(Path("out"))]


def _run_with_title(title):
    import fastcoil as fc

    Path("small.toml").write_text(study_text(title), encoding="utf-8")
    return fc.run_study("small.toml", "out", n_jobs=1).attrs["title"]


@step
def results_that_somebody_looks_at():
    """Results are replaced once the reader has closed them."""
    reader = open("out/results.nc", "rb")  # noqa: SIM115
    threading.Timer(0.5, reader.close).start()
    start = time.monotonic()
    return [_run_with_title("Länge"), time.monotonic() - start > 0.4]


@step
def results_that_stay_open():
    import fastcoil as fc
    from fastcoil.base import machine

    with open("out/results.nc", "rb"):
        machine._MAX_LOCKED_SECONDS = 0.2
        try:
            _run_with_title("Breite")
        except fc.StorageError as error:
            return str(error)


@step
def unknown_netcdf():
    """A file without a recorded hash is read by another process, also as on Windows."""
    from fastcoil.loops import netcdf

    probe = Path("probe.py").absolute()
    probe.write_text(
        "import json, runpy, sys\nsys.path[:] = json.loads(sys.argv[4])\nfrom helpers.windows import emulate\n"
        "emulate(('netCDF4', 'ctypes'))\n"
        f"runpy.run_path({str(netcdf._PROBE_SCRIPT)!r}, run_name='__main__')\nopen('probed', 'w').close()\n",
        encoding="utf-8",
    )
    netcdf._PROBE_SCRIPT = probe
    data = Path("out/results.nc").read_bytes()
    Path("copy.nc").write_bytes(data)
    Path("damaged.nc").write_bytes(data[:5000])
    outcome = [float(np.nansum(netcdf.probe_file(Path("copy.nc"), "copy it").load().rmse)), Path("probed").exists()]
    try:
        netcdf.probe_file(Path("damaged.nc"), "copy it")
    except Exception as error:
        return [*outcome, str(error)]


@step
def kernels_are_kept():
    """In a folder whose mode is meaningless there."""
    from fastcoil.model.numerics.jit import fingerprint
    from fastcoil.model.numerics.kernel_cache import kernel_folder

    folder = kernel_folder(fingerprint())
    mode = folder.stat().st_mode
    os.chmod(folder, 0o777)
    kernel_folder.cache_clear()
    try:
        return [kernel_folder(fingerprint()) == folder, any(folder.glob("*.emulate-*.nbc"))]
    finally:
        os.chmod(folder, mode & 0o777)


@step
def machine():
    from fastcoil.base import machine

    machine.PROC = Path("none")
    words = ["fastcoil", "run", "my study.toml", "-o", r"C:\results\a"]
    return [machine.available_memory(), machine.command_line(words), len(machine.TERMINATION_SIGNALS), machine.IS_POSIX]


@step
def commands():
    """Exit codes, and whether figures exist, with a code page that lacks letters of the messages."""
    from fastcoil.__main__ import run

    text = "[loop]\n[sweep]\nbacklash = [0.02, 0.07]\n[boundary]\nhours = 0.25\n[run]\nwarm_up = 100\n"
    Path("study.toml").write_text(f'title = "Größe → Δ"\n{text}', encoding="utf-8")
    codes = []
    for words in ("run study.toml -o commands -j 2", "verify commands", "verify none"):
        sys.argv[1:] = words.split()
        try:
            run()
        except SystemExit as ended:
            codes.append(ended.code)
    return [codes, Path("commands/figures").is_dir()]


def main(folder):
    """Run every step in a folder."""
    from helpers.windows import emulate

    os.chdir(folder)
    emulate()
    outcomes = {}
    for name, run_step in STEPS.items():
        try:
            with warnings.catch_warnings(record=True) as caught:
                outcomes[name] = run_step()
            outcomes[f"{name}: warnings"] = [str(w.message) for w in caught if "fastcoil" in w.filename]
        except BaseException:
            outcomes[name] = traceback.format_exc()
    print(json.dumps(outcomes))


if __name__ == "__main__":
    main(sys.argv[1])
