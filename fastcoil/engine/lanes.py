"""A block of lanes: which row of its state holds what, and how scenarios are cut into blocks.

A block is LANES scenarios side by side.  Its state is one flat array of rows of LANES doubles, so that row
offsets are compile-time constants and the compiler needs no alias checks between rows.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastcoil.parameter_table import PARAMETERS

LANES = 64

Columns = Mapping[str, np.ndarray]
"""Parameter name → one value per scenario; words as words, NaN where a stand-in is not given."""

PARAMETER_ROWS = (*PARAMETERS, "replicate")
STATE_ROWS = (
    # what the parameters amount to per step: see emulator.prepare
    "dt_C_w", "dt_C_c", "ntu_w_factor", "ntu_a_factor", "ntu_star_factor", "log_m_max", "max_travel", "sensor_decay",
    "ki", "sign",
    # sensor, controller, inverse
    "y_s", "noise", "noise_next", "measured", "u", "integral", "mode", "u_ext", "command",
    # learner
    "estimate", "next_update", "switches", "reference", "learning", "step", "evidence",
    # actuator, valve
    "position", "q", "opening", "growth", "log_m_w", "m_w",
    # coil: flow, conductance and effectiveness of this step
    "C_flow", "ntu_w", "G_w", "eps_a", "eps_star", "wet_volumes", "power",
    # sums of the metrics
    "sum_e2", "sum_e2_settled", "sum_abs_e", "e_previous", "crossings", "highest", "lowest", "sum_swing",
    "sum_switches", "stem_travel", "motor_travel", "last_turn", "reversals", "sum_estimate",
    "sum_power", "sum_power_block", "peak_power", "sum_m_w", "condensate", "farthest_T_c",
    "time_reached", "time_confirmed", "time_first_down", "estimate_first_down",
)  # fmt: skip
VOLUME_ROWS = ("T_w", "T_c", "T_a", "W_a", "Q_w", "W_s")
"""Rows of each control volume: the states, heat from the metal into the water, and saturation at T_c.

Volume 0 carries the entering water in T_w, volume N + 1 the entering air in T_a and W_a.
"""

Rows = namedtuple("Rows", PARAMETER_ROWS + STATE_ROWS)  # type: ignore[misc]
R: Any = Rows(*(LANES * k for k in range(len(Rows._fields))))
"""Offset of each row in the flat state S: constants to the compiler."""
T_W, T_C, T_A, W_A, Q_W, W_S = (LANES * k for k in range(len(VOLUME_ROWS)))
"""Offset of each row of volume 0 in the flat state V; volume i is i * VOLUME_STRIDE further."""
VOLUME_STRIDE = LANES * len(VOLUME_ROWS)


class Block(NamedTuple):
    """LANES scenarios that share a day, a number of volumes and an air march, ready for the kernel.

    ``rows`` is (len(PARAMETER_ROWS), LANES).  Periods are what the lanes have in common, s (0 = nobody
    learns); a flag tells what the whole block may skip or share, which changes no lane's bits.
    """

    rows: np.ndarray
    n_volumes: int
    lagged_air: bool
    control_period: int
    samples_together: bool
    learning_period: int
    has_noise: bool
    shares_air_side: bool


def blocks(columns: Columns) -> list[tuple[np.ndarray, Block]]:
    """Cut scenarios of one day into blocks: (index of the scenario in each used lane, block).

    Scenarios that share N and air march are sorted by sample time, so that most blocks sample in step; the
    last block of each kind is padded with copies of its last scenario.
    """
    matrix = parameter_matrix(columns)
    order = np.lexsort([matrix[PARAMETER_ROWS.index(name)] for name in
                        ("learning_interval", "sample_time", "air_march", "n_volumes")])  # fmt: skip
    kind = matrix[[PARAMETER_ROWS.index("n_volumes"), PARAMETER_ROWS.index("air_march")]][:, order]
    starts = np.flatnonzero(np.any(np.diff(kind, axis=1, prepend=-1.0) != 0.0, axis=0))
    cut = []
    for group in np.split(order, starts[1:]):
        for start in range(0, group.size, LANES):
            members = group[start : start + LANES]
            padded = np.concatenate([members, np.full(LANES - members.size, members[-1])])
            cut.append((members, _block(np.ascontiguousarray(matrix[:, padded]))))
    return cut


def parameter_matrix(columns: Columns) -> np.ndarray:
    """The columns as numbers, (len(PARAMETER_ROWS), n): a word becomes the index of its choice."""
    return np.stack([_numbers(name, columns[name]) for name in PARAMETER_ROWS])


def _numbers(name: str, values: np.ndarray) -> np.ndarray:
    if name in PARAMETERS and PARAMETERS[name].is_word:
        choices = np.array(PARAMETERS[name].choices)
        return np.asarray((values[:, None] == choices) @ np.arange(choices.size), dtype=float)
    return np.asarray(values, dtype=float)


def _block(rows: np.ndarray) -> Block:
    row = dict(zip(PARAMETER_ROWS, rows, strict=True))
    learners = row["learning_step"] > 0.0
    return Block(
        rows=rows,
        n_volumes=int(row["n_volumes"][0]),
        lagged_air=bool(row["air_march"][0] == 0.0),
        control_period=int(np.gcd.reduce(row["sample_time"].astype(np.int64))),
        samples_together=bool(np.ptp(row["sample_time"]) == 0.0),
        learning_period=_learning_period(row, learners),
        has_noise=bool(np.any(row["noise_std"] > 0.0)),
        shares_air_side=all(np.ptp(row[name]) == 0.0 for name in ("beta3", "beta4", "beta5", "beta6")),
    )


def _learning_period(row: Mapping[str, np.ndarray], learners: np.ndarray) -> int:
    """Seconds between two looks at the learners: intervals end at multiples of it, early trips come at samples."""
    early = learners & (row["learning_early_trip"] > 0.0)
    seconds = np.concatenate([row["learning_interval"][learners], row["sample_time"][early]])
    return int(np.gcd.reduce(seconds.astype(np.int64), initial=0))


def trace_rows(names: Sequence[str], n_volumes: int) -> np.ndarray:
    """Where the named traces are, volume by volume where they have volumes; (n_rows,).

    Offsets of S as they are, offsets of V as -1 - offset.
    """
    volume = {"T_w": T_W, "T_c": T_C, "T_a": T_A, "W_a": W_A}
    ends = {"T_sup": T_A + VOLUME_STRIDE, "W_sup": W_A + VOLUME_STRIDE, "T_w_out": T_W + n_volumes * VOLUME_STRIDE}
    signal = R._asdict() | {"T_measured": R.measured}
    rows: list[int] = []
    for name in names:
        if name in volume:
            rows += [-1 - (volume[name] + i * VOLUME_STRIDE) for i in range(1, n_volumes + 1)]
        else:
            rows.append(-1 - ends[name] if name in ends else signal[name])
    return np.array(rows, dtype=np.int64)
