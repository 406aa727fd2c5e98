"""What is seen, in sentences for a lecture hall; the loop and its day as Python and as a study file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from fastcoil.deliver.explore.loop import NO_GAP, NOW, PLAIN, Run, day_of, loop_of
from fastcoil.deliver.explore.settings import GIVEN, Settings, Start
from fastcoil.design.answer import kelvin, number, per_cent, seconds
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import HUNTING_SWING, OFF
from fastcoil.model.parameter_table import Scalar

_LOST = 0.5  # share of the time off the set-point from which a loop does not control
_MORE = 1.5  # so many times the motor travel of the plain PI is chatter
_ABOVE = 1.02
"""So many times the gap is an estimate that is too large: an estimator finds it to a few thousandths."""
_FEW_TURNS = 2.0  # turns in 10 min that are no chatter yet
_CALM = 0.25  # settled swing from peak to peak up to which a loop counts as calm, K
_SEEN = 0.01  # K
_HALF = 0.5


def headline(run: Run) -> str:
    """What the loop does, and whether the gap is to blame, in one sentence."""
    if run.failed:
        return "This loop cannot be simulated: its temperatures leave the range of the model."
    if chatters(run):
        return f"{_chatter(run)}."
    if run.value("hunts") > 0:
        learns = " while it learns" if run.learns else ""
        return f"The loop hunts{learns}: {_swing(run, NOW)}; {_blame(run)}."
    if run.value("share_off") > _LOST:
        return f"The loop does not hold its set-point: for most of the time it is more than {OFF:g} K off."
    if run.value("hunting_swing") > _CALM:
        return f"The loop does not hunt, but swings by {_half_swing(run, NOW)}; {_thanks(run, _half_swing)}."
    return f"The loop is calm, RMS error {_error(run, NOW)}; {_thanks(run, _error)}."


def _error(run: Run, case: int) -> str:
    """The control error in words, if it can be seen at all."""
    error = run.value("rmse", case)
    return kelvin(error) if error >= _SEEN else f"below {_SEEN:g} K"


def chatters(run: Run) -> bool:
    """Whether the motor turns again and again because the estimate is larger than the gap.

    Its travel is then more than ``_MORE`` times that of the plain PI, and of the PI behind a perfect valve.
    """
    estimate = run.value("estimate_settled")
    travel, others = run.value("motor_travel"), max(run.value("motor_travel", k) for k in (NO_GAP, PLAIN))
    too_large = estimate > _ABOVE * run.value("backlash_final") and run.compensates
    return too_large and travel > _MORE * others and run.value("switch_frequency") > _FEW_TURNS


def _chatter(run: Run) -> str:
    estimate, gap = run.value("estimate_settled"), run.value("backlash_final")
    swing = f", and the temperature swings by {_half_swing(run, NOW)}"
    return (
        f"The motor chatters, {6.0 * run.value('switch_frequency'):.0f} turns an hour: the estimate, "
        f"{per_cent(estimate)}, is larger than the gap, {per_cent(gap)}"
        f"{swing if run.value('hunting_swing') > HUNTING_SWING else ''}"
    )


def _swing(run: Run, case: int) -> str:
    return f"{_half_swing(run, case)} every {seconds(run.value('hunting_period', case))}"


def _half_swing(run: Run, case: int) -> str:
    half = _HALF * run.value("hunting_swing", case)
    return f"±{kelvin(half)}" if half >= _SEEN else f"less than ±{_SEEN:g} K"


def _blame(run: Run) -> str:
    """Whether it would hunt without the gap."""
    if not run.parameter("backlash"):
        return "the valve has no gap, so the tuning is to blame"
    if run.value("hunts", NO_GAP) > 0:
        return "without the gap it would hunt, too"
    if run.compensates and not run.value("hunts", PLAIN) > 0:
        return "without the inverse it would not"
    return "without the gap it would not"


def _thanks(run: Run, shown: Callable[[Run, int], str]) -> str:
    """What a loop that does not hunt owes to what.  shown: the number that the sentence is about."""
    if run.compensates and run.value("hunts", PLAIN) > 0:
        return f"without the inverse it would hunt, {_swing(run, PLAIN)}"
    if run.compensates:
        return f"without the inverse: {shown(run, PLAIN)}"
    if not run.parameter("backlash"):
        return "the valve has no gap"
    return f"without the gap: {shown(run, NO_GAP)}"


def learning(run: Run) -> str:
    """What an estimator has found; empty without one."""
    if not run.learns or run.failed:
        return ""
    found, gap = run.value("estimate_final"), run.value("backlash_final")
    hours = run.value("time_identified") / 3600.0
    since = f", right since hour {hours:.1f}" if math.isfinite(hours) else ", which is not right yet"
    return f"The estimate ends at {per_cent(round(found, 3))} for a gap of {per_cent(gap)}{since}."


def prediction(run: Run) -> str:
    """What theory predicts without simulating."""
    predicted = run.predicted
    if predicted.doubt:
        return f"Theory cannot tell: {predicted.doubt}."
    margin, limit = number(predicted.margin), f"a gap keeps a loop swinging from {HUNTS_ABOVE:g}"
    if not predicted.hunts and predicted.margin > HUNTS_ABOVE:
        return f"Theory: hardly hunts.  Margin {margin}; {limit}, but no swing that counts is predicted."
    if not predicted.hunts:
        return f"Theory: will not hunt.  Margin {margin}; {limit}."
    swing = f"±{kelvin(_HALF * predicted.swing)}" if math.isfinite(predicted.swing) else "by an unknown swing"
    return f"Theory: will hunt, {swing} every {seconds(predicted.period)}.  Margin {margin}; {limit}."


def outcome(run: Run) -> str:
    """What the simulation shows, to be compared with ``prediction``."""
    if run.failed:
        return "Simulated: failed."
    hunts, predicted = run.value("hunts") > 0, run.predicted
    apart = "" if predicted.doubt or predicted.hunts == hunts else "  The two disagree: go by the simulation."
    if hunts:
        return f"Simulated: hunts, {_swing(run, NOW)}.{apart}"
    return f"Simulated: does not hunt, swing {_half_swing(run, NOW)}.{apart}"


_BASE = "paper_like"  # the preset from which the changes of any other loop are listed


def python_lines(settings: Settings, start: Start) -> str:
    """A script that simulates the loop."""
    preset, changed = _preset_and_changes(settings, start)
    assign = f".assign({_arguments(changed)})" if changed else ""
    day = day_of(settings, start)
    made = f"fc.{day.maker}({_arguments(day.arguments)})" if day else f"fc.paper_day()  # give that of {start.title}"
    run = "" if day else f", warm_up={start.warm_up}, seed={start.seed}"
    return (
        "import fastcoil as fc\n\n"
        f"loop = fc.Loop.preset({_quoted(preset)}){assign}\n"
        f"day = {made}\n"
        f"ds = fc.simulate(loop, day{run})\n"
        'print(ds[["rmse", "hunts", "hunting_swing", "hunting_period"]])\n'
    )


def study_file(settings: Settings, start: Start) -> str:
    """A study file for ``fastcoil run``."""
    preset, changed = _preset_and_changes(settings, start)
    day = day_of(settings, start)
    lines = ["# from `fastcoil explore`", "[loop]", f"preset = {_quoted(preset)}", *_rows(changed), ""]
    if day is None:
        return "\n".join([*lines, f"# [boundary]: that of {start.title}", ""])
    return "\n".join([*lines, "[boundary]", f"kind = {_quoted(day.maker)}", *_rows(day.arguments), ""])


def _preset_and_changes(settings: Settings, start: Start) -> tuple[str, dict[str, Scalar]]:
    """A preset, and what differs from it."""
    preset = _BASE if settings.loop == GIVEN else settings.loop
    constants = loop_of(settings, start).constants
    changed = {name: constants[name] for name in PRESETS[preset].changed(constants)}
    if changed.get("estimator") == "none" and "estimator" not in PRESETS[preset].values:
        del changed["estimator"]
    return preset, changed


def _rows(values: Mapping[str, Any]) -> list[str]:
    return [f"{name} = {_literal(value)}" for name, value in values.items()]


def _arguments(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={_literal(value)}" for name, value in values.items())


def _literal(value: object) -> str:
    return _quoted(value) if isinstance(value, str) else repr(value)


def _quoted(text: str) -> str:
    return f'"{text}"'
