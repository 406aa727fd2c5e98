"""The parameters of a loop with rules of the user's own: the table of the package, and what the rules bring."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, WrongType
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules.parameter import text_without_one
from fastcoil.model.user_rules.rule import KINDS, Rule

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
    """The value of ``estimator`` or ``law`` with words in place of rules, and these rules.

    Raises
    ------
    InputError
        For a function that is no rule, or a rule of the other kind.
    """
    if isinstance(value, Rule):
        if value.kind != name:
            raise InputError(f"{name}: {value.name} is made with @fc.{value.kind}: give {value.kind} = {value.name}")
        return value.name, [value]
    if inspect.isfunction(value):
        raise InputError(
            WrongType(f"{name}: {value.__name__} is a plain function: put @fc.{name}(Parameters, Memory) before it")
        )
    if isinstance(value, (list, tuple)):
        deep = isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], (list, tuple, np.ndarray))
        parts = [
            without_rules(name, each) if deep or isinstance(each, Rule) or inspect.isfunction(each) else (each, [])
            for each in value
        ]
        rules = [rule for _, found in parts for rule in found]
        words = [word for word, _ in parts]
        return (tuple(words) if isinstance(value, tuple) else words) if rules else value, rules
    array = value.values if isinstance(value, xr.DataArray) else value
    if isinstance(array, np.ndarray) and array.dtype.kind == "O":
        words, rules = without_rules(name, array.ravel().tolist())
        if rules:
            named = np.array(words).reshape(array.shape)
            return (value.copy(data=named) if isinstance(value, xr.DataArray) else named), rules
    return value, []


def taken(known: Mapping[str, Rule], new: Collection[Rule], used: Collection[str]) -> dict[str, Rule]:
    """The rules known so far with new ones; one of the same name is replaced.

    used: names of the rules that are now used.  Those that are not give way where names of parameters clash.

    Raises
    ------
    InputError
        If two of the rules have one name, or declare one parameter differently.
    """
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
                raise InputError(
                    f"{name} is a parameter of {other.name} and another one of {rule.name}: rename one, or declare "
                    "both alike"
                )
    return rules


def _alike(parameter: Parameter) -> Parameter:
    """The parameter without what tells whose it is."""
    text = "" if parameter.text == text_without_one(parameter.group) else parameter.text
    return replace(parameter, group="", text=text)


def with_defaults(values: Mapping[str, Any], before: Mapping[str, Rule], rules: Mapping[str, Rule]) -> dict[str, Any]:
    """The values of a loop whose rules change: without parameters that no rule has any more, with new ones."""
    old = {n: p for rule in before.values() for n, p in rule.own.items()}
    new = {n: p for rule in rules.values() for n, p in rule.own.items()}
    kept = {n: v for n, v in values.items() if n not in old or n in new}
    for name, parameter in new.items():
        if name not in kept or (name in old and kept[name] is old[name].default):
            kept[name] = parameter.default
    return kept
