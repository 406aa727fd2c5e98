"""The result of a diagnosis: backlash, cause, indices, predictions; its words, its TOML and its page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, DOTTED, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.base.results import Result, as_toml, in_toml
from fastcoil.measured.cause import BACKLASH, DISTURBANCE, NONE, TUNING, WORDS
from fastcoil.measured.grid import openings
from fastcoil.measured.identify import GOOD

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
    """Diagnosis of a loop and its valve from a trend log.

    Attributes
    ----------
    source
        Name of the log.
    backlash, interval
        Most probable backlash and its 95 % interval, fractions of stroke; NaN and everything where the log was not fit
        to compare any.
    identified, reason
        Whether the backlash is right, to 20 % of itself or 1 % of the stroke, with 95 % probability; why not, and what
        to do to find out, else empty.
    cause, because
        Why the loop hunts: ``none`` (it does not), ``backlash`` (without the gap it would not), ``tuning`` (it would
        even with a perfect valve), ``disturbance`` (something outside the loop swings), ``unknown``; and a sentence.
    hunts
        Whether the log shows a swing that comes back regularly.
    profile
        Dataset over ``backlash``: the ``probability`` of each size.
    indices
        Dataset of single numbers with units: errors, the swing, Thornhill's regularity, Hägglund's oscillation index
        and backlash, the normalised Harris index, travel and turns of the motor; gain, integral time and sample time of
        the controller, gain of the plant and margin, where the loop could be modelled.
    predictions
        Dataset over ``case`` (``as_found``, ``no_gap``, ``half_gap``, ``half_gain``, ``inverse``): what the fitted loop
        does on this log's day; NaN where that cannot be predicted, with the ``doubt``.  None where there is no model.
    signals
        Dataset over ``elapsed_time``: the log at equal intervals, as it was used.
    notes
        What was left out of the log, what was assumed, and what could not be computed.
    """

    source: str
    backlash: float
    interval: tuple[float, float]
    identified: bool
    reason: str
    cause: str
    because: str
    hunts: bool
    profile: xr.Dataset
    indices: xr.Dataset
    predictions: xr.Dataset | None
    signals: xr.Dataset
    notes: list[str]

    def summary(self) -> list[str]:
        """The diagnosis in words, line by line."""
        hours = self.signals.attrs["hours"]
        lines = [f"{self.source}: {hours:.1f} h, a sample every {self.signals.attrs['interval']:g} s"]
        lines += [_gap(self), _hunting(self), *_cures(self), *_either(self)]
        return lines + [f"Note: {note}" for note in self.notes]

    def plot(self) -> Figure:
        """The diagnosis on one page, as a matplotlib ``Figure``."""
        return page(self)

    def to_toml(self, path: str | Path | None = None) -> str:
        """The backlash as TOML, written to ``path`` if one is given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` has the backlash if it is identified, and nothing else; ``[fit]`` is for readers.
        """
        lines = [f"# backlash fitted to {self.source} by fastcoil diagnose"]
        lines += [f"# {line}" for line in self.summary()[1:]]
        lines += ["", "[loop]"] + ([f"backlash = {self.backlash!r}"] if self.identified else [])
        lines += ["", "[fit]", 'kind = "diagnosis"', f"source = {in_toml(self.source)}"]
        lines += [f"identified = {in_toml(self.identified)}", f"reason = {in_toml(self.reason)}"]
        lines += [f"cause = {in_toml(self.cause)}", f"because = {in_toml(self.because)}"]
        lines += [f"notes = {in_toml(list(self.notes))}"]
        low, high = self.interval
        lines += ["", "[fit.interval_95]", f"backlash = {in_toml([low, high])}"]
        lines += ["", "[fit.indices]"] + [f"{name} = {in_toml(float(value))}" for name, value in self.indices.items()]
        if self.predictions is not None:
            for case in self.predictions["case"].values:
                one = self.predictions.sel(case=case)
                lines += ["", f"[fit.predictions.{case}]", f"doubt = {in_toml(str(one['doubt'].values))}"]
                numbers = one.drop_vars("doubt").data_vars.items()
                lines += [f"{name} = {in_toml(float(value))}" for name, value in numbers]
        return as_toml(lines, path)


_POSSIBLE = ("half_gain", "no_gap", "half_gap", "inverse")
"""Cures; without a known gap only the first."""


def _gap(d: Diagnosis) -> str:
    low, high = (100 * bound for bound in d.interval)
    if d.identified and d.backlash <= GOOD:
        return f"Gap: none to speak of, {100 * d.backlash:.3g} % of the stroke (95 %: {low:.3g} to {high:.3g} %)"
    if d.identified:
        return f"Gap: {100 * d.backlash:.3g} % of the stroke (95 %: {low:.3g} to {high:.3g} %)"
    if np.isnan(d.backlash):
        return f"Gap: cannot tell: {d.reason}"
    return f"Gap: cannot tell; most probable {100 * d.backlash:.3g} % (95 %: {low:.3g} to {high:.3g} %): {d.reason}"


def _hunting(d: Diagnosis) -> str:
    """Whether the loop hunts, and why."""
    size, period = float(d.indices["peak_to_peak"]) / 2, float(d.indices["period"])
    if d.cause == NONE:
        error = float(d.indices["error_rms_settled"])
        held = f": its error is {error:.2g} K (RMS, settled)" if np.isfinite(error) else ""
        return f"Hunting: none{held}"
    if not d.hunts:
        return f"Hunting: cannot tell: {d.because}"
    swings = f"Hunting: ± {size:.2g} K every {_duration(period)}"
    # of the three, the gap is blamed wrongly most often: see the table diagnosis_answers
    blamed = {
        BACKLASH: "probably because of the gap",
        TUNING: "because of the tuning",
        DISTURBANCE: "because of a disturbance",
    }
    return f"{swings}, {blamed[d.cause]}: {d.because}" if d.cause in blamed else f"{swings}; {d.because}"


def _cures(d: Diagnosis) -> list[str]:
    """What the fitted loop would do with another valve, tuning or controller."""
    if d.predictions is None:
        return []
    found = d.predictions.sel(case="as_found")
    cases = [("as_found", "As found"), ("half_gain", "With half the gain")]
    if d.identified and d.backlash > GOOD:
        cases += [
            ("no_gap", "Without the gap"),
            ("half_gap", "With half the gap"),
            ("inverse", "With a backlash inverse"),
        ]
    return [f"{words}: {_case_in_words(d.predictions.sel(case=case), found)}" for case, words in cases]


def _either(d: Diagnosis) -> list[str]:
    """What would stop the hunting, best first."""
    if d.predictions is None or not float(d.predictions["hunts"].sel(case="as_found")):
        return []
    calm = d.predictions.where(d.predictions["hunts"] == 0.0, drop=True).sortby("rmse")
    possible = _POSSIBLE if d.identified and d.backlash > GOOD else _POSSIBLE[:1]
    cures = [WORDS[case] for case in calm["case"].values if case in possible]
    return [f"What would stop the hunting: {', or '.join(cures)}"] if cures else []


def _case_in_words(one: xr.Dataset, found: xr.Dataset) -> str:
    """One case in words."""
    if str(one["doubt"].values):
        return f"cannot tell: {one['doubt'].values}"
    stands = ", no hunting" if float(found["hunts"]) > float(one["hunts"]) else ""
    return (
        f"error {float(one['rmse']):.2g} K, motor {float(one['travel_per_day']):.0f} strokes a day, stem turns "
        f"{float(one['reversals_per_day']):.0f} times a day{stands}"
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


_TELLING = 7200.0
"""Seconds that are drawn."""
_SIZE = (7.5, 9.0)
_ROOM = 160.0
"""Per cent of the longest bar, for the words behind it."""
_ABOVE: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "borderaxespad": 0.2}
_TABLE = (
    ("error_rms", "error, RMS", "K"),
    ("error_rms_settled", "error, settled", "K"),
    ("peak_to_peak", "swing, peak to peak", "K"),
    ("period", "period", "s"),
    ("regularity", "regularity (Thornhill)", ""),
    ("oscillation", "oscillation (Hägglund)", ""),
    ("harris", "Harris index, normalised", ""),
    ("hagglund_backlash", "backlash (Hägglund)", "%"),
    ("motor_travel", "motor, strokes a day", ""),
    ("reversals", "motor, turns a day", ""),
    ("kp", "controller gain", "1/K"),
    ("ti", "integral time", "s"),
    ("margin", "margin (hunts above 0.8)", ""),
)


@apply_style()
def page(d: Diagnosis) -> Figure:
    """The diagnosis as a page."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=_SIZE, layout="constrained")
    grid = fig.add_gridspec(4, 2, height_ratios=(1.0, 0.8, 1.25, 1.35))
    temperature = fig.add_subplot(grid[0, :])
    command = fig.add_subplot(grid[1, :], sharex=temperature)
    seen = d.signals.isel(elapsed_time=telling(d.signals))
    _temperature(temperature, seen)
    _command(command, seen)
    _opening(fig.add_subplot(grid[2, 0]), d, seen)
    _profile(fig.add_subplot(grid[2, 1]), d)
    _predictions(fig.add_subplot(grid[3, 0]), d)
    _indices(fig.add_subplot(grid[3, 1]), d)
    headline = d.summary()[:3]
    fig.suptitle("\n".join(wrapped(line, _SIZE[0], 9) for line in headline), x=0.01, ha="left", fontsize=9)
    return fig


def telling(signals: xr.Dataset) -> slice:
    """The two hours in which the motor travels most while nothing is missing: settled, where the loop ever is."""
    interval, n = signals.attrs["interval"], signals.sizes["elapsed_time"]
    width = min(n, max(2, round(_TELLING / interval)))
    moves = np.abs(np.diff(signals["position"].values, prepend=signals["position"].values[0]))
    there = np.isfinite(signals["T_sup"].values) & np.isfinite(signals["command"].values)
    calm = signals["calm"].values
    moves = np.where(calm, moves, 0.0) if calm.any() else moves
    worth = np.cumsum(np.concatenate([[0.0], np.where(there, moves, 0.0)]))
    seen = np.cumsum(np.concatenate([[0.0], there]))
    score = (worth[width:] - worth[:-width]) * ((seen[width:] - seen[:-width]) / width) ** 4
    start = int(np.argmax(score))
    return slice(start, start + width)


def _hours(seen: xr.Dataset) -> Array:
    return np.asarray(seen["elapsed_time"].values / 3600.0)


def _temperature(axes: Axes, seen: xr.Dataset) -> None:
    axes.plot(_hours(seen), seen["T_sup"], color=BLUE, lw=1.0, label="supply air")
    if "T_set" in seen:
        axes.step(_hours(seen), seen["T_set"], color=YELLOW, ls="--", where="post", label="set-point")
    axes.set_ylabel("temperature [°C]")
    axes.tick_params(labelbottom=False)
    axes.set_title("Two telling hours", loc="left")
    axes.legend(ncols=2, **_ABOVE)


def _command(axes: Axes, seen: xr.Dataset) -> None:
    axes.step(_hours(seen), 100 * seen["command"], color=RED, lw=1.0, where="post", label="command")
    axes.set(xlabel="time [h]", ylabel="command [%]")
    axes.margins(x=0.01)


def _opening(axes: Axes, d: Diagnosis, seen: xr.Dataset) -> None:
    """The opening behind the motor with the most probable gap: the wider the loop, the larger the gap."""
    axes.set(xlabel="motor position [%]", ylabel="opening [%]")
    axes.set_title("Valve behind the motor, modelled", loc="left")
    if not np.isfinite(d.backlash):
        _says(axes, "no size could be compared")
        return
    position = seen["position"].values
    opening = openings(position, np.array([d.backlash]))[:, 0]
    look = BLUE if d.identified else GREY
    axes.plot(100 * position, 100 * opening, color=look, lw=0.9)
    ends = np.array([position.min(), position.max()])
    alpha = 1.0 / (1.0 - d.backlash)
    for shift in (0.0, d.backlash):
        axes.plot(100 * ends, 100 * alpha * (ends - shift), color="black", lw=0.8, ls=DOTTED)
    low, high = 100 * opening.min(), 100 * opening.max()
    axes.set_ylim(low - 0.1 * (high - low) - 0.5, high + 0.1 * (high - low) + 0.5)


def _profile(axes: Axes, d: Diagnosis) -> None:
    sizes, probability = 100 * d.profile["backlash"].values, 100 * d.profile["probability"].values
    low, high = d.interval
    axes.axvspan(100 * low, 100 * high, color=FAINT, lw=0, label="95 % interval")
    axes.bar(sizes, probability, width=0.8 * (sizes[1] - sizes[0]), color=BLUE if d.identified else GREY)
    axes.set(xlabel="backlash [% of stroke]", ylabel="probability [%]")
    axes.set_xlim(-0.5, max(100 * high, 8.0) * 1.15)
    axes.set_title("Identified" if d.identified else "Not identified", loc="left")
    axes.legend(**_ABOVE)


def _predictions(axes: Axes, d: Diagnosis) -> None:
    """Error and travel in every case, as shares of what the model does as found."""
    axes.set_title("What the fitted loop would do", loc="left")
    if d.predictions is None:
        _says(axes, "no prediction: see the notes")
        return
    found = d.predictions
    cases = list(found["case"].values)
    places = np.arange(len(cases))[::-1]
    error, travel = found["rmse"].values, found["travel_per_day"].values
    for values, shift, colour, form in ((error, 0.2, BLUE, "{:.2g} K"), (travel, -0.2, YELLOW, "{:.0f} strokes a day")):
        share = np.nan_to_num(100 * values / values[0])
        axes.barh(places + shift, share, height=0.38, color=colour)
        for place, value, end in zip(places + shift, values, share, strict=True):
            if np.isfinite(value):
                axes.text(end + 2, place, form.format(value), va="center", fontsize=7)
    for place in places[~np.isfinite(error)]:
        axes.text(2, place, "cannot tell", va="center", fontsize=7)
    axes.set_xlim(0, _ROOM * np.nanmax(np.concatenate([error / error[0], travel / travel[0]])))
    axes.axvline(100, color="black", lw=0.8, ls=DOTTED)
    hunting = found["hunts"].values > 0
    axes.set_yticks(places, [WORDS[c] + "\n(hunts)" * bool(h) for c, h in zip(cases, hunting, strict=True)])
    axes.set_xlabel("RMS error and motor travel, as found = 100 %")
    axes.grid(visible=False, axis="y")


def _indices(axes: Axes, d: Diagnosis) -> None:
    axes.axis("off")
    axes.set_title("Indices", loc="left")
    cells = []
    for name, words, unit in _TABLE:
        value = float(d.indices[name]) * (100 if unit == "%" else 1)
        cells.append([words, f"{value:.3g} {unit}".rstrip() if np.isfinite(value) else "–"])
    table = axes.table(cells, colWidths=(0.68, 0.32), loc="upper left", cellLoc="left", edges="horizontal")
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for cell in table.get_celld().values():
        cell.set_linewidth(0.3)
        cell.set_height(1.0 / len(cells))


def _says(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=8)
    axes.set(xticks=[], yticks=[])


def scalars(values: Mapping[str, tuple[float, str, str]]) -> xr.Dataset:
    """Single numbers by name, with unit and meaning, as a Dataset."""
    return xr.Dataset(
        {name: ((), value, {"units": unit, "long_name": meaning}) for name, (value, unit, meaning) in values.items()}
    )
