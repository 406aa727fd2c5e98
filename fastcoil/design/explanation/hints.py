"""What would help besides, where sampling, sensor or hold take much of the phase: foretold only, not tried."""

from __future__ import annotations

from fastcoil.design.explanation.predicted import SAFE, Foretold, margins
from fastcoil.design.explanation.theory import Told
from fastcoil.design.theory.cycles import HUNTS_ABOVE
from fastcoil.loops.loop import Loop
from fastcoil.model.parameter_table import Scalar

MUCH = 25.0
"""Degrees."""
_SENSOR = 5.0
"""Time constant of a fast sensor, s."""
_WORN = 0.02
"""Backlash of a valve that is no longer new, fraction of stroke."""
_HELPS = 0.8
"""Margin relative to now from which a hint is worth a line."""
_FASTER = 3.0
"""Times as many samples."""


def hints_of(loop: Loop, told: Told) -> tuple[str, ...]:
    """Sentences for a single loop whose margin is too large; none for another."""
    foretold, found = told.foretold, []
    if not float(loop["backlash"]):  # type: ignore[arg-type]
        return _with_backlash(loop, foretold)
    if foretold.margin <= SAFE:
        return ()
    shares = dict(zip(told.phase["part"].values.tolist(), told.phase.values.tolist(), strict=True))
    sample, tau = (float(loop[name]) for name in ("sample_time", "sensor_time_constant"))  # type: ignore[arg-type]
    faster = float(max(1, round(sample / _FASTER)))
    if shares["sampling"] > MUCH and faster < sample:
        margin = _margin(loop, foretold, {"sample_time": faster})
        if margin < _HELPS * foretold.margin:
            found.append(
                f"Sampling every {sample:g} s takes {shares['sampling']:.0f}° of the phase: every {faster:g} s the "
                f"margin would be {margin:.2g}."
            )
    if shares["sensor"] > MUCH and tau > _SENSOR:
        margin = _margin(loop, foretold, {"sensor_time_constant": _SENSOR})
        if margin < _HELPS * foretold.margin:
            found.append(
                f"The sensor takes {shares['sensor']:.0f}° of the phase with its {tau:g} s: with {_SENSOR:g} s the "
                f"margin would be {margin:.2g}."
            )
    return tuple(found)


def _with_backlash(loop: Loop, foretold: Foretold) -> tuple[str, ...]:
    """Of a perfect valve: what becomes of its margin as it wears."""
    margin = _margin(loop, foretold, {"backlash": _WORN})
    if foretold.hunts or margin <= HUNTS_ABOVE:
        return ()
    return (
        f"With a backlash of {100 * _WORN:g} % the margin would be {margin:.2g}: as the valve wears, it will hunt.",
    )


def _margin(loop: Loop, foretold: Foretold, changes: dict[str, Scalar]) -> float:
    return float(margins(loop.assign(**changes), foretold.plants, foretold.reached).max())
