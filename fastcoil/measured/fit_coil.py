"""``fit_coil``: C_c, C_w, β1 … β6 of Eqs (3) and (4) from recorded flows and temperatures (section 2.2).

The log becomes 1-s series; the coil runs over them with many parameter sets at once.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import checking, choice_of, names_of, number_of
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs import Log
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.logs.pieces import at_seconds, require_whole_seconds
from fastcoil.logs.series import HUMIDITIES, counted, first_row
from fastcoil.loops.clashes import wet_slope
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of
from fastcoil.loops.simulate import within
from fastcoil.measured.agreement import require_agreement
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, finished, natural_interval
from fastcoil.measured.least_squares import Estimate, Model, Uncertainty, minimise, uncertainty
from fastcoil.measured.part import Part, checked_part, unbroken
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.plant import worst_numbers
from fastcoil.model.engine.recorded import COIL_COLUMNS, run_coil
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.metric_table import WARM_UP
from fastcoil.model.parameter_table import PARAMETERS

COIL = ("C_w", "C_c", "beta1", "beta2", "beta3", "beta4", "beta5", "beta6")
LOGS = np.array([True, True, True, False, True, False, True, False])
"""Which of ``COIL`` are searched by their logarithm."""
LN_C_W, LN_C_C, LN_NTU_W, BETA2, LN_NTU_A, BETA4, LN_NTU_STAR, BETA6 = range(8)
"""The searched parameters: as ``COIL``, but numbers of transfer units at the typical flow in place of their factors."""
RECORDED = ("T_sup", "T_w_out", "wet_volumes")  # what the model gives: °C, °C, number of wet volumes
COUPLED = {LN_NTU_STAR: LN_NTU_A, BETA6: BETA4}
"""Parameters that the data may not separate: the first is then held at the value of the second."""
_AS_DRY = "as that of heat alone"
_ROWS = np.array([PARAMETER_ROWS.index(name) for name in COIL])
_AIR_FLOWS = 9
_STILL, _MOSTLY = 0.05, 0.95
"""Air stands still below the first share of the flow that it stays below for the second share of the time."""
_ROUND_OFF = 1e-6  # of times counted from the start of a piece, s
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
    outputs = OUTPUTS[minimise_on]
    optional = [name for name in ("enabled", "T_w_out") if name not in outputs]
    data = part.read(log, Wanted((*_NEEDED, *outputs[1:]), optional, OUTPUTS["both"]), how, in_operation)
    record = record_of(data, loop, held_inputs, part.fitted(data))
    problem = CoilProblem(data, record, outputs, warm_up, part, held_inputs)
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
    marched = [f"{name} = {record.loop[name]!r}" for name in _MARCH if record.loop[name] != PARAMETERS[name].default]
    if marched:
        notes.append(f"fitted with {', '.join(marched)}: give the loop the same, the parameters belong to it")
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
    series, errors = dict[str, tuple[Array, str]](), dict[str, Array]()
    for name, ending in (("T_sup", ""), ("T_w_out", "_T_w_out")):
        modelled, measured = found[name], data.values.get(name, np.full(data.time.size, np.nan))
        series |= {name: (measured, "degC"), f"{name}_modelled": (modelled, "degC")}
        series[f"{name}_residual"] = measured - modelled, "K"
        errors[ending] = np.where(compared.get(name, False), modelled - measured, np.nan)
    series["wet_volumes"] = found["wet_volumes"], "1"
    return series | {name: (data.values[name], "kg s-1") for name in ("m_w", "m_a")}, errors


class Piece(NamedTuple):
    """An unbroken piece of a record: series (n_steps, 5) as ``COIL_COLUMNS``; ``at`` (n,), second of each sample."""

    series: Array
    at: Index


class Limits(NamedTuple):
    """What decides whether a coil is stable."""

    m_w_max: float  # kg/s
    m_a_span: tuple[float, float]  # kg/s
    wet_slope: float  # largest dh_s/dT


@dataclass(frozen=True, kw_only=True)
class Record:
    """The series that enter the coil second by second, and the seconds of the samples."""

    pieces: tuple[Piece, ...]  # each starts from ``T_initial``
    loop: Loop
    m_w: float  # typical flows of the part to fit, kg/s
    m_a: float
    limits: Limits  # in the part to fit
    limits_of_all: Limits

    def until(self, n_samples: int) -> Record:
        """The record up to its first samples."""
        kept = []
        for piece in self.pieces:
            if (here := piece.at[: max(n_samples, 0)]).size:
                kept.append(Piece(piece.series[: int(here[-1]) + 1], here))
            n_samples -= piece.at.size
        return replace(self, pieces=tuple(kept))

    def named(self) -> Array:
        """Matrix from the searched parameters to (the logarithms of) ``COIL``: ln β = ln NTU - β' ln m."""
        A = np.eye(8)
        A[LN_NTU_W, BETA2] = -math.log(self.m_w)
        A[LN_NTU_A, BETA4] = A[LN_NTU_STAR, BETA6] = -math.log(self.m_a)
        return A

    def values(self, sets: Array) -> Array:
        """``COIL`` of parameter sets as searched, (8, sets)."""
        y = self.named() @ sets
        return np.where(LOGS[:, None], np.exp(np.minimum(y, 50.0)), y)

    def run(self, sets: Array) -> dict[str, Array]:
        """Each of ``RECORDED`` at the samples with each parameter set (8, sets), (n, sets); NaN for unstable sets."""
        matrix, unstable = self._matrix(sets), self.unstable(sets, self.limits)
        # Ctrl-C is heard while a long one runs
        of_pieces = within(None, lambda: [run_coil(matrix, piece.series, piece.at) for piece in self.pieces])
        found = dict(zip(RECORDED, map(np.concatenate, zip(*of_pieces, strict=True)), strict=True))
        for series in found.values():
            series[:, unstable] = np.nan
        return found

    def unstable(self, sets: Array, limits: Limits) -> Mask:
        """Sets (8, sets) with γ or λ above 1 at the flows of ``limits``, (sets,)."""
        matrix = self._matrix(sets)
        # a valve that delivers just that at full opening
        most = {"m_max": limits.m_w_max, "valve_a": 1.0, "valve_b": 100.0, "valve_c": -5.0, "rangeability": np.nan}
        for name, value in most.items():
            matrix[PARAMETER_ROWS.index(name)] = value
        gamma, lam = worst_numbers(matrix, np.linspace(*limits.m_a_span, _AIR_FLOWS), limits.wet_slope)
        return np.asarray(~((gamma <= 1.0) & (lam <= 1.0)))

    def _matrix(self, sets: Array) -> Array:
        base = parameter_matrix(columns_of(self.loop, {}, np.array([0])))
        matrix = np.repeat(base, sets.shape[1], axis=1)
        matrix[_ROWS] = self.values(sets)
        return matrix


def in_operation(log: Log) -> Log:
    """The log without times of no air flow or ``enabled`` 0, in which sensors say nothing of the coil."""
    require_agreement(log)
    m_a, enabled = log.values["m_a"], log.values.pop("enabled", np.ones(log.time.size))
    on = (m_a > _STILL * np.quantile(m_a, _MOSTLY)) & (enabled != 0.0)
    if not on.any():
        raise InputError(f"{log.name}: m_a is 0 throughout: give a log with air flow")
    if on.all():
        return log
    spells = int(on[0] == 0) + int(np.sum(np.diff(on.astype(int)) < 0))
    log.notes.append(
        f"{counted(~on, 'sample')} in {counted(spells, 'spell')} left out, no air flows "
        f"({first_row(log.rows.tolist(), ~on)}): the record starts again after each"
    )
    return log.where(on)


def record_of(log: Log, loop: Loop, holds: tuple[str, ...], fitting: Mask) -> Record:
    """The log on 1-s steps, straight or held as ``holds`` says; scales and limits are those of ``fitting``, (n,)."""
    require_whole_seconds(log.name, log.step)
    values = log.values | {"W_a_in": log.humidity_ratio(loop["pressure"])}
    of_fit = {name: series[fitting] for name, series in values.items()}
    if not of_fit["m_w"].any():
        raise InputError(f"{log.name}: m_w is 0 throughout the part to fit: give a log with water flow")
    holds = COIL_COLUMNS if log.change_of_value else holds
    found = []
    for piece in unbroken(log.batch):
        series, at = on_seconds(log.time[piece], {name: values[name][piece] for name in COIL_COLUMNS}, holds)
        found.append(Piece(np.stack(list(series.values()), axis=1), at))
    return Record(
        pieces=tuple(found),
        loop=loop,
        m_w=_typical(of_fit["m_w"]),
        m_a=_typical(of_fit["m_a"]),
        limits=_limits(of_fit, loop),
        limits_of_all=_limits(values, loop),
    )


def on_seconds(time: Array, values: Mapping[str, Array], holds: Collection[str]) -> tuple[dict[str, Array], Index]:
    """The series of an unbroken piece at every second since its first sample, and the second of each sample."""
    time = time - time[0]
    seconds = np.arange(int(time[-1] + 0.5) + 1, dtype=float)
    return at_seconds(time, values, seconds, holds, slack=_ROUND_OFF), np.floor(time + 0.5).astype(np.int64)


def _limits(values: Mapping[str, Array], loop: Loop) -> Limits:
    coldest = min(values["T_a_in"].min(), values["T_w_in"].min(), loop["T_initial"])
    return Limits(
        m_w_max=float(values["m_w"].max()),
        m_a_span=(float(values["m_a"].min()), float(values["m_a"].max())),
        wet_slope=wet_slope(values["W_a_in"].max(), coldest, loop["pressure"]),
    )


def _typical(flow: Array) -> float:
    """Geometric mean of a flow where it flows, kg/s."""
    return float(np.exp(np.mean(np.log(flow[flow > 0.01 * flow.max()]))))


_PRIOR_EXPONENT = {BETA2: -0.2, BETA4: -0.45, BETA6: -0.42}
"""Exponents of turbulent flow: NTU = UA/(m cp) with UA rising as m^0.8 in the tubes, m^0.55 over the fins."""
_UNKNOWN = np.where(LOGS, 0.7, 0.5)
"""A parameter with a larger standard error is not identified: of a logarithm (a factor of 2), of an exponent."""
_CONSTANT = 0.02  # a flow that varies by less than this share is constant
_N_STARTS = 256
_STEP = 2e-3  # of the differences: long compared with the jumps where a volume turns wet
_FEWEST_SAMPLES = 16
_SMALL_SWING = 0.02  # water stands still below this share of its typical flow: its sensor says nothing of the coil
_COARSE = 10.0  # between samples further apart than this an input may step, s


class CoilProblem:
    """The record, which samples of it are compared, and which parameters are held."""

    def __init__(
        self, data: Log, record: Record, outputs: tuple[str, ...], warm_up: float, part: Part,
        holds: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        self.data, self.record, self.outputs, self.notes = data, record, outputs, list(data.notes)
        self.warm = data.since_batch() >= warm_up
        self.fitting = part.fitted(data)
        self.n_fit = int(self.fitting.sum())
        flowing = data.values["m_w"] > _SMALL_SWING * record.m_w
        self.compared = {
            name: self.warm & np.isfinite(values) & (flowing | (name == "T_sup"))
            for name in ("T_sup", "T_w_out")
            if (values := data.values.get(name)) is not None
        }
        self.notes += of_pieces(data, record.loop, warm_up)
        if "T_w_out" in self.compared and not flowing.all():
            self.notes.append(f"{counted(~flowing, 'sample')} of T_w_out not compared: no water flows")
        compared = self.compared["T_sup"] & self.fitting
        require_temperatures(data, compared, _FEWEST_SAMPLES, warm_up, self.notes)
        if data.step > _COARSE and not holds:
            self.notes.append(
                f"samples are {data.step:.4g} s apart and the inputs run straight between them: if some hold until the "
                "next sample, name them: holds=['m_w'], --hold m_w"
            )
        # ln of the C_w with γ = 1 at the largest flow
        least = record.limits.m_w_max * record.loop["cp_w"] * record.loop["n_volumes"]
        self.least_C_w = math.log(least / 8.0 / record.loop["substeps"])
        ln_C_w, ln_ntu = self.least_C_w + math.log(1.05), math.log(0.35)
        self.prior = np.array([ln_C_w, ln_C_w + math.log(10.0 / 8.8), ln_ntu, 0.0, ln_ntu, 0.0, ln_ntu, 0.0])
        self.prior[list(_PRIOR_EXPONENT)] = list(_PRIOR_EXPONENT.values())
        self.held: dict[int, str] = {}
        for flow, exponents, what in (("m_a", (BETA4, BETA6), "air"), ("m_w", (BETA2,), "water")):
            values = data.values[flow][compared]
            if np.ptp(values) < _CONSTANT * values.mean():
                self.held |= {k: f"held at a prior: the {what} flow is constant" for k in exponents}

    @property
    def coupling(self) -> Array:
        """Matrix that fills in the coupled parameters: a dry coil's ε* is its ε, and as uncertain."""
        rows = [COUPLED[k] if self.held.get(k, "").startswith(_AS_DRY) else k for k in range(8)]
        return np.asarray(np.eye(8)[rows])

    def model(self) -> Model:
        n, part = self.n_fit, self.record.until(self.n_fit)
        used = np.concatenate([self.compared[name][:n] for name in self.outputs])

        def residuals(sets: Array) -> Array:
            run = part.run(self.coupling @ sets)
            return np.concatenate([run[name] - self.data.values[name][:n, None] for name in self.outputs])

        low = self.least_C_w
        lower = np.array([low, low - 5.0, -5.0, -2.0, -5.0, -2.0, -5.0, -2.0])
        upper = np.array([low + 4.0, low + 8.0, 3.0, 1.0, 3.0, 1.0, 3.0, 1.0])
        segment = np.concatenate([self.data.batch[:n] + k * self.data.n_batches for k in range(len(self.outputs))])
        return Model(residuals, lower, upper, np.full(8, _STEP), segment, used)

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
        """Fit, hold what is unknown, fit again; the minimum, its uncertainty, wet volumes of fitted samples, (n,)."""
        model = self.model()
        best = minimise(model, self.starts(), list(self.held))
        run = self.record.until(self.n_fit).run(best.x[:, None])
        wet = run["wet_volumes"][self.warm[: self.n_fit], 0]
        if not wet.any():
            self.held |= dict.fromkeys(COUPLED, f"{_AS_DRY}: the coil is never wet")
            best = minimise(model, best.x[:, None], list(self.held))
        spread = uncertainty(model, best, list(self.held))
        needed: set[int] = set()
        while (k := self._least_known(model, best, spread, needed)) is not None:
            x = best.x.copy()
            x[k] = self.prior[k]
            as_dry = f"{_AS_DRY}: the data do not tell them apart"
            self.held[k] = as_dry if k in COUPLED else "held at a prior: the data do not identify it"
            tried = minimise(model, x[:, None], list(self.held))
            if tried.rss - best.rss > spread.quantile() ** 2 * spread.variance * spread.inflation[k]:
                del self.held[k]  # little is known of it, but it is not the prior
                needed.add(k)
            else:
                best, needed, spread = tried, set(), uncertainty(model, tried, list(self.held))
        return best, spread, wet

    def _least_known(self, model: Model, best: Estimate, spread: Uncertainty, needed: set[int]) -> int | None:
        """The free parameter that the data say least about, if they do not identify it."""
        error = np.sqrt(np.diag(spread.covariance)) / _UNKNOWN
        span = model.upper - model.lower
        far_down = best.x < model.lower + 1e-6 * span
        far_down[LN_C_W] = False  # a good answer: there the scheme is just stable
        far = far_down | (best.x > model.upper - 1e-6 * span)
        error = np.where(far | np.isin(np.arange(8), spread.dead), np.inf, np.nan_to_num(error, posinf=np.inf))
        # give up a factor last: without it no heat is exchanged
        rank = np.where(np.isin(np.arange(8), (LN_NTU_W, LN_NTU_A)), error / 10.0, error)
        rank[[*self.held, *needed]] = 0.0
        k = int(np.argmax(rank))
        return k if error[k] > 1.0 and rank[k] > 0.0 else None


def of_pieces(data: Log, loop: Loop, warm_up: float) -> list[str]:
    """A note where the log has more than one unbroken piece."""
    if data.n_batches == 1:
        return []
    short = data.n_batches - np.unique(data.batch[data.since_batch() >= warm_up]).size
    return [
        f"{data.n_batches:,} unbroken pieces, each starting at {loop['T_initial']:g} degC, the first {warm_up:g} s of "
        f"each left out ({short} shorter than that)"
    ]


def require_temperatures(data: Log, compared: Mask, least: int, warm_up: float, notes: list[str]) -> None:
    """Refuse a log with fewer than ``least`` temperatures to compare, or with a sensor that is constant."""
    if compared.sum() < least:
        seen = f"{counted(compared, 'temperature')} to compare in the part to fit, after the warm-up of {warm_up:g} s"
        cure = f"give at least {least}, lower warm_up, or raise split ({'; '.join(notes) or 'no gaps'})"
        raise InputError(f"{data.name}: {seen}: {cure}")
    T_sup = data.values["T_sup"][compared]
    if np.ptp(T_sup) == 0.0:
        raise InputError(f"{data.name}: T_sup is {T_sup[0]:g} throughout: check the sensor")
