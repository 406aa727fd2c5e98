"""Draw the parameters of ``[sample]``: designs, distributions, rank correlations.

A design is ``size`` points of the unit cube with one dimension for each parameter.  Correlations move the points, and
the quantiles of a parameter's distribution turn its coordinates into values: another distribution of one parameter
changes no other.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, collect_problems, raise_problems, require_choice, require_integer
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongTypeMessage, did_you_mean, short_repr
from fastcoil.base.files import read_text
from fastcoil.logs.readings import read_numbers
from fastcoil.logs.series import Series
from fastcoil.logs.table import Table
from fastcoil.loops.labelled import accepted_units
from fastcoil.loops.netcdf import file_sha256
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.study.file.tables import is_number_list, known_parameters, parse_toml, sampled_names, summarise_problems

SAMPLE_DIM, DESIGN_DIM = "sample", "design"  # the dimensions of a design; only ``saltelli`` has the second
SALTELLI = "saltelli"
METHODS = ("latin_hypercube", "sobol", "random", SALTELLI)
POWERS_OF_TWO = ("sobol", SALTELLI)
MAX_SAMPLE_SIZE = 10_000_000
_MIN_SHARE = 2.0**-32
"""A coordinate of the unit cube may be 0 or round to it; half a cell of the Sobol lattice is the least one used."""
_MAX_SHARE = 1.0 - 2.0**-53
_VALUES_AT_ONCE = 2**17  # values

_END_NAMES = ("lowest", "highest")
DISTRIBUTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "uniform": (_END_NAMES, "lowest < highest"),
    "loguniform": (_END_NAMES, "0 < lowest < highest"),
    "truncnorm": (("mean", "standard deviation", *_END_NAMES), "lowest < highest and standard deviation > 0"),
    "triangular": (("lowest", "most likely", "highest"), "lowest ≤ most likely ≤ highest, lowest < highest"),
    "normal": (("mean", "standard deviation", *_END_NAMES), "lowest < highest and standard deviation > 0"),
    "lognormal": (("median", "sigma", *_END_NAMES), "median > 0, sigma > 0 and 0 ≤ lowest < highest"),
    "beta": (("a", "b", *_END_NAMES), "a > 0, b > 0 and lowest < highest"),
}
"""The names of the arguments of each continuous distribution, and what they must be."""
_CUT_AT_BOUNDS = ("normal", "lognormal")  # without their ends they are cut at the bounds of the parameter
CHOICE, FIT, CSV = "choice", "fit", "csv"
DISTRIBUTION_KINDS = (*DISTRIBUTIONS, CHOICE, FIT, CSV)

Quantiles = Callable[[Array], Array]  # values below which the shares of a distribution lie


def sample(
    size: int, *, method: str = "sobol", seed: int = 0, correlation: Sequence[Any] | None = None, **distributions: Any
) -> dict[str, xr.DataArray]:
    """Draw parameters of a loop from distributions, as ``[sample]`` of a study file does.

    Parameters
    ----------
    size
        Number of samples; a power of two for ``sobol`` and ``saltelli``.
    method
        ``sobol``, ``latin_hypercube``, ``random`` or ``saltelli``.
    seed
        Of the design.
    correlation
        Rank correlations of pairs, such as ``[["kp", "ti", 0.6]]``: Spearman's rho, by a Gaussian copula.
    **distributions
        Parameter → distribution in its unit, such as ``backlash={"lognormal": [0.05, 0.4]}``; paths of ``csv`` and
        ``fit`` start from the current folder.

    Returns
    -------
    dict
        Name → values along ``sample``, for ``loop.assign(**drawn)``.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    options = {} if correlation is None else {"correlation": correlation}
    return sample_values({"method": method, "size": size, "seed": seed, **options, **distributions})


def sample_values(
    table: Mapping[str, Any], known: Mapping[str, Parameter] = PARAMETERS, folder: Path = Path(), batches: int = 1
) -> dict[str, xr.DataArray]:
    """Draw the parameters of ``[sample]``: name → numbers in the parameter's unit, or words, along ``sample``.

    The same table always gives the same values; with the methods ``sobol``, ``saltelli`` and ``random``
    they are the first of a larger ``size``.  ``saltelli`` draws for Sobol' indices: two independent samples, ``A`` and
    ``B`` along a dimension ``design``, and for each parameter ``A`` with only that parameter taken from ``B``
    (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).

    folder: where paths start.  batches: how many independent designs of ``size`` points are drawn, one after another;
    the first is that of a single one.
    """
    quantiles_by_name = _parse_sample(table, known, folder)
    names = list(quantiles_by_name)
    method, is_saltelli = table["method"], table["method"] == SALTELLI
    dims = len(names) * (2 if is_saltelli else 1)
    designs = [_design_points(method, table["size"], dims, table.get("seed", 0), k) for k in range(batches)]
    points = designs[0] if batches == 1 else np.concatenate(designs)
    points = _correlate_points(points, names, table.get("correlation", []))
    values_A = {name: _evaluate_quantiles(quantiles_by_name[name], points[:, k]) for k, name in enumerate(names)}
    if not is_saltelli:
        return {name: xr.DataArray(values, dims=SAMPLE_DIM) for name, values in values_A.items()}
    values_B = {
        name: _evaluate_quantiles(quantiles_by_name[name], points[:, len(names) + k]) for k, name in enumerate(names)
    }
    labels = ["A", "B", *names]
    arrays = {}
    for name in names:
        columns = [values_B[name] if label in ("B", name) else values_A[name] for label in labels]
        arrays[name] = xr.DataArray(
            np.stack(columns, axis=-1), dims=(SAMPLE_DIM, DESIGN_DIM), coords={DESIGN_DIM: labels}
        )
    return arrays


def _evaluate_quantiles(quantiles: Quantiles, shares: Array) -> Array:
    """The quantiles at many shares, some at a time: scipy takes ten times the memory of what it returns."""
    return np.concatenate([quantiles(shares[k : k + _VALUES_AT_ONCE]) for k in range(0, shares.size, _VALUES_AT_ONCE)])


def design_size(table: Mapping[str, Any]) -> int:
    """Number of scenarios that ``[sample]`` draws; 1 where it is absent or wrong."""
    size = table.get("size")
    if type(size) is not int or not 1 <= size <= MAX_SAMPLE_SIZE:
        return 1
    return size * (len(sampled_names(table)) + 2 if table.get("method") == SALTELLI else 1)


def sample_files(table: Mapping[str, Any] | None) -> Iterator[str]:
    """The files that ``[sample]`` names."""
    for name in sampled_names(table):
        shape = (table or {})[name]
        files = [shape.get(kind) for kind in (CSV, FIT)] if isinstance(shape, dict) else []
        yield from (file for file in files if isinstance(file, str))


def sample_file_hashes(table: Mapping[str, Any] | None, folder: Path) -> list[str]:
    """SHA-256 of the files that ``[sample]`` names."""
    return [file_sha256(folder / name) for name in sample_files(table)]


def _design_points(method: str, size: int, dims: int, seed: int, batch: int = 0) -> Array:
    """Points of the unit cube, (size, dims); each batch of a seed is independent of the others."""
    rng: Any = np.random.SeedSequence(seed, spawn_key=(batch,)) if batch else seed
    if method == "random":
        return np.random.Generator(np.random.PCG64(rng)).random((size, dims))
    from scipy.stats import qmc

    sampler = qmc.Sobol if method in POWERS_OF_TWO else qmc.LatinHypercube
    return np.asarray(sampler(dims, rng=rng).random(size))


def _parse_sample(table: Mapping[str, Any], known: Mapping[str, Parameter], folder: Path) -> dict[str, Quantiles]:
    """The quantiles of each parameter, all mistakes refused together; the loop checks the bounds of what is drawn."""
    needed = {"method": f"one of {', '.join(METHODS)}", "size": "the number of samples"}
    settings = {"method": METHODS[0], "size": 1, "seed": 0, **table}
    quantiles_by_name: dict[str, Quantiles] = {}
    with argument_checks() as check:
        problems = check.problems
        problems += [f"{name} is missing: give {what}" for name, what in needed.items() if name not in table]
        check(require_choice, "method", settings["method"], METHODS)
        check(require_integer, "size", settings["size"], 1, MAX_SAMPLE_SIZE)
        check(require_integer, "seed", settings["seed"], *RUN_LIMITS["seed"])
        if not problems and settings["method"] in POWERS_OF_TWO and settings["size"].bit_count() > 1:
            lower_power = 1 << (settings["size"].bit_length() - 1)
            problems.append(
                f"size = {settings['size']}: a Sobol design is even only in powers of two, such as {lower_power}"
            )
        names = sampled_names(table)
        for name, shape in known_parameters({name: table[name] for name in names}, problems, known=known).items():
            with collect_problems(problems):
                quantiles_by_name[name] = _parse_distribution(known[name], shape, folder)
        if not names:
            problems.append("no parameter is given: give at least one, such as backlash = { uniform = [0.02, 0.15] }")
        if "correlation" in table:
            check(_check_correlation, table)
    return quantiles_by_name


def _parse_distribution(parameter: Parameter, shape: object, folder: Path) -> Quantiles:
    """The quantiles of a distribution; ``InputError`` if ``shape`` is none for the parameter."""
    name = parameter.name
    if not isinstance(shape, dict) or not (len(shape) == 1 or shape.keys() == {CSV, "column"}):
        example = "{ uniform = [lowest, highest] }"
        raise InputError(
            f"{name} = {short_repr(shape)}: give one distribution, such as {example}; known: {', '.join(DISTRIBUTION_KINDS)}"
        )
    kind = CSV if CSV in shape else next(iter(shape))
    arguments = shape[kind]
    if kind == CHOICE and isinstance(arguments, list):
        raise_problems(summarise_problems([problem for value in arguments if (problem := parameter.problem(value))]))
    problems: list[str] = []
    with collect_problems(problems, f"{name} = {{ {kind} = {short_repr(arguments)} }}: "):
        if kind not in DISTRIBUTION_KINDS:
            raise InputError(
                f"unknown distribution{did_you_mean(kind, DISTRIBUTION_KINDS)}; known: {', '.join(DISTRIBUTION_KINDS)}"
            )
        if kind == CHOICE:
            return _choice_quantiles(_parse_choices(arguments))
        if parameter.is_word or (parameter.whole and kind != CSV):
            what = "word" if parameter.is_word else "whole number"
            raise InputError(f"{name} is a {what}, use {{ {CHOICE} = […] }}")
        if kind == CSV:
            return _choice_quantiles(_read_measured_values(parameter, arguments, shape.get("column"), folder))
        return (
            _fitted_quantiles(parameter, arguments, folder)
            if kind == FIT
            else _continuous_quantiles(parameter, kind, arguments)
        )
    raise InputError(summarise_problems(problems))


def _parse_choices(values: object) -> np.ndarray:
    if not isinstance(values, list) or not values:
        raise InputError("give a list of at least one value")
    raise_problems([f"{value} appears twice, leave one out" for value, n in Counter[Any](values).items() if n > 1])
    return np.array(values if isinstance(values[0], str) else [float(v) for v in values])


def _choice_quantiles(values: np.ndarray) -> Quantiles:
    """Equally likely values, in their order."""
    return lambda share: values[np.minimum((share * values.size).astype(np.int64), values.size - 1)]


def _continuous_quantiles(parameter: Parameter, kind: str, arguments: Any) -> Quantiles:
    """Quantiles strictly between the lowest and the highest value of a distribution."""
    names, rule = DISTRIBUTIONS[kind]
    if kind in _CUT_AT_BOUNDS and is_number_list(arguments, 2):
        raise_problems([problem for problem in [parameter.problem(arguments[0])] if problem])
        least = max(parameter.lower, 0.0) if kind == "lognormal" else parameter.lower
        arguments = [*arguments, least, parameter.upper]
    elif not is_number_list(arguments, len(names)):
        short_form = f"[{', '.join(names[:2])}] or " if kind in _CUT_AT_BOUNDS else ""
        raise InputError(f"give {short_form}[{', '.join(names)}], {len(names)} finite numbers")
    argument_by_name = dict(zip(names, np.array(arguments, dtype=float), strict=True))
    if not np.isfinite(_ppf(kind, argument_by_name, np.array(0.5))):
        raise InputError(f"give [{', '.join(names)}] with {rule}")
    limits = (
        np.nextafter(argument_by_name["lowest"], argument_by_name["highest"]),
        np.nextafter(argument_by_name["highest"], argument_by_name["lowest"]),
    )
    return lambda share: np.asarray(
        np.clip(_ppf(kind, argument_by_name, np.clip(share, _MIN_SHARE, _MAX_SHARE)), *limits)
    )


def _ppf(kind: str, arguments: Mapping[str, float], share: Array) -> Any:
    """Quantiles of a distribution; NaN where its arguments are none."""
    from scipy import stats

    low, high = arguments["lowest"], arguments["highest"]
    with np.errstate(all="ignore"):  # a range that overflows gives values that the loop refuses
        if kind == "uniform":
            frozen = stats.uniform(low, high - low)
        elif kind == "loguniform":
            frozen = stats.loguniform(low, high)
        elif kind == "triangular":
            frozen = stats.triang((arguments["most likely"] - low) / (high - low), low, high - low)
        elif kind == "beta":
            frozen = stats.beta(arguments["a"], arguments["b"], low, high - low)
        elif kind == "lognormal":
            low, mean, high = np.log([low, arguments["median"], high])
            std = arguments["sigma"]
            return np.exp(stats.truncnorm((low - mean) / std, (high - mean) / std, mean, std).ppf(share))
        else:
            mean, std = arguments["mean"], arguments["standard deviation"]
            frozen = stats.truncnorm((low - mean) / std, (high - mean) / std, mean, std)
        return frozen.ppf(share)


_FITTED_FILE_HINT = "a file that `fastcoil fit` or `fastcoil valve-test read` wrote"
_MAX_FITTED_FILE_BYTES = 2**20  # bytes
_NORMAL_QUANTILE_975 = 1.959963984540054  # standard deviations from the median to the ends of a 95 % interval


def _read_measured_values(parameter: Parameter, file: object, column: object, folder: Path) -> Array:
    """The values of a column, ascending: their quantiles draw them anew, as a bootstrap does."""
    if not isinstance(file, str) or not isinstance(column, str):
        raise InputError('give a file and the header of a column, such as { csv = "gaps.csv", column = "gap" }')
    table = Table.read(folder / file)
    place = table.column(column)
    if place is None:
        raise InputError(
            f"{file} has no column {short_repr(column)}{did_you_mean(column, table.header)}: give one of its headers"
        )
    header_unit = None if table.declared_units(place) else parameter.unit
    values = read_numbers(
        table, Series(parameter.name, parameter.text, accepted_units(parameter.unit)), place, header_unit
    )
    table.raise_problems()
    raise_problems([problem for value in values.tolist() if (problem := parameter.problem(value))])
    return np.sort(values)


def _fitted_quantiles(parameter: Parameter, file: object, folder: Path) -> Quantiles:
    """What a fit or a valve test knows of a parameter: its posterior, else a normal distribution on each side.

    These have the estimate as median, the ends of its 95 % interval as quantiles, and end at the parameter's bounds.
    """
    if not isinstance(file, str):
        raise InputError(f"give {_FITTED_FILE_HINT}")
    tables, name = parse_toml(read_text(folder / file, _FITTED_FILE_HINT, _MAX_FITTED_FILE_BYTES), file), parameter.name
    value, interval = _nested_entry(tables, "loop", name), _nested_entry(tables, "fit", "interval_95", name)
    if not is_number_list([value], 1) or not is_number_list(interval, 2) or not interval[0] < interval[1]:
        raise InputError(
            f"{file} has no estimate of {name} with a 95 % interval: give {_FITTED_FILE_HINT}, with {name} identified"
        )
    sizes, probability = (_nested_entry(tables, "fit", "posterior", key) or [] for key in (name, "probability"))
    if sizes and is_number_list(sizes, len(sizes)) and is_number_list(probability, len(sizes)):
        return _posterior_quantiles(np.array(sizes, dtype=float), np.array(probability, dtype=float))
    from scipy.special import ndtr, ndtri

    below, above = (
        (end - value) / z for end, z in zip(interval, (-_NORMAL_QUANTILE_975, _NORMAL_QUANTILE_975), strict=True)
    )
    least = ndtr((parameter.lower - value) / below) if below > 0.0 else 0.5
    most = ndtr((parameter.upper - value) / above) if above > 0.0 else 0.5

    def quantiles(share: Array) -> Array:
        z = ndtri(np.clip(least + share * (most - least), _MIN_SHARE, _MAX_SHARE))
        return np.asarray(np.clip(value + z * np.where(z < 0.0, below, above), parameter.lower, parameter.upper))

    return quantiles


def _nested_entry(table: Any, *keys: str) -> Any:
    """An entry of tables inside each other; None without it."""
    for key in keys:
        table = table.get(key) if isinstance(table, dict) else None
    return table


def _posterior_quantiles(sizes: Array, probability: Array) -> Quantiles:
    """Quantiles of sizes, each as probable throughout the cell around it."""
    edges = np.concatenate([sizes[:1], 0.5 * (sizes[1:] + sizes[:-1]), sizes[-1:]])
    below = np.concatenate([[0.0], np.cumsum(probability)]) / probability.sum()
    return lambda share: np.interp(share, below, edges)


_MIN_EIGENVALUE = 1e-9


def _check_correlation(table: Mapping[str, Any]) -> None:
    pairs, names = table["correlation"], sampled_names(table)
    is_well_formed = isinstance(pairs, list | tuple) and all(
        isinstance(pair, list | tuple) and len(pair) == 3 for pair in pairs
    )
    if not is_well_formed or not all(is_number_list([rho], 1) and {type(a), type(b)} == {str} for a, b, rho in pairs):
        example = 'such as [["kp", "ti", 0.6]]'
        text = f"correlation = {short_repr(pairs)}: give pairs of parameters and their rank correlation, {example}"
        raise InputError(text if isinstance(pairs, list | tuple) else WrongTypeMessage(text))
    problems = []
    if table.get("method") == SALTELLI:
        problems.append("correlation: Sobol' indices need independent parameters: leave it out, or take another method")
    for a, b, rho in pairs:
        text = f"correlation of {a} and {b}"
        unknown = [name for name in (a, b) if name not in names]
        problems += [
            f"{text}: {name} is not drawn{did_you_mean(name, names)}, give its distribution" for name in unknown
        ]
        choice_names = [
            name for name in (a, b) if name in names and isinstance(table[name], dict) and CHOICE in table[name]
        ]
        problems += [f"{text}: {name} is drawn by {CHOICE}, which has no ranks" for name in choice_names]
        if not -1.0 < rho < 1.0:
            problems.append(f"{text} = {rho}: must be above -1 and below 1")
    repeated_pairs = [
        pair for pair, n in Counter(frozenset(pair[:2]) for pair in pairs).items() if n > 1 or len(pair) == 1
    ]
    problems += [
        f"correlation of {' and '.join(sorted(pair))}: give each pair of two parameters once" for pair in repeated_pairs
    ]
    raise_problems(problems)
    if np.linalg.eigvalsh(_correlation_matrix(names, pairs)).min() < _MIN_EIGENVALUE:
        pairs_text = ", ".join(f"{a} and {b} = {rho}" for a, b, rho in pairs)
        raise InputError(
            f"correlation of {pairs_text}: these cannot hold together (their matrix is not positive definite), bring them "
            "nearer to 0"
        )


def _correlation_matrix(names: Sequence[str], pairs: Sequence[Sequence[Any]]) -> Array:
    """Correlations of normal variables whose ranks correlate as the pairs say (Pearson 1907): r = 2 sin(π ρ / 6)."""
    matrix = np.eye(len(names))
    for a, b, rho in pairs:
        i, j = names.index(a), names.index(b)
        matrix[i, j] = matrix[j, i] = 2.0 * np.sin(np.pi * rho / 6.0)
    return matrix


def _correlate_points(points: Array, names: Sequence[str], pairs: Sequence[Sequence[Any]]) -> Array:
    """The points with rank correlations, by a Gaussian copula; parameters in no pair, and the first of each, stay."""
    if not pairs:
        return points
    from scipy.special import ndtr, ndtri

    factor = np.linalg.cholesky(_correlation_matrix(names, pairs))
    z, correlated = ndtri(np.clip(points, _MIN_SHARE, _MAX_SHARE)), points.copy()
    for i, row in enumerate(factor):
        if row[:i].any():  # summed one by one: the bits of a product of matrices depend on its size
            correlated[:, i] = ndtr(sum(row[j] * z[:, j] for j in np.flatnonzero(row)))
    return correlated
