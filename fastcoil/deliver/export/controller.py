"""The controller of one loop: its numbers, its rules, and its laws in Python, of which C and ST are made.

The frame of the laws (PI, compensation, start, bad readings) is in ``laws/controller.py.jinja``; the estimator, and a
law in place of the PI, are translated from the functions that the kernel runs.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from textwrap import wrap
from typing import Any

import jinja2
import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.base.machine import package_version
from fastcoil.deliver.export.python import names_in
from fastcoil.deliver.export.translate import Port, Translator
from fastcoil.deliver.export.words import WIDTH, number
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.labels import unit_in_words
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of
from fastcoil.model.control import Law, noise_level
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.estimators.interface import Estimator
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.parameter_table import LARGEST, PARAMETERS, Parameter
from fastcoil.model.user_rules import rules_for_kernels

ANY_SET_POINTS = np.array([0.0, LARGEST])
"""A controller may get any."""
FRAME = (
    "running", "clock", "e", "integral_part", "u", "u_ext", "rising", "command", "estimate", "switches", "u_before",
    "readings", "noise_median", "e_1", "e_2", "T_seen", "decided", "w", "T_sup", "T_set", "m_a", "enabled", "reset",
    "start_command", "starts", "good_T_sup", "good_T_set", "assumed", "noise", "band", "changed", "power", "crossed",
    "size", "part", "x", "clipped", "start", "step", "control", "measure_noise", "compensate", "begin_law",
    "LOWEST_READING", "HIGHEST_READING", "NOISE_READINGS", "FIRST_NOISE", "LEAST_NOISE", "NOISE_OF_MEDIAN",
)  # fmt: skip
"""Names that the frame of the laws has."""
_LAWS = Path(__file__).parent / "laws"
_COMPOUND = {"K-1 s-1": "1/(K s)"}
"""Units that figures leave as they are."""


@cache
def templates() -> jinja2.Environment:
    """The templates; a line that begins with ``#:`` is for them alone."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(_LAWS),
        line_statement_prefix="#:",
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701 — no page
    )


@dataclass(frozen=True)
class Controller:
    """The parameters of one controller by name, its words, and its rules as laws."""

    number: dict[str, float]
    estimator: str
    law: str
    compensation: str
    heats: bool
    measures_noise: bool
    waives_buffer: bool
    rests: bool
    own: tuple[str, ...]
    parameters: dict[str, Parameter] = field(repr=False)
    estimating: Port | None = field(repr=False)
    deciding: Port | None = field(repr=False)

    @classmethod
    def of(cls, loop: Loop) -> Controller:
        """That of a loop.

        Raises
        ------
        InputError
            If it is a sweep, cannot run in fixed cycles, or has a rule that cannot be translated.
        """
        if loop.swept:
            raise InputError([f"{name} is swept: give it one value, a controller has one" for name in loop.swept])
        check_clashes(loop, ANY_SET_POINTS)
        rules = rules_for_kernels(loop.rules)
        columns = columns_of(loop, {}, np.zeros(1, dtype=np.int64))
        numbers = dict(zip((*PARAMETER_ROWS, *rules.own), parameter_matrix(columns, rules)[:, 0].tolist(), strict=True))
        words = {name: str(columns[name][0]) for name, p in PARAMETERS.items() if p.is_word}
        _require_cycles(words["estimator"], numbers)
        known: list[Estimator] = [*(e for e in ESTIMATORS if e is not None), *rules.estimators]
        estimator = next((e for e in known if e.name == words["estimator"]), None)
        law = next((one for one in rules.laws if one.name == words["law"]), None)
        seen = "s.estimate" if estimator is not None else "BACKLASH_ESTIMATE"
        # the function as it was written, not as it was compiled
        written = {rule.name: rule.parts[0] for rule in loop.rules.values() if rule.is_loaded}
        taken = [*FRAME, *(name.upper() for name in numbers)]
        others = [each for n in (law.Memory._fields if law is not None else ()) for each in (n, f"{n}_known")]
        estimating = deciding = None
        if estimator is not None:
            estimating = _port(estimator, written.get(estimator.name), numbers, seen, [*taken, *others])
            taken += names_in("\n".join([*estimating.functions, *estimating.sections]))
        if law is not None:
            deciding = _port(law, written.get(law.name), numbers, seen, taken)
        return cls(
            numbers,
            words["estimator"],
            words["law"],
            words["compensation"],
            words["action"] == "heating",
            words["buffer_noise"] == "measured",
            estimator is not None and estimator.waives_buffer,
            estimator is None or estimator.periods is None,
            tuple(name for name in written if name in words.values()),
            dict(loop.parameters),
            estimating,
            deciding,
        )

    @property
    def ports(self) -> tuple[Port, ...]:
        """Its rules as laws."""
        return tuple(port for port in (self.estimating, self.deciding) if port is not None)

    @property
    def sees_air(self) -> bool:
        """Whether the air flow is one of its inputs."""
        return any("m_a" in port.reads for port in self.ports)

    @property
    def has_estimate(self) -> bool:
        """Whether an estimator changes the estimate."""
        return self.estimating is not None

    def text(self) -> str:
        """The laws in Python, without what this controller does not need."""
        number, has = self.number, self.has_estimate
        share = has and number["estimate_share"] != 1.0
        assumed = "s.estimate" if has else "BACKLASH_ESTIMATE"
        buffer_ratio = number["buffer_ratio"] > 0.0
        parts = {
            "estimating": self.estimating,
            "deciding": self.deciding,
            "ports": self.ports,
            "rests": self.rests,
            "heating": self.heats,
            "sees_air": self.sees_air,
            "dead_band": number["error_dead_band"] > 0.0,
            "share": share,
            "assumed": "assumed" if share else assumed,
            "assumed_at_start": "ESTIMATE_SHARE * BACKLASH_ESTIMATE" if share else "BACKLASH_ESTIMATE",
            "additive": self.compensation == "additive",
            "smooth": self.compensation == "smooth",
            "buffer_ratio": buffer_ratio,
            "buffer_swing": buffer_ratio and number["buffer_swing"] > 0.0,
            "measures_noise": self.measures_noise,
            "waives_buffer": self.waives_buffer,
            "band": "band" if buffer_ratio or self.waives_buffer else "BUFFER",
            "noise_of_median": repr(float(noise_level(1.0))) if self.measures_noise else "",
            "sample_time": f"{number['sample_time']:g}",
        }
        read = {name for port in self.ports for name in port.parameters}
        frame = {
            "sample_time": True, "kp": self.deciding is None or buffer_ratio, "ti": self.deciding is None,
            "error_dead_band": parts["dead_band"], "backlash_estimate": True, "estimate_share": share, "buffer": True,
            "buffer_ratio": buffer_ratio, "noise_std": buffer_ratio and not self.measures_noise,
            "buffer_swing": parts["buffer_swing"], "plant_gain": parts["buffer_swing"],
            "smooth_rate": parts["smooth"],
        }  # fmt: skip
        names = [name for name, needed in frame.items() if needed or name in read]
        names += [name for name in self.number if name in read and name not in names]
        text = (
            templates()
            .get_template("controller.py.jinja")
            .render(parts, parameters=[self._constant(n) for n in names], version=package_version(), words=self.words())
        )
        text = text if "math." in text else text.replace("import math\n", "", 1)
        text = re.sub(r"\n+(?=(def|class) )", "\n\n\n", text)
        return re.sub(r"\n+(?=# (Parameters|Fixed)|import )", "\n\n", text)

    def words(self) -> str:
        """What the controller consists of."""
        parts = ["a PI law" if self.deciding is None else f"the law {self.law}"]
        if self.number["error_dead_band"] > 0.0:
            parts.append("a dead band")
        if self.compensation == "additive":
            parts.append("half the backlash added to its output")
        elif self.compensation == "smooth":
            parts.append("a smooth backlash inverse")
        elif self.has_estimate or self.number["backlash_estimate"] > 0.0:
            parts.append("a backlash inverse")
        if self.has_estimate:
            parts.append(f"the estimator {self.estimator}")
        last = f" and {parts.pop()}" if len(parts) > 1 else ""
        return f"{', '.join(parts)}{last}"

    def _constant(self, name: str) -> str:
        """A parameter as a constant, with its unit and meaning."""
        unit, text = self.parameters[name].unit, self.parameters[name].text
        unit = _COMPOUND.get(unit) or unit_in_words(unit)
        meaning = f"{unit}: {text}" if unit else text
        line = f"{name.upper()} = {number(self.number[name])}"
        if max(len(line), 33) + len(meaning) < WIDTH - 18:
            return f"{line}  # {meaning}"
        return "\n".join([*(f"# {part}" for part in wrap(meaning, WIDTH - 12)), line])


def _port(rule: Estimator | Law, written: Any, numbers: dict[str, float], estimate: str, taken: list[str]) -> Port:
    """A rule as laws.  A parameter that is at its default may be left out, a word is a number.

    written: the function of a user's rule.
    """
    of_table = [PARAMETERS[name] for name in rule.Parameters._fields if name in PARAMETERS]
    is_estimator = isinstance(rule, Estimator)
    return Translator(
        "estimator" if is_estimator else "law",
        rule.name,
        written or rule.step,
        rule.start if isinstance(rule, Estimator) else None,
        rule.Parameters,
        rule.Memory,
        {name: numbers[name] for name in rule.Parameters._fields},
        words=rule.words if isinstance(rule, Estimator) else 0,
        estimate=estimate,
        names=taken,
        literal=frozenset(p.name for p in of_table if p.is_word),
    ).port()


def _require_cycles(estimator: str, numbers: dict[str, float]) -> None:
    """Refuse a learner whose intervals are no whole number of cycles."""
    sample, interval = numbers["sample_time"], numbers["learning_interval"]
    if estimator == "learner" and interval % sample != 0.0:
        below, above = sample * math.floor(interval / sample), sample * math.ceil(interval / sample)
        raise InputError(
            f"learning_interval = {interval:g} s is not a whole number of cycles of {sample:g} s (sample_time): give "
            f"{below:g} or {above:g}, say"
        )
