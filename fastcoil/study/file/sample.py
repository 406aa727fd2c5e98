"""Draw the parameters of ``[sample]``: designs, distributions, rank correlations.

A design is ``size`` points of the unit cube; the quantiles of a parameter's distribution turn its coordinates into
values, so that another distribution of one parameter changes no other.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, collect_problems, raise_problems, require_choice, require_integer
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.logs.readings import read_numbers
from fastcoil.logs.series import Series
from fastcoil.logs.table import Table
from fastcoil.loops.labelled import accepted_units
from fastcoil.loops.netcdf import file_sha256
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.study.file.tables import is_number_list, known_parameters, sampled_names, summarise_problems

SAMPLE_DIM = "sample"
DESIGN_DIM = "design"  # only with ``saltelli``
SALTELLI = "saltelli"
METHODS = ("latin_hypercube", "sobol", "random", SALTELLI)
POWERS_OF_TWO = ("sobol", SALTELLI)
MAX_SAMPLE_SIZE = 10_000_000
_MIN_SHARE = 2.0**-32  # half a cell of the Sobol lattice, whose coordinates may be 0
_MAX_SHARE = 1.0 - 2.0**-53  # the largest float below 1
_VALUES_AT_ONCE = 2**17

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
_CUT_AT_BOUNDS = ("normal", "lognormal")  # of the parameter, where no ends are given
CHOICE = "choice"
CSV = "csv"
DISTRIBUTION_KINDS = (*DISTRIBUTIONS, CHOICE, CSV)

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
        ``sobol`` (default), ``latin_hypercube``, ``random`` or ``saltelli``, the design for Sobol' indices (Saltelli et
        al. 2010, doi:10.1016/j.cpc.2009.09.018).
    seed
        Seed of the design.
    correlation
        Rank correlations of pairs, such as ``[["kp", "ti", 0.6]]``: Spearman's rho, by a Gaussian copula.
    **distributions
        Parameter → distribution in its unit, such as ``backlash={"lognormal": [0.05, 0.4]}``; the path of
        ``csv`` starts from the current folder.

    Returns
    -------
    dict of str to xarray.DataArray
        Name → values along ``sample``, (``size``,), for ``loop.assign(**drawn)``; with ``saltelli`` along ``design`` as
        well.

    Raises
    ------
    InputError
        With one sentence for each mistake.

    Examples
    --------
    >>> import fastcoil as fc
    >>> drawn = fc.sample(8, backlash={"uniform": [0.02, 0.1]}, kp={"lognormal": [0.02, 0.5]})
    >>> fc.Loop().assign(**drawn).sizes
    {'sample': 8}
    """
    options = {} if correlation is None else {"correlation": correlation}
    return sample_values({"method": method, "size": size, "seed": seed, **options, **distributions})


def sample_values(
    table: Mapping[str, Any], known: Mapping[str, Parameter] = PARAMETERS, folder: Path = Path(), batches: int = 1
) -> dict[str, xr.DataArray]:
    """Draw the parameters of ``[sample]``: name → numbers in the parameter's unit, or words, along ``sample``.

    The same table always gives the same values, with all methods but ``latin_hypercube`` the first of a larger
    ``size``.  ``saltelli`` draws two independent samples, ``A`` and ``B`` along a dimension ``design``, and for each
    parameter ``A`` with only that parameter taken from ``B``.  batches: how many independent designs are drawn, one
    after another.
    """
    distributions = _parse_sample(table, known, folder)
    names = list(distributions)
    method, is_saltelli = table["method"], table["method"] == SALTELLI
    dims = len(names) * (2 if is_saltelli else 1)
    designs = [_design_points(method, int(table["size"]), dims, int(table.get("seed", 0)), k) for k in range(batches)]
    points = designs[0] if batches == 1 else np.concatenate(designs)
    points = _correlate_points(points, names, table.get("correlation", []))
    values_A = {name: _evaluate_quantiles(distributions[name], points[:, k]) for k, name in enumerate(names)}
    if not is_saltelli:
        return {name: xr.DataArray(values, dims=SAMPLE_DIM) for name, values in values_A.items()}
    points_B = points[:, len(names) :]
    values_B = {name: _evaluate_quantiles(distributions[name], points_B[:, k]) for k, name in enumerate(names)}
    coords, arrays = {DESIGN_DIM: ["A", "B", *names]}, {}
    for name in names:
        columns = [values_B[name] if label in ("B", name) else values_A[name] for label in coords[DESIGN_DIM]]
        arrays[name] = xr.DataArray(np.stack(columns, axis=-1), coords, (SAMPLE_DIM, DESIGN_DIM))
    return arrays


def _evaluate_quantiles(quantiles: Quantiles, shares: Array) -> Array:
    """Evaluate quantiles at many shares, some at a time: scipy takes ten times the memory of what it returns."""
    return np.concatenate([quantiles(shares[k : k + _VALUES_AT_ONCE]) for k in range(0, shares.size, _VALUES_AT_ONCE)])


def design_size(table: Mapping[str, Any]) -> int:
    """Return the ``size`` of ``[sample]``; 1 where it is absent or wrong."""
    size = table.get("size")
    return size if type(size) is int and 1 <= size <= MAX_SAMPLE_SIZE else 1


def sample_file_hashes(table: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the SHA-256 of the files that ``[sample]`` names."""
    shapes = [table[name] for name in sampled_names(table)]
    return [file_sha256(folder / shape[CSV]) for shape in shapes if CSV in shape]


def _design_points(method: str, size: int, dims: int, seed: int, batch: int = 0) -> Array:
    """Points of the unit cube, (size, dims); each batch of a seed is independent of the others."""
    rng: Any = np.random.SeedSequence(seed, spawn_key=(batch,)) if batch else seed
    if method == "random":
        return np.random.Generator(np.random.PCG64(rng)).random((size, dims))
    from scipy.stats import qmc

    sampler = qmc.Sobol if method in POWERS_OF_TWO else qmc.LatinHypercube
    return np.asarray(sampler(dims, rng=rng).random(size))


def _parse_sample(table: Mapping[str, Any], known: Mapping[str, Parameter], folder: Path) -> dict[str, Quantiles]:
    """Parse the distributions of all parameters; the loop checks the bounds of what is drawn."""
    settings = {"method": METHODS[0], "size": 1, "seed": 0, **table}
    distributions: dict[str, Quantiles] = {}
    with argument_checks() as check:
        problems = check.problems
        for name, meaning in {"method": f"one of {', '.join(METHODS)}", "size": "the number of samples"}.items():
            if name not in table:
                problems.append(Problem(f"{name} is missing: give {meaning}", name, "missing"))
        check(require_choice, "method", settings["method"], METHODS)
        size = check(require_integer, "size", settings["size"], 1, MAX_SAMPLE_SIZE)
        check(require_integer, "seed", settings["seed"], *RUN_LIMITS["seed"])
        if not problems and settings["method"] in POWERS_OF_TWO and size.bit_count() > 1:
            power = 1 << (size.bit_length() - 1)
            sentence = f"size = {size}: a Sobol design is even only in powers of two, give {power} or {2 * power}"
            problems.append(Problem(sentence, "size", "value"))
        names = sampled_names(table)
        for name, shape in known_parameters({name: table[name] for name in names}, problems, known=known).items():
            with collect_problems(problems):
                distributions[name] = _parse_distribution(known[name], shape, folder)
        if not names:
            sentence = "no parameter is given: give at least one, such as backlash = { uniform = [0.02, 0.15] }"
            problems.append(Problem(sentence, "sample", "missing"))
        if "correlation" in table:
            check(_check_correlation, table)
    return distributions


def _parse_distribution(parameter: Parameter, shape: object, folder: Path) -> Quantiles:
    """Return the quantiles of a distribution; ``InputError`` if ``shape`` is none for the parameter."""
    name, known = parameter.name, f"known: {', '.join(DISTRIBUTION_KINDS)}"
    if not isinstance(shape, dict) or not (len(shape) == 1 or shape.keys() == {CSV, "column"}):
        cure = "give one distribution, such as { uniform = [lowest, highest] }"
        raise InputError(f"{name} = {short_repr(shape)}: {cure}; {known}", name, "value")
    kind = CSV if CSV in shape else next(iter(shape))
    arguments = shape[kind]
    if kind == CHOICE and isinstance(arguments, list):
        raise_problems(summarise_problems([problem for value in arguments if (problem := parameter.problem(value))]))
    try:
        return _parse_shape(parameter, kind, arguments, shape, folder)
    except InputError as error:
        prefix = f"{name} = {{ {kind} = {short_repr(arguments)} }}: "
        raise InputError([p.with_prefix(prefix) for p in summarise_problems(error.problems)]) from None


def _parse_shape(parameter: Parameter, kind: str, arguments: Any, shape: Mapping[str, Any], folder: Path) -> Quantiles:
    if kind not in DISTRIBUTION_KINDS:
        known = f"{did_you_mean(kind, DISTRIBUTION_KINDS)}; known: {', '.join(DISTRIBUTION_KINDS)}"
        raise InputError(f"unknown distribution{known}", parameter.name, "name")
    if kind == CHOICE:
        return _choice_quantiles(_parse_choices(parameter.name, arguments))
    if parameter.is_word or (parameter.whole and kind != CSV):
        noun = "word" if parameter.is_word else "whole number"
        raise InputError(f"{parameter.name} is a {noun}, use {{ {CHOICE} = […] }}", parameter.name, "value")
    if kind == CSV:
        return _choice_quantiles(_read_measured_values(parameter, arguments, shape.get("column"), folder))
    return _continuous_quantiles(parameter, kind, arguments)


def _parse_choices(name: str, values: object) -> np.ndarray:
    if not isinstance(values, list) or not values:
        raise InputError("give a list of at least one value", name, "value")
    twice = [value for value, n in Counter[Any](values).items() if n > 1]
    raise_problems([Problem(f"{value} appears twice, leave one out", name, "duplicate") for value in twice])
    return np.array(values if isinstance(values[0], str) else [float(v) for v in values])


def _choice_quantiles(values: np.ndarray) -> Quantiles:
    """Return the quantiles of equally likely values, in their order."""
    return lambda share: values[np.minimum((share * values.size).astype(np.int64), values.size - 1)]


def _continuous_quantiles(parameter: Parameter, kind: str, arguments: Any) -> Quantiles:
    """Return quantiles strictly between the lowest and the highest value of a distribution."""
    names, rule = DISTRIBUTIONS[kind]
    if kind in _CUT_AT_BOUNDS and is_number_list(arguments, 2):
        raise_problems([problem for problem in [parameter.problem(arguments[0])] if problem])
        least = max(parameter.lower, 0.0) if kind == "lognormal" else parameter.lower
        arguments = [*arguments, least, parameter.upper]
    elif not is_number_list(arguments, len(names)):
        short_form = f"[{', '.join(names[:2])}] or " if kind in _CUT_AT_BOUNDS else ""
        sentence = f"give {short_form}[{', '.join(names)}], {len(names)} finite numbers"
        raise InputError(sentence, parameter.name, "value")
    named = dict(zip(names, np.array(arguments, dtype=float), strict=True))
    if not np.isfinite(_ppf(kind, named, np.array(0.5))):
        raise InputError(f"give [{', '.join(names)}] with {rule}", parameter.name, "value")
    low, high = named["lowest"], named["highest"]
    ends = np.nextafter(low, high), np.nextafter(high, low)
    return lambda share: np.asarray(np.clip(_ppf(kind, named, np.clip(share, _MIN_SHARE, _MAX_SHARE)), *ends))


def _ppf(kind: str, arguments: Mapping[str, float], share: Array) -> Any:
    """Return the quantiles of a distribution; NaN for wrong arguments."""
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


_SIZES_IN_PERCENT = ("backlash", "backlash_estimate", "learning_cap", "authority", "estimate_ratio")
"""Parameters of which a table has some above 1 %, unless its per cent are fractions."""


def _read_measured_values(parameter: Parameter, file: object, column: object, folder: Path) -> Array:
    """Read the values of a column, ascending: their quantiles draw them anew, as a bootstrap does."""
    if not isinstance(file, str) or not isinstance(column, str):
        cure = 'give a file and the header of a column, such as { csv = "gaps.csv", column = "gap" }'
        raise InputError(cure, parameter.name, "value")
    table = Table.read(folder / file, column=column)
    place = table.find_column(column)
    if place is None:
        suggestion = did_you_mean(column, table.header)
        sentence = f"{file} has no column {short_repr(column)}{suggestion}: give one of its headers"
        raise InputError(sentence, parameter.name, "name")
    header_unit = None if table.declared_units(place) else parameter.unit
    series = Series(parameter.name, parameter.text, accepted_units(parameter.unit))
    values = read_numbers(table, series, place, header_unit)
    table.raise_problems()
    unit = next(iter(table.declared_units(place).values()), "")
    if parameter.name in _SIZES_IN_PERCENT and series.is_same_unit(unit, "%") and 0.0 < values.max() <= 0.01:
        cell, row = table.rows[0][place].strip(), table.row_numbers[0]
        cure = f"write '{column} [1]' in the header, of fractions, also of {parameter.name} that are below 1 %"
        sentence = f"{column} = {cell} in row {row} is declared in {unit}, and its numbers look like a fraction: {cure}"
        raise InputError(f"{table.name}: {sentence}", parameter.name, "unit")
    raise_problems([problem for value in values.tolist() if (problem := parameter.problem(value))])
    return np.sort(values)


def _check_correlation(table: Mapping[str, Any]) -> None:
    pairs, names = table["correlation"], sampled_names(table)
    is_list = isinstance(pairs, list | tuple)
    is_well_formed = is_list and all(isinstance(pair, list | tuple) and len(pair) == 3 for pair in pairs)
    if not is_well_formed or not all(is_number_list([rho], 1) and {type(a), type(b)} == {str} for a, b, rho in pairs):
        cure = 'give pairs of parameters and their rank correlation, such as [["kp", "ti", 0.6]]'
        sentence = f"correlation = {short_repr(pairs)}: {cure}"
        raise InputError(sentence, "correlation", "value" if is_list else "type")
    problems: list[Problem] = []

    def add(sentence: str, code: str) -> None:
        problems.append(Problem(sentence, "correlation", code))

    if table.get("method") == SALTELLI:
        cure = "leave it out, or take another method"
        add(f"correlation: Sobol' indices need independent parameters: {cure}", "conflict")
    for a, b, rho in pairs:
        pair = f"correlation of {a} and {b}"
        for name in (a, b):
            if name not in names:
                add(f"{pair}: {name} is not drawn{did_you_mean(name, names)}, give its distribution", "name")
            elif isinstance(table[name], dict) and CHOICE in table[name]:
                add(f"{pair}: {name} is drawn by {CHOICE}, which has no ranks", "unsupported")
        if not -1.0 < rho < 1.0:
            add(f"{pair} = {rho}: must be above -1 and below 1", "value")
    for names_of_pair, n in Counter(frozenset(pair[:2]) for pair in pairs).items():
        if n > 1 or len(names_of_pair) == 1:
            pair = " and ".join(sorted(names_of_pair))
            add(f"correlation of {pair}: give each pair of two parameters once", "duplicate")
    raise_problems(problems)
    if np.linalg.eigvalsh(_correlation_matrix(names, pairs)).min() < 1e-9:
        pairs_text = ", ".join(f"{a} and {b} = {rho}" for a, b, rho in pairs)
        reason = "these cannot hold together (their matrix is not positive definite), bring them nearer to 0"
        raise InputError(f"correlation of {pairs_text}: {reason}", "correlation", "conflict")


def _correlation_matrix(names: Sequence[str], pairs: Sequence[Sequence[Any]]) -> Array:
    """Return the correlations of normal variables from those of their ranks (Pearson 1907): r = 2 sin(π ρ / 6)."""
    matrix = np.eye(len(names))
    for a, b, rho in pairs:
        i, j = names.index(a), names.index(b)
        matrix[i, j] = matrix[j, i] = 2.0 * np.sin(np.pi * rho / 6.0)
    return matrix


def _correlate_points(points: Array, names: Sequence[str], pairs: Sequence[Sequence[Any]]) -> Array:
    """Give the points rank correlations, by a Gaussian copula; parameters in no pair, and the first of each, stay."""
    if not pairs:
        return points
    from scipy.special import ndtr, ndtri

    factor = np.linalg.cholesky(_correlation_matrix(names, pairs))
    z, correlated = ndtri(np.clip(points, _MIN_SHARE, _MAX_SHARE)), points.copy()
    for i, row in enumerate(factor):
        if row[:i].any():  # summed one by one: the bits of a product of matrices depend on its size
            correlated[:, i] = ndtr(sum(row[j] * z[:, j] for j in np.flatnonzero(row)))
    return correlated
