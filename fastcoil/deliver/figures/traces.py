"""``fc.plot.traces``, ``learning`` and ``limit_cycle``: up to three scenarios with traces, and swings of many."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, instance_of, names_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.base.figures import BLUE, COLOURS, DOTTED, FAINT, GREY, LINE_STYLES, RED, STYLE, YELLOW, wrapped
from fastcoil.deliver.figures.drawing import caption, in_style, legend_above, places, say_if_empty, width_of
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labels import is_parameter, label_in_words, quantity, quantity_of
from fastcoil.loops.scenarios import check_result
from fastcoil.model.metric_table import SWITCH_BLOCK, TRACES
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CURE = "give a Dataset of fastcoil.simulate with traces, or one of them such as ds.T_sup"
_HOUR = 3600.0


class _Drawn(NamedTuple):
    """One scenario of a result.  words: for the legend; empty if there is no other."""

    words: str
    ds: xr.Dataset


def _traced(data: Any) -> xr.Dataset:
    """A result that has traces, as a Dataset."""
    if isinstance(data, xr.DataArray):
        if data.name not in TRACES or "elapsed_time" not in data.dims:
            raise InputError(f"data is {shown(data.name)}, which is no trace along elapsed_time: {_CURE}")
        data = data.to_dataset()
    ds: xr.Dataset = instance_of("data", data, xr.Dataset, _CURE)
    if "elapsed_time" not in ds.coords or not any(n in ds for n in TRACES):
        raise InputError('data has no traces: simulate with traces=["T_sup", "command"], or give a result that has')
    if not ds.sizes["elapsed_time"]:
        raise InputError("data has no point along elapsed_time: give a part of the result that has some")
    return ds


def _scenarios_of(ds: xr.Dataset, names: Collection[str]) -> list[_Drawn]:
    """The scenarios of these traces."""
    sizes = {str(d): n for name in names for d, n in ds[name].sizes.items() if d != "elapsed_time"}
    if "volume" in sizes:
        raise InputError(f"the traces have {sizes['volume']} volumes: select one, such as ds.sel(volume=1)")
    n = math.prod(sizes.values())
    if n > len(COLOURS):
        example = next(d for d, size in sizes.items() if size > 1)
        few = f"such as ds.isel({example}=[0, {sizes[example] - 1}])" if n == sizes[example] else "with isel or sel"
        raise InputError(f"data has {n:,} scenarios: a figure over time shows up to {len(COLOURS)}, select some, {few}")
    found = []
    for index in np.ndindex(*sizes.values()):
        place = dict(zip(sizes, index, strict=True))
        words = ", ".join(_words(ds, d, k) for d, k in place.items() if sizes[d] > 1)
        found.append(_Drawn(words, ds.isel(place)))
    return found


def _words(ds: xr.Dataset, dim: str, k: int) -> str:
    """One label of a dim; of a dim that only numbers scenarios, the parameters that go along with it."""
    along = [str(n) for n in ds.coords if n != dim and ds[n].dims == (dim,) and is_parameter(ds, n)]
    is_numbered = dim not in ds.coords or (ds[dim].dtype.kind in "iu" and dim not in ("day", "replicate"))
    if not along or not is_numbered or is_parameter(ds, dim):
        return label_in_words(ds, dim, k)
    values = {n: ds[n].values[k] for n in along}
    return ", ".join(v if isinstance(v, str) else quantity_of(ds, n).equals(float(v)) for n, v in values.items())


def _parameter(one: xr.Dataset, name: str) -> float:
    """A parameter of one scenario."""
    if name in one.coords and one[name].ndim == 0:
        return float(one[name])
    try:
        return float(json.loads(one.attrs["parameters"])[name])
    except (KeyError, TypeError, ValueError):
        text = PARAMETERS[name].label
        raise InputError(f"data does not say its {text}: give the whole Dataset of fastcoil.simulate") from None


def _times(one: xr.Dataset) -> tuple[Any, str]:
    """Where the points of a trace lie along the x axis, and its label: dates where they are known, else hours."""
    if "time" in one.coords and one["time"].dims == ("elapsed_time",):
        zone = one["time"].attrs.get("time_zone", "")
        return one["time"].values, f"date and time{f' ({zone})' if zone else ''}"
    return one["elapsed_time"].values / _HOUR, "time from the start [h]"


_TEMPERATURES = ("T_sup", "T_measured", "T_w_out", "T_w", "T_c", "T_a")
_VALVE = ("command", "position", "opening", "u", "integral")
_SHARED = {"temperature [°C]": _TEMPERATURES, "valve [%]": _VALVE}  # panels that several traces share
_USUAL = ("T_sup", "command", "position", "opening", "estimate")
_TALL, _LOW = 1.9, 1.3  # height of the first panel and of the others, inches
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
    ds = _traced(data)
    with checking() as check:
        names = check(_names, ds, show)
        check.unless_none(instance_of, "boundary", boundary, Boundary, "give the Boundary that was simulated")
    found = _scenarios_of(ds, names)
    set_points = [] if boundary is None else _set_points(boundary, found)
    panels = _panels(names)
    drawn_into = places(ax, [_TALL, *[_LOW] * (len(panels) - 1)])
    for axes, (label, of_panel) in zip(drawn_into, panels.items(), strict=True):
        _draw(axes, found, of_panel, is_first=axes is drawn_into[0])
        if of_panel[0] in _TEMPERATURES:
            for i, (x, values) in enumerate(set_points):
                axes.plot(x, values, label="_" if i else "set-point", **_SET_POINT)
        axes.set_ylabel(wrapped(label, 1.2, 9))
        axes.margins(x=0.0)
        legend_above(axes, width_of(axes, ax))
    _label_times(drawn_into[-1], *_times(found[0].ds))
    return drawn_into[0] if len(drawn_into) == 1 else np.array(drawn_into)


def _names(ds: xr.Dataset, show: Any) -> list[str]:
    """The traces to draw: those that are asked for, or the usual ones."""
    there = [n for n in TRACES if n in ds and "elapsed_time" in ds[n].dims]
    if show is None:
        usual = [n for n in _USUAL if n in there and (n != "estimate" or bool((ds[n] > 0.0).any()))]
        if any(size > 1 for dim, size in ds[there[0]].sizes.items() if dim != "elapsed_time"):
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


def _draw(axes: Axes, found: list[_Drawn], names: list[str], *, is_first: bool) -> None:
    """Scenarios differ in colour and traces in line style; of a single scenario, traces differ in colour."""
    for i, one in enumerate(found):
        x, _ = _times(one.ds)
        for k, name in enumerate(names):
            of = quantity(name)
            look: Any = {"color": COLOURS[i], "ls": LINE_STYLES[k % 3]} if one.words else {"color": COLOURS[k % 3]}
            words = [one.words, of.text if len(names) > 1 or not one.words else ""]
            label = ", ".join(filter(None, words)) if is_first or len(names) > 1 else "_"
            drawn = "steps-post" if name in _STEPPED else "default"
            axes.plot(x, of.factor * one.ds[name], lw=1.0, drawstyle=drawn, label=label, **look)


def _set_points(boundary: Boundary, found: list[_Drawn]) -> list[tuple[Any, Array]]:
    """The set-point of each day that is drawn, over the same axis as the traces; days that are alike once."""
    drawn: list[tuple[Any, Array]] = []
    for one in found:
        seconds = np.rint(one.ds["elapsed_time"].values).astype(np.int64)
        if seconds[-1] >= boundary.n_steps:
            raise InputError(
                f"boundary ends after {boundary.n_steps:,} s and the traces go to {seconds[-1]:,} s: give the boundary "
                "that was simulated"
            )
        if "start" in one.ds.coords and boundary.start is not None:
            starts = np.asarray(boundary.start, dtype="datetime64[s]")
            if one.ds["start"].values.astype("datetime64[s]") not in starts:
                raise InputError(
                    f"boundary starts on {starts[0]} and the traces on {one.ds['start'].values}: give the boundary "
                    "that was simulated"
                )
        day = boundary.sel(int(one.ds["day"])) if boundary.has_day_dim and "day" in one.ds.coords else boundary
        if day.n_days > 1:
            raise InputError(f"boundary has {day.n_days} days and the traces do not say of which they are: select one")
        values = day.of_day(0)["T_set"][seconds]
        if not any(np.array_equal(values, other) for _, other in drawn):
            drawn.append((_times(one.ds)[0], values))
    return drawn


def _label_times(axes: Axes, at: Array, words: str) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    is_dated = at.dtype.kind == "M"
    axes.set_xlabel(words, loc="left" if is_dated else "center")
    if is_dated:
        locator = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


_HEIGHT = 2.4


@in_style()
def learning(data: Any, *, ax: Any = None) -> Axes:
    """Draw the backlash estimate over time against the true backlash, up to three scenarios.

    A dot is where the estimate reached the backlash, a square where the learner confirmed it by stepping down.  Of a
    single scenario with the trace ``mode``, taken at every sample of the controller, grey bars are the switches of mode
    in each 10 min: those of a good estimate are few, chatter says that it is too large.

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
    ds = _traced(data)
    if "estimate" not in ds:
        raise InputError('data has no trace estimate: simulate with traces=["estimate", "mode"]')
    found = _scenarios_of(ds, ["estimate"])
    gaps = [100.0 * _parameter(one.ds, "backlash") for one in found]
    (axes,) = places(ax, [_HEIGHT])
    if len(found) == 1 and "mode" in ds:
        _draw_chatter(axes, found[0].ds)
    for one, colour, style in zip(found, COLOURS, LINE_STYLES, strict=False):
        estimate = 100.0 * one.ds["estimate"]
        hours = estimate["elapsed_time"] / _HOUR
        axes.plot(hours, estimate, drawstyle="steps-post", label=one.words or "estimate", color=colour, ls=style)
        for name, mark in (("learn_time_reached", "o"), ("learn_time_confirmed", "s")):
            at = float(one.ds[name]) if name in one.ds and one.ds[name].ndim == 0 else math.nan
            if math.isfinite(at):
                there = float(estimate.sel(elapsed_time=at, method="nearest"))
                axes.plot(at / _HOUR, there, mark, color=colour, mec="black", mew=0.6, ms=5, ls="none")
    if len({*gaps}) == 1:
        axes.axhline(gaps[0], color="black", lw=0.9, ls=":", label="true backlash")
    else:
        for k, gap in enumerate(gaps):
            axes.axhline(gap, color=COLOURS[k], lw=0.9, ls=":", label="_" if k else "true backlash of each")
    axes.set(xlabel="time from the start [h]", ylabel=quantity("estimate").axis)
    axes.margins(x=0.0)
    axes.set_ylim(0.0, 1.15 * max(*gaps, float(100.0 * ds["estimate"].max()), 0.1))
    legend_above(axes, width_of(axes, ax))
    return axes


def _draw_chatter(axes: Axes, one: xr.Dataset) -> None:
    """Switches of mode in each block of 10 min, behind the curves, on an axis of their own."""
    seconds = one["elapsed_time"].values
    interval = float(seconds[1] - seconds[0]) if seconds.size > 1 else math.inf
    if interval > _parameter(one, "sample_time"):
        return
    counts, hours = switches(one["mode"].values, interval)
    behind = axes.twinx()
    behind.bar(hours, counts, width=SWITCH_BLOCK / _HOUR, align="edge", color=FAINT, lw=0)
    behind.set(ylabel="mode switches per 10 min", ylim=(0.0, max(2.0 * float(counts.max(initial=0.0)), 1.0)))
    behind.tick_params(labelsize=STYLE["font.size"])
    behind.grid(visible=False)
    behind.spines["right"].set_visible(True)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)


def switches(mode: Array, interval: float) -> tuple[Array, Array]:
    """Switches of mode in each whole block of 10 min, and where the blocks start [h]."""
    per_block = round(SWITCH_BLOCK / interval)
    changed = np.diff(mode.astype(float), prepend=mode[0]) != 0.0
    n = changed.size // per_block
    counts = changed[: n * per_block].reshape(n, per_block).sum(axis=1).astype(float)
    return counts, np.arange(n) * per_block * interval / _HOUR


_HEIGHT_OF_SWING = 3.0
_PERIODS = 4  # the last periods of a swing that are drawn
_LAST = 3600.0  # seconds that are drawn of a loop without a period
_PLANE = ("command", "opening")
_PREDICTED = ("margin", "hunts", "period", "amplitude")
_KINDS = (
    ("predicted and seen", True, True, "o", BLUE),
    ("seen, not predicted", False, True, "s", RED),
    ("predicted, not seen", True, False, "^", YELLOW),
    ("neither", False, False, "x", GREY),
)
"""What became of the loops in a scatter of swings: words, predicted, seen, mark, colour."""


@in_style()
def limit_cycle(data: Any, predicted: xr.Dataset | None = None, *, ax: Any = None) -> Axes:
    """Draw how a loop swings, and a prediction of it.

    Of up to three scenarios with the traces ``command`` and ``opening``: the opening over the command in the last
    swings; the gap is the width of the parallelogram, between the dotted lines on which Eq (1) moves the stem.  The
    heading compares the swing with the one predicted.

    Of a sweep without these traces: the swing seen over the swing predicted of every scenario, peak to peak.

    Parameters
    ----------
    data
        Dataset of ``simulate``, ``run_study`` or ``open_study``.
    predicted
        What ``fc.limit_cycle(loop, boundary)`` gives for the same sweep.  A study with ``[run] predict`` has it itself.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    ds = instance_of("data", data, xr.Dataset, "give a Dataset of fastcoil.simulate or open_study")
    if predicted is not None:
        cure = "give what fastcoil.limit_cycle(loop, boundary) returns"
        instance_of("predicted", predicted, xr.Dataset, cure)
        missing = [name for name in _PREDICTED if name not in predicted]
        if missing:
            raise InputError(f"predicted has no {', '.join(missing)}: {cure}")
    elif "predicted_swing" in ds:
        names = {name: ds[f"predicted_{name}"] for name in ("margin", "hunts", "period")}
        predicted = xr.Dataset(names | {"amplitude": 0.5 * ds["predicted_swing"]})
    if all(name in ds for name in _PLANE):
        return _plane(_traced(ds), predicted, ax)
    check_result(ds)
    if predicted is None:
        raise InputError(
            'data has neither the traces command and opening nor a prediction: simulate with traces=["command", '
            '"opening"], or give predicted=fc.limit_cycle(loop, boundary)'
        )
    return _swings(ds, predicted, ax)


def _plane(ds: xr.Dataset, predicted: xr.Dataset | None, ax: Any) -> Axes:
    found = _scenarios_of(ds, _PLANE)
    gaps = [_parameter(one.ds, "backlash") for one in found]
    lines = [": ".join(filter(None, [one.words, _compared(one.ds, predicted)])) for one in found]
    (axes,) = places(ax, [_HEIGHT_OF_SWING])
    axes.set(xlabel="command [%]", ylabel="opening [%]")
    if say_if_empty(axes, ds["opening"]):
        return axes
    low, high = math.inf, -math.inf
    for k, (one, gap) in enumerate(zip(found, gaps, strict=True)):
        period = float(one.ds["hunting_period"]) if "hunting_period" in one.ds else math.nan
        end = float(one.ds["elapsed_time"][-1])
        last = one.ds.sel(elapsed_time=slice(end - (_PERIODS * period if math.isfinite(period) else _LAST), None))
        command, opening = 100.0 * last["command"].values, 100.0 * last["opening"].values
        axes.plot(command, opening, color=COLOURS[k], ls=LINE_STYLES[k], lw=1.2, label=one.words or "_only")
        ends = np.array([command.min(), command.max()])
        for shift in {0.0, 100.0 * gap}:
            edge = np.clip((ends - shift) / (1.0 - gap), 0.0, 100.0)
            axes.plot(ends, edge, color="black", lw=0.7, ls=DOTTED, zorder=1)
        low, high = float(np.fmin.reduce(opening, initial=low)), float(np.fmax.reduce(opening, initial=high))
    room = max(0.15 * (high - low), 0.5)
    axes.set_ylim(low - room, high + room)
    if found[0].words:
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    caption(axes, "\n".join([*lines, "dotted: the edges of the gap"]), width_of(axes, ax))
    return axes


def _compared(one: xr.Dataset, predicted: xr.Dataset | None) -> str:
    """The simulated and the predicted swing of one scenario in words."""
    words = []
    if "hunting_swing" in one:
        words.append(f"simulated {_swing(float(one['hunting_swing']), float(one['hunting_period']))}")
    if predicted is not None:
        place = {d: one[d].item() for d in predicted["margin"].dims if d in one.coords and one[d].ndim == 0}
        with suppress(KeyError, ValueError):
            predicted = predicted.sel(place)
        if predicted["margin"].ndim:
            dims = ", ".join(str(dim) for dim in predicted["margin"].dims)
            raise InputError(f"predicted has other labels along {dims} than data: give that of the same sweep")
        margin, hunts, period, amplitude = (float(predicted[name]) for name in _PREDICTED)
        swing = _swing(2.0 * amplitude, period) if hunts > 0.0 else "no swing"
        words.append(f"predicted {swing} (margin {margin:.2g})")
    return ", ".join(words)


def _swing(peak_to_peak: float, period: float) -> str:
    return f"{peak_to_peak:.2g} K" + (f" every {period:.0f} s" if math.isfinite(period) else "")


def _swings(ds: xr.Dataset, predicted: xr.Dataset, ax: Any) -> Axes:
    """The simulated over the predicted swing of every scenario."""
    seen, swing, hunts, does = xr.broadcast(
        ds["hunting_swing"], 2.0 * predicted["amplitude"], predicted["hunts"], ds["hunts"]
    )
    dims = [d for d in predicted["hunts"].dims if d in ds.indexes and d in predicted.indexes]
    alike = all(set(ds.indexes[d]) == set(predicted.indexes[d]) for d in dims)
    if not alike or seen.sizes != ds["hunting_swing"].sizes:
        raise InputError("predicted has other dims or labels than data: give that of the same sweep")
    known = np.isfinite(seen.values) & np.isfinite(hunts.values)
    y, x = seen.values[known], np.nan_to_num(swing.values[known])
    (axes,) = places(ax, [_HEIGHT_OF_SWING])
    for words, is_predicted, is_seen, mark, colour in _KINDS:
        of_kind = ((hunts.values[known] > 0.0) == is_predicted) & ((does.values[known] > 0.0) == is_seen)
        label = f"{words}: {int(of_kind.sum()):,}"
        axes.plot(x[of_kind], y[of_kind], mark, color=colour, ms=3.5, mew=0.8, mfc="none", ls="none", label=label)
    top = 1.05 * max(float(x.max(initial=0.1)), float(y.max(initial=0.1)))
    axes.axline((0.0, 0.0), slope=1.0, color="black", lw=0.8, ls=DOTTED)
    axes.set(xlabel="predicted swing, peak to peak [K]", ylabel="simulated swing,\npeak to peak [K]",
             xlim=(-0.02 * top, top), ylim=(-0.02 * top, top))  # fmt: skip
    legend_above(axes, width_of(axes, ax), title="hunting", title_fontsize=8, alignment="left")
    return axes
