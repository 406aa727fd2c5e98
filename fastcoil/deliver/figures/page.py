"""Panels on a page: as many abreast as its width takes, a row of them for each label of a dimension."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import number_of
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.loops.labels import is_parameter, quantity_of
from fastcoil.model.parameter_table import CHANCE_DIMS
from fastcoil.study.analysis.panels import picked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PANEL = 3.2
"""Width of a panel where the figure may be as wide as it likes, inches."""
_NARROWEST = 2.2
"""Width in which a panel is still read, inches."""
_ABREAST = 3
_MILLIMETRES = 25.4
_MOST_ROWS = 6
_CONTROL = {
    "backlash_estimate": 0.0,
    "estimate_ratio": 0.0,
    "learning_step": 0.0,
    "estimator": "none",
    "law": "pi",
}
"""What a plain PI has: it assumes no backlash, and learns none."""


class Page(NamedTuple):
    """width: of the figure, inches; None: as wide as its panels want."""

    width: float | None

    @property
    def abreast(self) -> int:
        """How many panels stand side by side."""
        return _ABREAST if self.width is None else int(np.clip(self.width / _NARROWEST, 1, _ABREAST))

    def panel(self, columns: int) -> float:
        """Width of a panel, inches."""
        return _PANEL if self.width is None else self.width / columns

    def grid(self, n: int) -> tuple[int, int]:
        """Rows and columns of ``n`` panels that follow each other."""
        columns = min(n, self.abreast)
        return -(-n // columns), columns

    def row(self, n: int) -> int:
        """The columns of ``n`` panels that belong into one row.

        Raises
        ------
        InputError
            If they do not fit.
        """
        if self.width is not None and n > self.abreast:
            raise InputError(
                f"a figure of {_MILLIMETRES * self.width:.0f} mm takes {self.abreast} panel"
                f"{'s' * (self.abreast > 1)} abreast, not one for each of {n} metrics: give fewer, or more width"
            )
        return n

    def figure(self, rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
        """Panels of one width, all of the same height."""
        from matplotlib.figure import Figure

        size = (_PANEL * max(columns, 2) if self.width is None else self.width, height * rows + 0.5)
        figure = Figure(figsize=size, layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, **options)


def page_of(width: float | None) -> Page:
    """A page of a width in inches.

    Raises
    ------
    InputError
        Unless it is a number from 1 to 60.
    """
    if width is None:
        return Page(None)
    return Page(number_of("width", width, "give the width in inches, from 1 to 60", least=1.0, most=60.0))


def rows_of(ds: xr.Dataset, by: str | None) -> list[tuple[int | None, str]]:
    """Position and words of the labels that get a row of panels each.

    Those are up to six names; of more names, and of numbers, the first, the middle and the last.

    Raises
    ------
    InputError
        For a dimension that there is not.
    """
    if by is None:
        return [(None, "")]
    dims = [str(d) for d in ds["status"].dims if d in ds.coords and ds.sizes[d] > 1]
    if by not in dims:
        raise InputError(f"by = {shown(by)} is no dimension of this study{nearest(by, dims)}; it has {', '.join(dims)}")
    labels = ds[by].values
    if labels.dtype.kind == "f" and is_parameter(ds, by):
        of = quantity_of(ds, by)
        return [(k, of.equals(float(labels[k])) + _plain(by, labels[k])) for k in picked(labels.size)]
    if labels.dtype.kind in "if":
        return [(k, f"{by} = {labels[k]}") for k in picked(labels.size)]
    chosen = range(labels.size) if labels.size <= _MOST_ROWS else picked(labels.size)
    return [(k, str(labels[k])) for k in chosen]


def control_dims(ds: xr.Dataset) -> list[str]:
    """Dimensions along which a plain PI is one of several controllers: a median over them would be of unlike things."""
    dims = [str(d) for d in ds["status"].dims if ds.sizes[d] > 1 and d not in CHANCE_DIMS]
    return [d for d in dims if d == "controller" or _has_plain_pi(ds, d)]


def _has_plain_pi(ds: xr.Dataset, dim: str) -> bool:
    """Whether some labels of a dimension, and not all, are a plain PI by what differs along it."""
    plain = [ds[n].values == value for n, value in _CONTROL.items() if n in ds.coords and ds[n].dims == (dim,)]
    alike = np.logical_and.reduce(plain) if plain else np.zeros(1, dtype=bool)
    return bool(alike.any() and not alike.all())


def _plain(by: str, label: float) -> str:
    return ", plain PI" if by in ("estimate_ratio", "backlash_estimate") and label == 0.0 else ""
