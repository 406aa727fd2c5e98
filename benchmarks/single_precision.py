"""What single precision would gain and lose: time of the kernel, metrics and verdicts, beside double.

``python benchmarks/single_precision.py`` prints two tables in some minutes.  The package knows nothing of it: one of
two processes compiles the same sources with constants and arrays narrowed.  exp, log and the time stay in double.
Loops with an estimator, another law or a valve test are not covered.
"""

import importlib
import inspect
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np

STUDY = Path(__file__).parents[1] / "studies" / "robustness" / "robustness.toml"
LANES, SECONDS, ROUNDS = 1024, 7200, 15
NARROWED = {
    r"(?<![\w.])\d+\.\d*(e-?\d+)?|np\.(inf|nan)": r"np.float32(\g<0>)",  # constants
    r"1\.0\) / config.substeps": "1.0 / config.substeps)",  # numba divides by whole numbers in double
    r"shares_air_side else 0\)": "shares_air_side else 0), np.float32",  # an array
}


def narrowing(compiled):
    """A decorator that compiles in single precision; a function that closes over others only calls them, and stays."""

    def narrowed(function):
        if function.__closure__:
            return compiled(function)
        source, scope = inspect.getsource(function), function.__globals__
        for double, single in NARROWED.items():
            source = re.sub(double, single, source[source.index("def ") :])
        for name in function.__code__.co_names:
            value = scope.get(name)
            if isinstance(value, float):
                scope[name] = np.float32(value)
            elif isinstance(value, tuple) and all(isinstance(v, float) for v in value):
                scope[name] = tuple(map(np.float32, value))
        exec(compile(source, inspect.getfile(function), "exec"), scope)
        return compiled(scope.pop(function.__name__))

    return narrowed


def compile_in_double(compiled, function):
    """The function for numbers in single precision."""
    return compiled(lambda x: np.float32(function(np.float64(x))))


def narrow():
    """Compile all formulas and loops in single precision from here on, and cache none of them."""
    jit, elementary, stages = (
        importlib.import_module(f"fastcoil.model.numerics.{name}") for name in ("jit", "elementary", "stages")
    )
    elementary.fma = jit.scalar(lambda a, b, c: a * b + c)
    for name in ("exp", "log"):
        setattr(elementary, name, compile_in_double(jit.exact, getattr(elementary, name)))
    stages.ROW_POINTER = numba.types.CPointer(numba.float32)
    jit.kernel_folder = stages.kernel_folder = lambda _: None
    for name in ("scalar", "section", "exact", "kernel"):
        setattr(jit, name, narrowing(getattr(jit, name)))
    lanes = importlib.import_module("fastcoil.model.engine.lanes")
    emulate, aligned = lanes.emulate, lanes._allocate_aligned
    lanes._allocate_aligned = lambda size: aligned(size).view(np.float32)[:size]
    lanes.emulate = lambda rows, config, day, *more: emulate(
        rows, config, day._replace(series=day.series.astype("f4"), command=day.command.astype("f4")), *more
    )


def simulate_work(work, seed):
    """The Dataset of a work: the robustness study on a day, or sizes of gap in a year of noise."""
    import fastcoil as fc

    if work == "robustness":
        cases = tomllib.loads(STUDY.read_text())["cases"]["tuning"].values()
        names = ("kp", "ti", "sample_time", "error_dead_band")
        loop = fc.Loop().assign(**{n: ("loop", [c.get(n, 0.0) for c in cases]) for n in names})
        loop = loop.assign(backlash=np.linspace(0.01, 0.15, 15), estimate_ratio=np.linspace(0.0, 1.5, 31))
        return fc.simulate(loop, fc.paper_day(hours=8, seed=seed), n_jobs=1)
    day = importlib.import_module("years").make
    loop = fc.Loop.preset("lbnl").assign(backlash=np.linspace(0.0, 0.15, 16), estimate_ratio=[0.0, 0.9])
    days = fc.Boundary.from_days(day, day=range(365), hours=24)
    return fc.simulate(loop.assign(noise_std=0.05, buffer=0.01), days, carry_over=True, seed=seed, n_jobs=1)


def serve():
    """Answer ``time SAMPLE_TIME`` and ``WORK SEED FILE`` with ns per lane-step; metrics go into the file."""
    import suite

    kernel_runs = {t: suite.kernel(suite.plan(LANES, SECONDS, float(t))) for t in ("30", "1")}
    for line in sys.stdin:
        request, argument, *file = line.split()
        start = time.process_time()
        if request == "time":
            kernel_runs[argument]()
        else:
            ds = simulate_work(request, int(argument))
            np.savez(file[0], **{n: v.transpose("estimate_ratio", ...).values for n, v in ds.data_vars.items()})
        print(1e9 * (time.process_time() - start) / LANES / SECONDS, flush=True)


def comparison_cells(double, single, other_seed):
    """Cells: days; the worst metric by its median deviation; verdicts that single, or another seed, changes."""
    with np.errstate(all="ignore"):
        deviation = {n: np.abs(single[n] / double[n] - 1.0) for n in double if n != "status"}
    median_deviation = {n: np.median(v[np.isfinite(v)]) for n, v in deviation.items() if np.isfinite(v).any()}
    worst = max(median_deviation, key=median_deviation.get)
    yield from (f"{double['rmse'].size:,}", f"{100 * median_deviation[worst]:.2g} % ({worst})")
    for verdict in (
        lambda ds: ds["hunts"] == 1.0,
        lambda ds: ds["switch_frequency"][1:] > 2.0 * ds["switch_frequency"][:1],
        lambda ds: ds["rmse"][1:] < ds["rmse"][:1],
    ):
        one, two, three = map(verdict, (double, single, other_seed))
        yield f"{100 * np.mean(one != two):.2f} / {100 * np.mean(one != three):.2f} %"


def main():
    command, pipes = [sys.executable, __file__], {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = {name: subprocess.Popen([*command, name], **pipes) for name in ("double", "single")}

    def ask(name, *words):
        print(*words, file=process[name].stdin, flush=True)
        return float(process[name].stdout.readline())

    print("| sample time | double, ns per lane-step | single | double / single |\n|---|---:|---:|---:|")
    for t in (30, 1):
        ns = np.array([[ask(name, "time", t) for name in process] for _ in range(ROUNDS + 1)][1:])
        ratio, (double, single) = ns[:, 0] / ns[:, 1], np.median(ns, axis=0)
        print(f"| {t} s | {double:.1f} | {single:.1f} | {np.median(ratio):.2f} ({ratio.min():.2f}–{ratio.max():.2f}) |")
    head = ("", "days", "worst median deviation", "hunts: single / another seed", "chatters", "beats the plain PI")
    print(f"\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    with TemporaryDirectory() as folder:
        for work in ("robustness", "year"):
            files = []
            for name, seed in (("double", 1), ("single", 1), ("double", 2)):
                files.append(f"{folder}/{work}-{name}-{seed}.npz")
                ask(name, work, seed, files[-1])
            print(f"| {work} | {' | '.join(comparison_cells(*map(np.load, files)))} |", flush=True)
    for program in process.values():
        program.stdin.close()


if __name__ == "__main__":
    if sys.argv[1:] == ["single"]:
        narrow()
    serve() if sys.argv[1:] else main()
