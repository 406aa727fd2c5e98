"""Build the ``Loop`` of a study from the tables ``[loop]``, ``[sweep]``, ``[cases.NAME]`` and ``[sample]``."""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import collect_problems, raise_problems
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.files import read_text
from fastcoil.loops.assignment import CONVERGED_KEYWORD, all_parameters, expand_converged
from fastcoil.loops.loop import Loop, add_rules
from fastcoil.model.parameter_table import INSTALLED_VALVE_PARAMETERS, PARAMETERS
from fastcoil.model.user_rules import Rule
from fastcoil.study.analysis.selected import list_first
from fastcoil.study.file.sample import DESIGN_DIM, SAMPLE_DIM, sample_values

from fastcoil.study.file.tables import (  # isort: skip
    StudyFile, is_number_list, known_parameters, parse_toml, sampled_names, summarise_problems,
)  # fmt: skip

_INCLUDE_HINT = "a file that `fastcoil fit` wrote, with a path from the study file's folder"
_MAX_INCLUDE_BYTES = 2**20
_MAX_INCLUDES = 100


def read_includes(loop: Mapping[str, Any], folder: Path, given: Collection[str] = ()) -> dict[str, Any]:
    """Read the parameters in the files that ``include`` in a study's ``[loop]`` names, with paths from ``folder``.

    A gap that ``[fit]`` calls not identified has to be ``given`` elsewhere in the study.
    """
    names = loop.get("include", [])
    if not isinstance(names, list) or len(names) > _MAX_INCLUDES or not all(isinstance(name, str) for name in names):
        cure = f'give a list of files, {_MAX_INCLUDES} at most, such as ["valve.toml", "coil.toml"]'
        raise InputError(f"include = {short_repr(names)}: {cure}", "include", "value")
    included: dict[str, Any] = {}
    file_by_name: dict[str, str] = {}
    problems: list[str] = []
    for name in names:
        parameters: dict[str, Any] = {}
        with collect_problems(problems, "include: "):
            parameters = _read_parameters(folder / name, name, has_backlash="backlash" in {*loop, *given})
        for n in [n for n in parameters if n in file_by_name]:
            sentence = f"include: {n} appears in {file_by_name[n]} and in {name}: leave one out"
            problems.append(Problem(sentence, n, "duplicate"))
        included |= parameters
        file_by_name.update((n, name) for n in parameters)
    raise_problems(problems)
    return included


def _read_parameters(path: Path, name: str, has_backlash: bool) -> dict[str, Any]:
    tables = parse_toml(read_text(path, _INCLUDE_HINT, _MAX_INCLUDE_BYTES), name)
    loop = tables.get("loop")
    if not isinstance(loop, dict) or set(tables) - {"loop", "fit"}:
        sentence = f"{name} is not a file that `fastcoil fit` wrote: it needs a table [loop], and may have [fit]"
        raise InputError(sentence, name, "format")
    fit = tables.get("fit")
    if isinstance(fit, dict) and fit.get("identified") is False and not has_backlash:
        why = f" ({short_repr(reason)})" if (reason := fit.get("reason")) else ""
        sentence = f"{name} did not identify the gap{why}: give backlash in the study, or leave the file out"
        raise InputError(sentence, "include", "data")
    problems: list[str] = []
    known = known_parameters(loop, problems, f"{name}: ")
    wrong = [problem for n, value in known.items() if (problem := PARAMETERS[n].problem(value))]
    raise_problems([*problems, *(problem.with_prefix(f"{name}: ") for problem in wrong)])
    return loop


MAX_AXIS_VALUES = 1_000_000  # more take minutes to label, and a design that large is drawn with [sample]
_MAX_DIMS = 32
SPACINGS: dict[str, Callable[..., Any]] = {"linspace": np.linspace, "geomspace": np.geomspace}


def build_loop(
    file: StudyFile, included: Mapping[str, Any], rules: Mapping[str, Rule], folder: Path, batches: int = 1
) -> Loop:
    """Build the loop of a study from its tables, what it includes, and user-defined rules by their names there."""
    if len(file.cases) > _MAX_DIMS:
        sentence = f"[cases] has {len(file.cases):,} tables: give at most {_MAX_DIMS}, each is a dimension"
        raise InputError(sentence, "cases", "size")
    problems: list[str] = []
    known = all_parameters(rules)
    entries = {name: value for name, value in file.loop.items() if name not in ("preset", "include")}
    constants = entries
    with collect_problems(problems, "[loop] "):
        constants = expand_converged(entries)
    constants = {n: value for n, value in constants.items() if n != CONVERGED_KEYWORD}
    places = {n: "[loop]" if n in entries else f"[loop] as part of {CONVERGED_KEYWORD}" for n in constants}
    constants = known_parameters(constants, problems, "[loop] ", known)
    loop = add_rules(Loop(), rules.values())
    with collect_problems(problems, "[loop] "):
        loop = add_rules(Loop.preset(str(file.loop.get("preset", "paper_like"))), rules.values()).assign(**included)
    split_valve = _split_valve_parameters(file)
    if split_valve:
        # any installed valve, so that each table can change its part of it
        loop = loop.assign(rangeability=50.0, authority=0.5, m_full=1.5)
        together = f"{', '.join(INSTALLED_VALVE_PARAMETERS)} go together"
        for n in [n for n in INSTALLED_VALVE_PARAMETERS if n not in split_valve]:
            problems.append(Problem(f"{together}: {n} is missing, give it too", n, "missing"))
    with collect_problems(problems, "[loop] "):
        loop = loop.assign(**constants)
    axes = {}
    for name, axis in known_parameters(file.sweep, problems, "[sweep] ", known).items():
        with collect_problems(problems, "[sweep] "):
            axes[name] = axis_values(name, axis)
    with collect_problems(problems, "[sweep] "):
        loop = loop.assign(**axes)
    problems += _find_repeated_parameters(file, places)
    for dim, cases in file.cases.items():
        with collect_problems(problems, f"[cases.{dim}] "):
            loop = loop.assign(**_zip_cases(dim, cases, loop, split_valve - constants.keys()))
    if file.sample is not None:
        with collect_problems(problems, "[sample] "):
            # in one call, since some parameters are only admissible together
            loop = loop.assign(**sample_values(file.sample, known, folder, batches))
    raise_problems(problems)
    return loop


def _find_repeated_parameters(file: StudyFile, constants: Mapping[str, str]) -> list[Problem]:
    """Find the parameters that two tables give; constants: those of [loop], and where they stand."""
    names_by_table = {"[sweep]": list(file.sweep)}
    names_by_table |= {f"[cases.{dim}]": _case_parameters(cases) for dim, cases in file.cases.items()}
    names_by_table["[sample]"] = sampled_names(file.sample)
    problems: list[Problem] = []
    places: dict[str, str] = {}
    for table, names in names_by_table.items():
        # a case may differ from the constant that holds for the others
        before = places if table.startswith("[cases") else {**places, **constants}
        for n in [n for n in names if n in before]:
            problems.append(Problem(f"{n} appears in {before[n]} and in {table}: leave one out", n, "duplicate"))
        places |= dict.fromkeys(names, table)
    return problems


def _split_valve_parameters(file: StudyFile) -> set[str]:
    """Return the parameters of an installed valve if they are spread over several tables, else none."""
    tables = [file.loop, file.sweep, *map(_case_parameters, file.cases.values()), sampled_names(file.sample)]
    parts = [{n for n in INSTALLED_VALVE_PARAMETERS if n in table} for table in tables]
    all_names = set[str]().union(*parts)
    return all_names if all_names not in parts else set()


def _case_parameters(cases: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for case in cases.values() for name in case))


def axis_values(name: str, axis: object) -> list[Any]:
    """Return the values of a swept axis: a list, ``{ linspace = [first, last, count] }`` or ``{ geomspace = […] }``."""
    if isinstance(axis, list):
        return axis
    spaced: dict[str, Any] = axis if isinstance(axis, dict) and len(axis) == 1 else {"": None}
    ((kind, spacing),) = spaced.items()
    if kind not in SPACINGS:
        kinds = "{ linspace = [first, last, count] } or { geomspace = [first, last, count] }"
        raise InputError(f"{name} = {short_repr(axis)}: give a list of values, {kinds}", name, "value")
    if not is_number_list(spacing, 3) or type(spacing[2]) is not int or not 1 <= spacing[2] <= MAX_AXIS_VALUES:
        cure = f"two finite numbers and a whole number from 1 to {MAX_AXIS_VALUES:,}; draw more with [sample]"
        sentence = f"{name} = {{ {kind} = {short_repr(spacing)} }}: give [first, last, count], {cure}"
        raise InputError(sentence, name, "value")
    first, last, count = spacing
    if kind == "geomspace" and min(first, last) <= 0.0:
        sentence = f"{name} = {{ geomspace = {short_repr(spacing)} }}: first and last must be above 0"
        raise InputError(sentence, name, "value")
    return list(SPACINGS[kind](float(first), float(last), count).tolist())


def _zip_cases(
    dim: str, cases: Mapping[str, Mapping[str, float | str]], loop: Loop, unset: Collection[str]
) -> dict[str, xr.DataArray]:
    """Put the parameters of named cases along ``dim``; a case may leave out what the loop gives, unless ``unset``."""
    if not cases:
        raise InputError("no case: give at least one, such as fast = { kp = 0.05, ti = 5 }", dim, "missing")
    if dim in loop.parameters or dim in (SAMPLE_DIM, DESIGN_DIM):
        what = "a parameter" if dim in loop.parameters else "the dimension of [sample]"
        sentence = f"{dim} is {what}: give the dimension another name, such as tuning or controller"
        raise InputError(sentence, dim, "name")
    zipped: dict[str, xr.DataArray] = {}
    problems: list[str] = []
    for name in known_parameters(dict.fromkeys(_case_parameters(cases)), problems, known=loop.parameters):
        default = None if name in unset else loop[name]
        without = [label for label, case in cases.items() if name not in case]
        if without and (default is None or isinstance(default, xr.DataArray)):
            sentence = f"{name} is missing in {list_first(without)}: give it in every case"
            problems.append(Problem(sentence, name, "missing"))
            continue
        values = [case.get(name, default) for case in cases.values()]
        wrong = [problem for value in values if (problem := loop.parameters[name].problem(value))]
        problems += summarise_problems(wrong)
        if not wrong:
            zipped[name] = xr.DataArray(values, dims=dim, coords={dim: list(cases)})
    if not zipped and not problems:
        sentence = "its cases are empty: give each the parameters that make it differ"
        problems.append(Problem(sentence, dim, "missing"))
    raise_problems(problems)
    return zipped
