"""``fc.plot.traces``: supply temperature, valve and estimate in the course of time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, instance_of, names_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, nearest
from fastcoil.base.figures import COLOURS, LINE_STYLES, wrapped
from fastcoil.deliver.figures.place import in_style, legend_above, places, several, width_of
from fastcoil.deliver.figures.scenarios import Scenario, scenarios_of, times, traced
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import TRACES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TEMPERATURES = ("T_sup", "T_measured", "T_w_out", "T_w", "T_c", "T_a")
_VALVE = ("command", "position", "opening", "u", "integral")
_SHARED = {"temperature [°C]": _TEMPERATURES, "valve [%]": _VALVE}
"""Panels that several traces share."""
_USUAL = ("T_sup", "command", "position", "opening", "estimate")
_OF_BOUNDARY = "set-point"
_TALL, _LOW = 1.9, 1.3
"""Heights of the first panel and of the others, inches."""
_SET_POINT: Any = {"color": "black", "lw": 0.9, "ls": (0, (4, 2)), "drawstyle": "steps-post"}
_STEPPED = frozenset(("command", "u", "integral", "estimate", "mode"))
"""They hold between two samples of the controller."""


@in_style()
def traces(data: Any, boundary: Boundary | None = None, *, show: Any = None, ax: Any = None) -> Any:
    """Draw traces over time, up to three scenarios: temperatures, then the valve, then the estimate.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with traces, or one trace such as ``ds.T_sup``.  Scenarios differ in colour.
    boundary
        What was simulated; its set-point is drawn with the supply temperature.
    show
        Names of the traces.  Left out: supply temperature, command, motor position, opening and an estimate that is not
        0, where the result has them; of several scenarios only the last of command, position and opening.
    ax
        Axes to draw into, one for each panel; a new figure if left out.

    Returns
    -------
    matplotlib.axes.Axes
        Or an array of them, from above, where there are several panels.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more scenarios than three.
    """
    ds = traced(data)
    with checking() as check:
        names = check(_names, ds, show)
        check.unless_none(instance_of, "boundary", boundary, Boundary, "give the Boundary that was simulated")
    found = scenarios_of(ds, names)
    set_points = [] if boundary is None else _set_points(boundary, found)
    panels = _panels(names)
    panels_axes = places(ax, [_TALL, *[_LOW] * (len(panels) - 1)])
    for k, (axes, (label, of_panel)) in enumerate(zip(panels_axes, panels.items(), strict=True)):
        _draw(axes, found, of_panel)
        if of_panel[0] in _TEMPERATURES:
            for i, (x, values) in enumerate(set_points):
                axes.plot(x, values, label="" if i else _OF_BOUNDARY, **_SET_POINT)
        axes.set_ylabel(wrapped(label, 1.2, 9))
        legend_above(axes, width_of(axes, ax), _named(axes, found, of_panel, first=k == 0))
    at, words = times(found[0].ds)
    if np.asarray(at).dtype.kind == "M":
        _dates(panels_axes[-1])
    panels_axes[-1].set_xlabel(words, loc="left" if np.asarray(at).dtype.kind == "M" else "center")
    for axes in panels_axes:
        axes.margins(x=0.0)
    return several(panels_axes)


def _names(ds: xr.Dataset, show: Any) -> list[str]:
    there = [n for n in TRACES if n in ds and "elapsed_time" in ds[n].dims]
    if show is None:
        usual = [n for n in _USUAL if n in there and (n != "estimate" or bool((ds[n] > 0.0).any()))]
        if any(size > 1 for dim, size in ds[there[0]].sizes.items() if dim != "elapsed_time"):
            # of several scenarios the last of them is enough: the opening, if it is there
            valve = [n for n in usual if n in _VALVE]
            usual = [n for n in usual if n not in valve[:-1]]
        return usual or there
    names = names_of("show", show)
    problems = [
        f"show: {name!r} is no trace of this result{nearest(name, there)}; it has {', '.join(there)}"
        for name in names
        if name not in there
    ]
    if problems:
        raise InputError(problems)
    return names


def _panels(names: list[str]) -> dict[str, list[str]]:
    """The traces of each panel, by its label: what has the same scale shares one."""
    found: dict[str, list[str]] = {}
    for name in names:
        label = next((words for words, alike in _SHARED.items() if name in alike), quantity(name).axis)
        found.setdefault(label, []).append(name)
    return {quantity(alike[0]).axis if len(alike) == 1 else label: alike for label, alike in found.items()}


def _draw(axes: Axes, found: list[Scenario], names: list[str]) -> None:
    """Scenarios differ in colour and traces in line style; of a single scenario, traces differ in colour."""
    for i, one in enumerate(found):
        x, _ = times(one.ds)
        for k, name in enumerate(names):
            shown = quantity(name)
            look: Any = {"color": COLOURS[i], "ls": LINE_STYLES[k % 3]} if one.words else {"color": COLOURS[k % 3]}
            drawn = "steps-post" if name in _STEPPED else "default"
            axes.plot(x, shown.factor * one.ds[name], lw=1.0, drawstyle=drawn, label=one.words or shown.text, **look)


def _named(axes: Axes, found: list[Scenario], names: list[str], *, first: bool) -> list[Any]:
    """What the legend of a panel names: in the first the scenarios, and traces where there are several."""
    from matplotlib.lines import Line2D

    lines, _ = axes.get_legend_handles_labels()
    if not found[0].words:
        return lines if first or len(names) > 1 else []
    styles = [Line2D([], [], color="black", ls=LINE_STYLES[k % 3], label=quantity(n).text) for k, n in enumerate(names)]
    own = [line for line in lines if line.get_label() == _OF_BOUNDARY]
    return (lines[:: len(names)][: len(found)] + own if first else []) + (styles if len(names) > 1 else [])


def _set_points(boundary: Boundary, found: list[Scenario]) -> list[tuple[Any, Array]]:
    """The set-point of each day that is drawn, over the same axis as the traces; days that are alike once."""
    drawn: list[tuple[Any, Array]] = []
    for one in found:
        seconds = np.rint(one.ds["elapsed_time"].values).astype(np.int64)
        if seconds[-1] >= boundary.n_steps:
            raise InputError(
                f"boundary ends after {boundary.n_steps:,} s and the traces go to {seconds[-1]:,} s: give the boundary "
                "that was simulated"
            )
        day = boundary.sel(int(one.ds["day"])) if boundary.has_day_dim and "day" in one.ds.coords else boundary
        if day.n_days > 1:
            raise InputError(f"boundary has {day.n_days} days and the traces do not say of which they are: select one")
        values = day.of_day(0)["T_set"][seconds]
        if not any(np.array_equal(values, other) for _, other in drawn):
            drawn.append((times(one.ds)[0], values))
    return drawn


def _dates(axes: Axes) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    locator = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
