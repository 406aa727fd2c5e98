"""``fit_coil``: C_c, C_w, β1 … β6 of Eqs (3) and (4) from recorded flows and temperatures (section 2.2)."""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, choice_of, names_of, number_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import shown
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.logs.series import HUMIDITIES
from fastcoil.loops.loop import Loop
from fastcoil.measured.coil_problem import COIL, LN_C_W, LOGS, CoilProblem, in_operation, record_of
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, finished, natural_interval
from fastcoil.measured.part import checked_part
from fastcoil.model.metric_table import WARM_UP
from fastcoil.model.parameter_table import PARAMETERS

OUTPUTS = {"T_sup": ("T_sup",), "both": ("T_sup", "T_w_out")}
_INPUTS = ("m_w", "m_a", "T_w_in", "T_a_in", *HUMIDITIES)
_NEEDED = ("m_w", "m_a", "T_w_in", "T_a_in", HUMIDITIES, "T_sup")
_NOTHING = 5.0  # half an interval this wide means nothing: a factor of 150, or an exponent
_MARCH = ("n_volumes", "air_march", "substeps")
_STABLE = "at the stability limit (γ = 1 at the largest flow)"


@np.errstate(all="ignore")
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
        CSV file, DataFrame or Dataset.  Needed: ``m_w``, ``m_a``, ``T_w_in``, ``T_a_in``, one of ``W_a_in``,
        ``RH_a_in``, ``T_dp_in``, ``T_sup``, and ``elapsed_time`` or ``timestamp``; optional: ``T_w_out`` and
        ``enabled``.  Samples are 1 s apart or more.  After a gap, and after a time without air flow or ``enabled``, the
        model starts again from ``T_initial``.
    minimise_on
        ``T_sup`` as in the paper, or ``both`` to compare the leaving water too.
    warm_up, T_initial
        Seconds left out at each start of the model [s], and all temperatures there [degC].
    n_volumes, air_march, substeps, pressure
        Of the model, see ``fc.parameters()``.  Fit with those that the loop will have: parameters take up the error of
        the march that they were fitted with.
    holds
        Name or names of inputs that hold between samples; the others run straight.
    split, validation
        As in ``fc.fit_valve``; the pieces between gaps are its batches.
    units, columns, constants, drop, jumps, max_gap, time_format
        How the log is read: see ``fastcoil.logs.Reading``.

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
        minimise_on = check(choice_of, "minimise_on", minimise_on, OUTPUTS)
        warm_up = check(number_of, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        held_inputs = check(_held_inputs, holds)
        loop = check(Loop, n_volumes=n_volumes, air_march=air_march, substeps=substeps, pressure=pressure,
                     T_initial=T_initial)  # fmt: skip
        for name, array in loop.swept.items() if loop else ():
            check.problems.append(f"{name} = {shown(array.values.tolist())}: give one value")
        how = checked_reading(check, columns=columns, units=units, constants=constants, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
        part = checked_part(check, split, validation)
    both = minimise_on == "both"
    wanted = Wanted(
        needed=(*_NEEDED, "T_w_out") if both else _NEEDED,
        optional=("enabled",) if both else ("enabled", "T_w_out"),
        measured=("T_sup", "T_w_out"),
    )
    data = part.read(log, wanted, how, in_operation)
    if "T_w_out" in data.values and not both:
        data.notes.append(
            "T_w_out is compared, but only the error of T_sup is minimised: minimise_on='both', --both uses it too"
        )
    record = record_of(data, loop, held_inputs, part.fitted(data))
    problem = CoilProblem(data, record, OUTPUTS[minimise_on], warm_up, part, held_inputs)
    return _fit_of(problem, started)


def _held_inputs(holds: Any) -> tuple[str, ...]:
    """The inputs that hold, under the names that the model has for them."""
    nothing = holds is None or (isinstance(holds, Sequence) and not holds)
    names = [] if nothing else [choice_of("holds", name, _INPUTS) for name in names_of("holds", holds)]
    return tuple("W_a_in" if name in HUMIDITIES else name for name in names)


def _fit_of(problem: CoilProblem, started: float) -> Fit:
    record, data, notes = problem.record, problem.data, problem.notes
    best, spread, wet = problem.solve()
    x = problem.coupling @ best.x[:, None]
    values = record.values(x)[:, 0]
    A = record.named() @ problem.coupling
    y, spread_y = A @ x[:, 0], A @ np.nan_to_num(spread.covariance, posinf=0.0) @ A.T
    half = spread.quantile() * np.sqrt(np.diag(spread_y))
    scale = np.where(LOGS, values, 1.0)
    covariance = spread_y * np.outer(scale, scale)

    held = {COIL[k]: why for k, why in sorted(problem.held.items())}
    for k, variance in enumerate(np.diag(spread.covariance)):
        if math.isinf(variance) or half[k] > _NOTHING:
            held.setdefault(COIL[k], NOT_UNIQUE)
        if math.isnan(variance):
            held.setdefault(COIL[k], _STABLE if k == LN_C_W and best.x[k] < problem.prior[k] else AT_BOUND)
    estimated = [k for k, name in enumerate(COIL) if name not in held]

    series, errors = _compared(problem, x)
    notes.append(f"{100 * (wet > 0).mean():.0f} % of the fitted samples have wet volumes, {wet.mean():.1f} on average")
    most = record.limits.m_w_max
    notes.append(f"stable up to the {most:.3g} kg/s of water in the part fitted; for more, raise C_w in proportion")
    marched = {n: record.loop[n] for n in _MARCH if record.loop[n] != PARAMETERS[n].default}
    if marched:
        given = ", ".join(f"{name} = {value!r}" for name, value in marched.items())
        notes.append(f"fitted with {given}: give the loop the same, the parameters belong to it")
    return finished(
        data, started, problem.compared["T_sup"], problem.fitting, errors, series, [COIL[k] for k in estimated],
        covariance[np.ix_(estimated, estimated)], kind="coil", parameters=dict(zip(COIL, values.tolist(), strict=True)),
        intervals={COIL[k]: natural_interval(y[k], half[k], bool(LOGS[k])) for k in estimated},
        profile=None, held=held, notes=notes, n_used=spread.n_used, n_effective=spread.n_effective,
    )  # fmt: skip


def _compared(problem: CoilProblem, x: Array) -> tuple[dict[str, tuple[Array, str]], dict[str, Array]]:
    """Measured and modelled series with their units, and the errors that count."""
    data, compared = problem.data, problem.compared
    found = {name: values[:, 0] for name, values in problem.record.run(x).items()}
    if problem.record.unstable(x, problem.record.limits_of_all)[0]:
        for values in found.values():
            values[~problem.fitting] = np.nan
        problem.notes.append(
            f"not validated: the coil is unstable at the flows of the part held back, up to "
            f"{problem.record.limits_of_all.m_w_max:.3g} kg/s of water: fit a part that has such flows"
        )
    series: dict[str, tuple[Array, str]] = {}
    errors: dict[str, Array] = {}
    for name, ending in (("T_sup", ""), ("T_w_out", "_T_w_out")):
        modelled, measured = found[name], data.values.get(name, np.full(data.time.size, np.nan))
        series |= {name: (measured, "degC"), f"{name}_modelled": (modelled, "degC")}
        series[f"{name}_residual"] = measured - modelled, "K"
        errors[ending] = np.where(compared.get(name, False), modelled - measured, np.nan)
    series["wet_volumes"] = found["wet_volumes"], "1"
    return series | {name: (data.values[name], "kg s-1") for name in ("m_w", "m_a")}, errors
