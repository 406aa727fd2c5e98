"""Compare this checkout with another one: the same numbers to the last bit, and no slower.

    python benchmarks/against.py ../before            # numbers, then kernel time in alternating rounds
    python benchmarks/against.py ../before --rounds 0 # numbers only

Both checkouts run under this interpreter, each in its own process with its own sources and ``benchmarks/suite.py``.
Only values of the same name are compared: units and texts may change.  Times are CPU time of one thread, so that other
work on the machine disturbs them less; the figure to quote is the median of the ratios.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

THIS_CHECKOUT = Path(__file__).parents[1]
KERNEL_RUNS = [(options, sample_time) for options in ("bare", "all four") for sample_time in (30, 1)]
LANES = 1024
SECONDS = 7200


def cases(fc: Any) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield the cases by name: functions that return Datasets or dicts of arrays."""
    days, hour = fc.paper_day(hours=2, seed=[3, 1]), fc.paper_day(hours=1, seed=5)
    presets = ("paper_like", "paper_like_fast", "lbnl", "g36")
    signals = ["T_sup", "T_measured", "u", "integral", "command", "position", "opening", "m_w", "estimate", "mode"]
    signals += ["T_w_out", "W_sup", "wet_volumes", "power", "T_w", "T_c", "T_a", "W_a"]
    learner = {"learning_step": 0.007, "backlash_estimate": 0.007, "learning_interval": 600, "noise_std": 0.02}
    variants: dict[str, dict[str, Any]] = {
        "noise": {"noise_std": [0.0, 0.05], "sensor_resolution": 0.1},
        "estimates": {"estimate_ratio": [0.0, 0.5, 1.0, 1.3], "backlash": [0.02, 0.15]},
        "buffer": {"backlash_estimate": 0.0665, "buffer": [0.0, 1e-9, 0.01], "noise_std": 0.02},
        "actuator": {"stroke_time": [0.0, 60.0], "command_resolution": [0.0, 0.01]},
        "learner": learner,
        "growing": learner | {"learning_growth": 1.5, "learning_early_trip": [0, 1], "learning_shrink": 0.5},
        "stopping": learner | {"learning_stop": "first_step_down", "learning_final": 0.9},
        "evidence": learner | {"learning_min_switches": 3.0, "learning_max_reference": 0.3},
        "volumes": {"n_volumes": [1, 4, 8, 12], "C_w": 20.0},
        "quasistatic": {"air_march": ["lagged", "quasistatic"]},
        "installed valve": {"rangeability": 50.0, "authority": [0.1, 0.6], "m_full": 1.5},
        "mixed": {"sample_time": [1, 7, 30], "beta3": [0.38, 0.42], "learning_step": [0.0, 0.01]},
        "heating": {"action": ["cooling", "heating"]},
    }
    for preset in presets:
        for name, values in variants.items():
            loop = fc.Loop.preset(preset).assign(**{"air_march": "lagged"} | values)
            yield f"{preset}, {name}", lambda loop=loop: fc.simulate(loop, days, warm_up=900, replicates=2, seed=7)
    for march in ("lagged", "quasistatic"):
        loop = fc.Loop(air_march=march, n_volumes=[4, 8], noise_std=0.02, backlash_estimate=0.06)
        yield f"traces, {march}", lambda loop=loop: fc.simulate(loop, hour, traces=signals, trace_interval=7)
    command = np.repeat(np.random.default_rng(1).uniform(0.0, 1.0, 24), 300)
    yield "open loop", lambda: fc.simulate(fc.Loop(), days, command=command, traces=["m_w", "T_sup"], warm_up=0)
    enabled = np.ones(3600)
    enabled[1000:1600] = 0.0
    disabled_series = {n: v[0] for n, v in hour.series.items()} | {"enabled": enabled}
    yield (
        "disabled",
        lambda: fc.simulate(fc.Loop(**learner), fc.Boundary(**disabled_series), warm_up=300, traces=["u", "T_sup"]),
    )
    yield "design day", lambda: fc.simulate(fc.Loop.preset("lbnl").assign(air_march="lagged"), fc.design_day(hours=3))
    yield "constant day", lambda: fc.simulate(fc.Loop(backlash=[0.0, 0.07]), fc.constant_day(hours=3))
    yield "compare", lambda: fc.compare(
        fc.simulate(fc.Loop(estimate_ratio=[0.0, 0.9]), fc.paper_day(hours=2, seed=range(4))),
        baseline={"estimate_ratio": 0.0}, over="day",
    )  # fmt: skip
    yield "valve fit", lambda: _fit_values(fc.fit_valve(_log(fc, hour, ["command", "m_w"])))
    coil_log = _log(fc, hour, ["m_w", "T_sup", "T_w_out"])
    yield "coil fit", lambda: _fit_values(fc.fit_coil(coil_log, warm_up=600, air_march="lagged"))
    yield "replay", lambda: fc.replay(fc.Loop(**learner), _log(fc, hour, ["T_sup"]))


def _log(fc: Any, day: Any, names: list[str]) -> Any:
    """A log of an hour with a new command every two minutes."""
    command = np.repeat(np.random.default_rng(2).uniform(0.1, 0.9, 30), 120)
    ds = fc.simulate(
        fc.Loop(backlash=0.09), day, command=command, traces=["command", "m_w", "T_sup", "T_w_out"], warm_up=0
    )
    boundary = day.to_dataset().drop_vars(["noise", "enabled", "day"])
    return ds[names].merge(boundary).isel(elapsed_time=slice(None, None, 10)).reset_coords(drop=True)


def _fit_values(fit: Any) -> dict[str, Any]:
    numbers = [value for value in fit.parameters.values() if isinstance(value, float)]
    return {"parameters": numbers, "intervals": list(fit.intervals.values())} | {
        str(name): values.values for name, values in fit.residuals.items() if values.dtype.kind == "f"
    }


def digests(dataset: Any) -> dict[str, str]:
    """Hash the values of each variable and coordinate, as doubles."""
    arrays = {str(n): v.values for n, v in dataset.variables.items()} if hasattr(dataset, "variables") else dataset
    numbers = {n: np.asarray(v).astype("<f8") for n, v in arrays.items() if np.asarray(v).dtype.kind in "biuf"}
    # all NaN count as equal
    comparable_arrays = {name: np.where(np.isnan(values), np.nan, values) for name, values in numbers.items()}
    return {name: hashlib.sha256(values.tobytes()).hexdigest()[:16] for name, values in comparable_arrays.items()}


def serve() -> None:
    """Answer the requests of the comparing process, in the checkout that PYTHONPATH names."""
    warnings.simplefilter("ignore")
    import suite

    import fastcoil as fc

    cases_by_name, out = dict(cases(fc)), os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # output of libraries must not mix with the answers
    kernel_runs: dict[str, Callable[[], Any]] = {}
    print(json.dumps(list(cases_by_name)), file=out, flush=True)
    for line in sys.stdin:
        kind, name = json.loads(line)
        if kind == "numbers":
            answer: Any = digests(cases_by_name[name]())
        else:
            options, sample_time = name
            key = f"{options} {sample_time}"
            if key not in kernel_runs:
                kernel_runs[key] = suite.kernel(suite.plan(LANES, SECONDS, sample_time, suite.OPTIONS[options]))
                kernel_runs[key]()
            start = time.process_time()
            kernel_runs[key]()
            answer = (time.process_time() - start) / LANES / SECONDS
        print(json.dumps(answer), file=out, flush=True)


class Checkout:
    """One checkout, answering in a process of its own."""

    def __init__(self, folder: Path) -> None:
        path = os.pathsep.join(map(str, (folder, folder / "benchmarks")))
        environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, "--serve"], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, cwd=folder,
        )  # fmt: skip
        self.names: list[str] = self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            sys.exit("a checkout stopped answering: see its error above")
        return json.loads(line)

    def ask(self, kind: str, name: Any) -> Any:
        """Digests of a case (``numbers``), or seconds per lane and step of a kernel run (``time``)."""
        assert self._process.stdin is not None
        print(json.dumps([kind, name]), file=self._process.stdin, flush=True)
        return self._answer()


def main() -> None:
    """Compare; exit code 1 if a number differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("other", nargs="?", type=Path, help="the checkout to compare with")
    parser.add_argument("--rounds", type=int, default=15, help="alternating rounds of the kernel; 0: numbers only")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve()
        return
    if arguments.other is None or not (arguments.other / "fastcoil").is_dir():
        parser.error(f"{arguments.other}: give the folder of another checkout of fastcoil")
    this_checkout, other_checkout = Checkout(THIS_CHECKOUT), Checkout(arguments.other.absolute())
    differing = compare_numbers(this_checkout, other_checkout)
    for options, sample_time in KERNEL_RUNS if arguments.rounds > 0 else []:
        pairs = []
        for k in range(arguments.rounds):  # the first of a round may meet another state of the machine
            order = (this_checkout, other_checkout) if k % 2 == 0 else (other_checkout, this_checkout)
            seconds = {checkout: checkout.ask("time", [options, sample_time]) for checkout in order}
            pairs.append((seconds[this_checkout], seconds[other_checkout]))
        this_ns, other_ns = (1e9 * statistics.median(times) for times in zip(*pairs, strict=True))
        ratio = statistics.median(a / b for a, b in pairs)
        times = f"{this_ns:.2f} against {other_ns:.2f} ns per lane-step, × {ratio:.3f}"
        print(f"{options}, sample time {sample_time} s: {times}")
    sys.exit(1 if differing else 0)


def compare_numbers(this_checkout: Checkout, other_checkout: Checkout) -> int:
    """Print the differing variables; return their number."""
    differing = n = 0
    for name in (name for name in this_checkout.names if name in other_checkout.names):
        this_digests, other_digests = (checkout.ask("numbers", name) for checkout in (this_checkout, other_checkout))
        shared = this_digests.keys() & other_digests.keys()
        differing_variables = sorted(v for v in shared if this_digests[v] != other_digests[v])
        n, differing = n + len(shared), differing + len(differing_variables)
        if differing_variables:
            print(f"{name}: {', '.join(differing_variables)} differ")
    print(f"{n - differing:,} of {n:,} variables are equal to the last bit")
    return differing


if __name__ == "__main__":
    main()
