"""What would help besides, where sampling, sensor or hold take much of the phase: foretold only, not tried."""

from __future__ import annotations

from fastcoil.explanation.foretold import SAFE, Foretold, margins
from fastcoil.explanation.found import Told
from fastcoil.parameter_table import Scalar
from fastcoil.simulation.loop import Loop

MUCH = 25.0
"""Degrees."""
_SENSOR = 5.0
"""Time constant of a fast sensor, s."""
_FASTER = 3.0
"""Times as many samples."""


def hints_of(loop: Loop, told: Told) -> tuple[str, ...]:
    """Sentences for a single loop whose margin is too large; none for another."""
    foretold, found = told.foretold, []
    if foretold.margin <= SAFE:
        return ()
    shares = dict(zip(told.phase["part"].values.tolist(), told.phase.values.tolist(), strict=True))
    sample, tau = (float(loop[name]) for name in ("sample_time", "sensor_time_constant"))  # type: ignore[arg-type]
    faster = float(max(1, round(sample / _FASTER)))
    if shares["sampling"] > MUCH and faster < sample:
        margin = _margin(loop, foretold, {"sample_time": faster})
        found.append(
            f"Sampling every {sample:g} s takes {shares['sampling']:.0f}° of the phase: every {faster:g} s the margin "
            f"would be {margin:.2g}."
        )
    if shares["sensor"] > MUCH and tau > _SENSOR:
        margin = _margin(loop, foretold, {"sensor_time_constant": _SENSOR})
        found.append(
            f"The sensor takes {shares['sensor']:.0f}° of the phase with its {tau:g} s: with {_SENSOR:g} s the margin "
            f"would be {margin:.2g}."
        )
    return tuple(found)


def _margin(loop: Loop, foretold: Foretold, changes: dict[str, Scalar]) -> float:
    return float(margins(loop.assign(**changes), foretold.plants, foretold.reached).max())
