"""``fit_coil``: C_c, C_w, β1 … β6 of Eqs (3) and (4) from recorded flows and temperatures (section 2.2)."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fastcoil.arguments import is_number
from fastcoil.calibrate.coil_problem import CoilProblem
from fastcoil.calibrate.coil_record import in_operation, record_of
from fastcoil.calibrate.coil_result import coil_fit
from fastcoil.calibrate.data import Log, read_log
from fastcoil.calibrate.result import Fit
from fastcoil.errors import InputError, shown
from fastcoil.outputs import WARM_UP
from fastcoil.simulation.loop import Loop

HUMIDITY = ("W_a_in", "RH_a_in", "T_dp_in")
OUTPUTS = {"T_sup": ("T_sup",), "both": ("T_sup", "T_w_out")}


def fit_coil(
    log: Any,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    minimise_on: str = "T_sup",
    warm_up: float = WARM_UP,
    T_initial: float = 20.0,
    n_volumes: int = 8,
    air_march: str = "lagged",
    pressure: float = 101325.0,
    holds: str | Sequence[str] | None = None,
    split: float | None = None,
    fit_until: float | None = None,
    validation: Any = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
) -> Fit:
    """Fit the eight parameters of a coil to a log of its flows and temperatures.

    Parameters
    ----------
    log
        Path of a CSV file, or a Dataset: ``m_w``, ``m_a``, ``T_w_in``, ``T_a_in``, one of ``W_a_in``, ``RH_a_in``,
        ``T_dp_in``, ``T_sup``, if there ``T_w_out`` and ``enabled``, and ``elapsed_time`` or ``timestamp``; samples 1 s
        apart or more.  After a gap, and after a time without air flow or ``enabled``, the record begins anew.
    units, columns, constants
        As in ``fc.Boundary.from_csv``.
    minimise_on
        ``T_sup`` as in the paper, or ``both`` for the leaving water as well.
    warm_up, T_initial
        Seconds left out wherever the record begins [s], and all temperatures there [degC].
    n_volumes, air_march, pressure
        Of the model, see ``fc.parameters()``.
    holds
        Name or names of inputs that hold between samples; the others run straight.
    split, fit_until
        Share of the log that is fitted (of its pieces, if there are at least four), 0.7 if left out, the rest is held
        back for validation; or the last second that is fitted.
    validation
        Another log, of the same columns, to validate with; then all of the first is fitted.
    drop, jumps, max_gap
        What to do with bad rows, with time that goes back and with gaps: see ``fastcoil.calibrate.data.read_log``.

    Returns
    -------
    Fit
        All eight parameters, as for 8 control volumes; those that the data do not identify are held at a stated
        prior, see ``held``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Notes
    -----
    Cai and Braun (2016), section 2.2: start at 20 °C, the first 1,800 s left out, T_sup alone minimised.  A trial set
    that is unstable at the recorded flows gets a large residual.
    """
    began = time.perf_counter()
    if minimise_on not in tuple(OUTPUTS):
        raise InputError(f"minimise_on = {minimise_on!r}: choose 'T_sup' or 'both'")
    inputs = ("m_w", "m_a", "T_w_in", "T_a_in", *HUMIDITY)
    one = isinstance(holds, str) or not isinstance(holds, Iterable)
    names: tuple[Any, ...] = () if holds is None else (holds,) if one else tuple(holds)
    wrong = [f"holds has {n!r}: choose from {', '.join(inputs)}" for n in names if n not in inputs]
    if not (is_number(warm_up) and warm_up >= 0.0):
        wrong.append(f"warm_up = {warm_up!r}: give a number of seconds, 0 or more")
    if wrong:
        raise InputError(wrong)
    loop = Loop(n_volumes=n_volumes, air_march=air_march, pressure=pressure, T_initial=T_initial)
    if loop.swept:
        raise InputError(
            [f"{name} = {shown(array.values.tolist())}: give one value" for name, array in loop.swept.items()]
        )
    needed: list[str | tuple[str, ...]] = ["m_w", "m_a", "T_w_in", "T_a_in", HUMIDITY, "T_sup"]
    optional = ["enabled"] if minimise_on == "both" else ["enabled", "T_w_out"]
    needed += ["T_w_out"] if minimise_on == "both" else []

    def read(source: Any) -> Log:
        return in_operation(
            read_log(
                source, needed, measured=("T_sup", "T_w_out"), optional=optional, units=units, columns=columns,
                constants=constants, drop=drop, jumps=jumps, max_gap=max_gap,
            )
        )  # fmt: skip

    data = read(log) if validation is None else read(log).followed_by(read(validation))
    held_series = tuple("W_a_in" if n in HUMIDITY else n for n in names)
    problem = CoilProblem(
        data, record_of(data, loop, held_series), OUTPUTS[minimise_on], warm_up, split, fit_until, held_series
    )
    return coil_fit(problem, *problem.solve(), began)
