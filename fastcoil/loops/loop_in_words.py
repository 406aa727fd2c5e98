"""A loop as a terminal and a notebook show it: what differs from a preset first, then all of it by its parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.results import Section, card
from fastcoil.loops.assignment import words_of
from fastcoil.loops.labels import unit_in_words
from fastcoil.loops.presets import PRESETS, Preset
from fastcoil.model.parameter_table import ESTIMATOR_GROUPS, Parameter, Scalar

_LISTED = 5
"""So many values of a sweep are written one by one."""


class Parts(NamedTuple):
    """What is told of a loop: its values by name, the table of all that it may have, its dimensions."""

    values: Mapping[str, Any]
    table: Mapping[str, Parameter]
    sizes: Mapping[str, int]


def nearest_preset(loop: Parts) -> Preset:
    """The preset from which the loop differs in the fewest parameters; the first of them."""
    return min(PRESETS.values(), key=lambda preset: len(_differing(loop, preset)))


def text_of(loop: Parts) -> str:
    """For a terminal: dimensions, and what differs from the nearest preset."""
    lines = [f"  {dim}: {size}" for dim, size in loop.sizes.items()]
    text = ["<fastcoil.Loop>"] + (["Dimensions:", *lines] if lines else [])
    preset, table = nearest_preset(loop), loop.table
    differs = []
    for name in _differing(loop, preset):
        value = loop.values[name]
        if isinstance(value, xr.DataArray):
            differs.append(f"  {name} ({', '.join(map(str, value.dims))}): {_listed(value.values)}")
        else:
            differs.append(f"  {table[name].equation(value)}")
    return "\n".join(text + ([f"Differs from {preset.name}:", *differs] if differs else [preset.name]))


def html_of(loop: Parts) -> str:
    """For a notebook: what differs from the nearest preset, then every parameter by its part of the loop."""
    preset, table = nearest_preset(loop), loop.table
    differing = _differing(loop, preset)
    sizes = ", ".join(f"{dim}: {size}" for dim, size in loop.sizes.items())
    n = int(np.prod(list(loop.sizes.values()), dtype=int))
    lines = [f"{n:,} scenarios ({sizes})"] if sizes else []
    changed = [_row(table[name], loop.values[name], preset.value(table[name])) for name in differing]
    sections = [Section(f"Differs from {preset.name}", changed, is_open=True)] if changed else []
    groups: dict[str, list[Parameter]] = {}
    for parameter in table.values():
        groups.setdefault(parameter.group, []).append(parameter)
    unused = set(ESTIMATOR_GROUPS) - words_of(loop.values, "estimator")
    for group, parameters in groups.items():
        given = [p for p in parameters if p.name in loop.values]
        if given and (group not in unused or any(p.name in differing for p in given)):
            sections.append(Section(group, [_row(p, loop.values[p.name]) for p in given], f"{len(given)}"))
    return card("fastcoil.Loop", preset.name + (" with changes" if changed else ""), [preset.text, *lines], sections)


def _differing(loop: Parts, preset: Preset) -> list[str]:
    """Parameters of another value than in a preset: those swept, then constants, in the order of the table."""
    swept = [name for name, value in loop.values.items() if isinstance(value, xr.DataArray)]
    constants = {name: loop.values[name] for name in loop.table if name in loop.values and name not in swept}
    return swept + preset.changed(constants, loop.table)


_NOT_COMPARED = object()


def _row(p: Parameter, value: Scalar | xr.DataArray, usual: object = _NOT_COMPARED) -> tuple[str, ...]:
    """Name, value with its unit, what it is."""
    unit = unit_in_words(p.unit)
    if isinstance(value, xr.DataArray):
        dims = ", ".join(f"{dim}: {size}" for dim, size in value.sizes.items())
        shown = f"{_ranged(value.values)} {unit}".rstrip() + f" ({dims})"
    else:
        shown = f"{_short(value)} {unit}".rstrip()
    beside = "" if usual is _NOT_COMPARED or usual is None else f"{_short(usual)} {unit}".rstrip()
    compared = () if usual is _NOT_COMPARED else (f"instead of {beside}" if beside else "",)
    return (p.name, shown, *compared, p.label or p.text)


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, (int, float)) else str(value)


def _listed(values: np.ndarray) -> str:
    shown = [f"{v:g}" if not isinstance(v, str) else v for v in values.ravel()[:_LISTED]]
    return " ".join(shown) + (f" … {_last(values)}" if values.size > _LISTED else "")


def _last(values: np.ndarray) -> str:
    value = values.ravel()[-1]
    return value if isinstance(value, str) else f"{value:g}"


def _ranged(values: np.ndarray) -> str:
    """A few values one by one; of many the range, and the median where they are not an axis from low to high."""
    flat = values.ravel()
    if flat.size <= _LISTED or flat.dtype.kind not in "iuf":
        words = list(dict.fromkeys(_short(v.item() if hasattr(v, "item") else v) for v in flat))
        return ", ".join(words[:_LISTED]) + (", …" if len(words) > _LISTED else "")
    text = f"{flat.min():.4g} to {flat.max():.4g}"
    return text if flat.ndim == 1 and bool((np.diff(flat) > 0.0).all()) else f"{text}, median {np.median(flat):.4g}"
