"""Build the ``Loop`` of a study from the tables ``[loop]``, ``[sweep]``, ``[cases.NAME]`` and ``[sample]``.

The parameters of ``[sample]`` are drawn together, zipped along the dimension ``sample``.  A design is ``size`` points
of the unit cube with one dimension for each parameter; the quantiles of a parameter's distribution turn its coordinates
into values.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, choice_of, collecting, refuse, whole_of
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.base.files import read_text
from fastcoil.loops.assignment import WORD, expanded, table_of
from fastcoil.loops.labels import unit_in_words
from fastcoil.loops.loop import Loop, knowing
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.model.parameter_table import INSTALLED_VALVE, PARAMETERS, Parameter
from fastcoil.model.user_rules import Rule
from fastcoil.study.analysis.selected import listed
from fastcoil.study.file.tables import StudyFile, are_numbers, first_of, known_parameters, parse_toml, sampled_names

_WHAT = "a file that `fastcoil fit` wrote, with a path from the study file's folder"
_LARGEST = 2**20  # bytes
_MOST_FILES = 100


def read_includes(loop: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Read the parameters in the files that ``include`` in a study's ``[loop]`` names.

    Paths start from ``folder``.  Only the ``[loop]`` of a file is read; its ``[fit]`` is documentation.
    """
    names = loop.get("include", [])
    if not isinstance(names, list) or len(names) > _MOST_FILES or not all(isinstance(name, str) for name in names):
        example = 'such as ["valve.toml", "coil.toml"]'
        raise InputError(f"include = {shown(names)}: give a list of files, {_MOST_FILES} at most, {example}")
    found: dict[str, Any] = {}
    origin: dict[str, str] = {}
    problems: list[str] = []
    for name in names:
        parameters: dict[str, Any] = {}
        with collecting(problems, "include: "):
            parameters = _read_parameters(folder / name, name)
        twice = [n for n in parameters if n in origin]
        problems += [f"include: {n} appears in {origin[n]} and in {name}: leave one out" for n in twice]
        found |= parameters
        origin.update((n, name) for n in parameters)
    refuse(problems)
    return found


def _read_parameters(path: Path, name: str) -> dict[str, Any]:
    tables = parse_toml(read_text(path, _WHAT, _LARGEST), name)
    loop = tables.get("loop")
    if not isinstance(loop, dict) or set(tables) - {"loop", "fit"}:
        raise InputError(f"{name} is no file that `fastcoil fit` wrote: it needs a table [loop], and may have [fit]")
    problems: list[str] = []
    known = known_parameters(loop, problems)
    problems += [problem for problem in (PARAMETERS[n].problem(value) for n, value in known.items()) if problem]
    refuse([f"{name}: {problem}" for problem in problems])
    return loop


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


def sample_values(table: Mapping[str, Any], known: Mapping[str, Parameter] = PARAMETERS) -> dict[str, xr.DataArray]:
    """Draw the parameters of ``[sample]``: name → numbers in the parameter's unit, or words, along ``sample``.

    The same table always gives the same values; with the methods ``sobol``, ``saltelli`` and ``random``
    they are the first of a larger ``size``.  ``saltelli`` draws for Sobol' indices: two independent samples, ``A`` and
    ``B`` along a dimension ``design``, and for each parameter ``A`` with only that parameter taken from ``B``
    (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).
    """
    _check_sample(table, known)
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


def _check_sample(table: Mapping[str, Any], known: Mapping[str, Parameter]) -> None:
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
        if wrong := [problem for value in arguments if (problem := parameter.problem(value))]:
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


LONGEST_AXIS = 1_000_000  # values; more take minutes to label, and a design that large is drawn with [sample]
_MOST_DIMS = 32
_SPACINGS: dict[str, Callable[..., Any]] = {"linspace": np.linspace, "geomspace": np.geomspace}


def build_loop(file: StudyFile, included: Mapping[str, Any], rules: Mapping[str, Rule]) -> Loop:
    """Build the loop of a study: preset, what it includes, constants, swept axes, named cases, the sample.

    rules: the study's own, by the names that stand for them in the tables.
    """
    if len(file.cases) > _MOST_DIMS:
        raise InputError(f"[cases] has {len(file.cases):,} tables: give at most {_MOST_DIMS}, each is a dimension")
    problems: list[str] = []
    known = table_of(rules)
    given = {name: value for name, value in file.loop.items() if name not in ("preset", "include")}
    constants = given
    with collecting(problems, "[loop] "):
        constants = expanded(given)
    standing = {n: "[loop]" if n in given else f"[loop] as part of {WORD}" for n in constants if n != WORD}
    constants = known_parameters({n: constants[n] for n in standing}, problems, "[loop] ", known)
    loop = knowing(Loop(), rules.values())
    with collecting(problems, "[loop] "):
        loop = knowing(Loop.preset(str(file.loop.get("preset", "paper_like"))), rules.values()).assign(**included)
    valve = _valve_of_several_tables(file)
    if valve:
        # any installed valve, so that each table can change its part of it
        loop = loop.assign(rangeability=50.0, authority=0.5, m_full=1.5)
        missing = [n for n in INSTALLED_VALVE if n not in valve]
        problems += [f"{', '.join(INSTALLED_VALVE)} go together: {n} is missing, give it too" for n in missing]
    with collecting(problems, "[loop] "):
        loop = loop.assign(**constants)
    axes = {}
    for name, axis in known_parameters(file.sweep, problems, "[sweep] ", known).items():
        with collecting(problems, "[sweep] "):
            axes[name] = axis_values(name, axis)
    with collecting(problems, "[sweep] "):
        loop = loop.assign(**axes)
    problems += _find_repeated(file, standing)
    for dim, cases in file.cases.items():
        with collecting(problems, f"[cases.{dim}] "):
            loop = loop.assign(**_zip_cases(dim, cases, loop, valve - constants.keys()))
    if file.sample is not None:
        with collecting(problems, "[sample] "):
            # in one call, since some parameters are only admissible together
            loop = loop.assign(**sample_values(file.sample, known))
    refuse(problems)
    return loop


_USUAL: dict[str, tuple[float, float, str]] = {
    "kp": (-1.0, 1.0, "%/K, divide it by 100"),
    "ti": (2.0, np.inf, "minutes, multiply it by 60"),
    "backlash": (0.0, 0.3, "%, divide it by 100"),
    "backlash_estimate": (0.0, 0.3, "%, divide it by 100"),
    "buffer": (0.0, 0.3, "%, divide it by 100"),
    "C_w": (0.0, 1000.0, "J/K, divide it by 1000"),
    "C_c": (0.0, 1000.0, "J/K, divide it by 1000"),
    "stroke_time": (5.0, np.inf, "minutes, multiply it by 60"),
    "noise_std": (0.0, 2.0, "mK, divide it by 1000"),
    "sensor_resolution": (0.0, 2.0, "mK, divide it by 1000"),
}
"""Least and largest usual value, and in which unit a value outside was perhaps meant; 0 always means off."""


def warn_of_magnitudes(loop: Loop) -> None:
    """Warn of values that are admissible, and more likely in another unit."""
    for name, (least, most, meant) in _USUAL.items():
        values = np.array([] if loop[name] is None else np.ravel(loop[name]))
        odd = values[(values != 0.0) & ((values < least) | (values > most))]
        if odd.size:
            value, unit = odd[np.argmax(abs(odd))], PARAMETERS[name].unit
            given = f"{value:g}" if unit == "1" else f"{value:g} {unit_in_words(unit)}"
            warnings.warn(f"{name} = {given} is unusual and taken as it is: if it is in {meant}", stacklevel=2)


def _find_repeated(file: StudyFile, constants: Mapping[str, str]) -> list[str]:
    """A sentence for each parameter that two tables give; constants: those of [loop], and where they stand."""
    places = {"[sweep]": list(file.sweep)}
    places |= {f"[cases.{dim}]": _case_names(cases) for dim, cases in file.cases.items()}
    places["[sample]"] = sampled_names(file.sample)
    problems: list[str] = []
    taken: dict[str, str] = {}
    for place, names in places.items():
        # a case may differ from the constant that holds for the others
        before = taken if place.startswith("[cases") else {**taken, **constants}
        problems += [f"{n} appears in {before[n]} and in {place}: leave one out" for n in names if n in before]
        taken |= dict.fromkeys(names, place)
    return problems


def _valve_of_several_tables(file: StudyFile) -> set[str]:
    """The parameters of an installed valve in the file, if they are spread over several tables, else none."""
    tables = [file.loop, file.sweep, *map(_case_names, file.cases.values()), sampled_names(file.sample)]
    parts = [{n for n in INSTALLED_VALVE if n in table} for table in tables]
    named = set[str]().union(*parts)
    return named if named not in parts else set()


def _case_names(cases: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Every parameter that one of the cases gives."""
    return list(dict.fromkeys(name for case in cases.values() for name in case))


def axis_values(name: str, axis: object) -> list[Any]:
    """Values of a swept axis: a list, ``{ linspace = [first, last, count] }`` or ``{ geomspace = […] }``."""
    if isinstance(axis, list):
        return axis
    spaced: dict[str, Any] = axis if isinstance(axis, dict) and len(axis) == 1 else {"": None}
    ((kind, spacing),) = spaced.items()
    if kind not in _SPACINGS:
        kinds = "{ linspace = [first, last, count] } or { geomspace = [first, last, count] }"
        raise InputError(f"{name} = {shown(axis)}: give a list of values, {kinds}")
    if not are_numbers(spacing, 3) or type(spacing[2]) is not int or not 1 <= spacing[2] <= LONGEST_AXIS:
        raise InputError(
            f"{name} = {{ {kind} = {shown(spacing)} }}: give [first, last, count], two finite numbers and a whole "
            f"number from 1 to {LONGEST_AXIS:,}; draw more with [sample]"
        )
    first, last, count = spacing
    if kind == "geomspace" and min(first, last) <= 0.0:
        raise InputError(f"{name} = {{ geomspace = {shown(spacing)} }}: first and last must be above 0")
    return list(_SPACINGS[kind](float(first), float(last), count).tolist())


def _zip_cases(
    dim: str, cases: Mapping[str, Mapping[str, float | str]], loop: Loop, unset: Collection[str]
) -> dict[str, xr.DataArray]:
    """Put the parameters of named cases along ``dim``; a case may leave out what the loop gives, unless ``unset``."""
    if not cases:
        raise InputError("no case: give at least one, such as fast = { kp = 0.05, ti = 5 }")
    if dim in loop.parameters or dim in (SAMPLE_DIM, DESIGN_DIM):
        what = "a parameter" if dim in loop.parameters else "the dimension of [sample]"
        raise InputError(f"{dim} is {what}: give the dimension another name, such as tuning or controller")
    zipped: dict[str, xr.DataArray] = {}
    problems: list[str] = []
    for name in known_parameters(dict.fromkeys(_case_names(cases)), problems, known=loop.parameters):
        default = None if name in unset else loop[name]
        without = [label for label, case in cases.items() if name not in case]
        if without and (default is None or isinstance(default, xr.DataArray)):
            problems.append(f"{name} is missing in {listed(without)}: give it in every case")
            continue
        values = [case.get(name, default) for case in cases.values()]
        wrong = first_of([problem for value in values if (problem := loop.parameters[name].problem(value))])
        problems += wrong
        if not wrong:
            zipped[name] = xr.DataArray(values, dims=dim, coords={dim: list(cases)})
    if not zipped and not problems:
        problems.append("its cases are empty: give each the parameters that make it differ")
    refuse(problems)
    return zipped
