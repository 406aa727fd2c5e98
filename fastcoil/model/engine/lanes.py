"""Blocks of lanes on the host side: scenarios cut into blocks, work space, runs, the state from one day to the next."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.engine.controller import ControllerFeatures, control_stage
from fastcoil.model.engine.emulator import DAY_COLUMN, Day, emulate
from fastcoil.model.engine.metrics import ESTIMATOR_METRICS, N_METRICS, make_schedule
from fastcoil.model.engine.plant import plant_stage
from fastcoil.model.engine.rules import estimator_stage, law_stage
from fastcoil.model.engine.valve import ActuatorFeatures, actuator_stage
from fastcoil.model.estimators.interface import Estimator, StepRule
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.hunting import N_SWING_ROWS, judge_swing
from fastcoil.model.numerics.stages import BUILT_IN
from fastcoil.model.parameter_table import PARAMETERS

from fastcoil.model.engine.rows import (  # isort: skip
    LANES, LINEAR, PARAMETER_ROWS, ROWS, T_A, T_C, T_W, VOLUME_ROWS, VOLUME_STRIDE, W_A, R,
)  # fmt: skip
from fastcoil.model.metric_table import (  # isort: skip
    COIL_METRICS, COIL_TRACES, LEARNING_STATUS_MEANINGS, METRICS, STATUS_OK, SUPPLY_METRICS,
)  # fmt: skip

Columns = Mapping[str, np.ndarray]
"""Parameter name → one value per scenario; words as words, NaN where a parameter without default is not given."""
ROOM = float(PARAMETERS["controlled"].choices.index("T_room"))
BLOCK_KEYS = ("plant", "controlled", "law", "estimator", "air_march", "n_volumes", "substeps")
"""Parameters of which a block has one value: lanes of different estimators or laws never share a block."""


class UserRules(NamedTuple):
    """Estimators, laws and plants of the user; their numbers follow those of the package."""

    estimators: tuple[Estimator, ...] = ()
    laws: tuple[StepRule, ...] = ()
    plants: tuple[StepRule, ...] = ()

    def choices(self, name: str) -> tuple[str, ...]:
        """Return the choices of a parameter, by number, with these rules."""
        user_rules: Mapping[str, tuple[StepRule, ...]]
        user_rules = {"estimator": self.estimators, "law": self.laws, "plant": self.plants}
        return (*PARAMETERS[name].choices, *(rule.name for rule in user_rules.get(name, ())))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters that these rules add: the last rows of a matrix."""
        names = [n for kind in self for rule in kind for n in rule.Parameters._fields if n not in PARAMETERS]
        return tuple(dict.fromkeys(names))


NO_USER_RULES = UserRules()


class BlockConfig(NamedTuple):
    """Settings of the kernel for all lanes of a block; flags let it skip or share work, and change no bits."""

    n_volumes: int
    substeps: int
    lagged_air: bool
    control_period: int  # common divisor of those of the lanes, s
    samples_together: bool
    estimating_period: int  # the same; 0: nothing is estimated
    has_noise: bool
    has_lag: bool
    shares_air_side: bool
    leaks: bool
    is_linear: bool
    has_room: bool
    controls_room: bool
    n_kept: int  # seconds that a plant of the user may look back to
    plant: Any  # this and the following are stages
    estimator: Any
    law: Any
    control: Any
    actuator: Any


class Block(NamedTuple):
    """LANES scenarios that share a day and all of BLOCK_KEYS; rows: parameters, then those of rules; row: by name."""

    rows: np.ndarray
    config: BlockConfig
    estimator: Estimator | None
    law: StepRule | None
    plant: StepRule | None
    row: Mapping[str, np.ndarray]


def cut_into_blocks(matrix: np.ndarray, rules: UserRules = NO_USER_RULES) -> list[tuple[np.ndarray, Block]]:
    """Cut scenarios of one day into blocks: (index of the scenario in each used lane, block).

    matrix, rules: see ``parameter_matrix``.  Scenarios that share all of BLOCK_KEYS are sorted by sample time, so that
    most blocks sample in step; the last block is padded with copies of its last scenario.
    """
    row = _rows_by_name(matrix, rules)
    order = np.lexsort([row[name] for name in ("learning_interval", "sample_time", *BLOCK_KEYS)])
    keys = np.stack([row[name] for name in BLOCK_KEYS])[:, order]
    starts = np.flatnonzero(np.any(np.diff(keys, axis=1, prepend=-1.0) != 0.0, axis=0))
    members_and_blocks = []
    for group in np.split(order, starts[1:]):
        for start in range(0, group.size, LANES):
            members = group[start : start + LANES]
            rows = np.ascontiguousarray(matrix[:, pad_members(members)])
            members_and_blocks.append((members, _make_block(rows, rules)))
    return members_and_blocks


def pad_members(members: np.ndarray) -> np.ndarray:
    """Index of the scenario in each lane of a block, padded with the last one."""
    return np.concatenate([members, np.full(LANES - members.size, members[-1])])


def run_sets(
    matrix: np.ndarray, run: Callable[[Block, np.ndarray], Sequence[np.ndarray]], rules: UserRules = NO_USER_RULES
) -> tuple[np.ndarray, ...]:
    """Run parameter sets block by block; run: a block, members → arrays (…, LANES), which become (…, n_sets)."""
    results: tuple[np.ndarray, ...] = ()
    for members, block in cut_into_blocks(matrix, rules):
        parts = run(block, members)
        results = results or tuple(np.empty((*part.shape[:-1], matrix.shape[1])) for part in parts)
        for whole, part in zip(results, parts, strict=True):
            whole[..., members] = part[..., : members.size]
    return results


def parameter_matrix(columns: Columns, rules: UserRules = NO_USER_RULES) -> np.ndarray:
    """Stack columns as numbers, (rows, n), a word as the index of its choice; parameters of rules are below."""
    matrix = np.stack([_as_numbers(name, columns[name], rules) for name in (*PARAMETER_ROWS, *rules.parameter_names)])
    row = _rows_by_name(matrix, rules)
    has_ratio = row["estimate_ratio"] >= 0.0
    np.copyto(row["backlash_estimate"], row["estimate_ratio"] * row["backlash"], where=has_ratio)
    return matrix


def _as_numbers(name: str, values: np.ndarray, rules: UserRules) -> np.ndarray:
    if name in PARAMETERS and PARAMETERS[name].is_word:
        choices = np.array(rules.choices(name))
        return np.asarray((values[:, None] == choices) @ np.arange(choices.size), dtype=float)
    return np.asarray(values, dtype=float)


def _rows_by_name(matrix: np.ndarray, rules: UserRules) -> dict[str, np.ndarray]:
    return dict(zip((*PARAMETER_ROWS, *rules.parameter_names), matrix, strict=True))


def _make_block(rows: np.ndarray, rules: UserRules) -> Block:
    row = _rows_by_name(rows, rules)
    estimator = (*ESTIMATORS, *rules.estimators)[int(row["estimator"][0])]
    law = (None, *rules.laws)[int(row["law"][0])]
    plant = (None, *rules.plants)[int(row["plant"][0])]
    config = BlockConfig(
        n_volumes=int(row["n_volumes"][0]),
        substeps=int(row["substeps"][0]),
        lagged_air=bool(row["air_march"][0] == 0.0),
        control_period=int(np.gcd.reduce(row["sample_time"].astype(np.int64))),
        samples_together=bool(np.ptp(row["sample_time"]) == 0.0),
        estimating_period=_estimating_period(row, estimator),
        has_noise=bool(np.any(row["noise_std"] > 0.0)),
        has_lag=bool(np.any(row["sensor_time_constant"] > 0.0)),
        shares_air_side=all(np.ptp(row[name]) == 0.0 for name in ("beta3", "beta4", "beta5", "beta6")),
        leaks=bool(np.any(row["leakage"] >= 0.0)),
        is_linear=bool(np.any(row["curve"] == LINEAR)),
        has_room=bool(np.any(row["room_capacity"] > 0.0)),
        controls_room=bool(row["controlled"][0] == ROOM),
        n_kept=1 + int(row["dead_time"].max()),
        plant=BUILT_IN if plant is None else plant_stage(plant),
        estimator=BUILT_IN if estimator is None else estimator_stage(estimator),
        law=BUILT_IN if law is None else law_stage(law),
        control=control_stage(ControllerFeatures.of_lanes(estimator, law, row)),
        actuator=actuator_stage(ActuatorFeatures.of_lanes(row)),
    )
    return Block(rows, config, estimator, law, plant, row)


def _estimating_period(row: Mapping[str, np.ndarray], estimator: Estimator | None) -> int:
    """Seconds between calls of the estimator: a common divisor of the periods of the lanes."""
    if estimator is None:
        return 0
    seconds = row["sample_time"] if estimator.periods is None else estimator.periods(row)
    return int(np.gcd.reduce(seconds.astype(np.int64)))


class WorkSpace(NamedTuple):
    """Flat states of one block: S and V, see ``rows``; parameters and memory of its estimator, law and plant."""

    S: np.ndarray
    V: np.ndarray
    estimator_state: np.ndarray
    law_state: np.ndarray
    plant_state: np.ndarray


def work_space(block: Block) -> WorkSpace:
    """Allocate the states of a block, uninitialised except the parameters of its rules."""
    return WorkSpace(
        _allocate_aligned(len(ROWS) * LANES),
        _allocate_aligned((block.config.n_volumes + 2) * VOLUME_STRIDE),
        _allocate_rule_state(block.estimator, block.row),
        _allocate_rule_state(block.law, block.row),
        _allocate_rule_state(block.plant, block.row, 2 * block.config.n_kept),
    )


def _allocate_rule_state(rule: StepRule | None, row: Mapping[str, np.ndarray], n_array: int = 0) -> np.ndarray:
    """Allocate the parameters that a rule reads and, behind them, its memory and an array for each lane, both 0."""
    if rule is None:
        return _allocate_aligned(0)
    parameters = [row[name] for name in rule.Parameters._fields]
    n_array = rule.n_floats if isinstance(rule, Estimator) else n_array
    state = _allocate_aligned(LANES * (len(parameters) + len(rule.Memory._fields) + n_array))
    state[:] = 0.0
    state[: LANES * len(parameters)] = np.ravel(parameters)
    return state


def _allocate_aligned(size: int) -> np.ndarray:
    """Allocate from the edge of a cache line, 8 doubles, on: a vector across two lines costs twice."""
    buffer = np.empty(size + 8)
    start = -buffer.ctypes.data // buffer.itemsize % 8
    return buffer[start : start + size]


def trace_rows(names: Sequence[str], n_volumes: int) -> np.ndarray:
    """Offsets of the named traces, (n_rows,), volume by volume; an offset of V is given as -1 - offset."""
    volumes = range(VOLUME_STRIDE, (n_volumes + 1) * VOLUME_STRIDE, VOLUME_STRIDE)
    states = {"T_w": (T_W, volumes), "T_c": (T_C, volumes), "T_a": (T_A, volumes), "W_a": (W_A, volumes)}
    states |= {"T_sup": (T_A, volumes[:1]), "W_sup": (W_A, volumes[:1]), "T_w_out": (T_W, volumes[-1:])}
    signals = vars(R) | {"T_measured": R.measured}
    rows: list[int] = []
    for name in names:
        row, places = states.get(name, (0, range(0)))
        rows += [-1 - row - place for place in places] or [signals[name]]
    return np.array(rows, dtype=np.int64)


class TraceRequest(NamedTuple):
    """Traces to record, and the interval between their samples, s."""

    names: tuple[str, ...] = ()
    interval: int = 1

    def n_points(self, n_steps: int) -> int:
        """Number of samples in a run of ``n_steps`` seconds: one at every ``interval``, from second 0 on."""
        return -(-n_steps // self.interval) if self.names else 0


def run_block(
    block: Block, day: Day, request: TraceRequest, work: WorkSpace | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Run one block.

    work: its state, which a day that does not start at 0 goes on from; left as at the end.  Return metrics (N_METRICS,
    LANES), status (LANES,) and traces by name, (n_points, LANES) or (n_points, N, LANES), NaN in failed lanes.
    """
    n_volumes = block.config.n_volumes
    rows = trace_rows(request.names, n_volumes)
    traces = np.empty((request.n_points(day.series.shape[0]), rows.size, LANES))
    metrics, status = np.full((N_METRICS, LANES), np.nan), np.empty(LANES, dtype=np.int64)
    swings = np.zeros((day.schedule.n_swing_blocks + 1, N_SWING_ROWS, LANES))
    swings[:, -2:] = [[-np.inf], [np.inf]]
    work = work_space(block) if work is None else work
    emulate(block.rows, block.config, day, *work, metrics, status, swings, rows, request.interval, traces)
    late_metrics = _estimator_metrics(block, work.estimator_state, day.command.size > 0)
    late_metrics["hunts"], late_metrics["hunting_swing"] = judge_swing(swings[:-1])
    unknown = (COIL_METRICS if block.plant else ()) + (SUPPLY_METRICS if block.config.controls_room else ())
    late_metrics |= dict.fromkeys(unknown, np.nan)
    for name, values in late_metrics.items():
        metrics[list(METRICS).index(name)] = np.where(status == STATUS_OK, values, np.nan)

    traces[:, :, status != STATUS_OK] = np.nan
    traces_by_name, k = {}, 0
    for name in request.names:
        has_volumes = name in VOLUME_ROWS
        traces_by_name[name] = traces[:, k : k + n_volumes] if has_volumes else traces[:, k]
        if block.plant and name in COIL_TRACES:
            traces_by_name[name] *= np.nan
        k += n_volumes if has_volumes else 1
    return metrics, status, traces_by_name


def _estimator_metrics(block: Block, estimator_state: np.ndarray, open_loop: bool) -> dict[str, Any]:
    """Compute ESTIMATOR_METRICS; those of other estimators are NaN, or off."""
    metrics: dict[str, Any] = dict.fromkeys(ESTIMATOR_METRICS, np.nan)
    metrics["learning_status"] = LEARNING_STATUS_MEANINGS.index("off")
    rule = block.estimator
    if rule is not None and rule.results is not None and not open_loop:
        first, n = len(rule.Parameters._fields), len(rule.Memory._fields)
        metrics |= rule.results(rule.Memory(*estimator_state.reshape(-1, LANES)[first : first + n]))
    return metrics


def default_block() -> Block:
    """Return a block of default loops."""
    columns = {p.name: np.array([np.nan if p.default is None else p.default]) for p in PARAMETERS.values()}
    columns |= {"replicate": np.zeros(1), "estimator": np.array(["none"])}
    ((_, block),) = cut_into_blocks(parameter_matrix(columns))
    return block


def compile_kernel() -> None:
    """Compile the kernel, or load it from the cache, by running the default loop for one second."""
    series = np.array([[1.0, 25.0, 0.01, 7.0, 14.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0]])  # DAY_COLUMNS
    schedule = make_schedule(series[:, DAY_COLUMN.T_set], series[:, DAY_COLUMN.enabled], warm_up=0)
    run_block(default_block(), Day(series, np.empty(0), schedule, 0, (0, 0)), TraceRequest())
