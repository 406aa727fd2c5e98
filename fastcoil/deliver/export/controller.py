"""The controller of one loop: parameters, rules, and laws in Python, from which C and Structured Text are made."""

import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jinja2
import numpy as np

from fastcoil.base.arguments import raise_problems
from fastcoil.base.errors import InputError, Problem
from fastcoil.base.machine import VERSION
from fastcoil.deliver.export.translate import TranslatedRule, Translator
from fastcoil.deliver.export.words import add_comment, names_in, number_literal, plain_text
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.labels import unit_in_words
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.model import valve_test
from fastcoil.model.control import clip01, noise_level
from fastcoil.model.engine.controller import opening_behind
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.parameter_table import LARGEST_FLOAT, PARAMETERS
from fastcoil.model.user_rules import rules_for_kernels
from fastcoil.model.valve_test import PHASE_OFF, begin_test, held_command, step_test, watch_loop

ANY_SET_POINTS_C = np.array([0.0, LARGEST_FLOAT])  # to check a controller with: it may get any set-point


def run_test(now: Any, p: Any, memory: Any) -> Any:
    """One cycle of the valve test; PI and compensation follow its command, to go on without a bump."""
    is_off = memory.phase == PHASE_OFF
    if is_off and not now.enabled and not (now.begins or memory.waited > 0.0):
        return now.command, memory
    starts, watched = watch_loop(now.command, now.m_a, now.enabled, now.begins, p, memory)
    if is_off and not starts:
        return now.command, watched
    held = held_command(now.command, memory) if starts else now.command
    running = begin_test(now.T_set, p, watched) if starts else memory
    sign = 1.0 - 2.0 * p.action
    command, after = step_test(sign * (now.T - running.reference), held, now.m_a, now.enabled, p, running)
    if after.phase == PHASE_OFF:  # the PI acts in this cycle
        return now.command, after, 0.0
    mode = after.direction if after.direction != 0.0 else now.mode
    e = sign * (now.T - now.T_set)
    u = opening_behind(command, mode, now.estimate, p.compensation)
    return command, after, 1.0, e, mode > 0.0, u, u, clip01(u - p.kp * e)


VALVE_TEST_RULE = SimpleNamespace(
    name="run_test", Memory=valve_test.Memory, step=run_test,
    Parameters=SimpleNamespace(_fields=(*valve_test.Parameters._fields, "kp", "action", "compensation")),
    controller_fields=("test", "e", "rising", "u", "u_ext", "integral_part"),
)  # fmt: skip
"""The valve test as a rule.  controller_fields: state of the controller that it returns after its memory."""


@cache
def templates() -> jinja2.Environment:
    """Return the environment of the templates; a line that begins with ``#:`` is a template statement."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "laws"),
        line_statement_prefix="#:",
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701 — no page
    )


class Controller:
    """One controller: its numbers and words by parameter, and its rules as laws."""

    def __init__(self, loop: Loop) -> None:
        raise_problems([
            Problem(f"{name} is swept: give it one value, a controller has one", name, "shape") for name in loop.swept
        ])  # fmt: skip
        check_clashes(loop, ANY_SET_POINTS_C)
        rules = rules_for_kernels(loop.rules)
        columns = parameter_columns(loop, {}, np.zeros(1, dtype=np.int64))
        values = parameter_matrix(columns, rules)[:, 0].tolist()
        self.number: dict[str, float] = dict(zip((*PARAMETER_ROWS, *rules.parameter_names), values, strict=True))
        self.word = {name: str(columns[name][0]) for name, p in PARAMETERS.items() if p.is_word}
        self.parameters = loop.parameters
        self.heats = self.word["action"] == "heating"
        self.set_point = 24.0 if self.heats else 14.0  # degC, of its vectors
        sample_time, interval = self.number["sample_time"], self.number["learning_interval"]
        if self.word["estimator"] == "learner" and interval % sample_time != 0.0:
            problem = f"learning_interval = {interval:g} s is not a whole number of cycles"
            cure = f"give a multiple of sample_time, {sample_time:g} s"
            raise InputError(f"{problem}: {cure}", "learning_interval", "conflict")
        estimator = next((e for e in (*ESTIMATORS, *rules.estimators) if e and e.name == self.word["estimator"]), None)
        if estimator is None:
            self.number["backlash_estimate"] *= self.number["estimate_share"]
            self.number["estimate_share"] = 1.0
        law = next((candidate for candidate in rules.laws if candidate.name == self.word["law"]), None)
        # as written, not as compiled
        source_functions = {rule.name: rule.parts[0] for rule in loop.rules.values() if rule.is_loaded}
        self.user_rules = {parameter: name for parameter, name in self.word.items() if name in source_functions}
        self.waives_buffer = estimator is not None and estimator.waives_buffer
        self.has_test = loop["test_start"] is not None
        self.rests_when_off = estimator is None or estimator.periods is None
        self.pauses_in_test = self.has_test and not (estimator is not None and estimator.sees_test)
        self.estimator_port = self.law_port = None
        self.test_port: TranslatedRule | None = None
        self.ports: list[TranslatedRule] = []
        self.sees_air = False
        # used around the rules; the last ones only where there is a rule
        taken_names = [*names_in(self.laws_text()), *(name.upper() for name in self.number)]
        taken_names += ["m_a", "T_seen", "decided", "begin_law", "estimate", "assumed", "w"]
        if estimator is not None:
            law_memory_names = [variable for n in (law.Memory._fields if law else ()) for variable in (n, f"{n}_known")]
            function = source_functions.get(estimator.name, estimator.step)
            names = [*taken_names, *law_memory_names]
            self.estimator_port = self._translate_rule("estimator", estimator, function, names)
            taken_names += names_in(self.estimator_port.step)
        if law is not None:
            self.law_port = self._translate_rule("law", law, source_functions.get(law.name, law.step), taken_names)
        if self.has_test:
            self.test_port = self._translate_rule("test", VALVE_TEST_RULE, VALVE_TEST_RULE.step, taken_names)
        self.ports = [port for port in (self.estimator_port, self.law_port, self.test_port) if port is not None]
        self.sees_air = any("m_a" in port.reads for port in self.ports)

    def _translate_rule(self, kind: str, rule: Any, function: Any, taken_names: list[str]) -> TranslatedRule:
        """Translate a rule of the kernel or of the user into laws; a word among its parameters becomes a number."""
        names = rule.Parameters._fields
        if non_ascii_names := [name for name in names if not name.isascii()]:
            cure = f"name {non_ascii_names[0]!r} with letters a to z alone"
            raise InputError(f"{kind} = {rule.name!r} cannot be exported: {cure}", kind, "code")
        estimate = "s.estimate" if self.word["estimator"] != "none" else "BACKLASH_ESTIMATE"
        if kind == "test" and self.number["estimate_share"] != 1.0:
            estimate = f"ESTIMATE_SHARE * {estimate}"
        return Translator(
            kind, rule, function, {name: self.number[name] for name in names},
            literal_names={name for name in names if name in self.word}, estimate=estimate, names=taken_names,
        ).translate()  # fmt: skip

    def laws_text(self) -> str:
        """Return the laws in Python, without what this controller does not need."""
        number, has_estimator = self.number, self.estimator_port is not None
        has_share, has_buffer_ratio = has_estimator and number["estimate_share"] != 1.0, number["buffer_ratio"] > 0.0
        template_values: dict[str, Any] = {
            "controller": self,
            "dead_band": number["error_dead_band"] > 0.0,
            "share": has_share,
            "assumed": "assumed" if has_share else "s.estimate" if has_estimator else "BACKLASH_ESTIMATE",
            "assumed_at_start": "ESTIMATE_SHARE * BACKLASH_ESTIMATE" if has_share else "BACKLASH_ESTIMATE",
            "additive": self.word["compensation"] == "additive",
            "smooth": self.word["compensation"] == "smooth",
            "buffer_ratio": has_buffer_ratio,
            "buffer_swing": has_buffer_ratio and number["buffer_swing"] > 0.0,
            "measures_noise": self.word["buffer_noise"] == "measured",
            "band": "band" if has_buffer_ratio or self.waives_buffer else "BUFFER",
            "noise_of_median": repr(float(noise_level(1.0))),
            "words": plain_text(self.describe()),
            "version": VERSION,
        }
        template = templates().get_template("controller.py.jinja")
        used_names = names_in(template.render(template_values, parameters=[]))
        parameters = [self._constant_line(name) for name in number if name.upper() in used_names]
        text = template.render(template_values, parameters=parameters)
        text = text if "math." in text else text.replace("import math\n", "", 1)
        text = re.sub(r"\n+(?=(def|class) )", "\n\n\n", text)
        return re.sub(r"\n+(?=# (Parameters|Fixed)|import )", "\n\n", text)

    def describe(self) -> str:
        """Describe the parts of the controller in a phrase: a PI law, a backlash inverse and so on."""
        inverse = "a backlash inverse" if self.estimator_port or self.number["backlash_estimate"] > 0.0 else ""
        others = {"additive": "half the backlash added to its output", "smooth": "a smooth backlash inverse"}
        parts = [
            f"the law {self.word['law']}" if self.law_port else "a PI law",
            "a dead band" if self.number["error_dead_band"] > 0.0 else "",
            others.get(self.word["compensation"], inverse),
            f"the estimator {self.word['estimator']}" if self.estimator_port else "",
            "a valve test" if self.has_test else "",
        ]
        return " and ".join(", ".join(filter(None, parts)).rsplit(", ", 1))

    def _constant_line(self, name: str) -> str:
        """Return the definition of a parameter as a constant of the laws, with its unit and meaning."""
        unit, text = self.parameters[name].unit, self.parameters[name].text
        unit = "1/(K s)" if unit == "K-1 s-1" else unit_in_words(unit)  # which figures leave as it is
        return add_comment(f"{name.upper()} = {number_literal(self.number[name])}", f"{unit}: {text}" if unit else text)
