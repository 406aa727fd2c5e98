"""``fit_coil``: C_c, C_w, β1 … β6 of Eqs (3) and (4) from recorded flows and temperatures (section 2.2).

The coil runs over the log, resampled at 1 s, with many parameter sets at once.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import argument_checks, require_choice, require_names, require_number
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import CheckedLog, as_log
from fastcoil.logs.pieces import require_whole_seconds, resample_at_seconds
from fastcoil.logs.series import HUMIDITY_COLUMNS, describe_first_row, format_count
from fastcoil.loops.clashes import wet_slope
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.loops.simulate import call_with_timeout
from fastcoil.measured.agreement import require_agreement
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, build_fit, natural_intervals
from fastcoil.measured.least_squares import Estimate, Model, Uncertainty, minimise, uncertainty
from fastcoil.measured.part import LogSource, fitting_mask, leave_out_repeats, require_split, split_segments
from fastcoil.model.engine.coil import stability_numbers
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.recorded import COIL_COLUMNS, run_coil
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.metric_table import WARM_UP_S

COIL_PARAMETERS = ("C_w", "C_c", "beta1", "beta2", "beta3", "beta4", "beta5", "beta6")
IS_LOGARITHMIC = np.array([True, True, True, False, True, False, True, False])  # which are searched by their logarithm
LN_C_W, LN_C_C, LN_NTU_W, BETA2, LN_NTU_A, BETA4, LN_NTU_STAR, BETA6 = range(8)
"""Indices of a searched set: numbers of transfer units at the typical flow stand for the factors of the exponents."""
COUPLED_PARAMETERS = {LN_NTU_STAR: LN_NTU_A, BETA6: BETA4}
"""Parameters that the data may not separate: the first is then held at the value of the second."""
MODEL_OUTPUTS = ("T_sup", "T_w_out", "wet_volumes")  # °C, °C, number of wet volumes
_MEASURED_OUTPUTS = ("T_sup", "T_w_out")
_FLOWS_AND_TEMPERATURES = ("m_w", "m_a", "T_w_in", "T_a_in")
_HELD_AS_DRY = "as that of heat alone"


@np.errstate(all="ignore")
def fit_coil(
    log: LogSource,
    *,
    warm_up: float = WARM_UP_S,
    T_initial: float = 20.0,
    n_volumes: int = 8,
    air_march: str = "quasistatic",
    substeps: int = 1,
    pressure: float = 101325.0,
    holds: str | Sequence[str] | None = None,
    split: float | None = None,
) -> Fit:
    """Fit the eight parameters of a coil to a log of its flows and temperatures.

    Parameters
    ----------
    log : path, DataFrame, Dataset or Log
        Needed: ``m_w``, ``m_a``, ``T_w_in``, ``T_a_in``, one of ``W_a_in``, ``RH_a_in``, ``T_dp_in``, ``T_sup``, and
        ``elapsed_time`` or ``timestamp``; optional: ``T_w_out`` and ``enabled``.  Samples are 1 s apart or more.  After
        a gap, and after a time without air flow or ``enabled``, the model restarts from ``T_initial``.  `read_log` has
        the options of reading.
    warm_up : float, default 1800
        Time left out at each start of the model, s.
    T_initial : float, default 20
        All temperatures of the model at its start, °C.
    n_volumes, air_march, substeps, pressure
        Of the model, see `parameters`.  The first three are in ``Fit.parameters``: the fitted parameters compensate the
        error of their march, and belong to it.
    holds : str or sequence of str, optional
        Inputs that hold between samples; the others run straight.
    split
        As in `fit_valve`; the pieces between gaps are the batches.

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

    Examples
    --------
    >>> day, loop = fc.paper_day(hours=0.5), fc.Loop(n_volumes=2)
    >>> ds = fc.simulate(loop, day, traces=["m_w", "T_sup"], warm_up=300)[["m_w", "T_sup"]]
    >>> log = ds.merge(day.to_dataset()[["m_a", "T_a_in", "W_a_in", "T_w_in"]])
    >>> fit = fc.fit_coil(log.isel(elapsed_time=slice(None, None, 5)), warm_up=300, n_volumes=2)
    >>> f"{fit.rmse['fit']:.2f} {fit.unit}"
    '0.01 K'
    """
    start_time = time.perf_counter()
    with argument_checks() as check:
        log = check(as_log, "log", log)
        warm_up = check(require_number, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        held_inputs = check(_require_held_inputs, holds)
        loop = check(Loop, n_volumes=n_volumes, air_march=air_march, substeps=substeps, pressure=pressure,
                     T_initial=T_initial)  # fmt: skip
        for name, array in loop.swept.items() if loop else ():
            sentence = f"{name} = {short_repr(array.values.tolist())}: give one value"
            check.problems.append(Problem(sentence, name, "value"))
        share = check(require_split, split)
    required: list[str | tuple[str, ...]] = [*_FLOWS_AND_TEMPERATURES, HUMIDITY_COLUMNS, "T_sup"]
    data = drop_idle_samples(log.read(ColumnSpec(required, ("enabled", "T_w_out"), _MEASURED_OUTPUTS)))
    fitting = fitting_mask(data, share)
    record = build_record(data, loop, held_inputs, fitting)
    return _assemble_fit(CoilProblem(data, record, warm_up, fitting, held_inputs), start_time)


def _require_held_inputs(holds: Any) -> tuple[str, ...]:
    """Check the inputs that hold, under the names that the model has for them."""
    is_empty = holds is None or (isinstance(holds, Sequence) and not holds)
    names = [] if is_empty else require_names("holds", holds)
    for name in names:
        require_choice("holds", name, (*_FLOWS_AND_TEMPERATURES, *HUMIDITY_COLUMNS))
    return tuple("W_a_in" if name in HUMIDITY_COLUMNS else name for name in names)


def _assemble_fit(problem: CoilProblem, start_time: float) -> Fit:
    record, data, notes = problem.record, problem.data, problem.notes
    best, spread, wet = problem.solve()
    x = problem.coupling @ best.x[:, None]
    values = record.coil_parameters(x)[:, 0]
    A = record.coil_matrix() @ problem.coupling
    y, spread_y = A @ x[:, 0], A @ np.nan_to_num(spread.covariance, posinf=0.0) @ A.T
    half = spread.quantile() * np.sqrt(np.diag(spread_y))
    scale = np.where(IS_LOGARITHMIC, values, 1.0)
    covariance = spread_y * np.outer(scale, scale)

    held = {COIL_PARAMETERS[k]: why for k, why in sorted(problem.held.items())}
    for k, variance in enumerate(np.diag(spread.covariance)):
        if math.isinf(variance) or half[k] > 5.0:  # a factor of 150, or an exponent
            held.setdefault(COIL_PARAMETERS[k], NOT_UNIQUE)
        if math.isnan(variance):
            is_just_stable = k == LN_C_W and best.x[k] < problem.prior[k]
            why = "at the stability limit (γ = 1 at the largest flow)" if is_just_stable else AT_BOUND
            held.setdefault(COIL_PARAMETERS[k], why)

    series, errors = _compare_series(problem, x)
    notes.append(f"{100 * (wet > 0).mean():.0f} % of the fitted samples have wet volumes, {wet.mean():.1f} on average")
    largest = f"{record.limits.m_w_max:.3g} kg/s"
    notes.append(f"stable up to the {largest} of water in the part fitted; for more, raise C_w in proportion")
    march = {name: record.loop[name] for name in ("air_march", "n_volumes", "substeps")}
    return build_fit(
        data, start_time, problem.compared["T_sup"], problem.fitting, errors, series, COIL_PARAMETERS, covariance, held,
        natural_intervals(y, half, IS_LOGARITHMIC), kind="coil", notes=notes, profile=None,
        parameters=dict(zip(COIL_PARAMETERS, values.tolist(), strict=True)) | march,
        n_used=spread.n_used, n_effective=spread.n_effective,
    )  # fmt: skip


def _compare_series(problem: CoilProblem, x: Array) -> tuple[dict[str, tuple[Array, str]], dict[str, Array]]:
    """Measured and modelled series with their units, and the errors that count."""
    data, compared = problem.data, problem.compared
    model_outputs = {name: values[:, 0] for name, values in problem.record.run(x).items()}
    if problem.record.is_unstable(x, problem.record.limits_of_all)[0]:
        for values in model_outputs.values():
            values[~problem.fitting] = np.nan
        flows = f"the flows of the part held back, up to {problem.record.limits_of_all.m_w_max:.3g} kg/s of water"
        problem.notes.append(f"not validated: the coil is unstable at {flows}: fit a part that has such flows")
    series, errors = dict[str, tuple[Array, str]](), dict[str, Array]()
    for name, ending in (("T_sup", ""), ("T_w_out", "_T_w_out")):
        modelled, measured = model_outputs[name], data.values.get(name, np.full(data.time.size, np.nan))
        series |= {name: (measured, "degC"), f"{name}_modelled": (modelled, "degC")}
        series[f"{name}_residual"] = measured - modelled, "K"
        errors[ending] = np.where(compared.get(name, False), modelled - measured, np.nan)
    series["wet_volumes"] = model_outputs["wet_volumes"], "1"
    return series | {name: (data.values[name], "kg s-1") for name in ("m_w", "m_a")}, errors


class RecordPiece(NamedTuple):
    """An unbroken piece of a record: series (n_steps, 5) as ``COIL_COLUMNS``; ``at`` (n,), second of each sample."""

    series: Array
    at: Index


class StabilityLimits(NamedTuple):
    """What decides whether a coil is stable."""

    m_w_max: float  # kg/s
    m_a_span: tuple[float, float]  # kg/s
    wet_slope: float  # largest dh_s/dT


@dataclass(frozen=True)
class CoilRecord:
    """Series that enter the coil at every second, and the seconds of the samples."""

    pieces: tuple[RecordPiece, ...]  # each starts from ``T_initial``
    loop: Loop
    m_w: float  # typical flows of the part to fit, kg/s
    m_a: float
    limits: StabilityLimits  # in the part to fit
    limits_of_all: StabilityLimits

    def take_samples(self, n_samples: int) -> CoilRecord:
        """The record up to its first samples."""
        kept = []
        for piece in self.pieces:
            if (seconds := piece.at[: max(n_samples, 0)]).size:
                kept.append(RecordPiece(piece.series[: int(seconds[-1]) + 1], seconds))
            n_samples -= piece.at.size
        return replace(self, pieces=tuple(kept))

    def coil_matrix(self) -> Array:
        """Matrix from a searched set to (the logarithms of) ``COIL_PARAMETERS``: ln β = ln NTU - β' ln m."""
        A = np.eye(8)
        A[LN_NTU_W, BETA2] = -math.log(self.m_w)
        A[LN_NTU_A, BETA4] = A[LN_NTU_STAR, BETA6] = -math.log(self.m_a)
        return A

    def coil_parameters(self, sets: Array) -> Array:
        """``COIL_PARAMETERS`` of searched sets, (8, sets)."""
        y = self.coil_matrix() @ sets
        return np.where(IS_LOGARITHMIC[:, None], np.exp(np.minimum(y, 50.0)), y)

    def run(self, sets: Array) -> dict[str, Array]:
        """Each of ``MODEL_OUTPUTS`` at the samples, (n, sets), of searched sets, (8, sets); NaN for unstable sets."""
        matrix, unstable = self._matrix(sets), self.is_unstable(sets, self.limits)
        # Ctrl-C is heard while a long one runs
        runs = call_with_timeout(None, lambda: [run_coil(matrix, piece.series, piece.at) for piece in self.pieces])
        outputs = dict(zip(MODEL_OUTPUTS, map(np.concatenate, zip(*runs, strict=True)), strict=True))
        for series in outputs.values():
            series[:, unstable] = np.nan
        return outputs

    def is_unstable(self, sets: Array, limits: StabilityLimits) -> Mask:
        """Whether γ or λ of each searched set, (8, sets), exceeds 1 at the flows of ``limits``, (sets,)."""
        matrix = self._matrix(sets)
        # a valve that delivers just that at full opening
        valve = {"m_max": limits.m_w_max, "valve_a": 1.0, "valve_b": 100.0, "valve_c": -5.0, "rangeability": np.nan}
        for name, value in valve.items():
            matrix[PARAMETER_ROWS.index(name)] = value
        gamma, lam = stability_numbers(matrix, np.linspace(*limits.m_a_span, 9), limits.wet_slope)
        return np.asarray(~((gamma <= 1.0) & (lam <= 1.0)))

    def _matrix(self, sets: Array) -> Array:
        matrix = parameter_matrix(parameter_columns(self.loop, {}, np.zeros(sets.shape[1], dtype=int)))
        matrix[[PARAMETER_ROWS.index(name) for name in COIL_PARAMETERS]] = self.coil_parameters(sets)
        return matrix


def drop_idle_samples(log: CheckedLog) -> CheckedLog:
    """Drop times without air flow or with ``enabled`` 0, in which sensors say nothing of the coil."""
    require_agreement(log)
    log = leave_out_repeats(log, _MEASURED_OUTPUTS)
    m_a, enabled = log.values["m_a"], log.values.pop("enabled", np.ones(log.time.size))
    is_on = (m_a > 0.05 * np.quantile(m_a, 0.95)) & (enabled != 0.0)
    if not is_on.any():
        raise InputError(f"{log.name}: m_a is 0 throughout: give a log with air flow", "m_a", "data")
    if is_on.all():
        return log
    spells = int(is_on[0] == 0) + int(np.sum(np.diff(is_on.astype(int)) < 0))
    counts = f"{format_count(~is_on, 'sample')} in {format_count(spells, 'spell')} left out, no air flows"
    log.notes.append(f"{counts} ({describe_first_row(log.rows.tolist(), ~is_on)}): the record starts again after each")
    return log.where(is_on)


def build_record(log: CheckedLog, loop: Loop, holds: tuple[str, ...], fitting: Mask) -> CoilRecord:
    """Resample a log at 1 s, straight or held as in ``holds``; scales and limits are those of ``fitting``, (n,)."""
    require_whole_seconds(log.name, log.step)
    values = log.values | {"W_a_in": log.humidity_ratio(loop["pressure"])}
    fitted_values = {name: series[fitting] for name, series in values.items()}
    if not fitted_values["m_w"].any():
        raise InputError(f"{log.name}: m_w is 0 throughout the part to fit: give a log with water flow", "m_w", "data")
    holds = COIL_COLUMNS if log.change_of_value else holds
    pieces = []
    for piece in split_segments(log.batch):
        time = log.time[piece] - log.time[piece[0]]
        seconds, inputs = np.arange(int(time[-1] + 0.5) + 1.0), {name: values[name][piece] for name in COIL_COLUMNS}
        series = resample_at_seconds(time, inputs, seconds, holds, slack=1e-6)
        pieces.append(RecordPiece(np.stack(list(series.values()), axis=1), np.floor(time + 0.5).astype(np.int64)))
    flows = ((flow := fitted_values[name])[flow > 0.01 * flow.max()] for name in ("m_w", "m_a"))
    m_w, m_a = (float(np.exp(np.mean(np.log(flow)))) for flow in flows)  # geometric means
    limits, limits_of_all = (_stability_limits(series, loop) for series in (fitted_values, values))
    return CoilRecord(tuple(pieces), loop, m_w, m_a, limits, limits_of_all)


def _stability_limits(values: Mapping[str, Array], loop: Loop) -> StabilityLimits:
    coldest = min(values["T_a_in"].min(), values["T_w_in"].min(), loop["T_initial"])
    slope = wet_slope(values["W_a_in"].max(), coldest, loop["pressure"])
    return StabilityLimits(float(values["m_w"].max()), (float(values["m_a"].min()), float(values["m_a"].max())), slope)


_PRIOR_EXPONENT = {BETA2: -0.2, BETA4: -0.45, BETA6: -0.42}
"""Exponents of turbulent flow: NTU = UA/(m cp) with UA rising as m^0.8 in the tubes, m^0.55 over the fins."""
_N_STARTS = 256
_FEWEST_SAMPLES = 16


class CoilProblem:
    """A record of a coil: the samples that are compared, and the parameters that are held."""

    def __init__(
        self, data: CheckedLog, record: CoilRecord, warm_up: float, fitting: Mask, holds: tuple[str, ...] = ()
    ) -> None:  # fmt: skip
        self.data, self.record, self.notes = data, record, list(data.notes)
        self.is_warm = data.seconds_since_batch_start() >= warm_up
        self.fitting = fitting  # whether each sample is fitted
        self.n_fit = int(self.fitting.sum())
        flowing = data.values["m_w"] > 0.02 * record.m_w  # in still water a sensor says nothing of the coil
        readings: dict[str, Array] = {name: data.values[name] for name in _MEASURED_OUTPUTS if name in data.values}
        self.compared = {n: self.is_warm & np.isfinite(T) & (flowing | (n == "T_sup")) for n, T in readings.items()}
        if data.n_batches > 1:
            n_short = data.n_batches - np.unique(data.batch[self.is_warm]).size
            start_text = f"each starting at {record.loop['T_initial']:g} degC, the first {warm_up:g} s of each left out"
            self.notes.append(f"{data.n_batches:,} unbroken pieces, {start_text} ({n_short} shorter than that)")
        if "T_w_out" in self.compared and not flowing.all():
            self.notes.append(f"{format_count(~flowing, 'sample')} of T_w_out not compared: no water flows")
        compared = self.compared["T_sup"] & self.fitting
        if compared.sum() < _FEWEST_SAMPLES:
            available = f"{format_count(compared, 'temperature')} to compare in the part to fit"
            notes = "; ".join(self.notes) or "no gaps"
            cure = f"give at least {_FEWEST_SAMPLES}, lower warm_up, or raise split ({notes})"
            raise InputError(f"{data.name}: {available}, after the warm-up of {warm_up:g} s: {cure}", "log", "data")
        T_sup = readings["T_sup"][compared]
        if np.ptp(T_sup) == 0.0:
            raise InputError(f"{data.name}: T_sup is {T_sup[0]:g} throughout: check the sensor", "T_sup", "data")
        if data.step > 10.0 and not holds:
            cure = "if some hold until the next sample, name them: holds=['m_w'], --hold m_w"
            self.notes.append(f"samples are {data.step:.4g} s apart and the inputs run straight between them: {cure}")
        # ln of the C_w with γ = 1 at the largest flow
        least = record.limits.m_w_max * record.loop["cp_w"] * record.loop["n_volumes"]
        self.least_C_w = math.log(least / 8.0 / record.loop["substeps"])
        ln_C_w, ln_ntu = self.least_C_w + math.log(1.05), math.log(0.35)
        self.prior = np.array([ln_C_w, ln_C_w + math.log(10.0 / 8.8), ln_ntu, 0.0, ln_ntu, 0.0, ln_ntu, 0.0])
        self.prior[list(_PRIOR_EXPONENT)] = list(_PRIOR_EXPONENT.values())
        self.held: dict[int, str] = {}
        for flow, exponents, what in (("m_a", (BETA4, BETA6), "air"), ("m_w", (BETA2,), "water")):
            values = data.values[flow][compared]
            if np.ptp(values) < 0.02 * values.mean():
                self.held |= {k: f"held at a prior: the {what} flow is constant" for k in exponents}

    @property
    def coupling(self) -> Array:
        """Matrix that fills in coupled parameters: ε* of a dry coil is its ε, and as uncertain."""
        rows = [COUPLED_PARAMETERS[k] if self.held.get(k, "").startswith(_HELD_AS_DRY) else k for k in range(8)]
        return np.asarray(np.eye(8)[rows])

    def model(self) -> Model:
        """Model of the fitted samples."""
        n, record = self.n_fit, self.record.take_samples(self.n_fit)

        def residuals(sets: Array) -> Array:
            return record.run(self.coupling @ sets)["T_sup"] - self.data.values["T_sup"][:n, None]

        low = self.least_C_w
        lower = np.array([low, low - 5.0, -5.0, -2.0, -5.0, -2.0, -5.0, -2.0])
        upper = np.array([low + 4.0, low + 8.0, 3.0, 1.0, 3.0, 1.0, 3.0, 1.0])
        step = np.full(8, 2e-3)  # long compared with the jumps where a volume turns wet
        return Model(residuals, lower, upper, step, self.data.batch[:n], self.compared["T_sup"][:n])

    def starts(self) -> Array:
        """A space-filling set of physical guesses, (8, sets)."""
        from scipy.stats import qmc

        low = np.array([[0.02, -1.0, -2.5, -0.6, -2.5, -0.7, -0.4, -0.7]]).T
        high = np.array([[1.5, 3.0, 1.0, 0.0, 1.0, 0.0, 0.4, 0.0]]).T
        x = low + (high - low) * qmc.Sobol(8, seed=0).random(_N_STARTS).T
        x[LN_C_W] += self.least_C_w
        x[LN_C_C] += x[LN_C_W]
        x[LN_NTU_STAR] += x[LN_NTU_A]
        held = list(self.held)
        x[held] = self.prior[held, None]
        return np.asarray(x)

    def solve(self) -> tuple[Estimate, Uncertainty, Array]:
        """Fit, hold what is not identified, and fit again.

        Returns the minimum, its uncertainty, and the number of wet volumes of the fitted samples, (n,).
        """
        model = self.model()
        best = minimise(model, self.starts(), list(self.held))
        wet = self.record.take_samples(self.n_fit).run(best.x[:, None])["wet_volumes"][self.is_warm[: self.n_fit], 0]
        if not wet.any():
            self.held |= dict.fromkeys(COUPLED_PARAMETERS, f"{_HELD_AS_DRY}: the coil is never wet")
            best = minimise(model, best.x[:, None], list(self.held))
        spread = uncertainty(model, best, list(self.held))
        not_held: set[int] = set()
        while (k := self._least_identified(model, best, spread, not_held)) is not None:
            x = best.x.copy()
            x[k] = self.prior[k]
            as_dry = f"{_HELD_AS_DRY}: the data do not tell them apart"
            self.held[k] = as_dry if k in COUPLED_PARAMETERS else "held at a prior: the data do not identify it"
            trial = minimise(model, x[:, None], list(self.held))
            if trial.rss - best.rss > spread.quantile() ** 2 * spread.variance * spread.inflation[k]:
                del self.held[k]  # little is known of it, but it is not the prior
                not_held.add(k)
            else:
                best, not_held, spread = trial, set(), uncertainty(model, trial, list(self.held))
        return best, spread, wet

    def _least_identified(self, model: Model, best: Estimate, spread: Uncertainty, not_held: set[int]) -> int | None:
        """Free parameter that the data identify least, None if they identify all."""
        # largest standard errors of what is identified: of a logarithm (a factor of 2), of an exponent
        error = np.sqrt(np.diag(spread.covariance)) / np.where(IS_LOGARITHMIC, 0.7, 0.5)
        span = model.upper - model.lower
        is_at_lower = best.x < model.lower + 1e-6 * span
        is_at_lower[LN_C_W] = False  # a good answer: there the scheme is just stable
        is_at_bound = is_at_lower | (best.x > model.upper - 1e-6 * span)
        is_unknown = is_at_bound | np.isin(np.arange(8), spread.without_effect)
        error = np.where(is_unknown, np.inf, np.nan_to_num(error, posinf=np.inf))
        # give up a factor last: without it no heat is exchanged
        rank = np.where(np.isin(np.arange(8), (LN_NTU_W, LN_NTU_A)), error / 10.0, error)
        rank[[*self.held, *not_held]] = 0.0
        k = int(np.argmax(rank))
        return k if error[k] > 1.0 and rank[k] > 0.0 else None
