"""``fit_coil``: C_c, C_w, β1 … β6 of Eqs (3) and (4) from recorded flows and temperatures (section 2.2)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from fastcoil.base.arguments import checking, choice_of, number_of, plain
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.logs import Log, read_log
from fastcoil.logs.arguments import Wanted, log_of
from fastcoil.logs.series import HUMIDITIES
from fastcoil.logs.timestamps import time_format_of
from fastcoil.loops.loop import Loop
from fastcoil.measured.fit.arguments import check_reading, split_of
from fastcoil.measured.fit.coil_problem import CoilProblem
from fastcoil.measured.fit.coil_record import in_operation, record_of
from fastcoil.measured.fit.coil_result import coil_fit
from fastcoil.measured.fit.result import Fit
from fastcoil.measured.fit.split import fitted_part, validated_with
from fastcoil.model.metric_table import WARM_UP

OUTPUTS = {"T_sup": ("T_sup",), "both": ("T_sup", "T_w_out")}
_INPUTS = ("m_w", "m_a", "T_w_in", "T_a_in", *HUMIDITIES)
_NEEDED = ("m_w", "m_a", "T_w_in", "T_a_in", HUMIDITIES, "T_sup")


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
    substeps: int = 1,
    pressure: float = 101325.0,
    holds: str | Sequence[str] | None = None,
    split: float | None = None,
    fit_until: float | None = None,
    validation: Any = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
) -> Fit:
    """Fit the eight parameters of a coil to a log of its flows and temperatures.

    Parameters
    ----------
    log
        Path of a CSV file, or a Dataset.  Needed: ``m_w``, ``m_a``, ``T_w_in``, ``T_a_in``, one of ``W_a_in``,
        ``RH_a_in``, ``T_dp_in``, ``T_sup``, and ``elapsed_time`` or ``timestamp``; optional: ``T_w_out`` and
        ``enabled``.  Samples are 1 s apart or more.  After a gap, and after a time without air flow or ``enabled``, the
        model starts again from ``T_initial``.
    units, columns, constants
        As in ``fc.Boundary.from_csv``.
    minimise_on
        ``T_sup`` as in the paper, or ``both`` to compare the leaving water too.
    warm_up, T_initial
        Seconds left out at each start of the model [s], and all temperatures there [degC].
    n_volumes, air_march, substeps, pressure
        Of the model, see ``fc.parameters()``.  Fit with those that the loop will have: parameters take up the error of
        the march that they were fitted with.
    holds
        Name or names of inputs that hold between samples; the others run straight.
    split, fit_until
        Share of the log that is fitted (of its pieces, if it has at least four), 0.7 if left out; or the last second
        that is fitted.  The rest is held back for validation.
    validation
        Another log, of the same columns, to validate with; then all of the first is fitted, or all up to
        ``fit_until``.  It has no influence on the fit.
    drop, jumps, max_gap
        What to do with bad rows, with time that goes back and with gaps: see ``fastcoil.logs.read_log``.
    time_format
        How ``timestamp`` is written, as in ``fc.Boundary.from_csv``.

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
    started = time.perf_counter()
    with checking() as check:
        log = check(log_of, "log", log)
        validation = check.unless_none(log_of, "validation", validation)
        minimise_on = check(choice_of, "minimise_on", minimise_on, OUTPUTS)
        warm_up = check(number_of, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        held_inputs = check(_held_inputs, holds)
        loop = check(Loop, n_volumes=n_volumes, air_march=air_march, substeps=substeps, pressure=pressure,
                     T_initial=T_initial)  # fmt: skip
        for name, array in loop.swept.items() if loop else ():
            check.problems.append(f"{name} = {shown(array.values.tolist())}: give one value")
        check_reading(check, units=units, columns=columns, constants=constants, drop=drop, jumps=jumps, max_gap=max_gap)
        time_format = check.unless_none(time_format_of, "time_format", time_format)
        split, fit_until = split_of(check, split, fit_until)
    both = minimise_on == "both"
    wanted = Wanted(
        needed=(*_NEEDED, "T_w_out") if both else _NEEDED,
        optional=("enabled",) if both else ("enabled", "T_w_out"),
        measured=("T_sup", "T_w_out"),
    )

    def read(source: Any) -> Log:
        found = read_log(
            source,
            wanted,
            units=units,
            columns=columns,
            constants={} if constants is None else constants,
            drop=drop,
            jumps=jumps,
            max_gap=max_gap,
            time_format=time_format,
            has_command=True,
        )
        return in_operation(found)

    data = read(log)
    if validation is not None:
        data, fit_until = validated_with(data, read(validation), fit_until), None
    if "T_w_out" in data.values and not both:
        data.notes.append(
            "T_w_out is compared, but only the error of T_sup is minimised: minimise_on='both', --both uses it too"
        )
    record = record_of(data, loop, held_inputs, fitted_part(data, split, fit_until))
    problem = CoilProblem(data, record, OUTPUTS[minimise_on], warm_up, split, fit_until, held_inputs)
    return coil_fit(problem, problem.solve(), started)


def _held_inputs(holds: Any) -> tuple[str, ...]:
    """The inputs that hold, under the names that the model has for them."""
    try:
        # an endless generator has to end
        names = () if holds is None else (holds,) if isinstance(holds, str) else tuple(islice(holds, len(_INPUTS) + 1))
    except Exception:  # nothing to iterate over; a user's class may raise anything
        names = (holds,)
    wrong = [name for name in map(plain, names) if not (isinstance(name, str) and name in _INPUTS)]
    known = f"choose from {', '.join(_INPUTS)}"
    if wrong:
        sentences = {isinstance(name, str): f"holds has {shown(name)}: {known}" for name in wrong}
        raise InputError([text if of_text else WrongType(text) for of_text, text in sentences.items()])
    return tuple("W_a_in" if name in HUMIDITIES else name for name in names)
