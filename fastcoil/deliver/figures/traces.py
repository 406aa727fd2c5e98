"""``fc.plot.traces``, ``learning`` and ``limit_cycle``: up to three scenarios with traces."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, choice_of, instance_of, names_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.figures import COLOURS, DOTTED, LINE_STYLES, wrapped
from fastcoil.deliver.figures.drawing import caption, in_style, legend_above, places, say_if_empty
from fastcoil.logs.series import COLUMNS
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labels import label_in_words, quantity
from fastcoil.loops.scenarios import require_our_units
from fastcoil.model.metric_table import TRACES
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CURE = "give a Dataset of fastcoil.simulate with traces"
_HOUR = 3600.0


class _Drawn(NamedTuple):
    """One scenario of a result with its colour and line style.  words: for the legend; empty if there is no other."""

    words: str
    ds: xr.Dataset
    colour: str
    style: str

    @property
    def backlash(self) -> float:
        found = self.ds.coords.get("backlash", json.loads(self.ds.attrs.get("parameters", "{}")).get("backlash"))
        if found is None:
            raise InputError(f"data does not say its backlash: {_CURE}")
        return float(found)

    @property
    def times(self) -> Array:
        """Where its points lie along the x axis: dates where they are known, else hours."""
        return self.ds["time"].values if "time" in self.ds.coords else self.ds["elapsed_time"].values / _HOUR


def _traced(data: Any, *names: str) -> xr.Dataset:
    """A result with traces, some or those of ``names``."""
    ds: xr.Dataset = instance_of("data", data, xr.Dataset, _CURE)
    if "elapsed_time" not in ds.coords or not any(n in ds for n in TRACES) or not all(n in ds for n in names):
        wanted = list(names or ("T_sup", "command"))
        raise InputError(f"data lacks traces such as {' and '.join(wanted)}: simulate with traces={wanted}")
    require_our_units(ds, PARAMETERS, TRACES, {"elapsed_time": COLUMNS["elapsed_time"]})
    return ds


def _scenarios_of(ds: xr.Dataset, names: Collection[str]) -> list[_Drawn]:
    sizes = {str(d): n for name in names for d, n in ds[name].sizes.items() if d != "elapsed_time"}
    if "volume" in sizes:
        raise InputError(f"the traces have {sizes['volume']} volumes: select one, such as ds.sel(volume=1)")
    n = math.prod(sizes.values())
    if n > len(COLOURS):
        raise InputError(f"data has {n:,} scenarios: select up to {len(COLOURS)} with isel or sel")
    found = []
    for index, colour, style in zip(np.ndindex(*sizes.values()), COLOURS, LINE_STYLES, strict=False):
        place = dict(zip(sizes, index, strict=True))
        words = ", ".join(label_in_words(ds, d, k) for d, k in place.items() if sizes[d] > 1)
        found.append(_Drawn(words, ds.isel(place), colour, style))
    return found


_TEMPERATURES = ("T_sup", "T_measured", "T_w_out", "T_w", "T_c", "T_a")
_VALVE = ("command", "position", "opening", "u", "integral")
_SHARED = {"temperature [°C]": _TEMPERATURES, "valve [%]": _VALVE}  # panels that several traces share
_USUAL = ("T_sup", "command", "position", "opening", "estimate")
_TALL, _LOW = 1.9, 1.3  # height of the first panel over time and of the others, inches
_HEIGHT_OF_ESTIMATE, _HEIGHT_OF_SWING = 2.4, 3.0
_STEPPED = ("command", "u", "integral", "estimate", "mode")  # they hold between two samples of the controller


@in_style()
def traces(data: Any, boundary: Boundary | None = None, *, show: Any = None, ax: Any = None) -> Any:
    """Draw traces over time, up to three scenarios: temperatures, then the valve, then the estimate.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with traces.  Scenarios differ in colour.
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
    ds = _traced(data)
    with checking() as check:
        names = check(_names, ds, show)
        check.unless_none(instance_of, "boundary", boundary, Boundary, "give the Boundary that was simulated")
    found = _scenarios_of(ds, names)
    set_points = [] if boundary is None else _set_points(boundary, found)
    panels = _panels(names)
    drawn_into = places(ax, [_TALL, *[_LOW] * (len(panels) - 1)])
    for k, (axes, (label, of_panel)) in enumerate(zip(drawn_into, panels.items(), strict=True)):
        _draw(axes, found, of_panel, is_first=k == 0)
        for i, (x, values) in enumerate(set_points if of_panel[0] in _TEMPERATURES else []):
            axes.step(x, values, where="post", color="black", lw=0.9, ls="--", label="_" if i else "set-point")
        axes.set_ylabel(wrapped(label, 1.2, 9))
        axes.margins(x=0.0)
        legend_above(axes)
    _label_times(drawn_into[-1], ds)
    return drawn_into[0] if len(drawn_into) == 1 else np.array(drawn_into)


def _names(ds: xr.Dataset, show: Any) -> list[str]:
    there = [n for n in TRACES if n in ds and "elapsed_time" in ds[n].dims]
    if show is None:
        usual = [n for n in _USUAL if n in there and (n != "estimate" or bool((ds[n] > 0.0).any()))]
        if ds[there[0]].size > ds.sizes["elapsed_time"]:  # several scenarios
            valve = [n for n in usual if n in _VALVE]
            usual = [n for n in usual if n not in valve[:-1]]
        return usual or there
    names = names_of("show", show)
    with checking() as check:
        for name in names:
            check(choice_of, "show", name, there)
    return names


def _panels(names: list[str]) -> dict[str, list[str]]:
    """The traces of each panel, by its label: what has the same scale shares one."""
    found: dict[str, list[str]] = {}
    for name in names:
        label = next((words for words, alike in _SHARED.items() if name in alike), quantity(name).axis)
        found.setdefault(label, []).append(name)
    return {quantity(alike[0]).axis if len(alike) == 1 else label: alike for label, alike in found.items()}


def _draw(axes: Axes, found: list[_Drawn], names: list[str], *, is_first: bool) -> None:
    """Scenarios differ in colour and traces in line style; of a single scenario, traces differ in colour."""
    for one in found:
        for k, name in enumerate(names):
            of = quantity(name)
            look: Any = {"color": one.colour, "ls": LINE_STYLES[k % 3]} if one.words else {"color": COLOURS[k % 3]}
            words = [one.words, of.text if len(names) > 1 or not one.words else ""]
            label = ", ".join(filter(None, words)) if is_first or len(names) > 1 else "_"
            drawn = "steps-post" if name in _STEPPED else "default"
            axes.plot(one.times, of.factor * one.ds[name], lw=1.0, drawstyle=drawn, label=label, **look)


def _set_points(boundary: Boundary, found: list[_Drawn]) -> list[tuple[Array, Array]]:
    """The set-point of each day that is drawn, over the same axis as the traces; days that are alike once."""
    drawn: list[tuple[Array, Array]] = []
    for one in found:
        seconds = np.rint(one.ds["elapsed_time"].values).astype(np.int64)
        day = boundary.sel(int(one.ds["day"])) if boundary.has_day_dim and "day" in one.ds.coords else boundary
        if day.n_days > 1:
            raise InputError(f"boundary has {day.n_days} days and the traces do not say of which they are: select one")
        attrs = one.ds.attrs
        known = {} if attrs.keys() & {"command_sha256", "carry_over"} else json.loads(attrs.get("day_sha256", "{}"))
        if seconds[-1] >= day.n_steps or (known and day.day_sha256[0] not in known):
            raise InputError("boundary has another day than the traces: give the boundary that was simulated")
        values = day.of_day(0)["T_set"][seconds]
        if not any(np.array_equal(values, other) for _, other in drawn):
            drawn.append((one.times, values))
    return drawn


def _label_times(axes: Axes, ds: xr.Dataset) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    if "time" not in ds.coords:
        axes.set_xlabel("time from the start [h]")
        return
    zone = ds["time"].attrs.get("time_zone", "")
    axes.set_xlabel(f"date and time{f' ({zone})' if zone else ''}", loc="left")
    locator = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


@in_style()
def learning(data: Any, *, ax: Any = None) -> Axes:
    """Draw the backlash estimate over time against the true backlash, up to three scenarios.

    A dot is where the estimate reached the backlash, a square where the learner confirmed it by stepping down.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with the trace ``estimate``.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more scenarios than three.
    """
    ds = _traced(data, "estimate")
    found = _scenarios_of(ds, ["estimate"])
    gaps = [100.0 * one.backlash for one in found]
    (axes,) = places(ax, [_HEIGHT_OF_ESTIMATE])
    for one in found:
        estimate = 100.0 * one.ds["estimate"]
        hours = estimate["elapsed_time"] / _HOUR
        words = one.words or "estimate"
        axes.plot(hours, estimate, drawstyle="steps-post", label=words, color=one.colour, ls=one.style)
        for name, mark in (("learn_time_reached", "o"), ("learn_time_confirmed", "s")):
            at = float(one.ds[name]) if name in one.ds and one.ds[name].ndim == 0 else math.nan
            if math.isfinite(at):
                there = float(estimate.sel(elapsed_time=at, method="nearest"))
                axes.plot(at / _HOUR, there, mark, color=one.colour, mec="black", mew=0.6, ms=5, ls="none")
    for k, gap in enumerate(dict.fromkeys(gaps)):
        axes.axhline(gap, color="black", lw=0.9, ls=":", label="_" if k else "true backlash")
    axes.set(xlabel="time from the start [h]", ylabel=quantity("estimate").axis)
    axes.margins(x=0.0)
    axes.set_ylim(bottom=0.0)
    legend_above(axes)
    return axes


_PERIODS = 4  # the last periods of a swing that are drawn
_LAST = 3600.0  # seconds that are drawn of a loop without a period
_PLANE = ("command", "opening")
_PREDICTED = ("margin", "hunts", "period", "amplitude")


@in_style()
def limit_cycle(data: Any, predicted: xr.Dataset | None = None, *, ax: Any = None) -> Axes:
    """Draw how a loop swings, and a prediction of it: the opening over the command in the last swings.

    The gap is the width of the parallelogram, between the dotted lines on which Eq (1) moves the stem.  The heading
    compares the swing with the one predicted.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with the traces ``command`` and ``opening``, up to three scenarios.
    predicted
        What ``fc.limit_cycle(loop, boundary)`` gives for the same sweep.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    ds = _traced(data, *_PLANE)
    if predicted is not None:
        cure = "give what fastcoil.limit_cycle(loop, boundary) returns"
        instance_of("predicted", predicted, xr.Dataset, cure)
        missing = [name for name in _PREDICTED if name not in predicted]
        if missing:
            raise InputError(f"predicted has no {', '.join(missing)}: {cure}")
        here, there = (json.loads(each.attrs.get("parameters", "{}")) for each in (ds, predicted))
        for name in (name for name in here if here[name] != there.get(name, here[name])):
            other = f"predicted is of another loop, with {name} = {there[name]}, in data {here[name]}"
            raise InputError(f"{other}: give that of the same loop")
    found = _scenarios_of(ds, _PLANE)
    lines = [": ".join(filter(None, [one.words, _compared(one.ds, predicted)])) for one in found]
    (axes,) = places(ax, [_HEIGHT_OF_SWING])
    axes.set(xlabel="command [%]", ylabel="opening [%]")
    if say_if_empty(axes, ds["opening"]):
        return axes
    drawn = np.concatenate([_draw_swings(axes, one) for one in found])
    low, high = float(np.nanmin(drawn)), float(np.nanmax(drawn))
    room = max(0.15 * (high - low), 0.5)
    axes.set_ylim(low - room, high + room)
    if found[0].words:
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    caption(axes, "\n".join([*lines, "dotted: the edges of the gap"]))
    return axes


def _draw_swings(axes: Axes, one: _Drawn) -> Array:
    """Draw the last swings of a scenario, and the edges of its gap; return the opening [%]."""
    gap = one.backlash
    period = float(one.ds["hunting_period"]) if "hunting_period" in one.ds else math.nan
    end = float(one.ds["elapsed_time"][-1])
    last = one.ds.sel(elapsed_time=slice(end - (_PERIODS * period if math.isfinite(period) else _LAST), None))
    command, opening = 100.0 * last["command"].values, 100.0 * last["opening"].values
    axes.plot(command, opening, color=one.colour, ls=one.style, lw=1.2, label=one.words or "_only")
    ends = np.array([command.min(), command.max()])
    for shift in {0.0, 100.0 * gap}:
        edge = np.clip((ends - shift) / (1.0 - gap), 0.0, 100.0)
        axes.plot(ends, edge, color="black", lw=0.7, ls=DOTTED, zorder=1)
    return opening


def _compared(one: xr.Dataset, predicted: xr.Dataset | None) -> str:
    """The simulated and the predicted swing of one scenario in words."""
    words = []
    if "hunting_swing" in one:
        words.append(f"simulated {_swing(float(one['hunting_swing']), float(one['hunting_period']))}")
    if predicted is not None:
        place = {d: one[d].item() for d in predicted["margin"].dims if d in one.coords and one[d].ndim == 0}
        if len(place) < predicted["margin"].ndim or any(label not in predicted[d] for d, label in place.items()):
            dims = ", ".join(str(dim) for dim in predicted["margin"].dims)
            raise InputError(f"predicted has other labels along {dims} than data: give that of the same sweep")
        margin, hunts, period, amplitude = (float(predicted[name].sel(place)) for name in _PREDICTED)
        swing = _swing(2.0 * amplitude, period) if hunts > 0.0 else "no swing"
        words.append(f"predicted {swing} (margin {margin:.2g})")
    return ", ".join(words)


def _swing(peak_to_peak: float, period: float) -> str:
    return f"{peak_to_peak:.2g} K" + (f" every {period:.0f} s" if math.isfinite(period) else "")
