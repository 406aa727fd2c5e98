"""Draw the parameters of the table ``[sample]`` together, zipped along the dimension ``sample``.

A design is ``size`` points of the unit cube with one dimension for each parameter; the quantiles of a parameter's
distribution turn its coordinates into values.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, choice_of, whole_of
from fastcoil.base.errors import nearest, shown
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.study.file.tables import are_numbers, first_of, known_parameters, sampled_names

SAMPLE_DIM, DESIGN_DIM = "sample", "design"  # the dimensions of a design; only ``saltelli`` has the second
SALTELLI = "saltelli"
METHODS = ("latin_hypercube", "sobol", "random", SALTELLI)
POWERS_OF_TWO = ("sobol", SALTELLI)
LARGEST_SAMPLE = 10_000_000
CHOICE = "choice"
_SMALLEST_SHARE = 2.0**-32
"""A coordinate of the unit cube may be 0 or round to it; half a cell of the Sobol lattice is the least one used."""


_ENDS = ("lowest", "highest")
DISTRIBUTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "uniform": (_ENDS, "lowest < highest"),
    "loguniform": (_ENDS, "0 < lowest < highest"),
    "truncnorm": (("mean", "standard deviation", *_ENDS), "lowest < highest and standard deviation > 0"),
    "triangular": (("lowest", "most likely", "highest"), "lowest ≤ most likely ≤ highest, lowest < highest"),
}
"""The names of the arguments of each continuous distribution, and what they must be; ``choice`` exists besides."""


def design_size(table: Mapping[str, Any]) -> int:
    """Number of scenarios that ``[sample]`` draws; 1 where it is absent or wrong."""
    size = table.get("size")
    if type(size) is not int or not 1 <= size <= LARGEST_SAMPLE:
        return 1
    return size * (len(sampled_names(table)) + 2 if table.get("method") == SALTELLI else 1)


def sample_values(table: Mapping[str, Any], known: Mapping[str, Parameter] = PARAMETERS) -> dict[str, xr.DataArray]:
    """Draw the parameters of ``[sample]``: name → numbers in the parameter's unit, or words, along ``sample``.

    The same table always gives the same values; with the methods ``sobol``, ``saltelli`` and ``random``
    they are the first of a larger ``size``.  ``saltelli`` draws for Sobol' indices: two independent samples, ``A`` and
    ``B`` along a dimension ``design``, and for each parameter ``A`` with only that parameter taken from ``B``
    (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).
    """
    _check(table, known)
    names = sampled_names(table)
    method, both = table["method"], table["method"] == SALTELLI
    points = _points(method, table["size"], len(names) * (2 if both else 1), table.get("seed", 0))
    of_A = {name: _quantiles(table[name], points[:, k]) for k, name in enumerate(names)}
    if not both:
        return {name: xr.DataArray(values, dims=SAMPLE_DIM) for name, values in of_A.items()}
    of_B = {name: _quantiles(table[name], points[:, len(names) + k]) for k, name in enumerate(names)}
    labels = ["A", "B", *names]
    found = {}
    for name in names:
        columns = [of_B[name] if label in ("B", name) else of_A[name] for label in labels]
        found[name] = xr.DataArray(
            np.stack(columns, axis=-1), dims=(SAMPLE_DIM, DESIGN_DIM), coords={DESIGN_DIM: labels}
        )
    return found


def _check(table: Mapping[str, Any], known: Mapping[str, Parameter]) -> None:
    """Refuse all mistakes together; the loop checks the bounds of what is drawn."""
    needed = {"method": f"one of {', '.join(METHODS)}", "size": "the number of samples"}
    given = {"method": METHODS[0], "size": 1, "seed": 0, **table}
    with checking() as check:
        problems = check.problems
        problems += [f"{name} is missing: give {what}" for name, what in needed.items() if name not in table]
        check(choice_of, "method", given["method"], METHODS)
        check(whole_of, "size", given["size"], 1, LARGEST_SAMPLE)
        check(whole_of, "seed", given["seed"], *RUN_LIMITS["seed"])
        if not problems and given["method"] in POWERS_OF_TWO and given["size"].bit_count() > 1:
            below = 1 << (given["size"].bit_length() - 1)
            problems.append(f"size = {given['size']}: a Sobol design is even only in powers of two, such as {below}")
        names = sampled_names(table)
        for name, shape in known_parameters({name: table[name] for name in names}, problems, known=known).items():
            problems += _find_problems(known[name], shape)
        if not names:
            problems.append("no parameter is given: give at least one, such as backlash = { uniform = [0.02, 0.15] }")


def _find_problems(parameter: Parameter, shape: object) -> list[str]:
    """A sentence if ``shape`` is no distribution for ``parameter``."""
    name, kinds = parameter.name, (*DISTRIBUTIONS, CHOICE)
    if not isinstance(shape, dict) or len(shape) != 1:
        example = "{ uniform = [lowest, highest] }"
        return [f"{name} = {shown(shape)}: give one distribution, such as {example}; known: {', '.join(kinds)}"]
    ((kind, arguments),) = shape.items()
    problems = []
    if kind not in kinds:
        problems = [f"unknown distribution{nearest(kind, kinds)}; known: {', '.join(kinds)}"]
    elif kind == CHOICE and (not isinstance(arguments, list) or not arguments):
        problems = ["give a list of at least one value"]
    elif kind == CHOICE:
        wrong = [problem for value in arguments if (problem := parameter.problem(value))]
        if wrong:
            return first_of(wrong)
        problems = [f"{value} appears twice, leave one out" for value, n in Counter[Any](arguments).items() if n > 1]
    elif parameter.is_word or parameter.whole:
        problems = [f"{name} is a {'word' if parameter.is_word else 'whole number'}, use {{ {CHOICE} = […] }}"]
    else:
        names, rule = DISTRIBUTIONS[kind]
        if not are_numbers(arguments, len(names)):
            problems = [f"give [{', '.join(names)}], {len(names)} finite numbers"]
        elif not np.isfinite(_ppf(kind, arguments, np.array(0.5))):
            problems = [f"give [{', '.join(names)}] with {rule}"]
    return first_of([f"{name} = {{ {kind} = {shown(arguments)} }}: {problem}" for problem in problems])


def _points(method: str, size: int, dims: int, seed: int) -> np.ndarray:
    """Points of the unit cube, (size, dims)."""
    if method == "random":
        return np.random.Generator(np.random.PCG64(seed)).random((size, dims))
    from scipy.stats import qmc

    sampler = qmc.Sobol if method in POWERS_OF_TWO else qmc.LatinHypercube
    return np.asarray(sampler(dims, rng=seed).random(size))


def _quantiles(shape: Mapping[str, Any], share: np.ndarray) -> np.ndarray:
    """Values below which the shares of a distribution lie, strictly between its lowest and its highest."""
    ((kind, arguments),) = shape.items()
    if kind == CHOICE:
        values = np.array(arguments if isinstance(arguments[0], str) else [float(v) for v in arguments])
        return values[np.minimum((share * values.size).astype(np.int64), values.size - 1)]
    low, high = (float(arguments[DISTRIBUTIONS[kind][0].index(end)]) for end in _ENDS)
    quantiles = _ppf(kind, arguments, np.clip(share, _SMALLEST_SHARE, 1.0 - 2.0**-53))
    return np.asarray(np.clip(quantiles, np.nextafter(low, high), np.nextafter(high, low)))


def _ppf(kind: str, arguments: Sequence[float], share: np.ndarray) -> Any:
    """Quantiles of a distribution; NaN where its arguments are none."""
    from scipy import stats

    of = dict(zip(DISTRIBUTIONS[kind][0], np.array(arguments, dtype=float), strict=True))
    low, high = of["lowest"], of["highest"]
    with np.errstate(all="ignore"):  # a range that overflows gives values that the loop refuses
        if kind == "uniform":
            frozen = stats.uniform(low, high - low)
        elif kind == "loguniform":
            frozen = stats.loguniform(low, high)
        elif kind == "triangular":
            frozen = stats.triang((of["most likely"] - low) / (high - low), low, high - low)
        else:
            mean, std = of["mean"], of["standard deviation"]
            frozen = stats.truncnorm((low - mean) / std, (high - mean) / std, mean, std)
        return frozen.ppf(share)
