"""``fc.plot.traces``, ``learning`` and ``limit_cycle``: up to three scenarios with traces."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_choice, require_instance, require_names
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.figures import COLOURS, DOTTED_LINE, LINE_STYLES, wrap_text
from fastcoil.deliver.figures.drawing import draw_caption, draw_legend_above, mark_if_empty, prepare_axes, use_style
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import require_one_clock
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labels import label_in_words, quantity
from fastcoil.loops.scenarios import require_distinct_labels, require_scenarios, require_table_units
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRACES_CURE = "give a Dataset of fastcoil.simulate with traces"


class _Scenario(NamedTuple):
    """One scenario of a result with its colour and line style.  words: for the legend; empty if there is no other."""

    words: str
    ds: xr.Dataset
    colour: str
    style: str

    @property
    def backlash(self) -> float:
        backlash = self.ds.coords.get("backlash", json.loads(self.ds.attrs.get("parameters", "{}")).get("backlash"))
        if backlash is None:
            raise InputError(f"data does not say its backlash: {_TRACES_CURE}", "data", "missing")
        return float(backlash)

    @property
    def times(self) -> Array:
        """Positions along the x axis: dates if they are known, else hours."""
        return self.ds["time"].values if "time" in self.ds.coords else self.ds["elapsed_time"].values / 3600.0


def _require_traces(data: Any, *names: str) -> xr.Dataset:
    """Check that a result has traces, some or those of ``names``, and return it."""
    ds: xr.Dataset = require_instance("data", data, xr.Dataset, _TRACES_CURE)
    if "elapsed_time" not in ds.coords or not any(n in ds for n in TRACES) or not all(n in ds for n in names):
        needed_names = list(names or ("T_sup", "command"))
        sentence = f"data lacks traces such as {' and '.join(needed_names)}: simulate with traces={needed_names}"
        raise InputError(sentence, "data", "missing")
    require_scenarios(ds, ds.dims)
    require_distinct_labels(ds, [d for d in ds.dims if d in ds.coords and d != "elapsed_time"])
    require_table_units(ds, PARAMETERS, TRACES, {"elapsed_time": COLUMNS["elapsed_time"]})
    require_one_clock(ds, "elapsed_time")
    return ds.sortby("elapsed_time")


def _select_scenarios(ds: xr.Dataset, names: Collection[str]) -> list[_Scenario]:
    """Split traces into scenarios with a colour each; refuse more than three."""
    sizes = {str(d): n for name in names for d, n in ds[name].sizes.items() if d != "elapsed_time"}
    if "volume" in sizes:
        sentence = f"the traces have {sizes['volume']} volumes: select one, such as ds.sel(volume=1)"
        raise InputError(sentence, "data", "shape")
    n = math.prod(sizes.values())
    if n > len(COLOURS):
        raise InputError(f"data has {n:,} scenarios: select up to {len(COLOURS)} with isel or sel", "data", "shape")
    scenarios = []
    for index, colour, style in zip(np.ndindex(*sizes.values()), COLOURS, LINE_STYLES, strict=False):
        label_indices = dict(zip(sizes, index, strict=True))
        words = ", ".join(label_in_words(ds, d, k) for d, k in label_indices.items() if sizes[d] > 1)
        scenarios.append(_Scenario(words, ds.isel(label_indices), colour, style))
    return scenarios


_TEMPERATURE_TRACES = ("T_sup", "T_room", "T_measured", "T_w_out", "T_w", "T_c", "T_a")
_VALVE_TRACES = ("command", "position", "opening", "u", "integral")
_SHARED_PANELS = {"temperature [°C]": _TEMPERATURE_TRACES, "valve [%]": _VALVE_TRACES}
_STEPPED_TRACES = ("command", "u", "integral", "estimate", "mode")  # they hold between two samples of the controller


@use_style()
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
    numpy.ndarray of matplotlib.axes.Axes
        One for each panel, from above.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more scenarios than three.
    """
    ds = _require_traces(data)
    with argument_checks() as check:
        names = check(_select_traces, ds, show)
        check.unless_none(require_instance, "boundary", boundary, Boundary, "give the Boundary that was simulated")
    scenarios = _select_scenarios(ds, names)
    set_points = [] if boundary is None else _set_point_curves(boundary, scenarios)
    panels = _group_by_panel(names)
    panel_axes = prepare_axes(ax, [1.9, *[1.3] * (len(panels) - 1)])
    for k, (axes, (label, panel_traces)) in enumerate(zip(panel_axes, panels.items(), strict=True)):
        _draw_traces(axes, scenarios, panel_traces, is_first=k == 0)
        for i, (x, values) in enumerate(set_points if panel_traces[0] in _TEMPERATURE_TRACES else []):
            axes.step(x, values, where="post", color="black", lw=0.9, ls="--", label="_" if i else "set-point")
        axes.set_ylabel(wrap_text(label, 1.2, 9))
        axes.margins(x=0.0)
        draw_legend_above(axes)
    _label_time_axis(panel_axes[-1], ds)
    return np.array(panel_axes)


def _select_traces(ds: xr.Dataset, show: Any) -> list[str]:
    """Return the names of the traces to draw: those of ``show``, or a default selection if it is None."""
    available = [n for n in TRACES if n in ds and "elapsed_time" in ds[n].dims]
    if show is None:
        default: list[str] = [n for n in ("T_sup", "command", "position", "opening", "estimate") if n in available]
        default = [n for n in default if n != "estimate" or bool((ds[n] > 0.0).any())]
        if ds[available[0]].size > ds.sizes["elapsed_time"]:  # several scenarios
            valve_traces = [n for n in default if n in _VALVE_TRACES]
            default = [n for n in default if n not in valve_traces[:-1]]
        return default or available
    names = require_names("show", show)
    with argument_checks() as check:
        for name in names:
            check(require_choice, "show", name, available)
    return names


def _group_by_panel(names: list[str]) -> dict[str, list[str]]:
    """Group traces by the label of their panel: those of the same scale share one."""
    panels: dict[str, list[str]] = {}
    for name in names:
        label = next((words for words, group in _SHARED_PANELS.items() if name in group), quantity(name).axis)
        panels.setdefault(label, []).append(name)
    return {quantity(group[0]).axis if len(group) == 1 else label: group for label, group in panels.items()}


def _draw_traces(axes: Axes, scenarios: list[_Scenario], names: list[str], *, is_first: bool) -> None:
    """Draw traces into a panel: scenarios differ in colour and traces in line style, or traces in colour if alone."""
    for scenario in scenarios:
        for k, name in enumerate(names):
            words = [scenario.words, quantity(name).text if len(names) > 1 or not scenario.words else ""]
            look: dict[str, Any] = {"color": COLOURS[k % 3]}
            if scenario.words:
                look = {"color": scenario.colour, "ls": LINE_STYLES[k % 3]}
            look["label"] = ", ".join(filter(None, words)) if is_first or len(names) > 1 else "_"
            look["drawstyle"] = "steps-post" if name in _STEPPED_TRACES else "default"
            axes.plot(scenario.times, quantity(name).factor * scenario.ds[name], lw=1.0, **look)


def _set_point_curves(boundary: Boundary, scenarios: list[_Scenario]) -> list[tuple[Array, Array]]:
    """Return times and set-points of each day whose traces are drawn; equal ones once."""
    curves: list[tuple[Array, Array]] = []
    for scenario in scenarios:
        ds = scenario.ds
        seconds = np.rint(ds["elapsed_time"].values).astype(np.int64)
        day = boundary.sel(int(ds["day"])) if boundary.has_day_dim and "day" in ds.coords else boundary
        if day.n_days > 1:
            sentence = f"boundary has {day.n_days} days and the traces do not say of which they are: select one"
            raise InputError(sentence, "boundary", "shape")
        has_days = not ds.attrs.keys() & {"command_sha256", "carry_over"}
        days = json.loads(ds.attrs.get("day_sha256", "{}")) if has_days else {}
        if seconds[-1] >= day.n_steps or (days and day.day_sha256[0] not in days):
            sentence = "boundary has another day than the traces: give the boundary that was simulated"
            raise InputError(sentence, "boundary", "conflict")
        values = day.of_day(0)["T_set"][seconds]
        if not any(np.array_equal(values, drawn_values) for _, drawn_values in curves):
            curves.append((scenario.times, values))
    return curves


def _label_time_axis(axes: Axes, ds: xr.Dataset) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    if "time" not in ds.coords:
        axes.set_xlabel("time from the start [h]")
        return
    zone = ds["time"].attrs.get("time_zone", "")
    axes.set_xlabel(f"date and time{f' ({zone})' if zone else ''}", loc="left")
    locator = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


@use_style()
def learning(data: Any, *, ax: Any = None) -> Any:
    """Draw the backlash estimate over time against the true backlash, up to three scenarios.

    A dot is where the estimate reached the backlash, a square where the learner confirmed it by stepping down.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with the trace ``estimate``.
    ax
        Axes to draw into; a new figure if left out.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
        (1,).

    Raises
    ------
    InputError
        With one sentence for each mistake; for more scenarios than three.
    """
    scenarios = _select_scenarios(_require_traces(data, "estimate"), ["estimate"])
    gaps = [100.0 * scenario.backlash for scenario in scenarios]
    (axes,) = prepare_axes(ax, [2.4])
    for scenario in scenarios:
        estimate = 100.0 * scenario.ds["estimate"]
        hours = estimate["elapsed_time"] / 3600.0
        words = scenario.words or "estimate"
        axes.plot(hours, estimate, drawstyle="steps-post", label=words, color=scenario.colour, ls=scenario.style)
        for name, marker in (("learn_time_reached", "o"), ("learn_time_confirmed", "s")):
            seconds = float(scenario.ds[name]) if name in scenario.ds and scenario.ds[name].ndim == 0 else math.nan
            if math.isfinite(seconds):
                y = float(estimate.sel(elapsed_time=seconds, method="nearest"))
                look: dict[str, Any] = {"color": scenario.colour, "mec": "black", "mew": 0.6, "ms": 5}
                axes.plot(seconds / 3600.0, y, marker, ls="none", **look)
    for k, gap in enumerate(dict.fromkeys(gaps)):
        axes.axhline(gap, color="black", lw=0.9, ls=":", label="_" if k else "true backlash")
    axes.set(xlabel="time from the start [h]", ylabel=quantity("estimate").axis)
    axes.margins(x=0.0)
    axes.set_ylim(bottom=0.0)
    draw_legend_above(axes)
    return np.array([axes])


_PREDICTED_VARIABLES = {
    "hunting_index": METRICS["hunts"], "hunts": METRICS["hunts"], "period": METRICS["hunting_period"],
    "amplitude": METRICS["hunting_swing"],
}  # fmt: skip
"""Variables of ``fc.limit_cycle``, and metrics that have their units."""


@use_style()
def limit_cycle(data: Any, predicted: xr.Dataset | None = None, *, ax: Any = None) -> Any:
    """Draw how a loop swings, and a prediction of it: the opening over the command in the last swings.

    The gap is the width of the parallelogram, between the dotted lines on which Eq (1) moves the stem.  The heading
    compares the swing with the one predicted.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with the traces ``command`` and ``opening``, up to three scenarios.
    predicted
        Result of ``fc.limit_cycle(loop, boundary)`` for the same sweep.
    ax
        Axes to draw into; a new figure if left out.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
        (1,).

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    ds = _require_traces(data, "command", "opening")
    if predicted is not None:
        cure = "give what fastcoil.limit_cycle(loop, boundary) returns"
        require_instance("predicted", predicted, xr.Dataset, cure)
        require_table_units(predicted, PARAMETERS, _PREDICTED_VARIABLES)
        missing_names = [name for name in _PREDICTED_VARIABLES if name not in predicted]
        if missing_names:
            raise InputError(f"predicted has no {', '.join(missing_names)}: {cure}", "predicted", "missing")
        require_distinct_labels(predicted, [d for d in predicted["hunting_index"].dims if d in predicted.coords])
        simulated, theory = (json.loads(each.attrs.get("parameters", "{}")) for each in (ds, predicted))
        for name, value in simulated.items():
            if value != theory.get(name, value):
                loops = f"predicted is of another loop, with {name} = {theory[name]}, in data {value}"
                raise InputError(f"{loops}: give that of the same loop", "predicted", "conflict")
    scenarios = _select_scenarios(ds, ("command", "opening"))
    lines = [": ".join(filter(None, [s.words, _describe_swings(s.ds, predicted)])) for s in scenarios]
    (axes,) = prepare_axes(ax, [3.0])
    axes.set(xlabel="command [%]", ylabel="opening [%]")
    if mark_if_empty(axes, ds["opening"]):
        return np.array([axes])
    openings = np.concatenate([_draw_swings(axes, scenario) for scenario in scenarios])
    low, high = float(np.nanmin(openings)), float(np.nanmax(openings))
    margin = max(0.15 * (high - low), 0.5)
    axes.set_ylim(low - margin, high + margin)
    if scenarios[0].words:
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    draw_caption(axes, "\n".join([*lines, "dotted: the edges of the gap"]))
    return np.array([axes])


def _draw_swings(axes: Axes, scenario: _Scenario) -> Array:
    """Draw opening over command in the last four periods, or the last hour, and the edges of the gap; return it [%]."""
    gap = scenario.backlash
    period = float(scenario.ds["hunting_period"]) if "hunting_period" in scenario.ds else math.nan
    start = float(scenario.ds["elapsed_time"][-1]) - (4 * period if math.isfinite(period) else 3600.0)
    last_swings = scenario.ds.sel(elapsed_time=slice(start, None))
    command, opening = 100.0 * last_swings["command"].values, 100.0 * last_swings["opening"].values
    axes.plot(command, opening, color=scenario.colour, ls=scenario.style, lw=1.2, label=scenario.words or "_only")
    command_range = np.array([command.min(), command.max()])
    for shift in {0.0, 100.0 * gap}:
        edge = np.clip((command_range - shift) / (1.0 - gap), 0.0, 100.0)
        axes.plot(command_range, edge, color="black", lw=0.7, ls=DOTTED_LINE, zorder=1)
    return opening


def _describe_swings(scenario: xr.Dataset, predicted: xr.Dataset | None) -> str:
    """Describe the simulated and the predicted swing of one scenario."""
    words = []
    if "hunting_swing" in scenario:
        words.append(f"simulated {_format_swing(float(scenario['hunting_swing']), float(scenario['hunting_period']))}")
    if predicted is not None:
        dims = predicted["hunting_index"].dims
        labels = {d: scenario[d].item() for d in dims if d in scenario.coords and scenario[d].ndim == 0}
        if len(labels) < len(dims) or any(label not in predicted[d] for d, label in labels.items()):
            sentence = f"predicted has other labels along {', '.join(map(str, dims))} than data"
            raise InputError(f"{sentence}: give that of the same sweep", "predicted", "shape")
        index, hunts, period, amplitude = (float(predicted[name].sel(labels)) for name in _PREDICTED_VARIABLES)
        swing_text = _format_swing(2.0 * amplitude, period) if hunts > 0.0 else "no swing"
        words.append(f"predicted {swing_text} (hunting index {index:.2g})")
    return ", ".join(words)


def _format_swing(peak_to_peak: float, period: float) -> str:
    return f"± {0.5 * peak_to_peak:.2g} K" + (f" every {period:.0f} s" if math.isfinite(period) else "")
