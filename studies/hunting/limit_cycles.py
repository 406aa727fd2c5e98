"""How right ``fc.limit_cycle`` is: what it predicts beside what the emulator does.

Loops, plants and operating points are drawn at random.  Each loop runs for 16 hours of constant air and water; a step
of the set-point after two hours starts what can be started, and the last eight hours count.  Other kinds of days
follow, predicted from their mean conditions.  ``print_threshold_choice`` prints how the threshold was chosen, on loops
of another seed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.design import limit_cycle as cycles
from fastcoil.design.describing_function import describing_function
from fastcoil.design.limit_cycle import HUNTING_INDEX_LIMIT, Cycles, frequency_at, harmonic_balance, predict_cycles
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import OPENINGS, Plants, frequency_response, loop_response
from fastcoil.model.moist_air import humidity_ratio
from studies.common import HEATING_GAIN, compare_rows, draw_loguniform, share_of, write_table
from studies.days import HEATING, kinds, loop_settings, make_days

HOURS = 16  # length of a constant day, h
STEP_AT = 2 * 3600  # second at which its set-point steps
STEP_SIZE = 1.5  # step of the set-point, K


class Population(NamedTuple):
    """A population of loops.  words: for the table.  ratio: estimate over backlash, from and to.  loop: parameters."""

    words: str
    ratio: tuple[float, float] = (0.0, 0.0)
    buffer: tuple[float, float] = (1e-9, 1e-9)
    loop: Mapping[str, object] = {}


POPULATIONS = {
    "cooling": Population("plain PI, cooling"),
    "heating": Population("plain PI, heating", loop={"action": "heating"}),
    "too small": Population("inverse, estimate 30 to 98 %", (0.3, 0.98)),
    "too large": Population("inverse, estimate 105 to 150 %", (1.05, 1.5)),
    "buffer": Population("inverse, estimate 30 to 100 %, buffer 0.2 to 1 %", (0.3, 1.0), (0.002, 0.01)),
    "additive": Population("additive compensation, 30 to 98 %", (0.3, 0.98), loop={"compensation": "additive"}),
    "smooth": Population("smooth compensation, 30 to 98 %", (0.3, 0.98), loop={"compensation": "smooth"}),
    "noise": Population("noise 0.05 K, which theory leaves out", loop={"noise_std": 0.05}),
}


def draw_population(name: str, seed: int, n_loops: int, n_points: int) -> tuple[fc.Loop, dict[str, np.ndarray]]:
    """A population: loops along ``sample``, and operating points, (n_points,) each.

    An eighth of the valves has no gap.
    """
    population = POPULATIONS[name]
    is_heating = population.loop.get("action") == "heating"
    rng = np.random.default_rng([seed, list(POPULATIONS).index(name)])

    backlash = np.where(
        rng.random(n_loops) < 0.5, draw_loguniform(rng, 0.005, 0.15, n_loops), rng.uniform(0.01, 0.15, n_loops)
    )
    backlash[::8] = 0.0
    values = {
        "backlash": backlash,
        "rangeability": draw_loguniform(rng, 20.0, 100.0, n_loops),
        "authority": draw_loguniform(rng, 0.02, 0.9, n_loops),
        "m_full": rng.uniform(1.2, 2.0, n_loops),
        "C_w": rng.uniform(8.8, 14.0, n_loops),
        "C_c": draw_loguniform(rng, 10.0, 30.0, n_loops),
        "kp": draw_loguniform(rng, 0.005, 0.06, n_loops) * (HEATING_GAIN if is_heating else 1.0),
        "ti": draw_loguniform(rng, 5.0, 600.0, n_loops),
        "sample_time": rng.choice([1.0, 5.0, 10.0, 15.0, 30.0, 60.0], n_loops),
        "sensor_time_constant": np.where(rng.random(n_loops) < 0.25, 0.0, rng.uniform(0.0, 60.0, n_loops)),
        "stroke_time": np.where(rng.random(n_loops) < 0.3, 0.0, rng.uniform(15.0, 150.0, n_loops)),
        "backlash_estimate": rng.uniform(*population.ratio, n_loops) * backlash,
        "buffer": rng.uniform(*population.buffer, n_loops),
    }
    loop = fc.Loop().assign(**{name: ("sample", value) for name, value in values.items()}, **population.loop)
    return loop, _draw_points(rng, n_points, is_heating)


def _draw_points(rng: np.random.Generator, n: int, is_heating: bool) -> dict[str, np.ndarray]:
    m_a = rng.uniform(0.6, 1.5, n)
    if is_heating:
        T_a_in, T_w_in = rng.uniform(-5.0, 20.0, n), rng.uniform(35.0, 65.0, n)
        T_set = rng.uniform(np.maximum(T_a_in + 4.0, 18.0), np.maximum(T_a_in + 8.0, 30.0))
        return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": np.full(n, 0.003), "T_w_in": T_w_in, "T_set": T_set}
    T_a_in, T_w_in = rng.uniform(20.0, 33.0, n), rng.uniform(5.0, 10.0, n)
    W_a_in = humidity_ratio(T_a_in, rng.uniform(0.2, 0.8, n))
    T_set = rng.uniform(T_w_in + 5.5, np.minimum(T_a_in - 2.0, 19.0))
    return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": W_a_in, "T_w_in": T_w_in, "T_set": T_set}


def constant_days(points: Mapping[str, np.ndarray], population: str) -> fc.Boundary:
    """A day for each point on which nothing happens but one step of the set-point."""
    is_heating = POPULATIONS[population].loop.get("action") == "heating"
    series = {name: np.repeat(values[:, None], HOURS * 3600, axis=1) for name, values in points.items()}
    series["T_set"][:, :STEP_AT] += -STEP_SIZE if is_heating else STEP_SIZE
    return fc.Boundary(**series, day=list(range(points["T_set"].size)))


def cycles_of_gap_alone(columns: Mapping[str, np.ndarray], plants: Plants) -> Cycles:
    """Predict cycles of the gap alone: same threshold, amplitude and period where |L| |N| is 1 or nearest to it."""
    n, w = plants.opening.size, np.geomspace(3e-4, np.pi, 300)
    predictions = Cycles(*(np.full(n, np.nan) for _ in Cycles._fields))
    predictions.hunting_index[:], predictions.hunts[:] = 0.0, 0.0
    for ts in np.unique(columns["sample_time"]):
        indices = np.flatnonzero((columns["sample_time"] == ts) & plants.reachable)
        if not indices.size:
            continue
        columns_at_time, plants_at_time, x_bl = (
            {k: v[indices] for k, v in columns.items()},
            plants.select(indices),
            columns["backlash"][indices],
        )
        w = np.geomspace(3e-4, np.pi / ts, 200)
        gap = np.maximum(x_bl, 1e-6)[:, None]
        A = 0.5005 * gap * np.geomspace(1.0, 1e4, 120)
        N = describing_function(A, gap, gap)
        balance = harmonic_balance(
            w, loop_response(columns_at_time, plants_at_time, w), lambda _, N=N: N, A.shape[1], np.zeros(indices.size)
        )
        product, frequency_index = balance.product.max(axis=0), balance.place[0]
        hunting_index = np.where(x_bl > 0.0, product.max(axis=1), product[:, -1])
        last = product.shape[1] - 1 - (product[:, ::-1] >= 1.0).argmax(axis=1)
        rows = np.arange(indices.size)
        k = np.where(hunting_index >= 1.0, last, product.argmax(axis=1))
        cycle_frequency = frequency_at(w, frequency_index[rows, k])
        G = np.abs(frequency_response(plants_at_time.response, w))
        T = (
            A[rows, k]
            * np.abs(N[rows, k])
            / (1.0 - x_bl)
            * G[rows, np.clip(frequency_index[rows, k].round().astype(int), 0, 199)]
        )
        hunts = (hunting_index > np.where(x_bl > 0.0, HUNTING_INDEX_LIMIT, 1.0)) & (2.0 * T > 0.1)
        predictions.hunting_index[indices], predictions.hunts[indices] = hunting_index, hunts
        predictions.period[indices], predictions.amplitude[indices] = (
            np.where(hunts, values, np.nan) for values in (2.0 * np.pi / cycle_frequency, T)
        )
    return predictions


SEARCH_SEED, FRESH_SEED = 901, 1201
LOOPS, POINTS = 400, 12
OTHER_LOOPS = 200  # of the populations that are not plain
DAY_SEEDS = range(1301, 1307)
WARM_UP_SECONDS = 8 * 3600
PERIOD_TOLERANCE, SWING_FACTOR = 0.15, 1.5
PLAIN_POPULATIONS = ("cooling", "heating")


class Case(NamedTuple):
    """A population beside what is predicted of it, both over (sample, day); at: the second that stands for the day."""

    loop: fc.Loop
    days: fc.Boundary
    seen: xr.Dataset
    predicted: xr.Dataset


def simulate_and_predict(population: str, seed: int, loops: int, points: int = POINTS) -> Case:
    """Simulate a population and predict it."""
    loop, conditions = draw_population(population, seed, loops, points)
    days = constant_days(conditions, population)
    seen = fc.simulate(loop, days, warm_up=WARM_UP_SECONDS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what theory cannot predict is left out of the cases
        return Case(loop, days, seen, fc.limit_cycle(loop, days, at=days.n_steps - 1))


class Verdicts(NamedTuple):
    """Correct predictions where the set-point can be held and theory predicts (``among``), over (sample, day)."""

    among: xr.DataArray
    hunts: xr.DataArray
    predicted: xr.DataArray
    period: xr.DataArray
    swing: xr.DataArray

    @classmethod
    def compare(cls, seen: xr.Dataset, predicted: xr.Dataset) -> Verdicts:
        """Compare a simulation with its prediction."""
        seen, predicted = (ds.reset_coords(drop=True).transpose("sample", "day") for ds in (seen, predicted))
        hunts, hunts_by_theory = seen.hunts == 1.0, predicted.hunts == 1.0
        among = (predicted.hunting_index > 0.0) & (seen.status == 0)
        period = abs(predicted.period / seen.hunting_period - 1.0) <= PERIOD_TOLERANCE
        swing = abs(np.log(2.0 * predicted.amplitude / seen.hunting_swing)) <= np.log(SWING_FACTOR)
        return cls(among, hunts, hunts_by_theory, period, swing)

    def cells(self, group: xr.DataArray | None = None) -> list[str]:
        """Format the verdicts as cells: missed cycles, false alarms, then shares with their intervals."""
        among = self.among if group is None else self.among & group
        both = among & self.hunts & self.predicted
        right = self.hunts == self.predicted
        is_few = int(both.sum()) < 10
        return [
            f"{int((among & self.hunts & ~self.predicted).sum())}",
            f"{int((among & ~self.hunts & self.predicted).sum())}",
            f"{int(among.sum()):,}",
            f"{int((among & self.hunts).sum())}",
            share_of(right, among).to_text(1) if bool(among.any()) else "—",
            "—" if is_few else str(share_of(self.period, both)),
            "—" if is_few else str(share_of(self.swing, both)),
        ]


HEAD = ["missed", "false alarms", "cases", "hunt", "hunts or not: right", "period within 15 %",
        "peak to peak within × 1.5"]  # fmt: skip


def rows_where(verdicts: Mapping[str, Verdicts], cases: Mapping[str, Case]) -> Iterable[list[str]]:
    """Rows of the plain loops, by their properties."""

    def join_plain(values_of: Callable[[str], xr.DataArray]) -> xr.DataArray:
        return xr.concat([values_of(name) for name in PLAIN_POPULATIONS], "sample")

    def join_verdicts(i: int) -> xr.DataArray:
        return join_plain(lambda name: verdicts[name][i].drop_vars(["sample", "day"], errors="ignore"))

    plain_verdicts = Verdicts(*(join_verdicts(i) for i in range(len(Verdicts._fields))))

    def join_parameter(name: str) -> xr.DataArray:
        return join_plain(lambda case: xr.DataArray(cases[case].loop[name]).drop_vars("sample", errors="ignore"))

    def join_theory(name: str) -> xr.DataArray:
        return join_plain(
            lambda case: (
                cases[case].predicted[name].reset_coords(drop=True).drop_vars(["sample", "day"], errors="ignore")
            )
        )

    at_rest = {
        name: fc.linearise(case.loop, case.days, at=case.days.n_steps - 1).reset_coords(drop=True)
        for name, case in cases.items()
    }

    def join_at_rest(name: str) -> xr.DataArray:
        return join_plain(lambda case: at_rest[case][name].drop_vars(["sample", "day"], errors="ignore"))

    wet, opening, hunting_index = join_at_rest("wet_volumes"), join_at_rest("opening"), join_theory("hunting_index")
    samples = join_theory("period") / join_parameter("sample_time")
    conditions = {
        "no gap": join_parameter("backlash") == 0.0,
        **_band_conditions("gap", join_parameter("backlash"), (0.0, 0.02, 0.05, 0.15), "{:.0%}"),
        **_band_conditions("hunting index", hunting_index, (0.0, 0.7, 0.85, 1.0, 1.2, 2.0, 4.0, np.inf), "{:g}"),
        **_band_conditions("sample time", join_parameter("sample_time"), (0.0, 5.0, 15.0, 60.0), "{:g} s"),
        **_band_conditions("predicted samples to a period", samples, (0.0, 6.0, 10.0, 20.0, np.inf), "{:g}"),
        "motor at once": join_parameter("stroke_time") == 0.0,
        **_band_conditions("stroke", join_parameter("stroke_time"), (0.0, 60.0, 150.0), "{:g} s"),
        "no sensor lag": join_parameter("sensor_time_constant") == 0.0,
        **_band_conditions("sensor lag", join_parameter("sensor_time_constant"), (0.0, 30.0, 60.0), "{:g} s"),
        **_band_conditions("authority", join_parameter("authority"), (0.0, 0.1, 0.9), "{:g}"),
        **_band_conditions("opening", opening, (0.0, 0.05, 0.2, 0.5, 1.0), "{:g}"),
        "dry": wet == 0.0,
        "partly wet": (wet > 0.0) & (wet < 8.0),
        "wet all over": wet == 8.0,
    }
    for name, is_member in conditions.items():
        yield [name, *plain_verdicts.cells(is_member)]


def _band_conditions(
    name: str, values: xr.DataArray, edges: tuple[float, ...], template: str
) -> dict[str, xr.DataArray]:
    """Conditions of a value, each above one edge and up to the next."""
    conditions = {}
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        label = (
            f"above {template.format(low)}" if np.isinf(high) else f"{template.format(low)} to {template.format(high)}"
        )
        conditions[f"{name} {label}"] = (values > low) & (values <= high)
    return conditions


def predict_with(
    loop: fc.Loop, days: fc.Boundary, predict: Callable[[dict[str, np.ndarray], Plants], Cycles]
) -> xr.Dataset:
    """Predict with another theory."""
    points = OperatingPoints(loop, days, days.n_steps - 1)
    predictions = points.evaluate(lambda columns, plants: list(predict(columns, plants)._asdict().items()))
    return points.dataset({name: (values, {}) for name, values in predictions.items()})


def cycles_without_motor(columns: dict[str, np.ndarray], plants: Plants) -> Cycles:
    """Predict cycles without the motor's stroke time."""
    return predict_cycles(columns | {"stroke_time": np.zeros_like(columns["stroke_time"])}, plants)


def cycles_of_straight_plant(columns: dict[str, np.ndarray], plants: Plants) -> Cycles:
    """Predict cycles with valve and coil linearised."""
    straight_curve = plants.T_sup[:, None] + plants.gain[:, None] * (OPENINGS - plants.opening[:, None])
    return predict_cycles(columns, plants._replace(curve=straight_curve))


def cycles_of_free_integral(columns: dict[str, np.ndarray], plants: Plants) -> Cycles:
    """Predict cycles without the limits of the integral."""
    with patch.object(cycles, "INTEGRAL_LIMIT_ROUNDS", 0):
        return predict_cycles(columns, plants)


THEORY_PARTS = {
    "gap alone": cycles_of_gap_alone,
    "all but the motor's speed": cycles_without_motor,
    "all but the curve of valve and coil": cycles_of_straight_plant,
    "all but the ends of the integral": cycles_of_free_integral,
    "all": predict_cycles,
}


def day_rows() -> Iterable[list[str]]:
    """Every kind of day, predicted from its mean conditions."""
    for kind in kinds():
        population = "heating" if kind == HEATING else "cooling"
        loop, _ = draw_population(population, FRESH_SEED + 1, LOOPS, POINTS)
        days = make_days(kind, DAY_SEEDS)
        loop = loop.assign(**loop_settings(kind))
        yield [kind, *Verdicts.compare(fc.simulate(loop, days), fc.limit_cycle(loop, days)).cells()]


def print_threshold_choice() -> None:
    """Print how often the forecast is right with other thresholds, on the loops of another seed."""
    cases = [simulate_and_predict(name, SEARCH_SEED, LOOPS) for name in PLAIN_POPULATIONS]
    for threshold in (0.75, 0.8, 0.825, 0.85, 0.875, 0.9, 0.95, 1.0):
        with patch.object(cycles, "HUNTING_INDEX_LIMIT", threshold):
            verdicts = [
                Verdicts.compare(case.seen, fc.limit_cycle(case.loop, case.days, at=case.days.n_steps - 1))
                for case in cases
            ]
        print(
            f"{threshold:g}",
            *(share_of(verdict.hunts == verdict.predicted, verdict.among).to_text(2) for verdict in verdicts),
            sep="   ",
        )


def sample() -> None:
    """Run a sample of the study: the first population."""
    name = next(iter(POPULATIONS))
    case = simulate_and_predict(name, FRESH_SEED, LOOPS if name in PLAIN_POPULATIONS else OTHER_LOOPS)
    cells = Verdicts.compare(case.seen, case.predicted).cells()
    compare_rows("hunting/limit_cycles", [[POPULATIONS[name].words, *cells]])


def main() -> None:
    """Write every table."""
    cases = {
        name: simulate_and_predict(name, FRESH_SEED, LOOPS if name in PLAIN_POPULATIONS else OTHER_LOOPS)
        for name in POPULATIONS
    }
    verdicts = {name: Verdicts.compare(case.seen, case.predicted) for name, case in cases.items()}
    write_table(
        "hunting/limit_cycles",
        f"Prediction compared with simulation: random loops × plants × {POINTS} operating points, seed {FRESH_SEED}; "
        "only "
        "cases whose set-point can be held",
        ["loops", *HEAD],
        ([POPULATIONS[name].words, *verdict.cells()] for name, verdict in verdicts.items()),
    )
    plain = {name: cases[name] for name in PLAIN_POPULATIONS}
    write_table(
        "hunting/limit_cycles_where",
        "Where the prediction is wrong: plain PI loops in cooling and heating, by property",
        ["of the plain loops", *HEAD],
        rows_where(verdicts, plain),
    )
    write_table(
        "hunting/limit_cycles_parts",
        "Contribution of each part of the theory, for plain PI loops in cooling and in heating",
        ["what theory counts", *HEAD],
        (
            [f"{part}; {name}", *Verdicts.compare(case.seen, predict_with(case.loop, case.days, predict)).cells()]
            for part, predict in THEORY_PARTS.items()
            for name, case in plain.items()
        ),
    )
    write_table(
        "hunting/limit_cycles_days",
        f"Prediction from the mean conditions of a day compared with the metric `hunts` of that day: {len(DAY_SEEDS)} "
        f"days of each kind, {LOOPS} loops",
        ["days", *HEAD],
        day_rows(),
    )
