"""``to_control``: a linearised loop as a system of python-control."""

import math
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_instance
from fastcoil.base.errors import InputError, missing_extra_error
from fastcoil.design.operating_points import require_pi
from fastcoil.loops.loop import Loop


def to_control(linearised: xr.Dataset, loop: Loop | None = None) -> Any:
    """Convert one operating point of ``linearise`` to a system of python-control.

    Parameters
    ----------
    linearised
        Result of ``linearise(…, state_space=True)`` at one point: choose it with ``.sel`` or ``.isel`` from a sweep.
    loop
        The loop that was linearised, for its open loop; what it sweeps is taken from the coordinates of the point.
        None: the plant alone.

    Returns
    -------
    control.StateSpace
        Deviations from rest.  The plant: from ``opening`` to ``T_sup``, K, in steps of 1 s.  The open loop L: from the
        error of the set-point to ``T_measured``, K per K, in steps of the sample time; PI, hold, gap, plant and sensor
        as ``linearise`` has them, with the sign that makes ``control.feedback(L)`` the loop from ``T_set`` to
        ``T_measured``.  For margins give ``control.margin`` its response, ``control.frd(L, w)``: the polynomials of
        some thirty states overflow.

    Raises
    ------
    InputError
        Without a state space, for more than one point, for laws other than the PI, and without python-control.
    """
    with argument_checks() as check:
        check(require_instance, "linearised", linearised, xr.Dataset, "give a result of fc.linearise")
        check.unless_none(require_instance, "loop", loop, Loop, "give the fastcoil.Loop that was linearised, or None")
    if not {"A", "B", "state"} <= {*linearised.variables}:
        sentence = "linearised has no state space: give fc.linearise(…, state_space=True)"
        raise InputError(sentence, "linearised", "missing")
    point = linearised[["A", "B"]].squeeze()
    dims = ", ".join(str(dim) for dim in point.dims if dim not in ("state", "state_before"))
    if dims:
        sentence = f"linearised has several points along {dims}: choose one with .sel or .isel"
        raise InputError(sentence, "linearised", "shape")
    try:
        import control
    except ImportError:
        raise missing_extra_error("to_control", "control", "control") from None
    states, before = ([str(name) for name in np.atleast_1d(point[dim].values)] for dim in ("state", "state_before"))
    if "T_a_1" not in states or sorted(before) != sorted({*states}) or len(states) != len(before):
        sentence = "linearised lacks states, or has one twice: give all of them, as fc.linearise does"
        raise InputError(sentence, "linearised", "shape")
    A, B = point["A"].sel(state_before=states).transpose("state", "state_before").values, point["B"].values
    output_row = np.array([name == "T_a_1" for name in states], float)
    if loop is None:
        names = {"inputs": "opening", "outputs": "T_sup", "states": states, "name": "plant"}
        return control.ss(A, B[:, None], output_row, 0.0, 1.0, **names)
    require_pi(loop)
    parameters = ("sample_time", "sensor_time_constant", "kp", "ti", "backlash")
    ts, tau, kp, ti, backlash = (_value_at(point, loop, name) for name in parameters)
    # the reading a second later is one state more; the PI holds the opening from sample to sample
    decay = math.exp(-1.0 / tau) if tau > 0.0 else 0.0
    output_row = np.append((1.0 - decay) * output_row, decay)
    one_second_map = np.vstack([np.column_stack([A, np.zeros(B.size)]), output_row])
    powers = [np.linalg.matrix_power(one_second_map, k) for k in range(int(ts) + 1)]
    held_input = sum(power @ np.append(B, 0.0) for power in powers[:-1])
    opening_per_stroke = (1.0 if _value_at(point, loop, "action") == "heating" else -1.0) / (1.0 - backlash)
    plant = control.ss(powers[-1], held_input[:, None], opening_per_stroke * output_row, 0.0, ts)
    pi = control.ss(1.0, 1.0, kp * ts / ti, kp * (1.0 + ts / ti), ts)
    L = plant * pi
    L.update_names(inputs="T_set", outputs="T_measured", name="open_loop")
    return L


def _value_at(point: xr.Dataset, loop: Loop, name: str) -> Any:
    """Value of a parameter of the loop at this point."""
    value = np.asarray(point[name] if name in point.coords else loop[name])
    if value.size != 1:
        sentence = f"{name} is swept, and linearised does not say which value it has: keep that coordinate"
        raise InputError(sentence, "linearised", "missing")
    return value.item()
