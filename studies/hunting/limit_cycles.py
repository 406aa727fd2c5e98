"""How right ``fc.limit_cycle`` is: what it predicts beside what the emulator does.

Loops, plants and operating points are drawn at random.  Each loop runs for 16 hours of constant air and water; a step
of the set-point after two hours starts what can be started, and the last eight hours count.  Other kinds of days
follow, predicted from their mean conditions.  ``choose`` prints how the threshold was chosen, on loops of another seed.
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
from studies.common import HEATING_GAIN, compare_rows, loguniform, share_of, write_table
from studies.days import HEATING, kinds, of_kind, settings

HOURS, STEP_AT, STEP = 16, 2 * 3600, 1.5
"""Length of a constant day, h; when its set-point steps, s, and by how much, K."""


class Population(NamedTuple):
    """What sets loops apart.  words: for the table.  ratio: estimate over backlash, from and to.  loop: parameters."""

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


def drawn(name: str, seed: int, n_loops: int, n_points: int) -> tuple[fc.Loop, dict[str, np.ndarray]]:
    """A population: loops along ``sample``, and operating points, (n_points,) each.

    An eighth of the valves has no gap.
    """
    of = POPULATIONS[name]
    heats = of.loop.get("action") == "heating"
    draw = np.random.default_rng([seed, list(POPULATIONS).index(name)])

    backlash = np.where(
        draw.random(n_loops) < 0.5, loguniform(draw, 0.005, 0.15, n_loops), draw.uniform(0.01, 0.15, n_loops)
    )
    backlash[::8] = 0.0
    values = {
        "backlash": backlash,
        "rangeability": loguniform(draw, 20.0, 100.0, n_loops),
        "authority": loguniform(draw, 0.02, 0.9, n_loops),
        "m_full": draw.uniform(1.2, 2.0, n_loops),
        "C_w": draw.uniform(8.8, 14.0, n_loops),
        "C_c": loguniform(draw, 10.0, 30.0, n_loops),
        "kp": loguniform(draw, 0.005, 0.06, n_loops) * (HEATING_GAIN if heats else 1.0),
        "ti": loguniform(draw, 5.0, 600.0, n_loops),
        "sample_time": draw.choice([1.0, 5.0, 10.0, 15.0, 30.0, 60.0], n_loops),
        "sensor_time_constant": np.where(draw.random(n_loops) < 0.25, 0.0, draw.uniform(0.0, 60.0, n_loops)),
        "stroke_time": np.where(draw.random(n_loops) < 0.3, 0.0, draw.uniform(15.0, 150.0, n_loops)),
        "backlash_estimate": draw.uniform(*of.ratio, n_loops) * backlash,
        "buffer": draw.uniform(*of.buffer, n_loops),
    }
    loop = fc.Loop().assign(**{name: ("sample", value) for name, value in values.items()}, **of.loop)
    return loop, _points(draw, n_points, heats)


def _points(draw: np.random.Generator, n: int, heats: bool) -> dict[str, np.ndarray]:
    m_a = draw.uniform(0.6, 1.5, n)
    if heats:
        T_a_in, T_w_in = draw.uniform(-5.0, 20.0, n), draw.uniform(35.0, 65.0, n)
        T_set = draw.uniform(np.maximum(T_a_in + 4.0, 18.0), np.maximum(T_a_in + 8.0, 30.0))
        return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": np.full(n, 0.003), "T_w_in": T_w_in, "T_set": T_set}
    T_a_in, T_w_in = draw.uniform(20.0, 33.0, n), draw.uniform(5.0, 10.0, n)
    W_a_in = humidity_ratio(T_a_in, draw.uniform(0.2, 0.8, n))
    T_set = draw.uniform(T_w_in + 5.5, np.minimum(T_a_in - 2.0, 19.0))
    return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": W_a_in, "T_w_in": T_w_in, "T_set": T_set}


def constant_days(points: Mapping[str, np.ndarray], population: str) -> fc.Boundary:
    """A day for each point on which nothing happens but one step of the set-point."""
    heats = POPULATIONS[population].loop.get("action") == "heating"
    series = {name: np.repeat(values[:, None], HOURS * 3600, axis=1) for name, values in points.items()}
    series["T_set"][:, :STEP_AT] += -STEP if heats else STEP
    return fc.Boundary(**series, day=list(range(points["T_set"].size)))


def textbook(columns: Mapping[str, np.ndarray], plants: Plants) -> Cycles:
    """The gap alone: the same threshold, and amplitude and period where |L| |N| is 1, or nearest to it."""
    n, w = plants.opening.size, np.geomspace(3e-4, np.pi, 300)
    found = Cycles(*(np.full(n, np.nan) for _ in Cycles._fields))
    found.hunting_index[:], found.hunts[:] = 0.0, 0.0
    for ts in np.unique(columns["sample_time"]):
        some = np.flatnonzero((columns["sample_time"] == ts) & plants.reachable)
        if not some.size:
            continue
        of, of_plants, x_bl = {k: v[some] for k, v in columns.items()}, plants.select(some), columns["backlash"][some]
        w = np.geomspace(3e-4, np.pi / ts, 200)
        gap = np.maximum(x_bl, 1e-6)[:, None]
        A = 0.5005 * gap * np.geomspace(1.0, 1e4, 120)
        N = describing_function(A, gap, gap)
        at = harmonic_balance(w, loop_response(of, of_plants, w), lambda _, N=N: N, A.shape[1], np.zeros(some.size))
        product, place = at.product.max(axis=0), at.place[0]
        hunting_index = np.where(x_bl > 0.0, product.max(axis=1), product[:, -1])
        last = product.shape[1] - 1 - (product[:, ::-1] >= 1.0).argmax(axis=1)
        rows = np.arange(some.size)
        k = np.where(hunting_index >= 1.0, last, product.argmax(axis=1))
        cycle = frequency_at(w, place[rows, k])
        G = np.abs(frequency_response(of_plants.response, w))
        T = (
            A[rows, k]
            * np.abs(N[rows, k])
            / (1.0 - x_bl)
            * G[rows, np.clip(place[rows, k].round().astype(int), 0, 199)]
        )
        hunts = (hunting_index > np.where(x_bl > 0.0, HUNTING_INDEX_LIMIT, 1.0)) & (2.0 * T > 0.1)
        found.hunting_index[some], found.hunts[some] = hunting_index, hunts
        found.period[some], found.amplitude[some] = (
            np.where(hunts, values, np.nan) for values in (2.0 * np.pi / cycle, T)
        )
    return found


SEARCH, FRESH = 901, 1201
LOOPS, POINTS = 400, 12
OTHER_LOOPS = 200
"""Of the populations that are not plain."""
DAY_SEEDS = range(1301, 1307)
WARM_UP = 8 * 3600
PERIOD, SWING = 0.15, 1.5
PLAIN = ("cooling", "heating")
Foretell = Callable[[fc.Loop, fc.Boundary, int], xr.Dataset]


class Case(NamedTuple):
    """A population beside what is predicted of it, both over (sample, day); at: the second that stands for the day."""

    loop: fc.Loop
    days: fc.Boundary
    seen: xr.Dataset
    predicted: xr.Dataset


def compared(population: str, seed: int, loops: int, points: int = POINTS) -> Case:
    """Simulate a population and predict it."""
    loop, conditions = drawn(population, seed, loops, points)
    days = constant_days(conditions, population)
    seen = fc.simulate(loop, days, warm_up=WARM_UP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what theory cannot predict is left out of the cases
        return Case(loop, days, seen, fc.limit_cycle(loop, days, at=days.n_steps - 1))


class Judged(NamedTuple):
    """What was right where the set-point can be held and something is predicted (``among``), over (sample, day)."""

    among: xr.DataArray
    hunts: xr.DataArray
    predicted: xr.DataArray
    period: xr.DataArray
    swing: xr.DataArray

    @classmethod
    def of(cls, seen: xr.Dataset, predicted: xr.Dataset) -> Judged:
        """Of a simulation and its forecast."""
        seen, predicted = (ds.reset_coords(drop=True).transpose("sample", "day") for ds in (seen, predicted))
        hunts, hunts_by_theory = seen.hunts == 1.0, predicted.hunts == 1.0
        among = (predicted.hunting_index > 0.0) & (seen.status == 0)
        period = abs(predicted.period / seen.hunting_period - 1.0) <= PERIOD
        swing = abs(np.log(2.0 * predicted.amplitude / seen.hunting_swing)) <= np.log(SWING)
        return cls(among, hunts, hunts_by_theory, period, swing)

    def cells(self, some: xr.DataArray | None = None) -> list[str]:
        """Failures first: missed, false alarms, then shares with their intervals."""
        among = self.among if some is None else self.among & some
        both = among & self.hunts & self.predicted
        right = self.hunts == self.predicted
        few = int(both.sum()) < 10
        return [
            f"{int((among & self.hunts & ~self.predicted).sum())}",
            f"{int((among & ~self.hunts & self.predicted).sum())}",
            f"{int(among.sum()):,}",
            f"{int((among & self.hunts).sum())}",
            share_of(right, among).written(1) if bool(among.any()) else "—",
            "—" if few else str(share_of(self.period, both)),
            "—" if few else str(share_of(self.swing, both)),
        ]


HEAD = ["missed", "false alarms", "cases", "hunt", "hunts or not: right", "period within 15 %",
        "peak to peak within × 1.5"]  # fmt: skip


def rows_where(judged: Mapping[str, Judged], cases: Mapping[str, Case]) -> Iterable[list[str]]:
    """The plain loops by what they are."""

    def joined(of: Callable[[str], xr.DataArray]) -> xr.DataArray:
        return xr.concat([of(name) for name in PLAIN], "sample")

    def judgement(i: int) -> xr.DataArray:
        return joined(lambda name: judged[name][i].drop_vars(["sample", "day"], errors="ignore"))

    both = Judged(*(judgement(i) for i in range(len(Judged._fields))))

    def parameter(name: str) -> xr.DataArray:
        return joined(lambda case: xr.DataArray(cases[case].loop[name]).drop_vars("sample", errors="ignore"))

    def theory(name: str) -> xr.DataArray:
        return joined(
            lambda case: (
                cases[case].predicted[name].reset_coords(drop=True).drop_vars(["sample", "day"], errors="ignore")
            )
        )

    at_rest = {
        name: fc.linearise(c.loop, c.days, at=c.days.n_steps - 1).reset_coords(drop=True) for name, c in cases.items()
    }

    def rest(name: str) -> xr.DataArray:
        return joined(lambda case: at_rest[case][name].drop_vars(["sample", "day"], errors="ignore"))

    wet, opening, hunting_index = rest("wet_volumes"), rest("opening"), theory("hunting_index")
    samples = theory("period") / parameter("sample_time")
    conditions = {
        "no gap": parameter("backlash") == 0.0,
        **_bands("gap", parameter("backlash"), (0.0, 0.02, 0.05, 0.15), "{:.0%}"),
        **_bands("hunting_index", hunting_index, (0.0, 0.7, 0.85, 1.0, 1.2, 2.0, 4.0, np.inf), "{:g}"),
        **_bands("sample time", parameter("sample_time"), (0.0, 5.0, 15.0, 60.0), "{:g} s"),
        **_bands("predicted samples to a period", samples, (0.0, 6.0, 10.0, 20.0, np.inf), "{:g}"),
        "motor at once": parameter("stroke_time") == 0.0,
        **_bands("stroke", parameter("stroke_time"), (0.0, 60.0, 150.0), "{:g} s"),
        "no sensor lag": parameter("sensor_time_constant") == 0.0,
        **_bands("sensor lag", parameter("sensor_time_constant"), (0.0, 30.0, 60.0), "{:g} s"),
        **_bands("authority", parameter("authority"), (0.0, 0.1, 0.9), "{:g}"),
        **_bands("opening", opening, (0.0, 0.05, 0.2, 0.5, 1.0), "{:g}"),
        "dry": wet == 0.0,
        "partly wet": (wet > 0.0) & (wet < 8.0),
        "wet all over": wet == 8.0,
    }
    for name, holds in conditions.items():
        yield [name, *both.cells(holds)]


def _bands(name: str, values: xr.DataArray, edges: tuple[float, ...], form: str) -> dict[str, xr.DataArray]:
    """Conditions of a value, each above one edge and up to the next."""
    found = {}
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        words = f"above {form.format(low)}" if np.isinf(high) else f"{form.format(low)} to {form.format(high)}"
        found[f"{name} {words}"] = (values > low) & (values <= high)
    return found


def predicted_with(
    loop: fc.Loop, days: fc.Boundary, of: Callable[[dict[str, np.ndarray], Plants], Cycles]
) -> xr.Dataset:
    """What another way of reckoning predicts."""
    points = OperatingPoints(loop, days, days.n_steps - 1)
    found = points.evaluate(lambda columns, _, plants: list(of(columns, plants)._asdict().items()))
    return points.dataset({name: (values, {}) for name, values in found.items()})


def without_motor(columns: dict[str, np.ndarray], plants: Plants) -> Cycles:
    """As if the motor were at its target at once."""
    return predict_cycles(columns | {"stroke_time": np.zeros_like(columns["stroke_time"])}, plants)


def straight(columns: dict[str, np.ndarray], plants: Plants) -> Cycles:
    """As if valve and coil were a straight line."""
    line = plants.T_sup[:, None] + plants.gain[:, None] * (OPENINGS - plants.opening[:, None])
    return predict_cycles(columns, plants._replace(curve=line))


def free_integral(columns: dict[str, np.ndarray], plants: Plants) -> Cycles:
    """As if the integral had no ends."""
    with patch.object(cycles, "INTEGRAL_LIMIT_ROUNDS", 0):
        return predict_cycles(columns, plants)


PARTS = {
    "gap alone": textbook,
    "all but the motor's speed": without_motor,
    "all but the curve of valve and coil": straight,
    "all but the ends of the integral": free_integral,
    "all": predict_cycles,
}


def rows_of_days() -> Iterable[list[str]]:
    """Every kind of day, predicted from its mean conditions."""
    for kind in kinds():
        population = "heating" if kind == HEATING else "cooling"
        loop, _ = drawn(population, FRESH + 1, LOOPS, POINTS)
        days = of_kind(kind, DAY_SEEDS)
        loop = loop.assign(**settings(kind))
        yield [kind, *Judged.of(fc.simulate(loop, days), fc.limit_cycle(loop, days)).cells()]


def choose() -> None:
    """Print how often the forecast is right with other thresholds, on the loops of another seed."""
    cases = [compared(name, SEARCH, LOOPS) for name in PLAIN]
    for above in (0.75, 0.8, 0.825, 0.85, 0.875, 0.9, 0.95, 1.0):
        with patch.object(cycles, "HUNTING_INDEX_LIMIT", above):
            right = [Judged.of(c.seen, fc.limit_cycle(c.loop, c.days, at=c.days.n_steps - 1)) for c in cases]
        print(f"{above:g}", *(share_of(j.hunts == j.predicted, j.among).written(2) for j in right), sep="   ")


def sample() -> None:
    """The first population."""
    name = next(iter(POPULATIONS))
    case = compared(name, FRESH, LOOPS if name in PLAIN else OTHER_LOOPS)
    found = Judged.of(case.seen, case.predicted).cells()
    compare_rows("hunting/limit_cycles", [[POPULATIONS[name].words, *found]])


def main() -> None:
    """Write every table."""
    cases = {name: compared(name, FRESH, LOOPS if name in PLAIN else OTHER_LOOPS) for name in POPULATIONS}
    judged = {name: Judged.of(case.seen, case.predicted) for name, case in cases.items()}
    write_table(
        "hunting/limit_cycles",
        f"Prediction compared with simulation: random loops × plants × {POINTS} operating points, seed {FRESH}; only "
        "cases whose set-point can be held",
        ["loops", *HEAD],
        ([POPULATIONS[name].words, *of.cells()] for name, of in judged.items()),
    )
    plain = {name: cases[name] for name in PLAIN}
    write_table(
        "hunting/limit_cycles_where",
        "Where the prediction is wrong: plain PI loops in cooling and heating, by property",
        ["of the plain loops", *HEAD],
        rows_where(judged, plain),
    )
    write_table(
        "hunting/limit_cycles_parts",
        "Contribution of each part of the theory, for plain PI loops in cooling and in heating",
        ["what theory counts", *HEAD],
        (
            [f"{part}; {name}", *Judged.of(case.seen, predicted_with(case.loop, case.days, of)).cells()]
            for part, of in PARTS.items()
            for name, case in plain.items()
        ),
    )
    write_table(
        "hunting/limit_cycles_days",
        f"Prediction from the mean conditions of a day compared with the metric `hunts` of that day: {len(DAY_SEEDS)} "
        f"days of each kind, {LOOPS} loops",
        ["days", *HEAD],
        rows_of_days(),
    )
