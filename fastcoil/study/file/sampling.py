"""Draw the parameters of the table ``[sample]`` together, zipped along the dimension ``sample``.

A design is ``size`` points of the unit cube with one dimension for each parameter; the quantiles of a parameter's
distribution turn its coordinates into values.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import whole_number_problems
from fastcoil.base.errors import InputError, collecting, nearest, shown
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.study.file.tables import are_numbers, first_of, known_parameters

SAMPLE_DIM, DESIGN_DIM = "sample", "design"
"""The dimensions of a design; only ``saltelli`` has the second."""
SETTINGS = ("method", "size", "seed")
"""Keys of ``[sample]`` that are not parameters."""
SALTELLI = "saltelli"
METHODS = ("latin_hypercube", "sobol", "random", SALTELLI)
POWERS_OF_TWO = ("sobol", SALTELLI)
LARGEST_SAMPLE = 10_000_000
CHOICE = "choice"
_SMALLEST_SHARE = 2.0**-32
"""A coordinate of the unit cube may be 0 or round to it; half a cell of the Sobol lattice is the least one used."""


@dataclass(frozen=True)
class Distribution:
    """A continuous distribution: the names of its arguments, what is wrong with them, and how scipy.stats makes it."""

    arguments: tuple[str, ...]
    problem: Callable[..., str | None]
    make: Callable[..., Any]

    @property
    def signature(self) -> str:
        """The arguments as a study file gives them."""
        return f"[{', '.join(self.arguments)}]"


def _order(low: float, high: float) -> str | None:
    return None if low < high else "the lowest value must be below the highest"


def _positive_order(low: float, high: float) -> str | None:
    return _order(low, high) or (None if low > 0.0 else "the lowest value must be above 0")


def _inside(low: float, mode: float, high: float) -> str | None:
    return _order(low, high) or (
        None if low <= mode <= high else "the most likely value must lie between the lowest and the highest"
    )


def _spread(_mean: float, std: float, low: float, high: float) -> str | None:
    return _order(low, high) or (None if std > 0.0 else "the standard deviation must be above 0")


def _truncnorm(stats: Any, mean: float, std: float, low: float, high: float) -> Any:
    return stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)


def _triangular(stats: Any, low: float, mode: float, high: float) -> Any:
    return stats.triang((mode - low) / (high - low), loc=low, scale=high - low)


DISTRIBUTIONS: dict[str, Distribution] = {
    "uniform": Distribution(("lowest", "highest"), _order, lambda stats, a, b: stats.uniform(a, b - a)),
    "loguniform": Distribution(("lowest", "highest"), _positive_order, lambda stats, a, b: stats.loguniform(a, b)),
    "truncnorm": Distribution(("mean", "standard deviation", "lowest", "highest"), _spread, _truncnorm),
    "triangular": Distribution(("lowest", "most likely", "highest"), _inside, _triangular),
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

    Raises
    ------
    InputError
        With one sentence for each mistake in the table.
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
    values = {name: _quantiles(table[name], points[:, k]) for k, name in enumerate(names)}
    if not both:
        return {name: xr.DataArray(v, dims=SAMPLE_DIM) for name, v in values.items()}
    others = {name: _quantiles(table[name], points[:, len(names) + k]) for k, name in enumerate(names)}
    labels = ["A", "B", *names]
    return {
        name: xr.DataArray(
            np.stack([others[name] if label in ("B", name) else values[name] for label in labels], axis=-1),
            dims=(SAMPLE_DIM, DESIGN_DIM),
            coords={DESIGN_DIM: labels},
        )
        for name in names
    }


def _find_setting_problems(table: Mapping[str, Any]) -> list[str]:
    problems = [
        f"{name} is missing: give {what}"
        for name, what in (("method", f"one of {', '.join(METHODS)}"), ("size", "the number of samples"))
        if name not in table
    ]
    method = table.get("method", METHODS[0])
    if not isinstance(method, str) or method not in METHODS:
        problems.append(
            f"method = {shown(method)}: unknown{nearest(str(method), METHODS)}; choose one of {', '.join(METHODS)}"
        )
    size = table.get("size", 1)
    wrong = whole_number_problems("size", size, 1, LARGEST_SAMPLE)
    if not wrong and method in POWERS_OF_TWO and size & (size - 1):
        below = 1 << (size.bit_length() - 1)
        fitting = [str(power) for power in (below, 2 * below) if power <= LARGEST_SAMPLE]
        wrong = [f"size = {size}: a Sobol design is even only in powers of two, give {' or '.join(fitting)}"]
    return problems + wrong + whole_number_problems("seed", table.get("seed", 0), *RUN_LIMITS["seed"])


def _check_shape(parameter: Parameter, shape: object) -> None:
    """Refuse anything but a distribution for ``parameter``; the loop checks its bounds."""
    name, known = parameter.name, ", ".join((*DISTRIBUTIONS, CHOICE))
    kind = next(iter(shape)) if isinstance(shape, dict) and len(shape) == 1 else None
    if not isinstance(shape, dict) or kind is None:
        raise InputError(
            f"{name} = {shown(shape)}: give one distribution, such as {{ uniform = [lowest, highest] }}; known: {known}"
        )
    arguments, given = shape[kind], f"{name} = {{ {kind} = {shown(shape[kind])} }}"
    if kind == CHOICE:
        _check_choice(parameter, arguments, given)
        return
    if kind not in DISTRIBUTIONS:
        raise InputError(f"{given}: unknown distribution{nearest(kind, (*DISTRIBUTIONS, CHOICE))}; known: {known}")
    if parameter.is_word or parameter.whole:
        what = "a word" if parameter.is_word else "a whole number"
        values = "[" + ", ".join(f'"{c}"' for c in parameter.choices) + "]" if parameter.is_word else "[…]"
        raise InputError(f"{given}: {name} is {what}, use {{ choice = {values} }}")
    distribution = DISTRIBUTIONS[kind]
    if not are_numbers(arguments, len(distribution.arguments)):
        raise InputError(f"{given}: give {distribution.signature}, {len(distribution.arguments)} finite numbers")
    problem = distribution.problem(*arguments)
    if problem:
        raise InputError(f"{given}: {problem}, give {distribution.signature}")


def _check_choice(parameter: Parameter, values: object, given: str) -> None:
    if not isinstance(values, list) or not values:
        raise InputError(f"{given}: give a list of at least one value")
    problems = first_of([p for p in map(parameter.problem, values) if p])
    if not problems:
        problems = first_of(
            [f"{given}: {v} appears twice, leave one out" for v, count in Counter(values).items() if count > 1]
        )
    if problems:
        raise InputError(problems)


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
    from scipy import stats

    distribution = DISTRIBUTIONS[kind]
    named = dict(zip(distribution.arguments, map(float, arguments), strict=True))
    with np.errstate(over="ignore", invalid="ignore"):  # a range that overflows gives values that the loop refuses
        quantiles = distribution.make(stats, *named.values()).ppf(np.clip(share, _SMALLEST_SHARE, 1.0 - 2.0**-53))
    low, high = named["lowest"], named["highest"]
    return np.asarray(np.clip(quantiles, np.nextafter(low, high), np.nextafter(high, low)))
