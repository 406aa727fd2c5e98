"""What was found about one loop on one day, and the sentences and tables that report it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.design.cures import DEAD_BAND, INVERSE, LONGER_TI, REPAIRED, hunting
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.phase_budget import SAFE, UNSURE, Prediction, Response, cycles_at
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import Scalar

_LOST = 0.5
"""Share of the time off the set-point from which a loop does not control."""


class Theory(NamedTuple):
    """What theory tells of a loop.

    response, phase, gain_margin: at the worst operating point; phase has the degrees that each part of the loop takes
    over ``part``; the gain margin is that behind a perfect valve.  swings: simulated at each operating point, K.
    kp_factor: kp could be that many times as large, below 1: it has to shrink to that, before the margin is that from
    which a loop hunts; infinite where it has none.  ti: shortest integral time with a margin of 0.85 at this kp, s; NaN
    if none has it.
    """

    prediction: Prediction
    response: Response
    kp_factor: float
    ti: float
    phase: xr.DataArray
    gain_margin: float
    swings: Array

    @property
    def rings(self) -> bool:
        """Whether the loop would swing behind a perfect valve, too."""
        return self.gain_margin <= 1.0

    @property
    def too_large(self) -> bool:
        """Whether the margin alone makes it hunt: a slow motor may keep a large swing up where it does not."""
        return self.prediction.margin > HUNTS_ABOVE

    @property
    def unsure(self) -> bool:
        """Whether the margin is so near its limit that it does not decide."""
        return UNSURE[0] <= self.prediction.margin <= UNSURE[1]

    @property
    def points(self) -> xr.Dataset:
        """The operating points with their margins."""
        points, plants, cycles, _ = self.prediction
        kelvin, second = {"units": "K"}, {"units": "s"}
        return xr.Dataset(
            {
                "start": ("point", points.start, second | {"long_name": "first second"}),
                "seconds": ("point", points.seconds, second | {"long_name": "seconds spent there"}),
                **{name: ("point", values) for name, values in points.conditions.items()},
                "opening": ("point", plants.opening),
                "gain": ("point", plants.gain, kelvin | {"long_name": "change per unit of opening"}),
                "reachable": ("point", plants.reachable),
                "margin": ("point", cycles.margin),
                "hunts": ("point", cycles.hunts),
                "period": ("point", cycles.period, second),
                "amplitude": ("point", cycles.amplitude, kelvin | {"long_name": "half of peak to peak"}),
                "swing": ("point", self.swings, kelvin | {"long_name": "simulated, peak to peak"}),
            }
        )


class Found(NamedTuple):
    """Everything behind an explanation.

    loop, boundary: a single scenario.  theory: None where theory cannot tell, for the reasons in ``doubts``.
    left_out: what the margin does not see.  hints: what else would help, not tried.
    cures: over ``cure``, as it is first, with the trace T_sup.  best: index of the recommended one.
    """

    loop: Loop
    boundary: Boundary
    theory: Theory | None
    doubts: tuple[str, ...]
    left_out: tuple[str, ...]
    hints: tuple[str, ...]
    cures: xr.Dataset
    best: int

    @property
    def now(self) -> xr.Dataset:
        """The loop as it is, simulated."""
        return self.cures.isel(cure=0)

    @property
    def failed(self) -> bool:
        """Whether the simulation of the loop as it is failed."""
        return int(self.now["status"]) != STATUS_OK

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts."""
        return bool(self.now["hunts"] > 0)

    @property
    def lost(self) -> bool:
        """Whether it is off its set-point for most of the time."""
        return bool(self.now["share_off"] > _LOST)

    @property
    def needs_cure(self) -> bool:
        """Whether it hunts, for a part of the day at least."""
        return bool(hunting(self.cures)[0])

    def value(self, name: str) -> float:
        """A parameter of the loop."""
        return float(self.loop[name])  # type: ignore[arg-type]

    def cured(self, name: str) -> int | None:
        """Index of a cure; None if it was not tried."""
        names = self.cures["cure"].values.tolist()
        return int(names.index(name)) if name in names else None

    def with_cure(self, parameter: str, k: int) -> float:
        """A parameter of the loop with a cure."""
        values = self.cures[parameter] if parameter in self.cures.coords else None
        return float(values[k]) if values is not None and values.ndim else self.value(parameter)


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


def hints_of(loop: Loop, theory: Theory) -> tuple[str, ...]:
    """Sentences for a single loop whose margin is too large; none for another."""
    prediction = theory.prediction

    def margin_with(**changes: Scalar) -> float:
        return float(cycles_at(loop.assign(**changes), prediction.plants, prediction.reached).margin.max())

    if not float(loop["backlash"]):  # type: ignore[arg-type]
        worn = margin_with(backlash=_WORN)
        if prediction.hunts or worn <= HUNTS_ABOVE:
            return ()
        return (
            f"With a backlash of {100 * _WORN:g} % the margin would be {worn:.2g}: as the valve wears, it will hunt.",
        )
    if prediction.margin <= SAFE:
        return ()
    sample, tau = (float(loop[name]) for name in ("sample_time", "sensor_time_constant"))  # type: ignore[arg-type]
    faster = float(max(1, round(sample / _FASTER)))
    found = []
    for part, name, now, then, words in (
        ("sampling", "sample_time", sample, faster, "Sampling every {now:g} s takes {share:.0f}° of the phase: every"),
        ("sensor", "sensor_time_constant", tau, _SENSOR,
         "The sensor takes {share:.0f}° of the phase with its {now:g} s: with"),
    ):  # fmt: skip
        share = float(theory.phase.sel(part=part))
        if share > MUCH and then < now and (margin := margin_with(**{name: then})) < _HELPS * prediction.margin:
            found.append(f"{words.format(now=now, share=share)} {then:g} s the margin would be {margin:.2g}.")
    return tuple(found)


MINUTES = 120.0
"""Seconds from which a period is given in minutes."""
_NOTHING = 5e-4
"""Temperature difference that nobody sees, K."""


def answer_of(found: Found) -> str:
    """Whether the loop will hunt, in one sentence."""
    if found.failed:
        return "This loop cannot be simulated: temperatures leave the range of the model."
    if found.hunts:
        theory = found.theory
        sure = theory is not None and theory.too_large and theory.prediction.hunts and not theory.rings
        whatever = ", whatever the size of the backlash" if sure else ""
        return f"This loop will hunt: about {simulated(found)}{whatever}."
    if found.lost and not found.needs_cure:
        error = kelvin(float(found.now["rmse"]))
        return f"This loop will not hunt, but it does not hold its set-point either: its RMS error is {error}."
    return _quiet(found)


def _quiet(found: Found) -> str:
    """Of a loop that the simulation shows quiet."""
    if found.theory is None or not found.theory.prediction.hunts:
        edge = found.theory is not None and found.theory.unsure
        return "This loop will not hunt, but it is on the edge." if edge else "This loop will not hunt."
    prediction = found.theory.prediction
    places = f"{prediction.hunting.size} of {prediction.reached.size} operating points"
    if found.needs_cure and prediction.elsewhere.size:
        return f"This loop will hunt for a part of the day: at {places}."
    if found.needs_cure:
        swing = kelvin(float(np.nanmedian(found.theory.swings)))
        return f"This loop will swing by about {swing} peak to peak, not regularly enough to count as hunting."
    most = kelvin(2.0 * float(np.nanmax(prediction.cycles.amplitude[prediction.hunting])))
    return f"This loop will hardly hunt: by up to {most} at {places} in theory, which the simulated day does not show."


def why_of(found: Found) -> str:
    """The reason, in a sentence or two."""
    if found.theory is None:
        return f"Why: theory cannot tell, since {'; '.join(found.doubts)}.  The answer is that of the simulation."
    if not found.theory.prediction.hunts:
        return _why_quiet(found, found.theory)
    if not found.theory.too_large:
        # calm by its margin, but not once it swings: the margin is that of swings up to 2 K
        stroke = found.value("stroke_time")
        motor = f"the motor is too slow, with {stroke:g} s for a full stroke: " if stroke else ""
        margin = (
            f"its margin of {found.theory.prediction.margin:.2g} is that of a small swing, and below {HUNTS_ABOVE:g}"
        )
        return f"Why: {motor}a large swing keeps itself up once it has begun, though a small one dies away ({margin})."
    return f"Why: {_too_fast(found, found.theory)} {_backlash(found, found.theory)}"


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


def _why_quiet(found: Found, theory: Theory) -> str:
    """Of a loop that theory expects no cycle of, or none that counts."""
    if theory.too_large:
        safe = number(found.value("kp") * theory.kp_factor)
        return (
            f"Why: its margin is {theory.prediction.margin:.2g}: a loop hunts above {HUNTS_ABOVE:g}, so kp "
            f"has to be below {safe} 1/K with this ti.  Theory finds no swing that counts: go by the simulation."
        )
    ways = []
    if math.isfinite(theory.kp_factor):
        ways.append(f"with {theory.kp_factor:.3g} times this kp")
    if theory.ti < found.value("ti"):
        ways.append(f"with a ti below {number(theory.ti)} s")
    far = f", and it would {', or '.join(ways)}" if ways else ""
    return f"Why: its margin is {theory.prediction.margin:.2g}; a loop hunts above {HUNTS_ABOVE:g}{far}."


def _too_fast(found: Found, theory: Theory) -> str:
    """Whether the integral or the gain is at fault."""
    kp, ti = found.value("kp"), found.value("ti")
    limit = f"(margin {theory.prediction.margin:.2g}; a loop hunts above {HUNTS_ABOVE:g})"
    longer = found.cured(LONGER_TI)
    if longer is not None:
        return (
            f"the integral is too fast for the coil: ti = {ti:g} s, while with this kp the loop needs about "
            f"{found.with_cure('ti', longer):g} s {limit}."
        )
    return (
        f"the gain is too high: kp = {kp:g} 1/K, while it has to be below {kp * theory.kp_factor:.2g} 1/K "
        f"with this ti, and for this kp no ti is long enough {limit}."
    )


def _backlash(found: Found, theory: Theory) -> str:
    if theory.rings or not found.value("backlash"):
        return "It would swing behind a perfect valve, too."
    size, stroke = per_cent(found.value("backlash")), found.value("stroke_time")
    motor = f" and the motor's {stroke:g} s" if stroke else ""
    return f"Any backlash starts it; its {size}{motor} set the size of the swing."


_HEAD = ("", "margin", "RMSE", "swing", "motor travel", "")


def table_of(found: Found) -> list[str]:
    """A heading and a row for each cure: what is now in numbers, the others relative to it."""
    ds = found.cures
    margin, error, swing, travel = (ds[name].values for name in ("margin", "rmse", "hunting_swing", "motor_travel"))
    rows: list[tuple[str, ...]] = [_HEAD]
    for k, words in enumerate(ds["words"].values.tolist()):
        if k:
            change = f"{100 * (error[k] / error[0] - 1):+.0f} %"
            moved, says = f"× {number(travel[k] / travel[0])}" if travel[0] > 0 else "–", str(ds["verdict"].values[k])
        else:
            change, moved = f"{error[0]:.3g} K", f"{travel[0]:.3g} strokes"
            says = "hunts" if found.hunts else "hunts in part" if found.needs_cure else "does not hunt"
        cells = (f"{margin[k]:.2f}", change, kelvin(swing[k]), moved)
        known = np.isfinite([margin[k], error[k], swing[k], travel[k]])
        rows.append((words, *(cell if is_known else "–" for cell, is_known in zip(cells, known, strict=True)), says))
    widths = [max(len(row[c]) for row in rows) for c in range(len(_HEAD))]
    lines = []
    for row in rows:
        numbers = [cell.rjust(width) for cell, width in zip(row[1:-1], widths[1:-1], strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *numbers, row[-1]]).rstrip())
    title = (
        "What would cure it, and what that costs" if found.needs_cure else "What else could be done, and what it costs"
    )
    return [f"{title}: the day simulated with each", *lines]


_LEAST_SHARE = 0.5
"""Degrees; less is not shown."""
_PARTS = {
    "integral": "integral of the PI",
    "coil": "coil",
    "sensor": "sensor",
    "sampling": "sampling and hold",
    "backlash": "backlash (and motor)",
}


def sentences(found: Found) -> list[str]:
    """The explanation, line by line."""
    lines = [answer_of(found), why_of(found)]
    if found.theory is not None:
        lines += [*_agreement(found, found.theory), *_where(found.theory)]
        lines += [f"Not in the margin: {clause}." for clause in found.left_out]
        lines += ["", *_phase(found.theory)]
    lines += ["", *table_of(found), *_honest(found), *_advice(found), *found.hints]
    if not found.value("noise_std") and not found.boundary.series["noise"].any():
        lines.append("No measurement noise is given: with some the motor travels more (--set noise_std=0.02).")
    return lines


def _agreement(found: Found, theory: Theory) -> list[str]:
    """What theory predicts beside what the simulation shows."""
    if found.failed:
        return []
    shown = simulated(found) if found.hunts else f"no hunting, RMS error {kelvin(float(found.now['rmse']))}"
    lines = [f"Predicted: {_predicted(theory.prediction)}; simulated over the day: {shown}."]
    if theory.unsure:
        margin = f"{theory.prediction.margin:.2g}"
        lines.append(f"A margin of {margin} is too near {HUNTS_ABOVE:g} to decide: go by the simulation.")
    elif theory.prediction.hunts != found.hunts:
        lines.append(f"The two disagree: {_reason(found, theory)}.")
    return lines


def _predicted(prediction: Prediction) -> str:
    if not prediction.hunts:
        return "no cycle"
    swings, periods = (of[prediction.hunting] for of in (2.0 * prediction.cycles.amplitude, prediction.cycles.period))
    if not np.isfinite(swings).any():
        return "a cycle, of a size that theory does not give"
    every = _span(periods, "s") if float(np.nanmax(periods)) < MINUTES else _span(periods / 60.0, "min")
    return f"{_span(swings, 'K')} peak to peak every {every}"


def _span(values: Array, unit: str) -> str:
    low, high = (number(float(end)) for end in (np.nanmin(values), np.nanmax(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _reason(found: Found, theory: Theory) -> str:
    """Why the simulated day may not show what is predicted, and whom to believe."""
    prediction = theory.prediction
    both = (prediction.hunting, prediction.elsewhere)
    if found.needs_cure and not found.hunts and all(np.isfinite(theory.swings[some]).any() for some in both):
        swings = [kelvin(float(np.nanmedian(theory.swings[some]))) for some in both]
        return (
            "it hunts for too small a part of the day to count.  Where it is predicted to hunt, T_sup swings by "
            f"{swings[0]} in the simulation (median), elsewhere by {swings[1]}"
        )
    if prediction.hunts:
        return "its swing is too small or not regular enough to count; go by the simulation for this day"
    return "go by the simulation for this day"


def _where(theory: Theory) -> list[str]:
    """Which operating point is quoted, what happens there, and how the margin differs over the day."""
    prediction = theory.prediction
    k, margin = prediction.worst, prediction.cycles.margin[prediction.reached]
    T_set, hours = float(prediction.points.conditions["T_set"][k]), float(prediction.points.start[k]) / 3600.0
    opening = 100 * float(prediction.plants.opening[k])
    place = f"{T_set:.3g} °C, {hours:.3g} h after the start (opening {opening:.0f} %)"
    swing, shown = 2.0 * float(prediction.cycles.amplitude[k]), float(theory.swings[k])
    if math.isfinite(swing) and math.isfinite(shown):
        place += f": {kelvin(swing)} predicted, {kelvin(shown)} simulated"
    if prediction.points.size == 1:
        return [f"Where: at {place}."]
    return [
        f"Where: worst at {place}.  Over the day the margin goes from {margin.min():.2g} to {margin.max():.2g}, and "
        f"{prediction.hunting.size} of {margin.size} operating points are predicted to hunt."
    ]


def _phase(theory: Theory) -> list[str]:
    """What each part of the loop takes, the largest first."""
    order = np.argsort(-theory.phase.values)
    shares = [(str(theory.phase["part"].values[k]), float(theory.phase[k])) for k in order]
    taken = [f"  {_PARTS[part]:<22}{share:>4.0f}°" for part, share in shares if abs(share) >= _LEAST_SHARE]
    return [f"Where the 180° of phase go, at one swing in {seconds(float(theory.phase.attrs['period']))}:", *taken]


def _honest(found: Found) -> list[str]:
    """What a cure does not do; what backlash costs a loop that does not hunt."""
    repaired, band, inverse = (found.cured(name) for name in (REPAIRED, DEAD_BAND, INVERSE))
    if not found.needs_cure:
        if repaired is None or found.failed:
            return []
        error, without = (kelvin(float(found.cures["rmse"][k])) for k in (0, repaired))
        size = per_cent(found.value("backlash"))
        if error == without:
            return []
        return [f"What the backlash of {size} costs anyway: RMSE {error} instead of {without}."]
    lines = []
    if band is not None:
        width = found.with_cure("error_dead_band", band)
        lines.append(f"The dead band leaves the margin as it is, and holds any error up to {width:g} K.")
    if inverse is not None and float(found.cures["margin"][inverse]) > HUNTS_ABOVE:
        lines.append("The inverse leaves the margin too large: what is left of the gap may keep up a smaller swing.")
    return lines


def _advice(found: Found) -> list[str]:
    if found.failed:
        return []
    if not found.best:
        if found.needs_cure:
            return ["None of these cures it."]
        if found.lost:
            return ["None of these makes it hold its set-point."]
        return ["Leave it: none of these takes 5 % off the error."]
    now, then = found.now, found.cures.isel(cure=found.best)
    error = float(then["rmse"] / now["rmse"]) - 1.0
    travel, before = float(then["motor_travel"]), float(now["motor_travel"])
    moved = f", motor travel × {number(travel / before)}" if before else ""
    then_do = "Do this" if found.needs_cure else "If the error matters"
    return [f"{then_do}: {then['words'].item()}: RMSE {100 * error:+.0f} %{moved}."]
