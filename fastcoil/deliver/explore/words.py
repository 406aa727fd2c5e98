"""What is seen, in sentences for a lecture hall; the loop and its day as a study file."""

import math
from typing import Any

from fastcoil.base.results import in_toml
from fastcoil.deliver.explore.loop import NO_GAP, NOW, PLAIN, Run, day_of, loop_of
from fastcoil.deliver.explore.settings import GIVEN, Settings, Start
from fastcoil.design.advice import kelvin, number, per_cent, seconds
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import HUNTING_SWING, OFF

_LOST = 0.5  # share of the time off the set-point from which a loop does not control
_MORE = 1.5  # times the motor travel of the plain PI that is chatter
_ABOVE = 1.02  # times the gap that is too large an estimate: an estimator finds the gap to a few thousandths
_FEW_TURNS = 2.0  # turns in 10 min that are no chatter yet
_CALM = 0.25  # settled swing from peak to peak up to which a loop counts as calm, K
_SEEN = 0.01  # K


def headline(run: Run) -> str:
    """What the loop does, and whether the gap is to blame, in one sentence."""
    if run.failed:
        return "This loop cannot be simulated: its temperatures leave the range of the model."
    if _chatters(run):
        turns = 6.0 * run.value("switch_frequency")
        estimate, gap = (per_cent(run.value(name)) for name in ("estimate_settled", "backlash_final"))
        swings = run.value("hunting_swing") > HUNTING_SWING
        also = f", and the temperature swings by {_half(run)}" if swings else ""
        sizes = f"the estimate, {estimate}, is larger than the gap, {gap}"
        return f"The motor chatters, {turns:.0f} turns an hour: {sizes}{also}."
    if run.value("hunts") > 0:
        return f"The loop hunts{' while it learns' if run.learns else ''}: {_swing(run)}; {_blame(run)}."
    if run.value("share_off") > _LOST:
        return f"The loop does not hold its set-point: for most of the time it is more than {OFF:g} K off."
    swings = run.value("hunting_swing") > _CALM
    now, no_gap, plain = (_half(run, k) if swings else _error(run, k) for k in (NOW, NO_GAP, PLAIN))
    if run.compensates and run.value("hunts", PLAIN) > 0:
        owed = f"without the inverse it would hunt, {_swing(run, PLAIN)}"
    elif run.compensates:
        owed = f"without the inverse: {plain}"
    else:
        owed = f"without the gap: {no_gap}" if run.parameter("backlash") else "the valve has no gap"
    verdict = f"does not hunt, but swings by {now}" if swings else f"is calm, RMS error {now}"
    return f"The loop {verdict}; {owed}."


def _chatters(run: Run) -> bool:
    """Whether the motor turns again and again because the estimate is larger than the gap."""
    travel, others = run.value("motor_travel"), max(run.value("motor_travel", k) for k in (NO_GAP, PLAIN))
    too_large = run.compensates and run.value("estimate_settled") > _ABOVE * run.value("backlash_final")
    return too_large and travel > _MORE * others and run.value("switch_frequency") > _FEW_TURNS


def _blame(run: Run) -> str:
    """Whether it would hunt without the gap."""
    if not run.parameter("backlash"):
        return "the valve has no gap, so the tuning is to blame"
    if run.value("hunts", NO_GAP) > 0:
        return "without the gap it would hunt too"
    if run.compensates and not run.value("hunts", PLAIN) > 0:
        return "without the inverse it would not"
    return "without the gap it would not"


def _error(run: Run, case: int) -> str:
    error = run.value("rmse", case)
    return kelvin(error) if error >= _SEEN else f"below {_SEEN:g} K"


def _half(run: Run, case: int = NOW) -> str:
    half = 0.5 * run.value("hunting_swing", case)
    return f"±{kelvin(half)}" if half >= _SEEN else f"less than ±{_SEEN:g} K"


def _swing(run: Run, case: int = NOW) -> str:
    return f"{_half(run, case)} every {seconds(run.value('hunting_period', case))}"


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
    swing = f"±{kelvin(0.5 * predicted.swing)}" if math.isfinite(predicted.swing) else "by an unknown swing"
    return f"Theory: will hunt, {swing} every {seconds(predicted.period)}.  Margin {margin}; {limit}."


def outcome(run: Run) -> str:
    """What the simulation shows, to be compared with ``prediction``."""
    if run.failed:
        return "Simulated: failed."
    hunts, predicted = run.value("hunts") > 0, run.predicted
    agree = predicted.doubt or predicted.hunts == hunts
    verdict = f"hunts, {_swing(run)}" if hunts else f"does not hunt, swing {_half(run)}"
    return f"Simulated: {verdict}.{'' if agree else '  The two disagree: go by the simulation.'}"


def study_file(settings: Settings, start: Start) -> str:
    """A study file for ``fastcoil run``, without the day of a study."""
    preset = "paper_like" if settings.loop == GIVEN else settings.loop
    constants = loop_of(settings, start).constants
    tables: dict[str, dict[str, Any]] = {
        "loop": {"preset": preset} | {name: constants[name] for name in PRESETS[preset].changed(constants)}
    }
    day = day_of(settings, start)
    if day is not None:
        tables["boundary"] = {"kind": day[0]} | day[1]
    lines = ["# from `fastcoil explore`"]
    for table, values in tables.items():
        lines += [f"[{table}]", *(f"{name} = {in_toml(value)}" for name, value in values.items())]
    return "\n".join([*lines, ""])
