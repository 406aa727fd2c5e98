"""``Loop``: the parameters of one valve loop, or of a sweep; the union of their dims is the shape of the study."""

from __future__ import annotations

import json
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from html import escape
from typing import Any, Unpack

import numpy as np
import xarray as xr

from fastcoil.base.arguments import raise_problems, require_choice, require_instance
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.loops.assignment import all_parameters, assign_values, check_value, merge_rules, values_for_rules
from fastcoil.loops.keywords import Keywords, PresetName, describe_parameters
from fastcoil.loops.presets import PRESETS, Preset
from fastcoil.model.metric_table import METRICS
from fastcoil.model.parameter_table import PARAMETERS, STAND_INS, Parameter, Scalar, require_parameter_name
from fastcoil.model.user_rules import RULE_KINDS, Rule


@describe_parameters
class Loop:
    """Immutable set of loop parameters; ``fc.Loop()`` is the preset ``paper_like``.

    Parameters
    ----------
    **values
        Parameters by name, from the table below.  Each may be a number or word, a list (a dimension of its own),
        ``(dim, values)`` (zipped with others along a shared dimension) or a DataArray, converted from its ``units``.
        ``estimator``, ``law`` and ``plant`` also take rules made with ``fc.estimator``, ``fc.law`` and ``fc.plant``.

    Raises
    ------
    InputError
        With one sentence for each unknown name, wrong type, value out of bounds, empty or duplicated axis, or zipped
        parameter of another length.

    Notes
    -----
    {parameters}

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.Loop.preset("lbnl").assign(backlash=[0.02, 0.07, 0.15], kp=("tuning", [0.01, 0.02])).sizes
    {'backlash': 3, 'tuning': 2}
    """

    __slots__ = ("_rules", "_values")
    _values: dict[str, Scalar | xr.DataArray]
    _rules: Mapping[str, Rule]

    def __init__(self, **values: Unpack[Keywords]) -> None:
        defaults = {p.name: p.default for p in PARAMETERS.values() if p.default is not None}
        self._values, self._rules = assign_values(defaults, {}, values)

    @classmethod
    def preset(cls, name: PresetName | str, *, converged: bool = False) -> Loop:
        """Return a named loop: ``paper_like``, ``paper_like_fast``, ``lbnl``, ``g36``, ``heating`` or ``heating_45``.

        ``fc.presets()`` describes each.  converged: as in ``Loop``; all but the first two are converged as they are.
        """
        return cls(**PRESETS[require_choice("preset", name, PRESETS)].values).assign(converged=converged)

    @classmethod
    def from_dataset(cls, ds: xr.Dataset, rules: Sequence[Rule] = ()) -> Loop:
        """Return the loop of a result, or of a part of it such as ``ds.isel(backlash=3)``.

        A parameter that the result does not hold, as after ``ds.isel(backlash=3, drop=True)``, takes its default, with
        a warning.  User rules are stored by name only: give ``rules=[my_rule]``.  ``InputError`` if ``ds`` was not made
        by fastcoil, or has no labels along a dimension named after a parameter.
        """
        require_instance("ds", ds, xr.Dataset, "give a result, or a part of one such as ds.isel(backlash=3)")
        if not isinstance(rules, (list, tuple)) or not all(isinstance(rule, Rule) for rule in rules):
            sentence = f"rules = {short_repr(rules)}: give a list of what @fc.estimator, @fc.law or @fc.plant made"
            raise InputError(sentence, "rules", "type")
        table = all_parameters(merge_rules({}, rules, ()))
        constants = _stored_constants(ds, table)
        dims = next((list(ds[n].dims) for n in ("status", *METRICS) if n in ds), list(ds.dims))
        unlabelled = [d for d in dims if d in table and d not in ds.coords]
        sentence = "the Dataset has no values along its dimension {}: keep that coordinate"
        raise_problems([Problem(sentence.format(d), str(d), "missing") for d in unlabelled])
        names = [n for n in ds.coords if n in table and set(ds[n].dims) <= set(dims)]
        names.sort(key=lambda n: [dims.index(d) for d in ds[n].dims])
        swept = {str(n): ds[n].reset_coords(drop=True) for n in names}
        loop = add_rules(cls(), rules)
        loop._values = constants | _defaults_of_missing(constants.keys() | swept.keys(), table)
        return loop.assign(**swept)

    def assign(self, **values: Unpack[Keywords]) -> Loop:
        """Return a copy with parameters changed; arguments and errors as for ``Loop``."""
        return self._copy(*assign_values(self._values, self._rules, values))

    @staticmethod
    def _copy(values: dict[str, Any], rules: Mapping[str, Rule]) -> Loop:
        changed = Loop.__new__(Loop)
        changed._values, changed._rules = values, rules
        return changed

    @property
    def rules(self) -> Mapping[str, Rule]:
        """User rules by name, including those no longer used."""
        return self._rules

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Every parameter that this loop may have: those of ``fc.parameters()``, then those of its rules."""
        return all_parameters(self._rules)

    def __getitem__(self, name: str) -> Any:
        """Value of a parameter; ``None`` for one that is not given."""
        return self._values.get(require_parameter_name(name, self.parameters))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self.parameters:
            suggestion = "" if name.startswith("_") else did_you_mean(name, dir(self))
            # obj=None, so that Python adds no second suggestion to the traceback
            raise AttributeError(f"a Loop has no {name}{suggestion}", name=name, obj=None)
        return self[name]

    def __setattr__(self, name: str, value: object) -> None:
        if name not in Loop.__slots__:
            raise AttributeError(f"a Loop does not change: take a copy, loop.assign({name}=…)")
        object.__setattr__(self, name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.parameters})

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.parameters)

    def items(self) -> Iterable[tuple[str, Scalar | xr.DataArray]]:
        """Return (name, value) of every parameter that is given."""
        return self._values.items()

    @property
    def swept(self) -> dict[str, xr.DataArray]:
        """Parameters with dimensions, in the order in which they were assigned."""
        return {n: v for n, v in self._values.items() if isinstance(v, xr.DataArray)}

    @property
    def constants(self) -> dict[str, Scalar]:
        """Parameters without dimensions."""
        return {n: v for n, v in self._values.items() if not isinstance(v, xr.DataArray)}

    @property
    def sizes(self) -> dict[str, int]:
        """Dimension → length, in the order in which the dimensions were first assigned."""
        return {str(dim): size for value in self.swept.values() for dim, size in value.sizes.items()}

    def coordinates(self) -> dict[str, xr.DataArray]:
        """Return the labels of every dimension, and the swept parameters along them."""
        labels: dict[str, xr.DataArray] = {}
        for name, value in self.swept.items():
            for dim in value.dims:
                if dim in value.coords and name != dim:
                    labels.setdefault(str(dim), value.coords[dim].reset_coords(drop=True))
        for dim, size in self.sizes.items():
            axis = self._values.get(dim)
            if isinstance(axis, xr.DataArray) and axis.dims == (dim,):
                labels[dim] = xr.DataArray(axis.values, dims=dim)
            elif axis is not None:
                sentence = f"{dim} is a parameter but not swept: give the dimension another name, such as tuning"
                raise InputError(sentence, dim, "name")
            labels.setdefault(dim, xr.DataArray(np.arange(size), dims=dim))
        for name, value in self.swept.items():
            labels.setdefault(name, value.drop_vars(list(value.coords)))
        return labels

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"

    def __repr__(self) -> str:
        sizes = [f"  {dim}: {size}" for dim, size in self.sizes.items()]
        # the one from which the loop differs in the fewest parameters; the first of them
        preset = min(PRESETS.values(), key=lambda candidate: len(_changed_names(self, candidate)))
        differences = []
        for name in _changed_names(self, preset):
            value = self[name]
            if isinstance(value, xr.DataArray):
                differences.append(f"  {name} ({', '.join(map(str, value.dims))}): {_summarise_values(value)}")
            else:
                differences.append(f"  {self.parameters[name].equation(value)}")
        dimensions = ["Dimensions:", *sizes] if sizes else []
        changes = [f"Differs from {preset.name}:", *differences] if differences else [preset.name]
        return "\n".join(["<fastcoil.Loop>", *dimensions, *changes])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Loop) or self._values.keys() != other._values.keys() or self._rules != other._rules:
            return False
        return all(xr.DataArray(v).identical(xr.DataArray(other._values[n])) for n, v in self._values.items())

    __hash__ = None  # type: ignore[assignment]


def add_rules(loop: Loop, rules: Iterable[Rule]) -> Loop:
    """Return the loop with user rules and their parameters added."""
    return _replace_rules(loop, merge_rules(loop.rules, list(rules), loop.rules))


def remove_rules(loop: Loop, rule_names: Collection[str]) -> Loop:
    """Return the loop without the user rules of these names and without their parameters."""
    return _replace_rules(loop, {n: rule for n, rule in loop.rules.items() if n not in rule_names})


def used_choices(loop: Loop, kind: str) -> set[str]:
    """Return the words of a parameter, such as the estimators or the plants, that some scenario has."""
    if loop[kind] is None:
        return {"learner" if np.any(np.asarray(loop["learning_step"]) > 0.0) else "none"}
    return set(np.unique(np.asarray(loop[kind])).tolist())


def _replace_rules(loop: Loop, rules: Mapping[str, Rule]) -> Loop:
    return Loop._copy(values_for_rules(dict(loop.items()), loop.rules, rules), rules)


def _stored_constants(ds: xr.Dataset, table: Mapping[str, Parameter]) -> dict[str, Any]:
    """Read the constants in the attributes of a result."""
    if "parameters" not in ds.attrs:
        raise InputError("this Dataset has no attribute 'parameters': it was not made by fastcoil", "ds", "data")
    try:
        stored = dict(json.loads(ds.attrs["parameters"]))
    except (TypeError, ValueError, RecursionError):
        sentence = "the attribute 'parameters' of this Dataset is not as fastcoil made it"
        raise InputError(sentence, "ds", "data") from None
    for kind in RULE_KINDS:
        words = {str(word) for word in [stored.get(kind), *np.ravel(ds[kind].values if kind in ds.coords else [])]}
        unknown = sorted(words - {"None", *table[kind].choices})
        if unknown:
            sentence = f"the result has the {kind} {unknown[0]}: give its rule, from_dataset(ds, rules=[…])"
            raise InputError(sentence, "rules", "missing")
    return {name: check_value(table[require_parameter_name(name, table)], value) for name, value in stored.items()}


def _defaults_of_missing(given_names: Collection[str], table: Mapping[str, Parameter]) -> dict[str, Scalar]:
    """Return defaults for the parameters that are neither constant nor coordinate of a result, with a warning."""
    known = {*given_names}.union(*(names for stand_in, names in STAND_INS.items() if stand_in in given_names))
    missing = {p.name: p.default for p in table.values() if p.default is not None and p.name not in known}
    if missing:
        text = ", ".join(table[name].equation(value) for name, value in missing.items())
        warnings.warn(f"the result does not hold these parameters, so their defaults are used: {text}", stacklevel=3)
    return missing


_MAX_LISTED_VALUES = 5  # of a sweep; of more values the range is written


def _changed_names(loop: Loop, preset: Preset) -> list[str]:
    """Return the parameters that differ from a preset: those swept, then constants, in the order of the table."""
    constants = {name: loop.constants[name] for name in loop.parameters if name in loop.constants}
    return [*loop.swept, *preset.changed_names(constants, loop.parameters)]


def _summarise_values(value: xr.DataArray) -> str:
    """Write a few values one by one; of many the range, and the median unless they rise along an axis."""
    flat = np.ravel(value)
    if flat.size <= _MAX_LISTED_VALUES or flat.dtype.kind not in "iuf":
        words = list(dict.fromkeys(f"{v:.6g}" if isinstance(v, (int, float)) else v for v in flat.tolist()))
        return ", ".join(words[:_MAX_LISTED_VALUES]) + (", …" if len(words) > _MAX_LISTED_VALUES else "")
    median = "" if (np.diff(flat) > 0.0).all() else f", median {np.median(flat):.4g}"
    return f"{flat.min():.4g} to {flat.max():.4g}{median}"
