"""Every metric and trace once: name, unit, meaning, from ``outputs.toml``, in the order of the kernel's output rows."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastcoil.base.errors import did_you_mean

STATUS_MEANINGS = ("ok", "non_finite", "out_of_range", "not_run", "crashed")
STATUS_OK, STATUS_NON_FINITE, STATUS_OUT_OF_RANGE, STATUS_NOT_RUN, STATUS_CRASHED = range(5)

WARM_UP_S = 1800  # default of the time left out of every metric, as in section 2.2 of the paper
SETTLING_TIME_S = 600  # after a step of the set-point, or a start of the loop, that the settled metrics leave out
SET_POINT_STEP_K = 0.05  # change of the set-point from one second to the next that is a step; less is a reset
SWITCH_BLOCK_S = 600  # of the switch frequency, as in section 3.3 of the paper
PEAK_BLOCK_S = 900  # averaging time of the peak power
ESTIMATE_WINDOW_S = 7200  # last part of a run, over which the estimate is averaged
HUNTING_SWING_K = 0.1  # peak-to-peak supply temperature above which a loop may hunt: less is not worth a repair
OFF_SET_POINT_ERROR_K = 0.5  # control error beyond which the supply temperature counts as off its set-point


@dataclass(frozen=True, slots=True)
class Output:
    """One result variable; ``long_name`` and ``comment`` are its attributes in a result."""

    name: str
    unit: str
    long_name: str
    comment: str = ""
    difference: bool = False  # of temperatures
    per_volume: bool = False  # whether it has the dim ``volume``
    flags: tuple[str, ...] = ()  # meanings of a variable that is 0, 1, …
    label: str = ""  # a few words for the axis of a figure
    censored: bool = False  # whether NaN means "not within the run"


def read_output(name: str, *, flags: Sequence[str] = (), **fields: Any) -> Output:
    """Return the result variable that a table of ``outputs.toml`` describes; constants of this file fill its braces."""
    texts = {key: value.format_map(globals()) for key, value in fields.items() if isinstance(value, str)}
    return Output(name, flags=tuple(flags), **fields | texts)


_TABLES = tomllib.loads(Path(__file__).with_name("outputs.toml").read_text(encoding="utf-8"))
METRICS, COSTS, TRACES = (
    {name: read_output(name, **fields) for name, fields in _TABLES[kind].items()}
    for kind in ("metrics", "costs", "traces")
)
YEARLY_PREFIX = "yearly_"  # of the names of ``COSTS`` of a year

LEARNING_STATUS_MEANINGS = METRICS["learning_status"].flags
TEST_ABORTED_MEANINGS = METRICS["test_aborted"].flags

SUPPLY_METRICS = ("reheat_energy", "recool_energy")
"""Metrics of the error of the supply air; NaN where the room is controlled."""
COIL_METRICS = (*SUPPLY_METRICS, "coil_energy", "coil_peak_power", "condensate", "frost_time", "freeze_time")
"""Metrics that only the coil has; NaN with another plant."""
COIL_TRACES = ("T_w_out", "W_sup", "wet_volumes", "power", "T_w", "T_c", "T_a", "W_a")
"""Traces that only the coil has; NaN with another plant."""


def metric_hint(name: str) -> str:
    """Return the clause ``, did you mean …?`` with the metric most similar to a wrong name; empty without one."""
    return "" if name in METRICS else did_you_mean(name, METRICS)
