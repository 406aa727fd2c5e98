"""Checks of ``Loop.assign``: values, parameters of user rules, stand-ins and the parameters that they replace."""

import inspect
from collections.abc import Collection, Hashable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from fastcoil.base import arguments
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.loops.labelled import accepted_units, as_data_array, convert_units
from fastcoil.model import parameter_table
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.user_rules import RULE_KINDS, Rule

FORBIDDEN_DIMS = {
    "day", "replicate", "volume", "elapsed_time", "status", *METRICS, *TRACES,
    "method", "tolerance", "drop", "indexers", "missing_dims",
}  # fmt: skip
"""Names that a swept dimension cannot have: dimensions and variables of a result, and arguments of xarray's ``sel``."""
MIN_SERIES_VALUES = 3600  # an hour of seconds: a list of that many values may be a time series by mistake
SERIES_HINT = (
    "did you mean a series?  A parameter does not change during a run: a series goes into fc.Boundary(…), an open-loop "
    "command into simulate(…, command=…)"
)


def check_value(parameter: parameter_table.Parameter, value: Any) -> parameter_table.Scalar | xr.DataArray:
    """Return a scalar in the parameter's type and unit, or a DataArray of admissible values."""
    name = parameter.name
    is_pair = isinstance(value, tuple) and [isinstance(item, str) for item in value] == [True, False]
    dim, values = value if is_pair else (name, value)
    array = None if is_pair and hasattr(values, "attrs") else as_data_array(name, values, dim)
    if array is not None and array.dtype.kind in "iuf":
        numbers = convert_units(name, array, accepted_units(parameter.unit))
        array = xr.DataArray(numbers, array.coords, array.dims)
    elif is_pair:
        array = xr.DataArray(_sweep_values(parameter, value[1]), dims=value[0])
    elif array is None and (isinstance(value, (list, tuple, range)) or (isinstance(value, np.ndarray) and value.ndim)):
        array = xr.DataArray(_sweep_values(parameter, value), dims=name)
    if array is not None and array.ndim:
        return _check_array(parameter, array)
    value = arguments.to_builtin(value if array is None else array.values)
    if problem := parameter.problem(value):
        own = ', or in a study your own: "module:function"' if name in RULE_KINDS else ""
        raise InputError(problem + own, name, problem.code)
    return value if parameter.is_word else int(value) if name in parameter_table.INTEGER_PARAMETERS else float(value)


def _sweep_values(parameter: parameter_table.Parameter, values: Any) -> np.ndarray:
    """Return values of a sweep along one dim, each of the right type."""
    name, cure = parameter.name, "give a DataArray with named dims for more dimensions"
    if as_data_array(name, values, name) is not None:
        sentence = f"{name} has labels of its own: give it as it is, without the name of a dimension"
        raise InputError(sentence, name, "conflict")
    if not isinstance(values, (list, tuple)):
        values = arguments.require_array(name, values, "give a list of values", "iufUbOM")
        if values.ndim != 1:
            raise InputError(f"{name}: a sweep is a list of values; {cure}", name, "shape")
    if len(values) > arguments.MAX_ARRAY_VALUES:
        sentence = f"{name} has {len(values):,} values: give at most {arguments.MAX_ARRAY_VALUES:,}"
        raise InputError(sentence, name, "size")
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf" and not parameter.is_word:
        return values
    right_types = (str,) if parameter.is_word else (float, int)
    for value in (arguments.to_builtin(item) for item in values if type(item) not in right_types):
        if isinstance(value, (np.ndarray, list, tuple)):
            raise InputError(f"{name} = {short_repr(value)} in a list: {cure}", name, "shape")
        if problem := parameter.problem(value):
            raise InputError(problem)
    return np.asarray(values)


def _check_array(parameter: parameter_table.Parameter, array: xr.DataArray) -> xr.DataArray:
    name = parameter.name
    if array.size == 0:
        raise InputError(f"{name} = []: a sweep needs at least one value", name, "missing")
    for dim in array.dims:
        _check_dim(name, dim, array)
    if not parameter.is_word and array.dtype.kind not in "iuf":
        raise InputError(f"{name} has values of type {array.dtype}: give numbers", name, "type")
    flat = array.values.ravel()
    is_valid = np.zeros(flat.size, dtype=bool)
    if not parameter.is_word:
        with np.errstate(over="ignore"):  # what overflows is out of bounds
            flat = flat.astype(float)
        is_valid = np.isfinite(flat) & (flat > parameter.lower) & (flat < parameter.upper)
        is_valid &= (flat == np.floor(flat)) | (not parameter.whole)
    problems = [p for p in map(parameter.problem, flat[~is_valid].tolist()) if p]
    if problems:
        more = f" (and {len(problems) - 1} more of its values)" if len(problems) > 1 else ""
        first = InputError(problems).problems[0]
        raise InputError(first + more, first.field, first.code)
    if not parameter.is_word:
        array = array.copy(data=array.values.astype(int if name in parameter_table.INTEGER_PARAMETERS else float))
    if array.dims == (name,):
        # a label such as 0.07 must be found on an axis made by linspace
        values = flat if parameter.is_word else np.array([float(f"{v:.12g}") for v in flat], dtype=array.dtype)
        unique, counts = np.unique(values, return_counts=True)
        if unique.size < values.size:
            hint = f"; {SERIES_HINT}" if values.size >= MIN_SERIES_VALUES else ""
            sentence = f"{name}: {unique[counts > 1][0]} appears twice on its axis: leave one out{hint}"
            raise InputError(sentence, name, "duplicate")
        array = xr.DataArray(values, dims=name)
    return array


def _check_dim(name: str, dim: Hashable, array: xr.DataArray) -> None:
    """Refuse names of dims that are taken or unusable, labels that cannot be stored, and labels in another unit."""
    if not isinstance(dim, str) or not dim.isidentifier() or dim in FORBIDDEN_DIMS:
        cure = "it is taken, choose another" if dim in FORBIDDEN_DIMS else "use letters, digits and _"
        sentence = f"{name}: {short_repr(dim)} cannot be the name of a swept dimension: {cure}"
        raise InputError(sentence, name, "name")
    if dim in parameter_table.PARAMETERS and dim == name and array.ndim > 1:
        sentence = f"{name}: its own name can only be the dimension of a plain list of its values"
        raise InputError(sentence, name, "name")
    if dim not in array.coords:
        return
    labels = array.coords[dim]
    is_text = [isinstance(label, str) and arguments.is_storable_text(label) for label in labels.values]
    if labels.dtype.kind not in "biuf" and not all(is_text):
        sentence = f"{name}: the labels along {dim!r} are of type {labels.dtype}: give numbers or text"
        raise InputError(sentence, name, "type")
    converted = labels.values
    if dim in parameter_table.PARAMETERS and labels.dtype.kind in "iuf":
        converted = convert_units(dim, labels, accepted_units(parameter_table.PARAMETERS[dim].unit))
    if not np.array_equal(converted, array.values if dim == name else labels.values):
        sentence = f"{name}: the labels along {dim}, {short_repr(converted.tolist())}, are not its values"
        raise InputError(f"{sentence}: give them in the unit of {dim}, or none", name, "unit")


Values: TypeAlias = Mapping[str, Any]  # of parameters, by name
Rules: TypeAlias = Mapping[str, Rule]


def all_parameters(rules: Rules) -> Mapping[str, parameter_table.Parameter]:
    """Return every parameter by name: those of the package, with the rules among the choices, then those of rules."""
    if not rules:
        return parameter_table.PARAMETERS
    table = dict(parameter_table.PARAMETERS)
    for kind in RULE_KINDS:
        names = [rule.name for rule in rules.values() if rule.kind == kind]
        table[kind] = replace(table[kind], choices=(*table[kind].choices, *names))
    for rule in rules.values():
        table |= rule.own
    return table


def extract_rules(name: str, value: Any) -> tuple[Any, list[Rule]]:
    """Replace rules in a value of ``estimator`` or ``law`` by their names; return it and the rules."""
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], (list, tuple, np.ndarray)):
        words, rules = extract_rules(name, value[1])
        return (value[0], words), rules
    array = value.values if isinstance(value, xr.DataArray) else value
    if isinstance(array, np.ndarray) and array.dtype.kind == "O":
        words, rules = extract_rules(name, array.ravel().tolist())
        names = np.array(words).reshape(array.shape) if rules else array
        return (value.copy(data=names) if isinstance(value, xr.DataArray) else names), rules
    items = value if isinstance(value, (list, tuple)) else [value]
    rules = [item for item in items if isinstance(item, Rule)]
    for rule in rules:
        if rule.kind != name:
            sentence = f"{name}: {rule.name} is made with @fc.{rule.kind}: give {rule.kind} = {rule.name}"
            raise InputError(sentence, name, "conflict")
    for function in filter(inspect.isfunction, items):
        sentence = f"{name}: {function.__name__} is a plain function: put @fc.{name}(Parameters, Memory) before it"
        raise InputError(sentence, name, "type")
    words = [item.name if isinstance(item, Rule) else item for item in items]
    return (words if items is value else words[0]) if rules else value, rules


def merge_rules(known_rules: Rules, new_rules: Collection[Rule], used: Collection[str]) -> dict[str, Rule]:
    """Add new rules to known ones; known rules that are not used are dropped if names of parameters clash."""
    new_by_name: dict[str, Rule] = {}
    for rule in new_rules:
        if new_by_name.setdefault(rule.name, rule) != rule:
            raise InputError(f"two rules are called {rule.name}: rename one of them", rule.kind, "duplicate")
    new = {n for rule in new_rules for n in rule.own}
    kept = {n: r for n, r in known_rules.items() if n in used or not new & r.own.keys()}
    rules = {n: r for n, r in kept.items() if n not in new_by_name} | new_by_name
    first_rules: dict[str, Rule] = {}
    for rule in rules.values():
        for name, parameter in rule.own.items():
            first = first_rules.setdefault(name, rule)
            if replace(first.own[name], group="", text="") != replace(parameter, group="", text=""):
                sentence = f"{name} is a parameter of {first.name} and another one of {rule.name}: rename one"
                raise InputError(sentence, name, "duplicate")
    return rules


def values_for_rules(values: Values, before: Rules, rules: Rules) -> dict[str, Any]:
    """Return the values of a loop whose rules change: drop parameters that no rule has any more, add new ones."""
    old = {n: p for rule in before.values() for n, p in rule.own.items()}
    new = {n: p for rule in rules.values() for n, p in rule.own.items()}
    kept = {n: v for n, v in values.items() if n not in old or n in new}
    for name, parameter in new.items():
        if name not in kept or (name in old and kept[name] is old[name].default):
            kept[name] = parameter.default
    return kept


CONVERGED_KEYWORD = "converged"
CONVERGED: Values = {"air_march": "quasistatic"}
"""Parameters that ``converged=True`` sets, within 1 % of the RMSE of Runge and Kutta's method, see docs/model.md."""
CONVERGED_TEXT = " and ".join(f"{name} = {value!r}" for name, value in CONVERGED.items())


def expand_converged(changes: Values) -> dict[str, Any]:
    """Replace ``converged`` in the changes of a loop by the parameters that it stands for; False changes nothing."""
    other_changes = {name: value for name, value in changes.items() if name != CONVERGED_KEYWORD}
    if CONVERGED_KEYWORD not in changes or not arguments.require_flag(CONVERGED_KEYWORD, changes[CONVERGED_KEYWORD]):
        return other_changes
    if conflicting := [name for name in CONVERGED if name in other_changes]:
        sentence = f"converged stands for {CONVERGED_TEXT}: leave it out, or leave out {' and '.join(conflicting)}"
        raise InputError(sentence, CONVERGED_KEYWORD, "conflict")
    return other_changes | dict(CONVERGED)


_EXCLUSIVE = {
    parameter_table.INSTALLED_VALVE_PARAMETERS: parameter_table.STAND_INS["rangeability"],
    ("estimate_ratio",): parameter_table.STAND_INS["estimate_ratio"],
}


def assign_values(values: Values, known_rules: Rules, changes: Values) -> tuple[dict[str, Any], Rules]:
    """Apply ``changes``, reporting all mistakes together; return the values and the known rules."""
    problems: list[str] = []
    checked: dict[str, Any] = {}
    with arguments.collect_problems(problems):
        changes, rules = _resolve_rules(values, known_rules, changes)
        values, known_rules = values_for_rules(values, known_rules, rules), rules
    refused = {CONVERGED_KEYWORD, *(RULE_KINDS if problems else ())}
    with arguments.collect_problems(problems):
        changes = expand_converged(changes)
    table = all_parameters(known_rules)
    for name in [name for name in changes if name not in refused]:
        with arguments.collect_problems(problems):
            checked[name] = check_value(table[parameter_table.require_parameter_name(name, table)], changes[name])
    for stand_ins, replaced in _EXCLUSIVE.items():
        given_stand_ins, given_replaced = [n for n in stand_ins if n in checked], [n for n in replaced if n in checked]
        if given_stand_ins and given_replaced:
            verb = "stands" if len(given_stand_ins) == 1 else "stand"
            both = f"{' and '.join(given_stand_ins)} {verb} in for {' and '.join(given_replaced)}"
            problems.append(Problem(f"{both}: give one or the other", given_stand_ins[0], "conflict"))
    arguments.raise_problems(problems)

    result = dict(values)
    for stand_ins, replaced in _EXCLUSIVE.items():
        for new, old in ((stand_ins, replaced), (replaced, stand_ins)):
            if not checked.keys() & set(new):
                continue
            if missing := [n for n in new if n not in checked and n not in result]:
                together = f"{', '.join(new)} go together"
                raise InputError(f"{together}: {' and '.join(missing)} missing", missing[0], "missing")
            result = {n: v for n, v in result.items() if n not in old}
    for name, value in checked.items():
        if isinstance(value, xr.DataArray):
            result.pop(name, None)  # dims are in the order in which they were last given
        result[name] = value
    _check_axes(result)
    return result, known_rules


def _resolve_rules(values: Values, known_rules: Rules, changes: Values) -> tuple[dict[str, Any], Rules]:
    """Return the changes with names in place of rules, and the rules known then."""
    extracted = {kind: extract_rules(kind, changes[kind]) for kind in RULE_KINDS if kind in changes}
    new_rules = [rule for _, rules in extracted.values() for rule in rules]
    if not new_rules:
        return dict(changes), known_rules
    changes = {**changes, **{kind: words for kind, (words, _) in extracted.items()}}
    unchanged_kinds = [kind for kind in RULE_KINDS if kind not in changes]
    used = {str(word) for kind in unchanged_kinds for word in np.ravel(np.asarray(values.get(kind)))}
    return changes, merge_rules(known_rules, new_rules, used)


def _check_axes(values: Values) -> None:
    """Refuse parameters of different lengths or labels along a dimension that they share."""
    first_names: dict[str, str] = {}
    labelled: dict[str, tuple[str, np.ndarray]] = {}
    problems = []
    arrays = {name: value for name, value in values.items() if isinstance(value, xr.DataArray)}
    for name, value in arrays.items():
        for dim, size in value.sizes.items():
            first_name = first_names.setdefault(str(dim), name)
            expected = values[first_name].sizes[dim]
            if size != expected:
                sentence = f"{name} has {size} values along {dim!r}, {first_name} has {expected}"
                cure = "give all of them in one call, of the same length"
                problems.append(Problem(f"{sentence}: {cure}", name, "shape"))
            elif name == dim or dim in value.coords:
                labels = value.values if name == dim else value.coords[dim].values
                labelled_name, first = labelled.setdefault(str(dim), (name, labels))
                is_float = labels.dtype.kind == first.dtype.kind == "f"  # rounded to 12 digits
                if not (np.allclose(labels, first, 1e-11, 0.0) if is_float else np.array_equal(labels, first)):
                    sentence = f"{name} has the labels {short_repr(labels.tolist())} along {dim!r}"
                    other = f"where {labelled_name} has {short_repr(first.tolist())}"
                    problems.append(Problem(f"{sentence} {other}: give the same, in one order", name, "shape"))
    for dim, (name, labels) in labelled.items():
        unlabelled = [n for n, v in arrays.items() if dim in v.dims and dim not in v.coords]
        numbers = np.arange(labels.size)  # which bare values have as labels in a result
        is_mixed = np.array_equal(np.sort(labels), numbers) and not np.array_equal(labels, numbers)
        if unlabelled and is_mixed and dim not in parameter_table.PARAMETERS:
            sentence = f"{name} has the labels {short_repr(labels.tolist())} along {dim!r}"
            cure = f"where {unlabelled[0]} counts from 0: give {name} in that order, or without labels"
            problems.append(Problem(f"{sentence} {cure}", name, "shape"))
    arguments.raise_problems(problems)
