"""What a loop tells its controller: numbers, and which parts of the laws it has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of
from fastcoil.model.control import noise_level
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.estimators.identify import CANDIDATES, HORIZON
from fastcoil.model.parameter_table import LARGEST, PARAMETERS

ANY_SET_POINTS = np.array([0.0, LARGEST])
"""A controller may get any."""


@dataclass(frozen=True)
class Settings:
    """The parameters of one controller by name, and its words."""

    number: dict[str, float]
    estimator: str
    compensation: str
    heats: bool
    measures_noise: bool

    @classmethod
    def of(cls, loop: Loop) -> Settings:
        """Those of a loop.

        Raises
        ------
        InputError
            If it is a sweep, has rules of the user's own, or cannot run in fixed cycles.
        """
        problems = [f"{name} is swept: give it one value, a controller has one" for name in loop.swept]
        problems += [
            f"{rule.kind} = {rule.name!r} is a rule of your own: port its Python by hand, or export the loop with a "
            f"{rule.kind} of fastcoil"
            for rule in loop.rules.values()
            if not loop.swept and loop[rule.kind] == rule.name
        ]
        if problems:
            raise InputError(problems)
        check_clashes(loop, ANY_SET_POINTS)
        columns = columns_of(loop, {}, np.zeros(1, dtype=np.int64))
        numbers = parameter_matrix(columns)[:, 0].tolist()
        words = {name: str(columns[name][0]) for name in ("estimator", "compensation", "action", "buffer_noise")}
        settings = cls(
            dict(zip(PARAMETER_ROWS, numbers, strict=True)),
            words["estimator"],
            words["compensation"],
            words["action"] == "heating",
            words["buffer_noise"] == "measured",
        )
        if problems := settings._cycle_problems():
            raise InputError(problems)
        return settings

    def _cycle_problems(self) -> list[str]:
        sample, interval = self.number["sample_time"], self.number["learning_interval"]
        if self.estimator != "learner" or interval % sample == 0.0:
            return []
        below, above = sample * math.floor(interval / sample), sample * math.ceil(interval / sample)
        return [
            f"learning_interval = {interval:g} s is not a whole number of cycles of {sample:g} s (sample_time): give "
            f"{below:g} or {above:g}, say"
        ]

    @property
    def sees_air(self) -> bool:
        """Whether the air flow is one of its inputs."""
        return self.estimator in ("gradient", "identify")

    @property
    def has_estimate(self) -> bool:
        """Whether an estimator changes the estimate."""
        return self.estimator != "none"

    def parts(self) -> dict[str, Any]:
        """What the templates ask for: which parts of the laws there are, and a few names and numbers."""
        number, has = self.number, self.has_estimate
        share = has and number["estimate_share"] != 1.0
        assumed = "s.estimate" if has else "BACKLASH_ESTIMATE"
        start = "ESTIMATE_SHARE * BACKLASH_ESTIMATE" if share else "BACKLASH_ESTIMATE"
        buffer_ratio, waives = number["buffer_ratio"] > 0.0, self.estimator == "identify"
        horizon = max(math.floor(HORIZON / number["sample_time"] + 0.5), 1)
        return {
            "estimator": self.estimator if has else "",
            "heating": self.heats,
            "sees_air": self.sees_air,
            "dead_band": number["error_dead_band"] > 0.0,
            "share": share,
            "assumed": "assumed" if share else assumed,
            "assumed_at_start": start,
            "additive": self.compensation == "additive",
            "smooth": self.compensation == "smooth",
            "buffer_ratio": buffer_ratio,
            "buffer_swing": buffer_ratio and number["buffer_swing"] > 0.0,
            "measures_noise": self.measures_noise,
            "waives_buffer": waives,
            "band": "band" if buffer_ratio or waives else "BUFFER",
            "noise_of_median": repr(float(noise_level(1.0))) if self.measures_noise else "",
            "sample_time": f"{number['sample_time']:g}",
            **self._learner(),
            "reports_only": number["estimate_share"] == 0.0,
            "horizon": horizon,
            "stroke_time": number["identify_stroke_time"] > 0.0,
            "candidates": "\n    ".join(wrap(", ".join(repr(float(size)) for size in CANDIDATES), 92)),
        }

    def _learner(self) -> dict[str, bool | str]:
        """Which variants of the learner differ from the paper's."""
        number = self.number
        changed = {name: number[name] != PARAMETERS[name].default for name in number if name.startswith("learning_")}
        stops, trips = number["learning_stop"] > 0.0, number["learning_early_trip"] > 0.0
        return {
            "min_switches": changed["learning_min_switches"],
            "max_reference": changed["learning_max_reference"],
            "evidence": changed["learning_min_switches"] or changed["learning_max_reference"],
            "growth": changed["learning_growth"],
            "shrink": changed["learning_shrink"],
            "stop": stops,
            "learning": "s.learning and " if stops else "",
            "acts": "acts" if stops or trips else "ends",
            "final": changed["learning_final"] and stops,
            "reference": number["learning_reference"] > 0.0,
            "error_ratio": number["learning_error_ratio"] > 0.0,
            "early_trip": trips,
        }
