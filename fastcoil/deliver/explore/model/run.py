"""One loop simulated and foretold: the traces, and the same loop without its gap and without its inverse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.deliver.explore.model.scene import Scene
from fastcoil.deliver.explore.model.start import estimator_of
from fastcoil.design.theory.limit_cycle import limit_cycle
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import Scalar

EVERY = 5
"""Seconds between the samples of a trace."""
TRACES = ("T_sup", "T_measured", "u", "command", "opening", "estimate")
NOW, NO_GAP, PLAIN = range(3)
"""The loop as it is, behind a perfect valve, and with nothing that compensates the gap."""
_OF_A_GAP = ("backlash", "slip_jump", "wear_rate")


class Foretold(NamedTuple):
    """What theory says of a loop in the mean conditions of its day; doubt: why it says nothing, else empty.

    swing: peak to peak, K.  period: s.  Both are NaN where it does not hunt.
    """

    margin: float = np.nan
    hunts: bool = False
    swing: float = np.nan
    period: float = np.nan
    doubt: str = ""


class Run(NamedTuple):
    """One loop on one day.

    hours, traces: one sample each ``EVERY`` seconds.  metrics: by name, (3,), of ``NOW``, ``NO_GAP`` and ``PLAIN``.
    """

    scene: Scene
    hours: Array
    traces: Mapping[str, Array]
    metrics: xr.Dataset
    foretold: Foretold

    def value(self, metric: str, case: int = NOW) -> float:
        """A metric of a case."""
        return float(self.metrics[metric].values[case])

    def parameter(self, name: str) -> float:
        """A number of the loop."""
        return float(self.scene.loop[name])  # type: ignore[arg-type]

    @property
    def failed(self) -> bool:
        """Whether the loop left the range of the model."""
        return bool(self.value("status") != STATUS_OK)

    @property
    def compensates(self) -> bool:
        """Whether anything compensates the gap."""
        return self.parameter("backlash_estimate") > 0.0 or self.learns

    @property
    def learns(self) -> bool:
        """Whether an estimator changes the estimate."""
        return estimator_of(self.scene.loop) != "none"


def run(scene: Scene) -> Run:
    """Simulate a loop, twice more without what may be to blame or to thank, and ask theory.

    Raises
    ------
    InputError
        If loop and day cannot be simulated.
    """
    loop = scene.loop
    ds = simulate(
        loop.assign(**_cases(loop)), scene.day, traces=TRACES, trace_interval=EVERY, warm_up=scene.warm_up,
        seed=scene.seed, n_jobs=1, progress=False,
    )  # fmt: skip
    now = ds.isel(case=NOW)
    T_set = scene.day.series["T_set"][0][::EVERY]
    traces = {name: now[name].values for name in TRACES} | {"T_set": T_set}
    metrics = ds.drop_vars(TRACES)
    return Run(scene, ds["elapsed_time"].values / 3600.0, traces, metrics, foretell(scene))


def _cases(loop: Loop) -> dict[str, tuple[str, list[Scalar]]]:
    """The loop as it is, without a gap, and without compensation."""
    found: dict[str, tuple[str, list[Scalar]]] = {}
    for name in _OF_A_GAP:
        own = float(loop[name])  # type: ignore[arg-type]
        if own or name == "backlash":
            found[name] = ("case", [own, 0.0, own])
    found["backlash_estimate"] = ("case", [float(loop["backlash_estimate"]), 0.0, 0.0])  # type: ignore[arg-type]
    if estimator_of(loop) != "none":
        found["estimator"] = ("case", [estimator_of(loop), "none", "none"])
    return found


def foretell(scene: Scene) -> Foretold:
    """What theory says in the mean conditions of the day."""
    try:
        found = limit_cycle(scene.loop, scene.day)
    except InputError as error:
        # behind the first colon stands the reason, behind the second what to do about it in Python
        parts = error.problems[0].split(": ")
        return Foretold(doubt=parts[1] if len(parts) > 1 else parts[0])
    return Foretold(
        float(found["margin"]),
        bool(found["hunts"] > 0),
        2.0 * float(found["amplitude"]),
        float(found["period"]),
    )
