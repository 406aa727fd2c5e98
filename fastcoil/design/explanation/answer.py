"""The answer and the reason: the first sentences of an explanation."""

from __future__ import annotations

import math

import numpy as np

from fastcoil.design.explanation.cures import LONGER_TI
from fastcoil.design.explanation.theory import Found, Told
from fastcoil.design.theory.cycles import HUNTS_ABOVE

MINUTES = 120.0
"""Seconds from which a period is told in minutes."""
_NOTHING = 5e-4
"""Temperature difference that nobody sees, K."""


def answer_of(found: Found) -> str:
    """Whether the loop will hunt, in one sentence."""
    if found.failed:
        return "This loop cannot be simulated: temperatures leave the range of the model."
    if found.hunts:
        sure = found.told is not None and found.told.too_large and found.told.foretold.hunts and not found.told.rings
        whatever = ", whatever the size of the backlash" if sure else ""
        return f"This loop will hunt: about {simulated(found)}{whatever}."
    if found.lost and not found.needs_cure:
        error = kelvin(float(found.now["rmse"]))
        return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
    return _quiet(found)


def _quiet(found: Found) -> str:
    """Of a loop that the simulation shows quiet."""
    if found.told is None or not found.told.foretold.hunts:
        edge = found.told is not None and found.told.unsure
        return "This loop will not hunt, but it is on the edge." if edge else "This loop will not hunt."
    told = found.told.foretold
    places = f"{told.n_hunting} of {told.reached.size} operating points"
    if found.needs_cure and told.elsewhere.size:
        return f"This loop will hunt for a part of the day: at {places}."
    if found.needs_cure:
        swing = kelvin(float(np.nanmedian(found.told.swings)))
        return f"This loop will swing by about {swing} peak to peak, not regularly enough to count as hunting."
    most = kelvin(2.0 * float(np.nanmax(told.cycles.amplitude[told.hunting])))
    return f"This loop will hardly hunt: by up to {most} at {places} in theory, which the simulated day does not show."


def why_of(found: Found) -> str:
    """The reason, in a sentence or two."""
    if found.told is None:
        return f"Why: theory cannot tell, since {'; '.join(found.doubts)}.  The answer is that of the simulation."
    if not found.told.foretold.hunts:
        return _why_quiet(found, found.told)
    if not found.told.too_large:
        return _why_kept_up(found, found.told)
    return f"Why: {_too_fast(found, found.told)} {_backlash(found, found.told)}"


def simulated(found: Found) -> str:
    """The swing of the simulated day."""
    swing, period = float(found.now["hunting_swing"]), float(found.now["hunting_period"])
    return f"{kelvin(swing)} peak to peak every {seconds(period)}"


def seconds(value: float) -> str:
    """A period in words."""
    if not math.isfinite(value):
        return "now and then"
    return f"{number(value)} s" if value < MINUTES else f"{number(value / 60.0)} min"


def kelvin(value: float) -> str:
    """A temperature difference in words."""
    return f"{number(value)} K" if abs(value) >= _NOTHING else "0 K"


def number(value: float) -> str:
    """Two digits, without an exponent where it is large."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def per_cent(value: float) -> str:
    """A fraction in words."""
    return f"{100.0 * value:.3g} %"


def _why_quiet(found: Found, told: Told) -> str:
    """Of a loop that theory expects no cycle of, or none that counts."""
    if told.too_large:
        safe = number(found.value("kp") * told.distance.kp_factor)
        return (
            f"Why: its margin is {told.foretold.margin:.2g}: a loop hunts above {HUNTS_ABOVE:g}, so kp "
            f"has to be below {safe} 1/K with this ti.  Theory finds no swing that counts: go by the simulation."
        )
    ways = []
    if math.isfinite(told.distance.kp_factor):
        ways.append(f"with {told.distance.kp_factor:.3g} times this kp")
    if told.distance.ti < found.value("ti"):
        ways.append(f"with a ti below {number(told.distance.ti)} s")
    far = f", and it would {', or '.join(ways)}" if ways else ""
    return f"Why: its margin is {told.foretold.margin:.2g}; a loop hunts above {HUNTS_ABOVE:g}{far}."


def _why_kept_up(found: Found, told: Told) -> str:
    """Of a loop that is calm by its margin, but not once it swings: the margin is that of swings up to 2 K."""
    stroke = found.value("stroke_time")
    motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
    margin = f"its margin of {told.foretold.margin:.2g} is that of a small swing, and below {HUNTS_ABOVE:g}"
    return f"Why: {motor}a large swing keeps itself up once it has begun, though a small one dies away ({margin})."


def _too_fast(found: Found, told: Told) -> str:
    """Whether the integral or the gain is at fault."""
    kp, ti = found.value("kp"), found.value("ti")
    limit = f"(margin {told.foretold.margin:.2g}; a loop hunts above {HUNTS_ABOVE:g})"
    longer = found.cured(LONGER_TI)
    if longer is not None:
        return (
            f"the integral is too fast for the coil: ti = {ti:g} s, while with this kp the loop needs about "
            f"{found.with_cure('ti', longer):g} s {limit}."
        )
    return (
        f"the gain is too high: kp = {kp:g} 1/K, while it has to be below {kp * told.distance.kp_factor:.2g} 1/K with "
        f"this ti, and for this kp no ti is long enough {limit}."
    )


def _backlash(found: Found, told: Told) -> str:
    if told.rings or not found.value("backlash"):
        return "It would swing behind a perfect valve, too."
    size, stroke = per_cent(found.value("backlash")), found.value("stroke_time")
    if stroke:
        return f"Any backlash starts it; its {size} and the motor's {stroke:g} s set the size of the swing."
    return f"Any backlash starts it; its {size} set the size of the swing."
