"""``linearise``: loops × days × seconds → what a small change does there, and the tunings that follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, flag_of
from fastcoil.base.arrays import Array, array_of
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.design.theory.margins import margins_of
from fastcoil.design.theory.operating_points import OperatingPoints, require_pi
from fastcoil.design.theory.plants import Columns, Plants, frequency_response, loop_response, plants_of
from fastcoil.design.theory.response import Complex
from fastcoil.design.theory.state_space import state_names, state_space_of
from fastcoil.design.theory.tunings import calm, first_order, simc, ziegler_nichols
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import check_memory
from fastcoil.loops.provenance import provenance

Attributes = Mapping[str, Any]
_LOWEST, _FREQUENCIES = 1e-6, 400
"""Of a response whose phase is followed, rad/s and number."""
_NO_GAP = "without the gap, the motor's stroke time and the inverse"
_RULE = "for a plain PI; half a sample time counts as dead time; NaN if the valve changes nothing or acts the wrong way"
_RADIANS = {"dims": ("frequency",), "units": "degree", "comment": "unwrapped from the lowest frequency on"}
_NAMES: Mapping[str, Attributes] = {
    "opening": {"long_name": "opening at which T_sup rests at T_set", "units": "1"},
    "T_sup": {"long_name": "supply air temperature at rest", "units": "degC"},
    "m_w": {"long_name": "water flow", "units": "kg s-1"},
    "wet_volumes": {
        "long_name": "number of wet control volumes", "units": "1",
        "comment": "a volume that is wet and dry by turns counts with the share of time in which it is wet",
    },
    "reachable": {
        "long_name": "whether an opening holds the set-point", "units": "1",
        "comment": "where False, the opening is 0 or 1, whichever is nearer; or T_sup jumps past it, and gain is NaN",
    },
    "gain": {"long_name": "gain from the opening to T_sup", "units": "K", "comment": "per unit opening"},
    "lag": {
        "long_name": "lag of the plant and its sensor", "units": "s",
        "comment": "first order plus delay, through 35.3 and 85.3 % of the response (Sundaresan, Krishnaswamy 1978)",
    },
    "delay": {
        "long_name": "delay of the plant and its sensor", "units": "s",
        "comment": "first order plus delay, as lag; the controller's sample time is not in it",
    },
    "kp_simc": {"long_name": "kp after SIMC", "units": "K-1", "comment": f"lag/(2 gain dead time), {_RULE}"},
    "ti_simc": {"long_name": "ti after SIMC", "units": "s", "comment": "min(lag, 8 dead time)"},
    "kp_lambda": {"long_name": "kp after lambda tuning", "units": "K-1", "comment": f"lambda = 3 lag, {_RULE}"},
    "ti_lambda": {"long_name": "ti after lambda tuning", "units": "s", "comment": "lag"},
    "kp_zn": {"long_name": "kp after Ziegler and Nichols", "units": "K-1", "comment": "0.45 ultimate_gain"},
    "ti_zn": {"long_name": "ti after Ziegler and Nichols", "units": "s", "comment": "ultimate_period/1.2"},
    "ultimate_gain": {
        "long_name": "ultimate gain of a P controller", "units": "K-1", "comment": f"at this sample time, {_NO_GAP}",
    },
    "ultimate_period": {"long_name": "ultimate period of a P controller", "units": "s"},
    "gain_margin": {
        "long_name": "gain margin", "units": "1",
        "comment": f"kp may grow by this factor until the loop swings, {_NO_GAP}; below 1 it is unstable",
    },
    "phase_margin": {
        "long_name": "phase margin", "units": "degree",
        "comment": f"{_NO_GAP}; NaN where |L| is above 1 at every frequency that the controller can make",
    },
    "plant_magnitude": {"dims": ("frequency",), "long_name": "gain from the opening to T_sup", "units": "K"},
    "plant_phase": {"long_name": "phase from the opening to T_sup", **_RADIANS},
    "loop_magnitude": {"dims": ("frequency",), "long_name": "gain of the open loop L", "units": "1"},
    "loop_phase": {"long_name": "phase of the open loop L", **_RADIANS},
    "A": {"dims": ("state", "state_before"), "long_name": "from the states of a second to those of the next"},
    "B": {"dims": ("state",), "long_name": "from the opening to the states of the next second"},
}  # fmt: skip


def linearise(
    loop: Loop, boundary: Boundary, *, at: Any = None, frequency: Any = None, state_space: bool = False
) -> xr.Dataset:
    """Linearise every loop of ``loop`` where it rests at its set-point on every day of ``boundary``.

    The plant is the emulator's own one-second step, differentiated.  The controller and the sensor are taken as they
    are sampled.

    Parameters
    ----------
    loop, boundary
        As for ``simulate``; a sweep and several days give results of these dims.
    at
        Where on the day: None for the mean conditions and the mean set-point of the enabled seconds after the warm-up
        of 1,800 s; a second, or a list of them, for the conditions of that second, as if they were held until all is
        steady.  A list becomes the dim ``elapsed_time``.
    frequency
        Angular frequencies [rad/s] at which to give the response of plant and open loop; they become the dim
        ``frequency``.  The open loop has none above π/sample_time.
    state_space
        Whether to give A and B of x[t+1] = A x[t] + B opening[t], in steps of 1 s.  T_sup is the state ``T_a_1``.

    Returns
    -------
    xarray.Dataset
        opening, T_sup, m_w, wet_volumes, reachable; gain, lag, delay; kp and ti after SIMC, lambda tuning and Ziegler
        and Nichols; ultimate gain and period, gain and phase margin.  The attributes of each say what it is.

    Raises
    ------
    InputError
        With one sentence for each mistake; for an unstable coil; for a result that does not fit in memory.
    """
    points = OperatingPoints(loop, boundary, at)
    with checking() as check:
        w = check.unless_none(_frequencies, "frequency", frequency)
        wants_states = check(flag_of, "state_space", state_space)
        if frequency is not None:
            check(require_pi, points.loop)
        check.problems += _volume_problems(points.loop) if wants_states else []
    sizes = 22 + (0 if w is None else 4 * w.size)
    sizes += (4 * int(np.max(np.asarray(points.loop["n_volumes"], float)))) ** 2 if wants_states else 0
    check_memory(2 * 8 * sizes * points.size, points.size)
    found: dict[str, Array] = {}
    for index in points.chunks():
        columns, conditions = points.columns(index), points.conditions(index)
        plants = plants_of(columns, conditions)
        for name, values in _of(columns, conditions, plants, w, wants_states):
            if name not in found:
                found[name] = np.empty((points.size, *values.shape[1:]), values.dtype)
            found[name][index] = values
    ds = points.dataset({name: (values, _NAMES[name]) for name, values in found.items()})
    if w is not None:
        ds = ds.assign_coords(frequency=("frequency", w, {"long_name": "angular frequency", "units": "rad s-1"}))
    if wants_states:
        names = state_names(int(np.max(np.asarray(points.loop["n_volumes"]))))
        ds = ds.assign_coords(
            state=("state", list(names), {"long_name": "state of the coil, by control volume"}),
            state_before=("state_before", list(names), {"long_name": "state of the coil a second before"}),
        )
    return ds.assign_attrs(title="fastcoil linearised loops", **provenance())


def _of(
    columns: Columns, conditions: Mapping[str, Array], plants: Plants, w: Array | None, wants_states: bool
) -> Iterator[tuple[str, Array]]:
    """Every variable of some points by name."""
    for name in ("opening", "T_sup", "m_w", "wet_volumes", "reachable", "gain"):
        yield name, getattr(plants, name)
    model, margins = first_order(columns, plants), margins_of(columns, plants)
    yield "lag", model.lag
    yield "delay", model.delay
    gains = {
        "simc": simc(columns, plants, model),
        "lambda": calm(columns, plants, model),
        "zn": ziegler_nichols(margins.ultimate_gain, margins.ultimate_period),
    }
    for rule, (kp, ti) in gains.items():
        yield f"kp_{rule}", kp
        yield f"ti_{rule}", ti
    yield from margins._asdict().items()
    if w is not None:
        yield from _response("plant", lambda at: frequency_response(plants.response, at), w)
        yield from _response("loop", lambda at: loop_response(columns, plants, at), w)
    if wants_states:
        system = state_space_of(columns, conditions)
        yield "A", system.A
        yield "B", system.B


def _response(name: str, transfer: Callable[[Array], Complex], w: Array) -> Iterator[tuple[str, Array]]:
    """Magnitude, and phase without jumps, which takes frequencies in between."""
    every = np.union1d(w, np.geomspace(min(_LOWEST, w[0]), w[-1], _FREQUENCIES))
    G = transfer(every)
    phase, there = np.angle(G), np.isfinite(G)
    phase = np.where(there, np.unwrap(np.where(there, phase, 0.0), axis=-1), np.nan)
    at = np.searchsorted(every, w)
    yield f"{name}_magnitude", np.abs(G[:, at])
    yield f"{name}_phase", np.degrees(phase[:, at])


def _frequencies(name: str, value: Any) -> Array:
    cure = "give angular frequencies in rad/s, ascending and above 0"
    with np.errstate(over="ignore"):  # what does not fit is infinite, and refused as such
        w = array_of(name, value, cure).astype(float)
    if w.ndim != 1:
        raise InputError(WrongType(f"{name} = {shown(value)}: {cure}"))
    if not w.size or not (np.isfinite(w).all() and w[0] > 0.0 and (np.diff(w) > 0.0).all()):
        raise InputError(f"{name} = {shown(value)}: {cure}")
    return w


def _volume_problems(loop: Loop) -> list[str]:
    counts = np.unique(np.asarray(loop["n_volumes"]))
    if counts.size < 2:
        return []
    return ["n_volumes is swept, and each value has another number of states: ask for the state space one by one"]
