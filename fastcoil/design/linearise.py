"""linearise: plant, margins and the tuning after SIMC at each operating point."""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_array
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, short_repr
from fastcoil.design.operating_points import OperatingPoints, require_pi
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labelled import accepted_units, to_bare_numbers
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import check_memory
from fastcoil.loops.provenance import provenance

from fastcoil.design.plants import (  # isort: skip
    Columns, Complex, Plants, floats, frequency_response, loop_response, sampled_plant_response, sensor_response,
    stroke_gain, unique_columns,
)  # fmt: skip

_LOWEST_FREQUENCY = 1e-6  # rad/s: any integral has brought L above 1 there


class Margins(NamedTuple):
    """Margins of n loops without a gap, (n,); NaN for a valve that changes nothing or acts the wrong way round."""

    ultimate_gain: Array  # kp at which the loop would keep swinging under a P controller, 1/K
    ultimate_period: Array  # s
    gain_margin: Array  # by how much kp may be multiplied; below 1 the loop is unstable
    phase_margin: Array  # degrees


def margins_of(columns: Columns, plants: Plants) -> Margins:
    """Return the margins of every loop, from the exact transfer function of the sampled loop."""
    margins = Margins(*(np.full(plants.gain.size, math.nan) for _ in Margins._fields))
    (periods,), gain = floats(columns, "sample_time"), stroke_gain(columns, plants)
    for period in np.unique(periods[gain > 0.0]):
        members = np.flatnonzero((periods == period) & (gain > 0.0))
        subset = {name: values[members] for name, values in columns.items()}
        subset_plants = plants.select(members)
        w = np.geomspace(_LOWEST_FREQUENCY, math.pi / period, 800)
        P, kind = sampled_plant_response(subset, subset_plants, w)
        first = np.unique(kind, return_index=True)[1]
        size, w_180 = phase_crossover(np.sign(subset_plants.gain[first])[:, None] * P, w)
        unit = gain[members] / np.abs(subset_plants.gain)
        margins.ultimate_gain[members] = 1.0 / (unit * size[kind])
        margins.ultimate_period[members] = 2.0 * math.pi / w_180[kind]
        L = loop_response(subset, subset_plants, w)
        margins.gain_margin[members] = 1.0 / phase_crossover(L, w)[0]
        margins.phase_margin[members] = _phase_margin(L)
    return margins


def phase_crossover(L: Complex, w: Array) -> tuple[Array, Array]:
    """Largest |L| on the negative real axis, and ω there, (n,) each; the end of L at π/ts is on it."""
    before, after = L[:, :-1].imag, L[:, 1:].imag
    crosses = (before < 0.0) & (after >= 0.0) & (L[:, 1:].real < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, before / (before - after), 0.0)
    size = np.where(crosses, -(L[:, :-1].real + share * (L[:, 1:].real - L[:, :-1].real)), 0.0)
    w_crossover = w[:-1] + share * np.diff(w)
    end = np.maximum(-L[:, -1].real, 0.0)
    size, w_crossover = np.column_stack([size, end]), np.column_stack([w_crossover, np.full(end.size, w[-1])])
    k = np.argmax(size, axis=1)
    rows = np.arange(k.size)
    return np.where(size[rows, k] > 0.0, size[rows, k], math.nan), w_crossover[rows, k]


def _phase_margin(L: Complex) -> Array:
    """Least phase margin over the frequencies at which |L| = 1, degrees."""
    with np.errstate(divide="ignore"):  # a loop with kp = 0 has a size of 0 and no margin
        log_size = np.log(np.abs(L))
    phase = np.unwrap(np.angle(L), axis=1)
    before, after = log_size[:, :-1], log_size[:, 1:]
    crosses = before * after <= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, before / (before - after), 0.0)
    margin = 180.0 + np.degrees(phase[:, :-1] + share * np.diff(phase, axis=1))
    least = np.min(np.where(crosses, margin, np.inf), axis=1)
    return np.where(np.isfinite(least), least, math.nan)


class FirstOrder(NamedTuple):
    """Model from the opening to the measured temperature, gain e^(-delay s)/(1 + lag s); lag and delay (n,), s."""

    lag: Array
    delay: Array


class Gains(NamedTuple):
    """Gains of a PI, kp, 1/K, and ti, s, (n,) each; NaN where the valve changes nothing or acts the wrong way round."""

    kp: Array
    ti: Array


def first_order(columns: Columns, plants: Plants) -> FirstOrder:
    """Reduce the response to a step of the opening, seen through the sensor's lag, to first order with a delay ≥ 0.

    The model meets the response at 35.3 and 85.3 % of its end: Sundaresan and Krishnaswamy, Can. J. Chem. Eng. 56
    (1978), 257-262, who round lag = 0.67 (t2 - t1), delay = 1.3 t1 - 0.29 t2.
    """
    (tau,), early, late = floats(columns, "sensor_time_constant"), 0.353, 0.853
    first, kind = unique_columns(plants.kind, tau)
    with np.errstate(divide="ignore", invalid="ignore"):
        response, gain = plants.response[first], plants.gain[first][:, None]
        n_more = 36000 if np.any(response[:, -1:] / gain < late) else 0  # s
        share = sensor_response(response, tau[first], n_more) / gain
    t1, t2 = _crossing_time(share, early), _crossing_time(share, late)
    lag = (t2 - t1) / math.log((1.0 - early) / (1.0 - late))
    return FirstOrder(lag[kind], np.maximum(t1 + lag * math.log(1.0 - early), 0.0)[kind])


def integral_speed(columns: Columns, plants: Plants, model: FirstOrder) -> Array:
    """Speed of the integral, (kp K)^0.7 (T + 2 θ)/ti, fitted to loops with a gap: docs/findings/hunting.md."""
    kp, ti = floats(columns, "kp", "ti")
    gain = np.maximum(kp * stroke_gain(columns, plants), 0.0)
    return np.asarray(gain**0.7 * (model.lag + 2.0 * _dead_time(columns, model)) / ti)


def simc(columns: Columns, plants: Plants, model: FirstOrder) -> Gains:
    """Skogestad's SIMC with the closed-loop time constant equal to the dead time θ.

    kp = lag/(2 K θ), ti = min(lag, 8 θ).  S. Skogestad: Simple analytic rules for model reduction and PID controller
    tuning.  J. Process Control 13 (2003), 291-309, eqs 23 and 24.
    """
    dead_time, gain = _dead_time(columns, model), stroke_gain(columns, plants)
    ti = np.minimum(model.lag, 8.0 * dead_time)
    is_acting = (gain > 0.0) & (ti > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        kp = model.lag / (2.0 * dead_time) / gain
    return Gains(np.where(is_acting, kp, np.nan), np.where(is_acting, ti, np.nan))


def _dead_time(columns: Columns, model: FirstOrder) -> Array:
    """Dead time θ, s: a controller acts half a sample time late on average."""
    return np.asarray(model.delay + 0.5 * np.asarray(columns["sample_time"], float))


def _crossing_time(share: Array, level: float) -> Array:
    """Seconds after the step at which each row, from second 1 on, first reaches a level; linear between seconds."""
    from_zero = np.concatenate([np.zeros((share.shape[0], 1)), share], axis=1)
    k = np.maximum(np.argmax(from_zero >= level, axis=1), 1)
    rows = np.arange(k.size)
    below, above = from_zero[rows, k - 1], from_zero[rows, k]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(above >= level, k - 1 + (level - below) / (above - below), np.nan)


_NO_GAP_NOTE = "without the gap, the motor's stroke time and the inverse"
_RULE_NOTE = "for a plain PI; dead time: delay + sample_time/2; NaN if the valve changes nothing or acts the wrong way"
_FIRST_ORDER_NOTE = "first order plus delay, through 35.3 and 85.3 % of the response (Sundaresan, Krishnaswamy 1978)"
_VARIABLES = {  # long_name, units, comment
    "opening": ("opening at which T_sup rests at T_set", "1", ""),
    "T_sup": ("supply air temperature at rest", "degC", ""),
    "m_w": ("water flow", "kg s-1", ""),
    "wet_volumes": ("number of wet control volumes", "1", "share of time for one that is wet and dry by turns"),
    "reachable": ("whether an opening holds the set-point", "1", "where False, the opening is 0 or 1, whichever is "
        "nearer; or T_sup jumps past it, and gain is NaN"),
    "gain": ("gain from the opening to T_sup", "K", "per unit opening"),
    "lag": ("lag of the plant and its sensor", "s", _FIRST_ORDER_NOTE),
    "delay": ("delay of the plant and its sensor", "s", "as lag; the controller's sample time is not in it"),
    "kp_simc": ("kp after SIMC", "K-1", f"lag/(2 gain dead time), {_RULE_NOTE}"),
    "ti_simc": ("ti after SIMC", "s", "min(lag, 8 dead time)"),
    "ultimate_gain": ("ultimate gain of a P controller", "K-1", f"at this sample time, {_NO_GAP_NOTE}"),
    "ultimate_period": ("ultimate period of a P controller", "s", ""),
    "gain_margin": ("gain margin", "1", f"kp may grow by this factor until the loop swings, {_NO_GAP_NOTE}; below 1 it "
        "is unstable"),
    "phase_margin": ("phase margin", "degree", f"{_NO_GAP_NOTE}; NaN where |L| is above 1 at every frequency"),
    "plant_magnitude": ("gain from the opening to T_sup", "K", ""),
    "plant_phase": ("phase from the opening to T_sup", "degree", "unwrapped from the lowest frequency on"),
    "loop_magnitude": ("gain of the open loop L", "1", ""),
    "loop_phase": ("phase of the open loop L", "degree", "unwrapped from the lowest frequency on"),
}  # fmt: skip


def _attributes(name: str) -> dict[str, Any]:
    """Attributes of a variable, and its dims beyond those of the points."""
    texts = zip(("long_name", "units", "comment"), _VARIABLES[name], strict=True)
    dims = ("frequency",) if name.endswith(("_magnitude", "_phase")) else ()
    return {key: text for key, text in texts if text} | {"dims": dims}


def linearise(loop: Loop, boundary: Boundary, *, at: Any = None, frequency: Any = None) -> xr.Dataset:
    """Linearise every loop of ``loop`` where it rests at its set-point on every day of ``boundary``.

    The plant is the emulator's own one-second step, differentiated.  Controller and sensor are sampled as in the
    emulator.

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

    Returns
    -------
    xarray.Dataset
        opening, T_sup [°C], m_w [kg/s], wet_volumes, reachable; gain [K], lag and delay [s] of the plant; kp [1/K] and
        ti [s] after SIMC (Skogestad 2003, doi:10.1016/S0959-1524(02)00062-8); ultimate gain [1/K] and period [s], gain
        and phase margin [°].  The attributes of each say what it is.

    Raises
    ------
    InputError
        With one sentence for each mistake; for an unstable coil; for a result that does not fit in memory.

    Examples
    --------
    >>> loop, day = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.07]), fc.constant_day(hours=1)
    >>> linear = fc.linearise(loop, day)
    >>> linear.kp_simc.values.round(3).tolist(), linear.gain_margin.values.round(1).tolist()
    ([0.035, 0.032], [13.2, 12.3])
    """
    points = OperatingPoints(loop, boundary, at)
    with argument_checks() as check:
        w = check.unless_none(_parse_frequencies, "frequency", frequency)
        if frequency is not None:
            check(require_pi, points.loop)
    values_per_point = 18 + (0 if w is None else 4 * w.size)
    check_memory(2 * 8 * values_per_point * points.size, points.size)
    variables = points.evaluate(lambda columns, plants: _variables_of_points(columns, plants, w))
    ds = points.dataset({name: (values, _attributes(name)) for name, values in variables.items()})
    if w is not None:
        ds = ds.assign_coords(frequency=("frequency", w, {"long_name": "angular frequency", "units": "rad s-1"}))
    return ds.assign_attrs(title="fastcoil linearised loops", **provenance())


def _variables_of_points(columns: Columns, plants: Plants, w: Array | None) -> Iterator[tuple[str, Array]]:
    """Yield every variable of some operating points by name."""
    for name in ("opening", "T_sup", "m_w", "wet_volumes", "reachable", "gain"):
        yield name, getattr(plants, name)
    model, margins = first_order(columns, plants), margins_of(columns, plants)
    yield from model._asdict().items()
    gains = simc(columns, plants, model)
    yield from (("kp_simc", gains.kp), ("ti_simc", gains.ti))
    yield from margins._asdict().items()
    if w is not None:
        yield from _magnitude_and_phase("plant", lambda at: frequency_response(plants.response, at), w)
        yield from _magnitude_and_phase("loop", lambda at: loop_response(columns, plants, at), w)


def _magnitude_and_phase(name: str, transfer: Callable[[Array], Complex], w: Array) -> Iterator[tuple[str, Array]]:
    """Yield the magnitude, and the phase without jumps, which takes 400 frequencies in between."""
    frequencies = np.union1d(w, np.geomspace(min(_LOWEST_FREQUENCY, w[0]), w[-1], 400))
    G = transfer(frequencies)
    phase, is_finite = np.angle(G), np.isfinite(G)
    phase = np.where(is_finite, np.unwrap(np.where(is_finite, phase, 0.0), axis=-1), np.nan)
    places = np.searchsorted(frequencies, w)
    yield f"{name}_magnitude", np.abs(G[:, places])
    yield f"{name}_phase", np.degrees(phase[:, places])


def _parse_frequencies(name: str, value: Any) -> Array:
    cure = "give angular frequencies in rad/s, ascending and above 0"
    sentence = f"{name} = {short_repr(value)}: {cure}"
    with np.errstate(over="ignore"):  # what does not fit is infinite, and refused as such
        w = require_array(name, to_bare_numbers(name, value, accepted_units("rad s-1")), cure).astype(float)
    if w.ndim != 1:
        raise InputError(sentence, name, "type")
    if not w.size or not (np.isfinite(w).all() and w[0] > 0.0 and (np.diff(w) > 0.0).all()):
        raise InputError(sentence, name, "value")
    return w
