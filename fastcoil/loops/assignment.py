"""What ``Loop.assign`` does: changes checked together, stand-ins and what they replace, rules and their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, collecting
from fastcoil.loops.converged import WORD, expanded
from fastcoil.loops.parameter_values import checked_value
from fastcoil.loops.rule_table import table_of, taken, with_defaults, without_rules
from fastcoil.model.parameter_table import INSTALLED_VALVE, STAND_INS, check_name
from fastcoil.model.user_rules.rule import KINDS, Rule

_VALVE_CURVE = STAND_INS["rangeability"]
_ALTERNATIVES = ((INSTALLED_VALVE, _VALVE_CURVE), (("estimate_ratio",), STAND_INS["estimate_ratio"]))


def assigned(
    values: Mapping[str, Any], known: Mapping[str, Rule], changes: Mapping[str, Any]
) -> tuple[dict[str, Any], Mapping[str, Rule]]:
    """Apply ``changes``; all of their mistakes are reported together.  Returns the values and the rules known."""
    problems: list[str] = []
    checked: dict[str, Any] = {}
    try:
        changes, rules = _with_rules(values, known, changes)
        values, known = with_defaults(values, known, rules), rules
    except InputError as error:
        problems += error.problems
        changes = {n: v for n, v in changes.items() if n not in KINDS}
    try:
        changes = expanded(changes)
    except InputError as error:
        problems += error.problems
        changes = {n: v for n, v in changes.items() if n != WORD}
    table = table_of(known)
    for name, value in changes.items():
        with collecting(problems):
            checked[name] = checked_value(table[check_name(name, table)], value)
    for stand_ins, replaced in _ALTERNATIVES:
        one, other = [n for n in stand_ins if n in checked], [n for n in replaced if n in checked]
        if one and other:
            problems.append(f"{' and '.join(one)} stand in for {' and '.join(other)}: give one or the other")
    if problems:
        raise InputError(problems)

    result = dict(values)
    if "backlash_estimate" in checked:
        result.pop("estimate_ratio", None)
    if "estimate_ratio" in checked:
        result.pop("backlash_estimate", None)
    if checked.keys() & set(_VALVE_CURVE) and result.keys() & set(INSTALLED_VALVE):
        missing = [n for n in _VALVE_CURVE if n not in checked]
        if missing:
            raise InputError(
                f"{', '.join(sorted(checked.keys() & set(_VALVE_CURVE)))}: the valve is given by rangeability, "
                f"authority and m_full; give {', '.join(missing)} too to replace them"
            )
        for n in INSTALLED_VALVE:
            result.pop(n, None)
    if checked.keys() & set(INSTALLED_VALVE):
        missing = [n for n in INSTALLED_VALVE if n not in checked and n not in result]
        if missing:
            raise InputError(f"rangeability, authority and m_full go together: {' and '.join(missing)} missing")
        for n in _VALVE_CURVE:
            result.pop(n, None)
    for name, value in checked.items():
        result.pop(name, None) if isinstance(value, xr.DataArray) else None
        result[name] = value
    _check_lengths(result)
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


def _check_lengths(values: Mapping[str, Any]) -> None:
    """Refuse parameters of different lengths along a dimension that they share."""
    first: dict[str, str] = {}
    problems = []
    for name, value in values.items():
        if not isinstance(value, xr.DataArray):
            continue
        for dim, size in value.sizes.items():
            other = first.setdefault(str(dim), name)
            expected = values[other].sizes[dim]
            if size != expected:
                problems.append(
                    f"{name} has {size} values along {dim!r}, {other} has {expected}: zipped parameters need the same "
                    "length; to change it, give all of them in one call"
                )
    if problems:
        raise InputError(problems)


def words_of(values: Mapping[str, Any], kind: str) -> set[str]:
    """The estimators, or the laws, that some scenario of these parameters has."""
    value = values.get(kind)
    if value is None:
        learns = bool(np.any(np.asarray(values["learning_step"]) > 0.0))
        return {"learner"} if learns else {"none"}
    return set(np.unique(np.asarray(value)).tolist())
