"""What limits the time loop: the divider, and how near to it the C peer and the kernel come.

``python benchmarks/limit.py`` prints the instructions of the loops over a wet volume, for a vector of eight lanes, with
cycles of a core by llvm-mca, which has a model of Ice Lake; then CPU time of the divisions alone and of both programs,
in alternating runs on one thread.  It needs a processor with 512-bit vectors, gcc and llvm-mca.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numba
import numpy as np
from numba import types
from peers import c_peer, common
from report import alternate, spread
from suite import LANES, contenders

import fastcoil as fc
from fastcoil.model.engine.plant import air_step_wet, water_step
from fastcoil.model.numerics.jit import FLAGS, widest_vectors

BLOCKS, SECONDS, ROUNDS = 8, 7200, 15
NUMBER, ROWS = types.float64, types.Array(types.float64, 1, "C")
KINDS = {
    "arithmetic": r"v(fn?m(add|sub)|mul|add|sub|max|min|cmp)\w*",
    "divisions": r"vdiv\w*",
    "loads": r"v\w+\s+.*\(.*\).*%",
    "stores": r"vmov\w+\s+%zmm\d+.*\(",
}


def kernel() -> str:
    """Assembly of the kernel's two loops over a wet volume."""

    def water(S, V, i):  # type: ignore[no-untyped-def]
        water_step(S, V, i, True)

    def air(S, V, i, eps_a, eps_star, m_a, m_a_dt, T_dry):  # type: ignore[no-untyped-def]
        return air_step_wet(S, V, i, True, eps_a, eps_star, m_a, m_a_dt, T_dry)

    with widest_vectors():
        compiled_functions = [
            numba.njit((ROWS, ROWS, types.int64, *n * [NUMBER]), **FLAGS)(f).inspect_asm()
            for f, n in ((water, 0), (air, 5))
        ]
    return "\n".join(text for assembly_by_signature in compiled_functions for text in assembly_by_signature.values())


def peer() -> str:
    """Assembly of the C peer."""
    return subprocess.run(c_peer.command("-S", "-o", "-"), capture_output=True, text=True, check=True).stdout


class Loop(NamedTuple):
    """The code of a loop, and how many vectors it treats: as many as it has divisions."""

    code: list[str]
    vectors: int


def loops(assembly: str) -> Iterator[Loop]:
    """Loops over 512-bit vectors with a division, but for that of the valve's logarithm, which shifts bits."""
    for block in re.split(r"^\S+:.*$|^\s+j\w+\s.*$", assembly, flags=re.MULTILINE):
        code = [line.split("#")[0].strip() for line in block.splitlines() if line.strip() and line.strip()[0] != "."]
        n = sum(line.startswith("vdivpd") and "zmm" in line for line in code)
        if n and not any("vpsllq" in line or "vpsraq" in line for line in code):
            yield Loop(code, n)


def cycles(loop: Loop) -> tuple[float, float]:
    """Cycles for a vector of the divider, and of the busiest other port, as llvm-mca counts them."""
    code = "\n".join(loop.code)
    command = ["llvm-mca", "-mcpu=icelake-server", "-iterations=100"]
    mca_report = subprocess.run(command, input=code, capture_output=True, text=True, check=True).stdout
    per_iteration = mca_report.split("Resource pressure per iteration:\n")[1].splitlines()[1].split()
    pressures = [0.0 if p == "-" else float(p) / loop.vectors for p in per_iteration]
    return max(pressures[:2]), max(pressures[2:])


def division() -> Callable[[float], None]:
    """A function that divides as often as this work with so many wet volumes: twice per volume, lane and second."""

    def divide(dividend, divisor, n):  # type: ignore[no-untyped-def]
        for _ in range(n):
            for j in range(LANES):
                divisor[j] = dividend[j] / divisor[j]

    with widest_vectors():
        compiled = numba.njit((ROWS, ROWS, types.int64), **FLAGS)(divide)
    numbers = np.linspace(1.0, 2.0, LANES)
    return lambda wet: compiled(numbers, numbers.copy(), round(2.0 * wet * BLOCKS * SECONDS))


def times(sample_time: int) -> Iterator[str]:
    """One row for the divisions alone, the C peer and the kernel: ns per lane-step, and over that of the divisions."""
    scenarios, series = common.work(BLOCKS * LANES, SECONDS, sample_time)
    swept = {{"estimate": "backlash_estimate"}.get(k, k): ("case", v) for k, v in scenarios.items()}
    ds = fc.simulate(fc.Loop().assign(**swept), fc.Boundary(**series), traces=["wet_volumes"], trace_interval=60)
    wet = float(ds.wet_volumes.max("case").mean())
    runs = {c.name: c.ready(scenarios, series) for c in contenders() if c.threads == 1}
    divide = division()
    runs = {"divisions": lambda: divide(wet)} | {n: runs[n] for n in ("C", "fastcoil, kernel")}
    seconds_by_program = alternate(runs, ROUNDS, time.process_time)
    for name, seconds in seconds_by_program.items():
        label = f"{name} of {wet:.1f} wet volumes" if name == "divisions" else name
        cost = 1e9 * seconds / BLOCKS / LANES / SECONDS
        yield f"| {label} | {sample_time} s | {spread(cost, 1)} | {spread(seconds / seconds_by_program['divisions'], 2)} |"


def main() -> None:
    """Print the tables."""
    lines = [
        f"| loop | {' | '.join(KINDS)} | cycles of the divider | of the busiest other port |",
        "|---|" + "---:|" * 6,
    ]
    programs = (
        (kernel(), ("kernel: saturation and water", "kernel: air and metal")),
        (peer(), ("C: saturation", "C: water, air and metal")),
    )
    for assembly, names in programs:
        for name, loop in zip(names, loops(assembly), strict=True):
            counts = (
                sum(bool(re.match(kind, line)) and "zmm" in line for line in loop.code) for kind in KINDS.values()
            )
            cells = [f"{n / loop.vectors:.1f}" for n in counts] + [f"{c:.1f}" for c in cycles(loop)]
            lines.append(f"| {name} | {' | '.join(cells)} |")
    lines += ["", "| | sample time | ns per lane-step | over that of the divisions |", "|---|---:|---:|---:|"]
    lines += [line for sample_time in (30, 1) for line in times(sample_time)]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
