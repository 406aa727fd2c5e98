"""``Loop.assign``: checks of values, parameters of user rules, stand-ins and the parameters that they replace."""

import inspect
from collections.abc import Collection, Hashable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import MOST_VALUES, array_of, collecting, flag_of, is_text, plain, refuse
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.loops.labelled import as_labelled, in_our_unit, units_of
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.parameter_table import COUNTS, INSTALLED_VALVE, PARAMETERS, STAND_INS, Parameter, Scalar, check_name
from fastcoil.model.user_rules import KINDS, Rule

FORBIDDEN_DIMS = {"day", "replicate", "volume", "elapsed_time", "status", *METRICS, *PREDICTIONS, *TRACES}
FORBIDDEN_DIMS |= {"method", "tolerance", "drop", "indexers", "missing_dims"}
"""Names that a swept dimension cannot have: dimensions and variables of a result, and what xarray's ``sel`` takes."""
SHORTEST_SERIES = 3600  # values, an hour of seconds: a list of that many may be a time series by mistake
SERIES_HINT = (
    "did you mean a series?  A parameter does not change during a run: a series goes into fc.Boundary(…), an open-loop "
    "command into simulate(…, command=…)"
)


def checked_value(parameter: Parameter, value: Any) -> Scalar | xr.DataArray:
    """A scalar in the parameter's type and unit, or a DataArray of admissible values; ``value`` as of ``Loop``."""
    name = parameter.name
    array = as_labelled(name, value, name)
    if array is not None and array.dtype.kind in "iuf":
        array = array.copy(data=in_our_unit(name, array, units_of(parameter.unit)))
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str) and not isinstance(value[1], str):
        array = xr.DataArray(_vector(parameter, value[1]), dims=value[0])
    elif isinstance(value, (list, tuple, range)) or (isinstance(value, np.ndarray) and value.ndim):
        array = xr.DataArray(_vector(parameter, value), dims=name)
    if array is not None and array.ndim:
        return _checked_array(parameter, array)
    value = plain(value if array is None else array.values)
    if problem := parameter.problem(value):
        raise InputError(problem)
    return value if parameter.is_word else int(value) if name in COUNTS else float(value)


def _vector(parameter: Parameter, values: Any) -> np.ndarray:
    """A sweep along one dim, of values of the right type."""
    name, cure = parameter.name, "give a DataArray with named dims for more dimensions"
    if as_labelled(name, values, name) is not None:
        raise InputError(f"{name} has labels of its own: give it as it is, without the name of a dimension")
    if not isinstance(values, (list, tuple)):
        values = array_of(name, values, "give a list of values", "iufUbOM")
        if values.ndim != 1:
            raise InputError(f"{name}: a sweep is a list of values; {cure}")
    if len(values) > MOST_VALUES:
        raise InputError(f"{name} has {len(values):,} values: give at most {MOST_VALUES:,}")
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf" and not parameter.is_word:
        return values
    right = (str,) if parameter.is_word else (float, int)
    for value in (plain(given) for given in values if type(given) not in right):
        if isinstance(value, (np.ndarray, list, tuple)):
            raise InputError(f"{name} = {shown(value)} in a list: {cure}")
        if problem := parameter.problem(value):
            raise InputError(problem)
    return np.asarray(values)


def _checked_array(parameter: Parameter, array: xr.DataArray) -> xr.DataArray:
    name = parameter.name
    if array.size == 0:
        raise InputError(f"{name} = []: a sweep needs at least one value")
    for dim in array.dims:
        _check_dim(name, dim, array)
    if not parameter.is_word and array.dtype.kind not in "iuf":
        raise InputError(WrongType(f"{name} has values of type {array.dtype}: give numbers"))
    flat = array.values.ravel()
    fine = np.zeros(flat.size, dtype=bool)
    if not parameter.is_word:
        with np.errstate(over="ignore"):  # what overflows is out of bounds
            flat = flat.astype(float)
        fine = np.isfinite(flat) & (flat > parameter.lower) & (flat < parameter.upper)
        fine &= (flat == np.floor(flat)) | (not parameter.whole)
    bad = [p for p in map(parameter.problem, flat[~fine].tolist()) if p]
    if bad:
        raise InputError(bad[0] if len(bad) == 1 else f"{bad[0]} (and {len(bad) - 1} more of its values)")
    if not parameter.is_word:
        array = array.copy(data=array.values.astype(int if name in COUNTS else float))
    if array.dims == (name,):
        # a label such as 0.07 must be found on an axis made by linspace
        values = flat if parameter.is_word else np.array([float(f"{v:.12g}") for v in flat], dtype=array.dtype)
        unique, counts = np.unique(values, return_counts=True)
        if unique.size < values.size:
            hint = f"; {SERIES_HINT}" if values.size >= SHORTEST_SERIES else ""
            raise InputError(f"{name}: {unique[counts > 1][0]} appears twice on its axis: leave one out{hint}")
        array = xr.DataArray(values, dims=name)
    return array


def _check_dim(name: str, dim: Hashable, array: xr.DataArray) -> None:
    """Refuse names of dims that are taken or unusable, labels that no file can hold, and labels in another unit."""
    if not isinstance(dim, str) or not dim.isidentifier() or dim in FORBIDDEN_DIMS:
        cure = "it is taken, choose another" if dim in FORBIDDEN_DIMS else "use letters, digits and _"
        raise InputError(f"{name}: {shown(dim)} cannot be the name of a swept dimension: {cure}")
    if dim in PARAMETERS and dim == name and array.ndim > 1:
        raise InputError(f"{name}: its own name can only be the dimension of a plain list of its values")
    if dim not in array.coords:
        return
    labels = array.coords[dim]
    if labels.dtype.kind not in "biuf" and not all(isinstance(one, str) and is_text(one) for one in labels.values):
        raise InputError(f"{name}: the labels along {dim!r} are of type {labels.dtype}: give numbers or text")
    ours = labels.values
    if dim in PARAMETERS and labels.dtype.kind in "iuf":
        ours = in_our_unit(dim, labels, units_of(PARAMETERS[dim].unit))
    if not np.array_equal(ours, array.values if dim == name else labels.values):
        text = f"{name}: the labels along {dim}, {shown(ours.tolist())}, are not its values"
        raise InputError(f"{text}: give them in our unit, or none")


NO_RULES: Mapping[str, Rule] = {}


def table_of(rules: Mapping[str, Rule]) -> Mapping[str, Parameter]:
    """Every parameter by name: those of the package, with the rules among the choices, then the rules' own."""
    if not rules:
        return PARAMETERS
    table = dict(PARAMETERS)
    for kind in KINDS:
        names = [rule.name for rule in rules.values() if rule.kind == kind]
        table[kind] = replace(table[kind], choices=(*table[kind].choices, *names))
    for rule in rules.values():
        table |= rule.own
    return table


def without_rules(name: str, value: Any) -> tuple[Any, list[Rule]]:
    """The value of ``estimator`` or ``law`` with words in place of rules, and these rules."""
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], (list, tuple, np.ndarray)):
        words, rules = without_rules(name, value[1])
        return (value[0], words), rules
    array = value.values if isinstance(value, xr.DataArray) else value
    if isinstance(array, np.ndarray) and array.dtype.kind == "O":
        words, rules = without_rules(name, array.ravel().tolist())
        named = np.array(words).reshape(array.shape) if rules else array
        return (value.copy(data=named) if isinstance(value, xr.DataArray) else named), rules
    several = value if isinstance(value, (list, tuple)) else [value]
    rules = [each for each in several if isinstance(each, Rule)]
    for rule in rules:
        if rule.kind != name:
            raise InputError(f"{name}: {rule.name} is made with @fc.{rule.kind}: give {rule.kind} = {rule.name}")
    for function in filter(inspect.isfunction, several):
        cure = f"put @fc.{name}(Parameters, Memory) before it"
        raise InputError(WrongType(f"{name}: {function.__name__} is a plain function: {cure}"))
    words = [each.name if isinstance(each, Rule) else each for each in several]
    return (words if several is value else words[0]) if rules else value, rules


def taken(known: Mapping[str, Rule], new: Collection[Rule], used: Collection[str]) -> dict[str, Rule]:
    """The rules known so far with new ones; those not ``used`` give way where names of parameters clash."""
    found: dict[str, Rule] = {}
    for rule in new:
        if found.setdefault(rule.name, rule) != rule:
            raise InputError(f"two rules are called {rule.name}: rename one of them")
    names = {n for rule in new for n in rule.own}
    kept = {n: r for n, r in known.items() if n not in found and (n in used or not names & r.own.keys())}
    rules = kept | found
    first: dict[str, Rule] = {}
    for rule in rules.values():
        for name, parameter in rule.own.items():
            other = first.setdefault(name, rule)
            if _alike(other.own[name]) != _alike(parameter):
                raise InputError(f"{name} is a parameter of {other.name} and another one of {rule.name}: rename one")
    return rules


def _alike(parameter: Parameter) -> Parameter:
    """The parameter without what each rule says of it in its own words."""
    return replace(parameter, group="", text="")


def with_defaults(values: Mapping[str, Any], before: Mapping[str, Rule], rules: Mapping[str, Rule]) -> dict[str, Any]:
    """The values of a loop whose rules change: without parameters that no rule has any more, with new ones."""
    old = {n: p for rule in before.values() for n, p in rule.own.items()}
    new = {n: p for rule in rules.values() for n, p in rule.own.items()}
    kept = {n: v for n, v in values.items() if n not in old or n in new}
    for name, parameter in new.items():
        if name not in kept or (name in old and kept[name] is old[name].default):
            kept[name] = parameter.default
    return kept


WORD = "converged"
CONVERGED: Mapping[str, Any] = {"air_march": "quasistatic", "substeps": 8}
"""Parameters that the word ``converged`` sets."""
MEANING = " and ".join(f"{name} = {value!r}" for name, value in CONVERGED.items())


def expanded(changes: Mapping[str, Any]) -> dict[str, Any]:
    """The changes of a loop with the parameters that ``converged`` stands for; False changes nothing."""
    rest = {name: value for name, value in changes.items() if name != WORD}
    if WORD not in changes or not flag_of(WORD, changes[WORD]):
        return rest
    given = [name for name in CONVERGED if name in rest]
    if given:
        raise InputError(f"converged stands for {MEANING}: leave it out, or leave out {' and '.join(given)}")
    return rest | dict(CONVERGED)


_ALTERNATIVES = ((INSTALLED_VALVE, STAND_INS["rangeability"]), (("estimate_ratio",), STAND_INS["estimate_ratio"]))


def assigned(
    values: Mapping[str, Any], known: Mapping[str, Rule], changes: Mapping[str, Any]
) -> tuple[dict[str, Any], Mapping[str, Rule]]:
    """Apply ``changes``; all of their mistakes are reported together.  Returns the values and the rules known."""
    problems: list[str] = []
    checked: dict[str, Any] = {}
    with collecting(problems):
        changes, rules = _with_rules(values, known, changes)
        values, known = with_defaults(values, known, rules), rules
    refused = {WORD, *(KINDS if problems else ())}
    with collecting(problems):
        changes = expanded(changes)
    table = table_of(known)
    for name in [name for name in changes if name not in refused]:
        with collecting(problems):
            checked[name] = checked_value(table[check_name(name, table)], changes[name])
    for stand_ins, replaced in _ALTERNATIVES:
        one, other = [n for n in stand_ins if n in checked], [n for n in replaced if n in checked]
        if one and other:
            problems.append(f"{' and '.join(one)} stand in for {' and '.join(other)}: give one or the other")
    refuse(problems)

    result = dict(values)
    for stand_ins, replaced in _ALTERNATIVES:
        for new, old in ((stand_ins, replaced), (replaced, stand_ins)):
            if not checked.keys() & set(new):
                continue
            if missing := [n for n in new if n not in checked and n not in result]:
                raise InputError(f"{', '.join(new)} go together: {' and '.join(missing)} missing")
            result = {n: v for n, v in result.items() if n not in old}
    for name, value in checked.items():
        if isinstance(value, xr.DataArray):
            result.pop(name, None)  # dims are in the order in which they were last given
        result[name] = value
    _check_axes(result)
    return result, known


def _with_rules(
    values: Mapping[str, Any], known: Mapping[str, Rule], changes: Mapping[str, Any]
) -> tuple[dict[str, Any], Mapping[str, Rule]]:
    """The changes with words in place of rules, and the rules then known."""
    found = {kind: without_rules(kind, changes[kind]) for kind in KINDS if kind in changes}
    new = [rule for _, rules in found.values() for rule in rules]
    if not new:
        return dict(changes), known
    changes = {**changes, **{kind: words for kind, (words, _) in found.items()}}
    used = {str(word) for kind in KINDS for word in np.ravel(np.asarray(values.get(kind))) if kind not in changes}
    return changes, taken(known, new, used)


def _check_axes(values: Mapping[str, Any]) -> None:
    """Refuse parameters of different lengths or labels along a dimension that they share."""
    first: dict[str, str] = {}
    labelled: dict[str, tuple[str, np.ndarray]] = {}
    problems = []
    for name, value in values.items():
        for dim, size in value.sizes.items() if isinstance(value, xr.DataArray) else ():
            other = first.setdefault(str(dim), name)
            expected = values[other].sizes[dim]
            if size != expected:
                cure = "give all of them in one call, of the same length"
                problems.append(f"{name} has {size} values along {dim!r}, {other} has {expected}: {cure}")
            elif name == dim or dim in value.coords:
                labels = value.values if name == dim else value.coords[dim].values
                one, before = labelled.setdefault(str(dim), (name, labels))
                is_float = labels.dtype.kind == before.dtype.kind == "f"  # rounded to 12 digits
                if not (np.allclose(labels, before, 1e-11, 0.0) if is_float else np.array_equal(labels, before)):
                    problems.append(
                        f"{name} has the labels {shown(labels.tolist())} along {dim!r} where {one} has "
                        f"{shown(before.tolist())}: give the same, in one order"
                    )
    for dim, (name, labels) in labelled.items():
        bare = [n for n, v in values.items() if isinstance(v, xr.DataArray) and dim in v.dims and dim not in v.coords]
        numbers = np.arange(labels.size)  # which bare values have as labels in a result
        is_mixed = np.array_equal(np.sort(labels), numbers) and not np.array_equal(labels, numbers)
        if bare and is_mixed and dim not in PARAMETERS:
            counted = f"{shown(labels.tolist())} along {dim!r} where {bare[0]} counts from 0"
            problems.append(f"{name} has the labels {counted}: give {name} in that order, or without labels")
    refuse(problems)
