"""``Loop``: the parameters of one valve loop, or of a whole sweep of them.

Any parameter may be a number, a list (its own dimension), ``(dim, values)`` (zipped along a shared
dimension) or an ``xarray.DataArray``.  The union of the dimensions is the shape of the study.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, nearest
from fastcoil.outputs import METRICS, TRACES
from fastcoil.parameter_table import INSTALLED_VALVE, LARGEST, PARAMETERS, STAND_INS, Parameter, Scalar, check_name

_REAL_LOOP = {"C_c": 10.0, "sensor_time_constant": 30.0, "stroke_time": 90.0}
PRESETS: dict[str, dict[str, Scalar]] = {
    "paper_like": {},
    "paper_like_fast": {"C_c": 10.0, "kp": 0.05, "ti": 5.0, "sample_time": 10.0},
    "lbnl": {**_REAL_LOOP, "kp": 0.018, "ti": 30.0, "sample_time": 15.0},
    "g36": {**_REAL_LOOP, "kp": 0.05, "ti": 600.0, "sample_time": 5.0},
}
"""Differences from the defaults.  ``paper_like*`` are generic coils and tunings on which the paper's phenomena
appear; ``lbnl`` is the recorded tuning of LBNL building 33 AHU-2, ``g36`` the default of ASHRAE Guideline 36
in the Modelica Buildings library.  None is the paper's unpublished fit."""

_VALVE_CURVE = STAND_INS["rangeability"]
_ALTERNATIVES = ((INSTALLED_VALVE, _VALVE_CURVE), (("estimate_ratio",), STAND_INS["estimate_ratio"]))
FORBIDDEN_DIMS = {"day", "replicate", "volume", "elapsed_time"} | {"status"} | set(METRICS) | set(TRACES)
"""Dimensions that a sweep cannot have: those of a result, and the names of its variables."""


class Loop:
    """An immutable set of loop parameters, each a number, a word or an ``xarray.DataArray``.

    ``fc.Loop()`` is the preset ``paper_like``; ``fc.parameters()`` lists names, units and bounds.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.Loop.preset("lbnl").assign(backlash=[0.02, 0.07, 0.15], kp=("tuning", [0.01, 0.02])).sizes
    {'backlash': 3, 'tuning': 2}
    """

    __slots__ = ("_values",)
    _values: dict[str, Scalar | xr.DataArray]

    def __init__(self, **values: Any) -> None:
        defaults = {p.name: p.default for p in PARAMETERS.values() if p.default is not None}
        self._values = _assigned(defaults, values)

    @classmethod
    def preset(cls, name: str) -> Loop:
        """Return a named loop: ``paper_like``, ``paper_like_fast``, ``lbnl`` or ``g36``."""
        if not isinstance(name, str) or name not in PRESETS:
            raise InputError(
                f"preset = {name!r}: unknown{nearest(str(name), PRESETS)}; choose one of {', '.join(PRESETS)}"
            )
        return cls(**PRESETS[name])

    @classmethod
    def from_dataset(cls, ds: xr.Dataset) -> Loop:
        """Rebuild the loop behind a result, or behind a part of it such as ``ds.isel(backlash=3)``."""
        if "parameters" not in ds.attrs:
            raise InputError("this Dataset has no attribute 'parameters': it was not made by fastcoil")
        loop = cls()
        loop._values = dict(json.loads(ds.attrs["parameters"]))
        dims = next((list(ds[n].dims) for n in ("status", *METRICS) if n in ds), list(ds.dims))
        names = [n for n in ds.coords if n in PARAMETERS]
        names.sort(key=lambda n: [dims.index(d) for d in ds[n].dims])
        swept = {n: ds[n].reset_coords(drop=True) for n in names}
        return loop.assign(**{str(n): da.item() if da.ndim == 0 else da for n, da in swept.items()})

    def assign(self, **values: Any) -> Loop:
        """Return a copy with parameters changed.

        Raises
        ------
        InputError
            With one sentence for each unknown name, wrong type, value out of bounds, empty or duplicated axis.
        """
        changed = Loop.__new__(Loop)
        changed._values = _assigned(self._values, values)
        return changed

    def __getitem__(self, name: str) -> Scalar | xr.DataArray | None:
        """Value of a parameter; ``None`` for one that is not given."""
        return self._values.get(check_name(name))

    def items(self) -> Iterable[tuple[str, Scalar | xr.DataArray]]:
        """(name, value) of every parameter that is given."""
        return self._values.items()

    @property
    def swept(self) -> dict[str, xr.DataArray]:
        """The parameters that have dimensions, in the order in which they were assigned."""
        return {n: v for n, v in self._values.items() if isinstance(v, xr.DataArray)}

    @property
    def constants(self) -> dict[str, Scalar]:
        """The parameters that have none."""
        return {n: v for n, v in self._values.items() if not isinstance(v, xr.DataArray)}

    @property
    def sizes(self) -> dict[str, int]:
        """Dimension → length, in the order in which the dimensions were first assigned."""
        sizes: dict[str, int] = {}
        for name, value in self.swept.items():
            for dim, size in value.sizes.items():
                if sizes.setdefault(str(dim), size) != size:
                    raise InputError(
                        f"{name} has {size} values along {dim!r}, other parameters have {sizes[str(dim)]}: "
                        "zipped parameters need the same length"
                    )
        return sizes

    def coordinates(self) -> dict[str, xr.DataArray]:
        """The labels of every dimension, and the swept parameters along them."""
        labels: dict[str, xr.DataArray] = {}
        for name, value in self.swept.items():
            for dim in value.dims:
                if dim in value.coords and name != dim:
                    index = value.coords[dim].reset_coords(drop=True)
                    if not labels.setdefault(str(dim), index).identical(index):
                        raise InputError(
                            f"the labels of dimension {dim!r} given with {name} differ from those given before"
                        )
        for dim, size in self.sizes.items():
            own = self._values.get(dim)
            if own is not None and not (isinstance(own, xr.DataArray) and own.dims == (dim,)):
                raise InputError(f"{dim} is a parameter but not swept: give the dimension another name, such as tuning")
            if isinstance(own, xr.DataArray):
                if dim in labels and not np.array_equal(labels[dim].values, own.values):
                    raise InputError(f"the labels of dimension {dim!r} differ from the values of the parameter {dim}")
                labels[dim] = xr.DataArray(own.values, dims=dim)
            labels.setdefault(dim, xr.DataArray(np.arange(size), dims=dim))
        for name, value in self.swept.items():
            labels.setdefault(name, value.drop_vars(list(value.coords)))
        return labels

    def __repr__(self) -> str:
        default = {p.name: p.default for p in PARAMETERS.values()}
        lines = [f"  {dim}: {size}" for dim, size in self.sizes.items()]
        text = ["<fastcoil.Loop>"] + (["Dimensions:", *lines] if lines else [])
        differs = []
        for name, value in self._values.items():
            if isinstance(value, xr.DataArray):
                differs.append(f"  {name} ({', '.join(map(str, value.dims))}): {_brief(value.values)}")
            elif value != default[name]:
                unit = PARAMETERS[name].unit
                differs.append(f"  {name} = {value}" + ("" if unit in ("", "1") else f" {unit}"))
        return "\n".join(text + (["Differs from paper_like:", *differs] if differs else ["paper_like"]))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Loop) or self._values.keys() != other._values.keys():
            return False
        return all(xr.DataArray(v).identical(xr.DataArray(other._values[n])) for n, v in self._values.items())

    __hash__ = None  # type: ignore[assignment]


def _brief(values: np.ndarray) -> str:
    shown = [f"{v:g}" if not isinstance(v, str) else v for v in values.ravel()[:5]]
    return " ".join(shown) + (" …" if values.size > 5 else "")


def _assigned(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Apply ``changes``, all of their mistakes reported at once."""
    problems: list[str] = []
    checked: dict[str, Any] = {}
    for name, value in changes.items():
        try:
            checked[name] = _checked(PARAMETERS[check_name(name)], value)
        except InputError as error:
            problems += error.problems
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
    return result


def _checked(parameter: Parameter, value: Any) -> Scalar | xr.DataArray:
    """A scalar in its canonical type, or a DataArray of admissible values."""
    if isinstance(value, xr.DataArray):
        data = value if value.ndim else value.item()
        if value.ndim == 0:
            return _checked(parameter, data)
        return _checked_array(parameter, value)
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str) and not isinstance(value[1], str):
        return _checked_array(parameter, xr.DataArray(_vector(parameter, value[1]), dims=value[0]))
    if isinstance(value, (list, tuple, range)) or (isinstance(value, np.ndarray) and value.ndim):
        return _checked_array(parameter, xr.DataArray(_vector(parameter, value), dims=parameter.name))
    if isinstance(value, np.generic):
        value = value.item()
    problem = parameter.problem(value)
    if problem:
        raise InputError(problem)
    return value if parameter.is_word else int(value) if parameter.name == "n_volumes" else float(value)


def _vector(parameter: Parameter, values: Any) -> np.ndarray:
    if not isinstance(values, (list, tuple, range)) and np.ndim(values) != 1:
        raise InputError(
            f"{parameter.name}: a sweep is a list of values; give a DataArray with named dims for more dimensions"
        )
    for value in values:
        plain = value.item() if isinstance(value, np.generic) else value
        if np.ndim(plain) if isinstance(plain, np.ndarray) else isinstance(plain, (list, tuple)):
            raise InputError(
                f"{parameter.name} = {plain!r} in a list: give a DataArray with named dims for more dimensions"
            )
        fits = isinstance(plain, str) if parameter.is_word else type(plain) in (int, float) and abs(plain) <= LARGEST
        problem = None if fits else parameter.problem(plain)
        if problem:
            raise InputError(problem)
    return np.asarray(values)


def _checked_array(parameter: Parameter, array: xr.DataArray) -> xr.DataArray:
    name = parameter.name
    if array.size == 0:
        raise InputError(f"{name} = []: a sweep needs at least one value")
    for dim in array.dims:
        _check_dim(name, dim, array.ndim)
    if not parameter.is_word:
        if array.dtype.kind not in "iuf":
            raise InputError(f"{name} has values of type {array.dtype}: give numbers")
        array = array.astype(int if name == "n_volumes" and array.dtype.kind in "iu" else float)
    flat = array.values.ravel()
    bad = [p for p in (parameter.problem(v) for v in _suspects(parameter, flat)) if p]
    if bad:
        raise InputError(bad[0] if len(bad) == 1 else f"{bad[0]} (and {len(bad) - 1} more of its values)")
    if name == "n_volumes":
        array = array.astype(int)
    if array.dims == (name,):
        # a label such as 0.07 must be found on an axis made by linspace
        values = flat if parameter.is_word else np.array([float(f"{v:.12g}") for v in flat], dtype=array.dtype)
        unique, counts = np.unique(values, return_counts=True)
        if unique.size < values.size:
            raise InputError(f"{name}: {unique[counts > 1][0]} stands twice on its axis, leave one out")
        array = xr.DataArray(values, dims=name)
    return array


def _suspects(parameter: Parameter, flat: np.ndarray) -> list[Any]:
    """The values that are not plainly admissible, so that a million good ones cost nothing."""
    if parameter.is_word:
        return [v for v in flat.tolist() if v not in parameter.choices]
    fine = np.isfinite(flat) & (flat > parameter.lower) & (flat < parameter.upper)
    if parameter.whole:
        fine &= flat == np.floor(flat)
    return [v for v in flat[~fine].tolist()]


def _check_dim(name: str, dim: Hashable, ndim: int) -> None:
    if not isinstance(dim, str) or dim in FORBIDDEN_DIMS:
        raise InputError(f"{name}: {dim!r} cannot be the name of a swept dimension, it is taken; choose another")
    if not dim.isidentifier() or dim in ("method", "tolerance", "drop", "indexers", "missing_dims"):
        raise InputError(f"{name}: {dim!r} cannot be the name of a dimension; use letters, digits and _")
    if dim in PARAMETERS and dim == name and ndim > 1:
        raise InputError(f"{name}: its own name can only be the dimension of a plain list of its values")
