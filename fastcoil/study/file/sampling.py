"""Draw the parameters of the table ``[sample]`` together, zipped along the dimension ``sample``.

A design is ``size`` points of the unit cube with one dimension for each parameter; the quantiles of a parameter's
distribution turn its coordinates into values.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import whole_of
from fastcoil.base.errors import InputError, collecting, nearest, shown
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.study.file.tables import are_numbers, first_of, known_parameters

SAMPLE_DIM, DESIGN_DIM = "sample", "design"  # the dimensions of a design; only ``saltelli`` has the second
SETTINGS = ("method", "size", "seed")  # keys of ``[sample]`` that are not parameters
SALTELLI = "saltelli"
METHODS = ("latin_hypercube", "sobol", "random", SALTELLI)
POWERS_OF_TWO = ("sobol", SALTELLI)
LARGEST_SAMPLE = 10_000_000
CHOICE = "choice"
_SMALLEST_SHARE = 2.0**-32
"""A coordinate of the unit cube may be 0 or round to it; half a cell of the Sobol lattice is the least one used."""


class Distribution(NamedTuple):
    """A continuous distribution: the names of its arguments, what they must be, and how scipy.stats makes it."""

    arguments: tuple[str, ...]
    rule: str
    make: Callable[..., Any]


def _truncnorm(stats: Any, mean: float, std: float, low: float, high: float) -> Any:
    return stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)


def _triangular(stats: Any, low: float, mode: float, high: float) -> Any:
    return stats.triang((mode - low) / (high - low), loc=low, scale=high - low)


_ENDS = ("lowest", "highest")
DISTRIBUTIONS: dict[str, Distribution] = {
    "uniform": Distribution(_ENDS, "lowest < highest", lambda stats, a, b: stats.uniform(a, b - a)),
    "loguniform": Distribution(_ENDS, "0 < lowest < highest", lambda stats, a, b: stats.loguniform(a, b)),
    "truncnorm": Distribution(
        ("mean", "standard deviation", *_ENDS), "lowest < highest and standard deviation > 0", _truncnorm
    ),
    "triangular": Distribution(
        ("lowest", "most likely", "highest"), "lowest ≤ most likely ≤ highest, lowest < highest", _triangular
    ),
}
"""The continuous ones; ``choice`` exists besides."""


def sampled_names(table: Mapping[str, Any] | None) -> list[str]:
    """Names of the parameters in ``[sample]``; none if the table is absent."""
    return [name for name in table or {} if name not in SETTINGS]


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
    problems = _find_setting_problems(table)
    names = sampled_names(table)
    for name, shape in known_parameters({name: table[name] for name in names}, problems, known=known).items():
        with collecting(problems):
            _check_shape(known[name], shape)
    if not names:
        problems.append("no parameter is given: give at least one, such as backlash = { uniform = [0.02, 0.15] }")
    if problems:
        raise InputError(problems)
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


def _find_setting_problems(table: Mapping[str, Any]) -> list[str]:
    needed = {"method": f"one of {', '.join(METHODS)}", "size": "the number of samples"}
    problems = [f"{name} is missing: give {what}" for name, what in needed.items() if name not in table]
    method, size = table.get("method", METHODS[0]), table.get("size", 1)
    if method not in METHODS:
        hint = nearest(str(method), METHODS)
        problems.append(f"method = {shown(method)}: unknown{hint}; choose one of {', '.join(METHODS)}")
    with collecting(problems):
        size = whole_of("size", size, 1, LARGEST_SAMPLE)
        if method in POWERS_OF_TWO and size & (size - 1):
            below = 1 << (size.bit_length() - 1)
            fitting = " or ".join(str(power) for power in (below, 2 * below) if power <= LARGEST_SAMPLE)
            problems.append(f"size = {size}: a Sobol design is even only in powers of two, give {fitting}")
    with collecting(problems):
        whole_of("seed", table.get("seed", 0), *RUN_LIMITS["seed"])
    return problems


def _check_shape(parameter: Parameter, shape: object) -> None:
    """Refuse anything but a distribution for ``parameter``; the loop checks its bounds."""
    name, known = parameter.name, (*DISTRIBUTIONS, CHOICE)
    if not isinstance(shape, dict) or len(shape) != 1:
        raise InputError(
            f"{name} = {shown(shape)}: give one distribution, such as {{ uniform = [lowest, highest] }}; "
            f"known: {', '.join(known)}"
        )
    ((kind, arguments),) = shape.items()
    problem = None
    if kind == CHOICE:
        if not isinstance(arguments, list) or not arguments:
            problem = "give a list of at least one value"
        else:
            _check_choice(parameter, arguments)
    elif kind not in DISTRIBUTIONS:
        problem = f"unknown distribution{nearest(kind, known)}; known: {', '.join(known)}"
    elif parameter.is_word or parameter.whole:
        values = ", ".join(f'"{word}"' for word in parameter.choices) if parameter.is_word else "…"
        what = "a word" if parameter.is_word else "a whole number"
        problem = f"{name} is {what}, use {{ choice = [{values}] }}"
    else:
        names, rule, _ = DISTRIBUTIONS[kind]
        if not are_numbers(arguments, len(names)):
            problem = f"give [{', '.join(names)}], {len(names)} finite numbers"
        elif not np.isfinite(_ppf(kind, arguments, np.array(0.5))):
            problem = f"give [{', '.join(names)}] with {rule}"
    if problem:
        raise InputError(f"{name} = {{ {kind} = {shown(arguments)} }}: {problem}")


def _check_choice(parameter: Parameter, values: list[Any]) -> None:
    problems = [problem for value in values if (problem := parameter.problem(value))]
    if not problems:
        twice = [value for value, count in Counter(values).items() if count > 1]
        given = f"{parameter.name} = {{ {CHOICE} = {shown(values)} }}"
        problems = [f"{given}: {value} appears twice, leave one out" for value in twice]
    if problems:
        raise InputError(first_of(problems))


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
    low, high = (float(arguments[DISTRIBUTIONS[kind].arguments.index(end)]) for end in _ENDS)
    quantiles = _ppf(kind, arguments, np.clip(share, _SMALLEST_SHARE, 1.0 - 2.0**-53))
    return np.asarray(np.clip(quantiles, np.nextafter(low, high), np.nextafter(high, low)))


def _ppf(kind: str, arguments: Sequence[float], share: np.ndarray) -> Any:
    """Quantiles of a distribution; NaN where its arguments are none."""
    from scipy import stats

    with np.errstate(all="ignore"):  # a range that overflows gives values that the loop refuses
        return DISTRIBUTIONS[kind].make(stats, *np.array(arguments, dtype=float)).ppf(share)
