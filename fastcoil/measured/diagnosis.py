"""Results of a diagnosis and of a valve test: backlash, cause, predictions, as text, TOML and pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.figures import BLUE, DOTTED_LINE, LINE_GREY, RED, SHADE_GREY, YELLOW, apply_style, wrap_text
from fastcoil.base.results import Result, toml_document, toml_table
from fastcoil.base.text import align_columns, format_kelvin, format_percent
from fastcoil.design.advice import AS_IS, INVERSE, INVERSE_SHARE, REPAIRED_VALVE, SIMC, Option, advise
from fastcoil.design.swing_verdict import SwingVerdict
from fastcoil.measured.cause import CASE_LABELS, CAUSE_BACKLASH, CAUSE_DISTURBANCE, CAUSE_NONE, CAUSE_TUNING
from fastcoil.measured.identify import CANDIDATES, GOOD_BACKLASH, Identification
from fastcoil.measured.swings import TI_PER_PERIOD, describe_period, judge_gains
from fastcoil.measured.triage import LEAST_HOURLY_SWING_K, STATES, write_headline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INDICES = {
    "error_rms": ("K", "RMS control error"),
    "error_rms_settled": ("K", "RMS control error, settled and in control"),
    "peak_to_peak": ("K", "swing of the supply temperature, peak to peak"),
    "block_swing": ("K", "median swing of the supply temperature in 20 min, regular or not"),
    "period": ("s", "period of the swing"),
    "regularity": ("1", "regularity of the swing after Thornhill: regular above 1"),
    "periodic_share": ("1", "share of the variance that comes back after a period"),
    "command_swing": ("1", "median swing of the command in a period, peak to peak"),
    "motor_travel": ("d-1", "strokes of the motor per day"),
    "reversals": ("d-1", "reversals of the motor per day"),
    "kp": ("K-1", "gain of the controller"),
    "ti": ("s", "integral time of the controller"),
    "sample_time": ("s", "time between samples of the controller"),
    "plant_gain": ("K", "change of the temperature over the stroke"),
}
"""Unit and meaning of each index of a diagnosis."""


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
    is_own
        Whether the loop makes its swings in 20 min itself, 0 or 1, judged by m_a, T_a_in and T_w_in; NaN without them.
    profile
        Dataset over ``backlash``: the ``probability`` of each size.
    indices
        Dataset of single numbers with units: errors, the swing, Thornhill's regularity, travel and reversals of the
        motor; gain, integral time and sample time of the controller, gain of the plant, where the loop could be
        modelled.
    predictions
        Dataset over ``case`` (``as_found``, ``no_gap``, ``half_gap``, ``half_gain``, ``simc``, ``inverse``): kp and ti,
        and what the fitted loop does on this log's day; NaN where that cannot be predicted, with the ``doubt``.  None
        where there is no model.
    signals
        Dataset over ``elapsed_time``: the log at equal intervals, as it was used.
    triage, warnings
        Dataset over ``hour``: ``state`` in a word, shares of the hour (``enabled``, ``in_control``, ``saturated``,
        ``not_responding``), ``error`` and ``swing`` (peak to peak, K), ``period`` (s), and in ``log_limits`` what the
        log of that hour cannot show; and a sentence on each fault that lasts, the worst first.
    advice
        What to do: ``kp``, 1/K, and ``ti``, s, to set, NaN where the log does not show any, and ``reason``, a sentence.
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
    is_own: float
    profile: xr.Dataset
    indices: xr.Dataset
    predictions: xr.Dataset | None
    signals: xr.Dataset
    triage: xr.Dataset
    warnings: list[str]
    notes: list[str]

    def summary(self) -> list[str]:
        """Return the diagnosis as lines of text."""
        return [*self.findings, *_tabulate_predictions(self), *(f"Note: {note}" for note in self.notes)]

    @property
    def findings(self) -> list[str]:
        """Sentences on the log: its hours, controller and gap, what to do, whether the loop hunts and why."""
        attrs = self.signals.attrs
        kp, ti, every = (float(self.indices[name]) for name in ("kp", "ti", "sample_time"))
        controller = "" if np.isnan(kp) else f"Controller: kp {kp:.3g} 1/K, ti {ti:.3g} s, a sample every {every:.3g} s"
        answers = [self.headline, controller, self.advice.reason, _describe_gap(self), _describe_hunting(self)]
        lines = [f"{self.source}: {attrs['hours']:.1f} h, a sample every {attrs['interval']:.4g} s"]
        lines += filter(None, answers)
        sticking = "Gap or sticking: a stem that sticks and then jumps looks the same in this log"
        return [*lines, sticking] if self.identified and self.backlash > GOOD_BACKLASH else lines

    @property
    def headline(self) -> str:
        """The most important finding of the log, and what to log again, in one or two sentences."""
        return write_headline(self.triage)

    @property
    def verdict(self) -> SwingVerdict:
        """Swing of the temperature, and whose it is; noise and load make irregular ones of up to 1 K."""
        swing = float(self.indices["peak_to_peak" if self.hunts else "block_swing"])
        is_swinging = self.hunts or swing >= LEAST_HOURLY_SWING_K
        is_blamed = self.hunts and self.cause in (CAUSE_BACKLASH, CAUSE_TUNING)
        is_own = is_swinging and self.cause != CAUSE_DISTURBANCE and (is_blamed or self.is_own != 0.0)
        period = float(self.indices["period"]) if self.hunts else math.nan
        return SwingVerdict(is_own, self.hunts, swing, period, movers=("air", "water") if is_swinging else ())

    @property
    def advice(self) -> GainAdvice:
        """Advice by the rule of ``fc.explain``; the reason is empty where the log shows nothing to do."""
        kp, ti = float(self.indices["kp"]), float(self.indices["ti"])
        by_period = self._advise_by_period(kp, ti)
        if self.cause == CAUSE_DISTURBANCE:
            return GainAdvice(kp, ti, "Leave the gains: the swing comes from outside the loop.")
        if self.predictions is None:
            return by_period if self.hunts else GainAdvice(kp, ti, "")
        cases = {"as_found": (AS_IS, "present gains"), "simc": (SIMC, _describe_simc_gains(self.predictions))}
        if self.identified and self.backlash > GOOD_BACKLASH:
            cases["inverse"] = (INVERSE, f"inverse of {format_percent(INVERSE_SHARE * self.backlash)}")
            cases["no_gap"] = (REPAIRED_VALVE, "repair")
        options = []
        for case, (name, label) in cases.items():
            prediction = self.predictions.sel(case=case)
            hunts = self.hunts if case == "as_found" else bool(prediction["hunts"] > 0.0)
            options.append(Option(name, label, float(prediction["rmse"]), float(prediction["travel_per_day"]), hunts))
        advice = advise(options)
        if self.hunts and not advice.best:
            return by_period
        case = list(cases)[advice.best]
        kp, ti = (float(self.predictions[name].sel(case=case)) for name in ("kp", "ti"))
        return GainAdvice(kp, ti, advice.text)

    def _advise_by_period(self, kp: float, ti: float) -> GainAdvice:
        """Advise gains of a loop that hunts and cannot be predicted, by the period of its swing."""
        period = float(self.indices["period"])
        if np.isfinite(kp * ti * period):
            fault = judge_gains(kp, ti, period)
            return GainAdvice(fault.kp, fault.ti, f"Do this: {fault.action}.")
        least_ti = float(f"{TI_PER_PERIOD * period:.2g}")
        cure = f"Do this: raise Ti to {least_ti:.0f} s, a quarter of the period; if it is longer already, halve kp."
        return GainAdvice(math.nan, math.nan, cure)

    @apply_style()
    def plot(self) -> Figure:
        """Plot the diagnosis on one page."""
        from matplotlib.figure import Figure

        fig = Figure(figsize=(_PAGE_WIDTH_INCHES, 7.6), layout="constrained")
        grid = fig.add_gridspec(4, 2, height_ratios=(0.2, 1.0, 0.8, 1.3))
        _draw_hours(fig.add_subplot(grid[0, :]), self.triage)
        temperature = fig.add_subplot(grid[1, :])
        excerpt = self.signals.isel(elapsed_time=_find_busiest_hours(self.signals))
        _draw_excerpt(temperature, fig.add_subplot(grid[2, :], sharex=temperature), excerpt)
        _draw_profile(fig.add_subplot(grid[3, 0]), self)
        _draw_predictions(fig.add_subplot(grid[3, 1]), self)
        _set_page_title(fig, [*self.summary()[:2], _describe_gap(self), _describe_hunting(self), self.advice.reason])
        return fig

    def to_toml(self, path: str | Path | None = None) -> str:
        """Return what was found as TOML; write it to ``path`` if given.

        For ``include`` in the ``[loop]`` of a study file: ``[loop]`` has the backlash if it is identified, gains and
        sample time if the controller was recovered, and the stroke time that was given; ``[fit]`` is for readers.  A
        study that includes a file without a backlash has to give its own.
        """
        lines = toml_table("fit.indices", {str(name): float(value) for name, value in self.indices.items()})
        if self.predictions is not None:
            for case in self.predictions["case"].values:
                prediction = self.predictions.sel(case=case)
                numbers = {str(name): float(value) for name, value in prediction.drop_vars("doubt").items()}
                lines += toml_table(f"fit.predictions.{case}", {"doubt": str(prediction["doubt"].values), **numbers})
        found = {name: float(f"{float(self.indices[name]):.4g}") for name in ("kp", "ti", "sample_time")}
        found["sample_time"] = np.round(found["sample_time"])  # a loop samples in whole seconds
        found["stroke_time"] = self.signals.attrs.get("stroke_time", math.nan)
        parameters = {name: float(value) for name, value in found.items() if np.isfinite(value)}
        return _gap_as_toml(self, "diagnose", "diagnosis", parameters, {}, lines, path)


@dataclass(frozen=True, repr=False)
class ValveReading(Result):
    """What a valve test shows of its valve and loop.

    Attributes
    ----------
    source
        Name of the log.
    backlash, interval
        Most probable backlash and its 95 % interval, fractions of stroke.
    identified, reason
        Whether the backlash is right, to 20 % of itself or 1 % of the stroke, with 95 % probability; why not, and what
        to do, else empty.
    gain, lag, dead_time
        Change of the temperature per stroke of the stem where the test was made, K, sum of the lags and dead time, s,
        of the most probable model.
    held_swing, held_for
        Highest less lowest temperature in the second half of the hold at the start of the test, K; that half, s.
    cause, because
        Why the loop hunted before the test, as in a ``Diagnosis``, and a sentence; ``unknown`` where less than an hour
        before the test is logged.
    explained
        Share of the variance of the temperature that the command explains.
    minutes
        How long the test took.
    profile
        Dataset over ``backlash``: the ``probability`` of each size.
    signals
        Dataset over ``elapsed_time``, from ten minutes before the test to ten after it: ``T_sup``, ``command``,
        ``stem`` (its place behind the most probable gap), ``model`` (temperature without drift) and ``test``.
    notes
        How the log was read, and what was assumed.
    """

    source: str
    backlash: float
    interval: tuple[float, float]
    identified: bool
    reason: str
    gain: float
    lag: float
    dead_time: float
    held_swing: float
    held_for: float
    cause: str
    because: str
    explained: float
    minutes: float
    profile: xr.Dataset
    signals: xr.Dataset
    notes: list[str]

    def summary(self) -> list[str]:
        """Return the reading as lines of text."""
        plant = f"Plant: {self.gain:.3g} K per stroke, lags of {self.lag:.0f} s, dead time {self.dead_time:.0f} s"
        hold = f"; the temperature moved by {self.held_swing:.2g} K while the command was held"
        plant += hold * bool(np.isfinite(self.held_swing))
        cause = f"Cause of the swing before the test: {self.cause}: {self.because}"
        head = f"{self.source}: a valve test of {self.minutes:.0f} min"
        return [head, _describe_gap(self), plant, cause, *(f"Note: {note}" for note in self.notes)]

    @apply_style()
    def plot(self) -> Figure:
        """Plot the reading on one page."""
        from matplotlib.figure import Figure

        ds = self.signals
        fig = Figure(figsize=(_PAGE_WIDTH_INCHES, 6.4), layout="constrained")
        upper, middle, lower = fig.subplots(3, 1, height_ratios=(1.2, 1.0, 1.0))
        minutes = (ds["elapsed_time"] - ds["elapsed_time"].values[ds["test"].values > 0][0]) / 60.0
        upper.plot(minutes, ds["T_sup"], color=BLUE, lw=1.0, label="supply air")
        upper.plot(minutes, ds["model"], color=YELLOW, lw=1.0, label="model, without drift")
        middle.plot(minutes, 100 * ds["command"], color=RED, lw=1.0, label="command")
        middle.plot(minutes, 100 * ds["stem"], color=LINE_GREY, lw=1.0, label="stem behind the gap")
        for axes in (upper, middle):
            axes.axvspan(0.0, self.minutes, color=SHADE_GREY, lw=0)
            axes.legend(ncols=2, **_LEGEND_ABOVE)
            axes.margins(x=0.01)
        upper.set(ylabel="temperature [°C]")
        upper.tick_params(labelbottom=False)
        middle.set(xlabel="minutes from the start of the test", ylabel="of the stroke [%]")
        _draw_profile(lower, self)
        _set_page_title(fig, [line for line in self.summary() if not line.startswith("Note: ")])
        return fig

    def to_toml(self, path: str | Path | None = None) -> str:
        """Return the backlash as TOML; write it to ``path`` if given.

        For ``include`` in the ``[loop]`` of a study file: ``[loop]`` has the backlash if it is identified, and nothing
        else; ``[fit]`` is for readers.
        """
        names = ("gain", "lag", "dead_time", "held_swing", "held_for", "minutes")
        numbers = {name: getattr(self, name) for name in names}
        return _gap_as_toml(self, "valve-test", "valve test", {}, numbers, [], path)


class GainAdvice(NamedTuple):
    """Advice on the gains of a loop."""

    kp: float  # gain to set, 1/K: that of now where it may stay, NaN where the log shows none
    ti: float  # integral time to set, s, likewise
    reason: str  # what to do and what it brings, in a sentence


def probability_profile(identification: Identification) -> xr.Dataset:
    """Return a Dataset with the probability of each candidate size of the backlash."""
    sizes = ("backlash", CANDIDATES, {"units": "1", "long_name": "backlash, fraction of stroke"})
    probability = ("backlash", identification.probability, {"long_name": "probability of each size"})
    return xr.Dataset({"probability": probability}, {"backlash": sizes})


def _gap_as_toml(
    result: Any, command: str, kind: str, parameters: Mapping[str, float], numbers: Mapping[str, float],
    extra_tables: Sequence[str], path: str | Path | None,
) -> str:  # fmt: skip
    """Write the gap, if identified, and other parameters as TOML for ``include``.

    numbers: for readers.  extra_tables: lines at the end.
    """
    texts = {name: getattr(result, name) for name in ("source", "identified", "reason", "cause", "because")}
    lines = [f"# backlash fitted to {result.source} by fastcoil {command}"]
    lines += [f"# {line}" for line in result.summary()[1:]]
    gap: dict[str, float] = {"backlash": result.backlash} if result.identified else {}
    lines += toml_table("loop", {**gap, **parameters})
    lines += toml_table("fit", {"kind": kind, **texts, **numbers, "notes": result.notes})
    lines += toml_table("fit.interval_95", {"backlash": list(result.interval)})
    return toml_document([*lines, *extra_tables], path)


def _describe_gap(result: Any) -> str:
    """Describe the gap and its interval, or why it is not identified; of a diagnosis or a reading of a test."""
    low, high = (100 * bound for bound in result.interval)
    size = f"{100 * result.backlash:.3g} % of the stroke (95 %: {low:.3g} to {high:.3g} %)"
    if result.identified:
        return f"Gap: negligible, {size}" if result.backlash <= GOOD_BACKLASH else f"Gap: {size}"
    is_blank = np.isnan(result.backlash) or high - low > _UNTOLD_INTERVAL  # such a size says nothing
    most_probable = "" if is_blank else f"; most probable {size.replace(' of the stroke', '')}"
    return f"Gap: not identified{most_probable}: {result.reason}"


def _describe_hunting(diagnosis: Diagnosis) -> str:
    """Describe size, period and cause of the swing, and whose it is, or why that is unknown."""
    cause, because, verdict = diagnosis.cause, diagnosis.because, diagnosis.verdict
    answer = f"This loop {verdict.clause}"
    if not verdict.is_own:
        if at_times := _describe_hunting_at_times(diagnosis):
            return at_times
        is_moved = cause == CAUSE_DISTURBANCE
        if reason := f"T_sup swings {verdict.size}: {because}." if is_moved else verdict.reason:
            return f"{answer}.  {reason}"
        error = float(diagnosis.indices["error_rms_settled"])
        if cause == CAUSE_NONE:
            return f"{answer}{f'; the settled RMS error is {format_kelvin(error)}' * bool(np.isfinite(error))}."
        return f"Whether this loop hunts is not clear: {because}."
    if not diagnosis.hunts:
        makes = "It makes the swing itself: air and water move too little"
        unknown = "The log does not show whose swing it is: log m_a, T_a_in and T_w_in as well"
        return f"{answer}.  {makes if diagnosis.is_own > 0.0 else unknown}."
    hourly_swings = diagnosis.triage["swing"].values[diagnosis.triage["state"].values == "swinging"]
    if hourly_swings.size and np.median(hourly_swings) > 1.3 * verdict.swing:
        answer += " on average over the log"
    # both are blamed wrongly in more than a tenth of the logs: see the table diagnosis_answers
    blame = {CAUSE_BACKLASH: ", probably caused by the gap:", CAUSE_TUNING: ", probably caused by the tuning:"}
    return f"{answer}{blame.get(cause, ';')} {because}."


def _describe_hunting_at_times(diagnosis: Diagnosis) -> str:
    """Describe a swing that the valve makes on a part of the log only; blank without one."""
    hours = diagnosis.triage.isel(hour=diagnosis.triage["state"].values == "swinging")
    times = diagnosis.triage.attrs["swing_times"]
    if not times or not hours["hour"].size or diagnosis.is_own == 0.0 or diagnosis.cause == CAUSE_DISTURBANCE:
        return ""
    swing, period = (float(hours[name].median()) for name in ("swing", "period"))
    return f"This loop hunts at times: ± {swing / 2:.2g} K every {describe_period(period)}, {times}."


def _tabulate_predictions(diagnosis: Diagnosis) -> list[str]:
    """Tabulate what the fitted loop would do with other gains, another valve or an inverse."""
    if diagnosis.predictions is None:
        return []
    labels = {"as_found": "Now", "simc": f"With {_describe_simc_gains(diagnosis.predictions)}"}
    if diagnosis.identified and diagnosis.backlash > GOOD_BACKLASH:
        labels |= {"no_gap": "Without the gap", "half_gap": "With half the gap", "inverse": "With a backlash inverse"}
    rows, doubts = [("Predicted for a day:", "error", "motor", "stem", "")], []
    for case, label in labels.items():
        prediction = diagnosis.predictions.sel(case=case)
        if doubt := str(prediction["doubt"].values):
            doubts.append(f"{label}: not predicted: {doubt}")
            continue
        error, travel, reversals = (float(prediction[n]) for n in ("rmse", "travel_per_day", "reversals_per_day"))
        numbers = (f"{error:.2g} K", f"{travel:.0f} strokes", f"{reversals:.0f} reversals")
        rows.append((f"{label}:", *numbers, "hunts" * bool(prediction["hunts"] > 0.0)))
    return [*(align_columns(rows, right=(1, 2, 3)) if len(rows) > 1 else []), *doubts]


def _describe_simc_gains(predictions: xr.Dataset) -> str:
    kp, ti = (float(predictions[name].sel(case="simc")) for name in ("kp", "ti"))
    return f"kp {kp:g} 1/K, ti {ti:g} s"


_UNTOLD_INTERVAL = 20.0  # % of the stroke
_PAGE_WIDTH_INCHES = 7.5
_STATE_SHADES = (SHADE_GREY, "#997700", "#882255", RED, "#EE99AA", YELLOW, "0.45", "0.75", "#EECC66", "#6699CC", BLUE)
_STATE_COLOURS = dict(zip(STATES, _STATE_SHADES, strict=True))
_LEGEND_ABOVE: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "borderaxespad": 0.2}


def _find_busiest_hours(signals: xr.Dataset) -> slice:
    """Find the two hours with the most travel of the motor, settled if the loop ever is."""
    is_calm, is_known = signals["calm"].values, np.isfinite(signals["T_sup"].values + signals["command"].values)
    moves = np.abs(np.diff(signals["position"].values, prepend=signals["position"].values[0]))
    counted_moves = np.where(is_known & (is_calm if is_calm.any() else is_known), moves, 0.0)
    width = min(counted_moves.size, max(2, round(7200.0 / signals.attrs["interval"])))
    travel = np.cumsum(np.concatenate([[0.0], counted_moves]))
    start = int(np.argmax(travel[width:] - travel[:-width]))
    return slice(start, start + width)


def _set_page_title(fig: Figure, lines: Sequence[str]) -> None:
    title = "\n".join(wrap_text(line, _PAGE_WIDTH_INCHES, 9) for line in lines if line)
    fig.suptitle(title, x=0.01, ha="left", fontsize=9)


def _draw_hours(axes: Axes, triage: xr.Dataset) -> None:
    """Draw the states hour by hour; lines between days in a log of more than two."""
    from matplotlib.patches import Patch

    hours, state = triage["hour"].values, triage["state"].values
    # hours without a sample take no room
    axes.bar(np.arange(hours.size), 1.0, width=1.0, align="edge", color=[_STATE_COLOURS[word] for word in state])
    if hours.size > 48:
        day_ends = np.flatnonzero(np.diff(hours // 24)) + 1
        axes.vlines(day_ends, 0.0, 1.0, color="black", lw=0.6)
        axes.set_xticks([0, *day_ends], hours[[0, *day_ends]])
    axes.set(xlim=(0, hours.size), ylim=(0, 1), yticks=[], xlabel="hour of the log")
    axes.grid(visible=False)
    axes.set_title("Hour by hour", loc="left")
    states_present = [word for word in STATES if word in state]
    patches = [Patch(color=_STATE_COLOURS[word], label=word) for word in states_present]
    axes.legend(handles=patches, ncols=len(states_present), handlelength=0.8, columnspacing=1.0, **_LEGEND_ABOVE)


def _draw_excerpt(upper: Axes, lower: Axes, excerpt: xr.Dataset) -> None:
    hours = excerpt["elapsed_time"] / 3600.0
    upper.plot(hours, excerpt["T_sup"], color=BLUE, lw=1.0, label="supply air")
    if "T_set" in excerpt:
        upper.step(hours, excerpt["T_set"], color=YELLOW, ls="--", where="post", label="set-point")
    upper.set_ylabel("temperature [°C]")
    upper.tick_params(labelbottom=False)
    upper.set_title("The two hours with the most motor travel", loc="left")
    upper.legend(ncols=2, **_LEGEND_ABOVE)
    lower.step(hours, 100 * excerpt["command"], color=RED, lw=1.0, where="post", label="command")
    lower.set(xlabel="time [h]", ylabel="command [%]")
    lower.margins(x=0.01)


def _draw_profile(axes: Axes, result: Any) -> None:
    """Draw the probability of each size of the backlash, and its interval."""
    sizes, probability = 100 * result.profile["backlash"].values, 100 * result.profile["probability"].values
    low, high = result.interval
    axes.axvspan(100 * low, 100 * high, color=SHADE_GREY, lw=0, label="95 % interval")
    axes.bar(sizes, probability, width=0.8 * (sizes[1] - sizes[0]), color=BLUE if result.identified else LINE_GREY)
    axes.set(xlabel="backlash [% of stroke]", ylabel="probability [%]")
    axes.set_xlim(-0.5, max(100 * high, 8.0) * 1.15)
    axes.set_title("Identified" if result.identified else "Not identified", loc="left")
    axes.legend(**_LEGEND_ABOVE)


def _draw_predictions(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw predicted error and travel with each change, in per cent of those with the present gains."""
    axes.set_title("What the fitted loop would do", loc="left")
    if diagnosis.predictions is None:
        axes.text(0.5, 0.5, "no prediction: see the notes", transform=axes.transAxes, ha="center", fontsize=8)
        axes.set(xticks=[], yticks=[])
        return
    predictions, cases = diagnosis.predictions, list(diagnosis.predictions["case"].values)
    bar_ys = np.arange(len(cases))[::-1]
    error, travel, hunts = (predictions[name].values for name in ("rmse", "travel_per_day", "hunts"))
    bars = ((error, 0.2, BLUE, "{:.2g} K"), (travel, -0.2, YELLOW, "{:.0f} strokes a day"))
    for values, shift, colour, text_format in bars:
        percent = np.nan_to_num(100 * values / values[0])
        axes.barh(bar_ys + shift, percent, height=0.38, color=colour)
        for y, value, end in zip(bar_ys + shift, values, percent, strict=True):
            if np.isfinite(value):
                axes.text(end + 2, y, text_format.format(value), va="center", fontsize=7)
    for y in bar_ys[~np.isfinite(error)]:
        axes.text(2, y, "not predicted", va="center", fontsize=7)
    axes.set_xlim(0, 160.0 * np.nanmax(np.concatenate([error / error[0], travel / travel[0]])))
    axes.axvline(100, color="black", lw=0.8, ls=DOTTED_LINE)
    axes.set_yticks(bar_ys, [CASE_LABELS[c] + "\n(hunts)" * bool(h > 0) for c, h in zip(cases, hunts, strict=True)])
    axes.set_xlabel("error, motor travel [% of now]")
    axes.grid(visible=False, axis="y")
