"""Translate a rule of the kernel, of the package or of the user, into laws for the field.

``Translator`` executes the Python of a rule, and of all functions that it calls, with expressions in place of numbers.
The result is one function of the state, without classes, tuples or conditional expressions.

NaN, "nothing yet" in a memory, has no portable form: a variable that may be NaN gets a flag, ``x_known``, and every
comparison tests the flag first.
"""

import ast
import copy
import re
from collections.abc import Mapping, Sequence
from itertools import chain, repeat
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

from fastcoil.base.errors import InputError
from fastcoil.deliver.export.formulas import ALLOWED_FUNCTIONS, ALLOWED_SYNTAX, FUNCTIONS, Formulas, TranslateAgainError
from fastcoil.deliver.export.words import constant_text, definition_of, function_text, lines_of, names_in, summary_of
from fastcoil.model.estimators.interface import is_sample, memory_defaults

from fastcoil.deliver.export.values import (  # isort: skip
    Number, Scope, Table, assignment, call_of, constant, expression, has_return, join_conditions, names_read_in,
    needed_statements,
)  # fmt: skip

_ALREADY_STORED = object()  # stands for a value that is stored in the state already


class TranslatedRule(NamedTuple):
    """A rule as laws: parts of a Python text, see ``printer.Laws``; step: a function; call: the text that calls it."""

    constants: list[str]
    fields: list[str]
    start: list[str]
    step: str
    call: str
    reads: frozenset[str]


class Translator(Formulas):
    """Translates one rule.

    kind: estimator, law or test.  function: its step in Python.  numbers: its parameters; literal_names: those that
    become literals.  estimate: the text of the estimate that it sees.  names: those in use in the laws.
    """

    def __init__(
        self, kind: str, rule: Any, function: Any, numbers: Mapping[str, float], *, literal_names: set[str],
        estimate: str, names: list[str],
    ) -> None:  # fmt: skip
        super().__init__(kind, rule.name, [*names, *map(str.upper, numbers)])
        self.step, self.start, self.words = function, getattr(rule, "start", None), getattr(rule, "n_floats", 0)
        self.Memory = rule.Memory
        self.numbers, self.literal_names, self.estimate = numbers, literal_names, estimate
        self.goal = {"law": "s.decided", "estimator": "s.estimate", "test": "s.command"}[kind]
        # state and inputs of the controller for the valve test only
        self.controller_fields = [f"s.{n}" for n in getattr(rule, "controller_fields", ())]
        self.flags = ("enabled", "begins") if kind == "test" else ()
        self.kinds["s.rising"] = "flag"
        taken_names = set(map(str.casefold, names))
        field_names = {n: f"{n}_kept" if n.casefold() in taken_names else n for n in self.Memory._fields}
        field_names |= {n: f"test_{n}" for n in field_names if kind == "test"}
        self.fields = {n: "s." + self._unique_name(name, "field") for n, name in field_names.items()}

    def translate(self) -> TranslatedRule:
        """Translate the rule; rounds repeat until the kinds of all variables are known."""
        while True:
            try:
                return self._translate_once()
            except TranslateAgainError:
                continue
            except InputError:
                raise
            except (AttributeError, IndexError, KeyError, RecursionError, TypeError, ValueError) as error:
                raise self._export_error("it has what other languages lack", f"use {ALLOWED_SYNTAX}") from error

    def _translate_once(self) -> TranslatedRule:
        """Translate the rule with the kinds known so far; raise ``TranslateAgainError`` where one was wrong."""
        self._begin_round()
        self.bounds: dict[str, int] = {}  # upper one of each counter
        parameters = {n: Number(ast.Name(n.upper()), "real", float(x)) for n, x in self.numbers.items()}
        parameters |= {n: constant(float(self.numbers[n])) for n in self.literal_names}
        start_values = {n: constant(x) for n, x in zip(self.Memory._fields, memory_defaults(self.Memory), strict=True)}
        if self.start is not None:
            self.path = ("start",)
            start_values = self._inline(self.start, [parameters], lambda value: value)
        memory: dict[str, Any] = {}
        for n, name in self.fields.items():
            value = self._to_real(start_values[n])
            if value.is_nan:
                self.may_be_nan.add(name)
                for target, unknown in ((name, 0.0), (f"{name}_known", False)):
                    self.statements.append(assignment(target, ast.Constant(unknown)))
            else:
                self._store_value(name, value)
            memory[n] = self._variable_value(name)
        start_statements = self._begin_function()
        arguments = [self._sample_inputs(), parameters, memory, *([Table()] if self.words else [])]
        self._inline(self.step, arguments, self._store_results)
        goals = {self.goal, "s.w", *self.controller_fields, *(["s.test_aborted"] if self.kind == "test" else [])}
        return self._assemble_port(start_statements, needed_statements(self.statements, goals))

    def _sample_inputs(self) -> dict[str, Any]:
        """Return what the rule sees of its loop, by the fields of ``Sample``, as expressions of the controller."""
        texts = {
            "t": "s.clock", "T_set": "T_set", "T": "s.T_seen" if self.kind == "estimator" else "T_sup", "e": "s.e",
            "u": "s.u", "command": "s.command", "switches": "s.switches", "estimate": self.estimate,
        }  # fmt: skip
        sample: dict[str, Any] = {name: Number(expression(text)) for name, text in texts.items()}
        sample["test"] = Number(expression("s.test")) if "start_test" in self.taken_names else constant(0.0)
        sample |= {name: Number(expression(name), "flag") for name in self.flags}
        sample["m_a"] = Number(expression("m_a"), known_flags=frozenset({"m_a >= 0.0"}))
        modes = (lambda: constant(1.0), lambda: constant(-1.0))
        sample["mode"] = self._evaluate_branches(expression("s.rising"), modes, "mode", "mode")
        return sample

    # what a step leaves

    def _store_results(self, returned: Any) -> Any:
        """Store what the rule returned, decision and memory; all are computed before the first is stored."""
        result, memory, *field_values = returned.values()
        numbers: dict[str, Number] = {self.fields[n]: value for n, value in memory.items()}
        numbers |= dict(zip(self.controller_fields, field_values, strict=False))
        numbers[self.goal] = self._to_real(result)
        changed_fields = {target: number for target, number in numbers.items() if ast.unparse(number.text) != target}
        fields = {*changed_fields, *(f"{target}_known" for target in changed_fields)}
        for target, number in changed_fields.items():
            if (names_read_in(number.text) | number.known_flags) & fields - {target}:
                name = self._local_name(f"next_{target[2:]}", "next")
                self._store_value(name, number)
                changed_fields[target] = self._variable_value(name)
        goal = changed_fields.pop(self.goal, None)
        for target, number in changed_fields.items():
            self._store_value(target, number)
        if goal is not None and not goal.is_nan:  # an estimate that is NaN is none
            flags, store = self._known_flags(goal), assignment(self.goal, call_of("clipped", goal.text))
            self.statements.append(ast.If(join_conditions(ast.And(), flags), [store], []) if flags else store)
        return _ALREADY_STORED

    # statements

    def _make_scope(self, function: Any, finish: Any) -> Scope:
        """Return a new scope for a call of a function; refuse one whose source is not available."""
        python = getattr(function, "py_func", function)
        definition = definition_of(python)
        if definition is None:
            raise self._export_error(f"the source of {python.__name__} is not at hand", "write it in a file, as a def")
        return Scope(python, definition, finish)

    def _inline(self, function: Any, arguments: Sequence[Any], finish: Any) -> Any:
        """Translate a call of a function in place; ``finish`` receives the value that it returns."""
        scope = self._make_scope(function, finish)
        for name, value in zip(scope.arguments, arguments, strict=True):
            scope.names[name] = self._bind_value(name, value, "local", scope.store_counts[name] > 0)
        return self._run_statements(scope.definition.body, scope)

    def _run_statements(self, body: list[ast.stmt], scope: Scope) -> Any:
        """Translate statements of a function; return its value, or ``None`` if it continues after them."""
        for k, node in enumerate(body):
            self.source_line = f"line {node.lineno} of {Path(scope.function.__code__.co_filename).name}"
            returned_value = self._translate_statement(node, body[k + 1 :], scope)
            if returned_value is not None:
                return returned_value
        return None

    def _translate_statement(self, node: ast.stmt, rest: list[ast.stmt], scope: Scope) -> Any:
        """Translate a statement; a condition with a return includes the rest of the function."""
        if isinstance(node, ast.Return):
            return scope.finish(None if node.value is None else self._evaluate(node.value, scope))
        if isinstance(node, ast.If):
            test = self._to_flag(self._evaluate(node.test, scope))
            may_return = has_return(node)
            tails = [[*branch, *(rest if may_return else [])] for branch in (node.body, node.orelse)]
            if test.value is None:
                name = f"{scope.function.__name__.strip('_')}_found"
                runs = (lambda: self._run_statements(tails[0], scope), lambda: self._run_statements(tails[1], scope))
                result = self._evaluate_branches(test.text, runs, name, id(node))
            else:
                result = self._run_statements(tails[0 if test.value else 1], scope)
            return _ALREADY_STORED if may_return and result is None else result
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            name = targets[0].id if isinstance(targets[0], ast.Name) else "value"
            value = self._evaluate_named(name, node.value, scope)
            for target in targets:
                self._assign_to(target, value, scope)
        elif isinstance(node, ast.AugAssign):
            load = copy.copy(node.target)
            load.ctx = ast.Load()
            self._assign_to(node.target, self._evaluate(ast.BinOp(load, node.op, node.value), scope), scope)
        elif isinstance(node, ast.For):
            self._translate_loop(node, scope)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            self._evaluate(node.value, scope)
        elif not isinstance(node, ast.Pass) and not isinstance(getattr(node, "value", None), ast.Constant):
            first_line = ast.unparse(node).partition("\n")[0].rstrip(":")
            raise self._export_error(f"it has {first_line}", f"use {ALLOWED_SYNTAX}")
        return None

    def _assign_to(self, target: ast.expr, value: Any, scope: Scope) -> None:
        """Translate an assignment to a name, a tuple of names or an element of the estimator's array."""
        if isinstance(target, ast.Name):
            scope.names[target.id] = self._bind_value(target.id, value, "local", scope.store_counts[target.id] > 1)
        elif isinstance(target, (ast.Tuple, ast.List)):
            values = [*value.values()]
            # all are evaluated before the first is stored, as in a, b = b, a
            if any(isinstance(element, ast.Name) and scope.store_counts[element.id] > 1 for element in target.elts):
                values = [self._bind_value("before", part, ("before", id(target), k)) for k, part in enumerate(values)]
            for element, part in zip(target.elts, values, strict=True):
                self._assign_to(element, part, scope)
        elif isinstance(target, ast.Subscript) and self._evaluate(target.value, scope) == Table():
            index = self._evaluate(target.slice, scope)
            element = ast.Subscript(expression("s.w"), index.text)
            self.statements.append(ast.Assign([element], self._to_real(value).text))
        else:
            raise self._export_error(f"it changes {ast.unparse(target)}", "return a new memory, or keep it in a name")

    def _translate_loop(self, node: ast.For, scope: Scope) -> None:
        call = node.iter
        if has_return(node):
            raise self._export_error("it returns from a loop", "keep what is found, and return behind the loop")
        ends = [self._evaluate(end, scope) for end in call.args] if isinstance(call, ast.Call) else []
        is_range = ends and ast.unparse(call).startswith("range(") and (len(ends) < 3 or ends[2].value == -1)
        if node.orelse or not is_range:
            cure = "write for k in range(…), by one up or down"
            raise self._export_error(f"it has for … in {ast.unparse(call)}", cure)
        name = ast.unparse(node.target)
        i = self._local_name(name, "loop")
        scope.names[name] = Number(ast.Name(i), "whole")
        self.kinds[i] = "whole"
        loop_conditions: list[ast.expr] = []
        if len(ends) < 3:  # a loop of the languages has constant ends
            largest = self._largest_value(ends[-1])
            if largest is None:
                cure = "give the loop a constant number of passes"
                raise self._export_error(f"{ast.unparse(call)} has no largest end", cure)
            if ends[-1].value is None:
                loop_conditions = [ast.Compare(ast.Name(i), [ast.Lt()], [ends[-1].text])]
            ends[-1] = ends[-1] if not loop_conditions else constant(largest)
            self.bounds[i] = largest - 1
        # a pass may change what the previous one left
        self.true_conditions -= self.reassigned_names | {f"{name}_known" for name in self.reassigned_names}
        with self._separate_block() as block:
            self._run_statements(node.body, scope)
        block = [ast.If(loop_conditions[0], block, [])] if loop_conditions and block else block
        if block:
            range_call = ast.Call(ast.Name("range"), [end.text for end in ends], [])
            self.statements.append(ast.For(ast.Name(i), range_call, block, []))

    def _largest_value(self, end: Number) -> int | None:
        """Return the largest value that the end of a loop can have; None if it is not known."""
        if end.value is not None:
            return int(end.value)
        if isinstance(end.text, ast.Name):
            return self.bounds.get(end.text.id)
        if isinstance(end.text, ast.BinOp) and isinstance(end.text.right, ast.Constant):
            left = self._largest_value(Number(end.text.left, "whole"))
            increment: Any = end.text.right.value
            return None if left is None or not isinstance(end.text.op, ast.Add) else left + increment
        return None

    # calls

    def _evaluate_call(self, node: ast.Call, scope: Scope) -> Any:
        function = self._evaluate(node.func, scope)
        names = chain(getattr(function, "_fields", ()), repeat("value"))
        positional = [self._evaluate_named(name, value, scope) for name, value in zip(names, node.args, strict=False)]
        keywords = {str(k.arg): self._evaluate_named(str(k.arg), k.value, scope) for k in node.keywords}
        if isinstance(function, type) and hasattr(function, "_fields"):
            values = {n: constant(x) for n, x in zip(function._fields, memory_defaults(function), strict=True)}
            return values | dict(zip(function._fields, positional, strict=False)) | keywords
        if function is is_sample:  # an exported controller is called only at its samples
            return constant(True)
        if function is len and isinstance(positional[0], Table):
            return constant(len(positional[0].values))
        for name, alternatives in FUNCTIONS.items():
            if any(function is alternative for alternative in alternatives):
                return self._apply_function(name, positional)
        python = getattr(function, "py_func", function)
        if not isinstance(python, FunctionType):
            cure = f"use {ALLOWED_FUNCTIONS} and functions written in Python"
            raise self._export_error(f"it calls {ast.unparse(node.func)}", cure)
        caller, self.path = (self.path, self.source_line), (*self.path, id(node))
        arguments, defaults = self._make_scope(python, None).arguments, python.__defaults__ or ()
        default_values = dict(zip(arguments[len(arguments) - len(defaults) :], map(constant, defaults), strict=True))
        values = default_values | dict(zip(arguments, positional, strict=False)) | keywords
        returned_value = self._inline(python, [values[n] for n in arguments], lambda value: value)
        self.path, self.source_line = caller
        return returned_value

    def _assemble_port(self, start_statements: list[ast.stmt], body: list[ast.stmt]) -> TranslatedRule:
        """Assemble the translated rule, without constants and fields that nothing reads."""
        name = self._unique_name(self.rule, "rule")
        arguments = [n for n in ("T_sup", "T_set", "m_a", *self.flags) if n in names_read_in(body)]
        arguments_text = ["s: State", *(f"{n}: {'bool' if n in self.flags else 'float'}" for n in arguments)]
        text = function_text(name, arguments_text, "None", summary_of(getattr(self.step, "py_func", self.step)), body)
        used_fields, fields = set(re.findall(r"\bs\.(\w+)", text)), []
        for field_name in (field[2:] for field in self.fields.values()):
            if field_name in used_fields:
                fields.append(f"{field_name}: float")
            if f"{field_name}_known" in used_fields:
                fields.append(f"{field_name}_known: bool  # whether {field_name} has a value")
        start_lines = lines_of(needed_statements(start_statements, {f"s.{used_field}" for used_field in used_fields}))
        if "w" in used_fields:
            fields.append("w: list[float]  # sums and other numbers, one behind the other")
            start_lines.append(f"s.w = zeros({self.words})")
        read_names = {*names_in("\n".join([text, *start_lines]))}
        return TranslatedRule(
            [constant_text(n, value) for n, value in self.constants.items() if n in read_names],
            fields, start_lines, text, f"{name}({', '.join(['s', *arguments])})",
            frozenset({*arguments, *(["T_seen"] if "T_seen" in read_names else [])}),
        )  # fmt: skip
