"""Statements and calls of a rule: each function is run with symbols, its statements become those of the code."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

from fastcoil.deliver.export.python import (
    comments_of,
    definition_of,
    docstring_of,
    function_text,
)
from fastcoil.deliver.export.symbols import (
    MATHEMATICS,
    Later,
    Number,
    Record,
    Rows,
    Scope,
    SeesConstantsError,
    Table,
    constant,
)
from fastcoil.deliver.export.trees import (
    call_of,
    ends,
    has_return,
    merged,
)
from fastcoil.deliver.export.values import Values
from fastcoil.model.estimators.interface import is_sample

_SHORT = 60
"""Characters of a formula that is written where it is called."""


def scope_changes(target: ast.Tuple | ast.List, scope: Scope) -> bool:
    """Whether one of the names of an assignment to several has a value already."""
    return any(isinstance(one, ast.Name) and scope.stored[one.id] > 1 for one in target.elts)


class Statements(Values):
    """Runs the functions of a rule."""

    def _scope(self, function: Any, given: Sequence[Any]) -> Scope:
        python = getattr(function, "py_func", function)
        definition = definition_of(python)
        if definition is None:
            raise self._refusal(f"the source of {python.__name__} is not at hand", "write it in a file, as a def")
        arguments = definition.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs:
            raise self._refusal(f"{python.__name__} takes * or ** arguments", "give each a name of its own")
        names = [one.arg for one in (*arguments.posonlyargs, *arguments.args)]
        defaults = [constant(x) for x in python.__defaults__ or ()][max(0, len(given) - len(names)) :]
        values = [*given, *defaults[len(defaults) - (len(names) - len(given)) :]] if len(given) < len(names) else given
        scope = Scope(python, definition, {})
        for name, value in zip(names, values, strict=True):
            if isinstance(value, Number) and (
                scope.stored[name] or (not self._is_steady(value) and scope.loaded[name] > 1)
            ):
                scope.stored[name] += 1
                scope.blocks.append(definition.body)
                self._assign(name, value, scope)
                scope.blocks.pop()
            else:
                scope.names[name] = value
        return scope

    def _run(self, body: list[ast.stmt], scope: Scope, finish: Callable[[Any], None] | None) -> Any:
        """Take the statements of a function in turn.  Returns what it returns, or hands that to ``finish``."""
        scope.blocks.append(body)
        try:
            for k, node in enumerate(body):
                self.where = f"line {node.lineno} of {Path(scope.function.__code__.co_filename).name}"
                before = len(self.out)
                choice = node.value if isinstance(node, ast.Return) and self.as_function else None
                if isinstance(choice, ast.IfExp):
                    parts = [ast.copy_location(ast.Return(one), node) for one in (choice.body, choice.orelse)]
                    both = ast.copy_location(ast.If(choice.test, [parts[0]], [parts[1]]), node)
                    return self._condition(both, [], scope, finish)[1]
                if isinstance(node, ast.Return):
                    found = self._returned(node, scope)
                    self._comment(before, node, scope)
                    if finish is not None:
                        finish(found)
                    return found
                if isinstance(node, ast.If):
                    ended, found = self._condition(node, body[k + 1 :], scope, finish)
                    self._comment(before, node, scope)
                    if ended:
                        return found
                else:
                    self._statement(node, scope)
                    self._comment(before, node, scope)
        finally:
            scope.blocks.pop()
        return None

    def _returned(self, node: ast.Return, scope: Scope) -> Any:
        if node.value is None:
            return None
        return self._value(node.value, scope, scope.hint)

    def _condition(
        self, node: ast.If, rest: list[ast.stmt], scope: Scope, finish: Callable[[Any], None] | None
    ) -> tuple[bool, Any]:
        """An if, with what follows it where a branch returns.  Returns whether all of it has returned, and what."""
        test = self._flag(self._value(node.test, scope, "test"))
        returns = has_return(node)
        if test.value is not None:
            branch = node.body if test.value else node.orelse
            if returns:
                return True, self._run([*branch, *rest], scope, finish)
            self._run(branch, scope, None)
            return False, None
        names = dict(scope.names)
        found: list[Any] = []
        blocks: list[list[ast.stmt]] = []
        tails = [[*branch, *(rest if returns and not ends(branch) else [])] for branch in (node.body, node.orelse)]
        results: list[dict[str, Any]] = []
        for branch, truth in zip(tails, (True, False), strict=True):
            scope.names = dict(names)
            with self._aside(test.text, truth) as block:
                found.append(self._run(branch, scope, finish))
            blocks.append(block)
            results.append(scope.names)
        scope.names = names
        for name in {*results[0], *results[1]}:
            if results[0].get(name) is not names.get(name) or results[1].get(name) is not names.get(name):
                out = scope.called.get(name)
                scope.names[name] = self._variable(out) if out else results[0].get(name, results[1].get(name))
        if not returns:
            self._when(test.text, *blocks)
            return False, None
        if finish is None and found[0] is not None:
            wanted = self._joined_name(scope)
            for block, value, truth in zip(blocks, found, (True, False), strict=True):
                with self._aside(test.text, truth) as kept:
                    self._keep(wanted, value)
                block.extend(kept)
            self._when(test.text, *blocks)
            return True, self._kept(wanted, found[0])
        self._when(test.text, *blocks)
        return True, None

    def _joined_name(self, scope: Scope) -> str:
        return self._local(f"{scope.function.__name__.strip('_')}_found", "found")

    def _statement(self, node: ast.stmt, scope: Scope) -> None:
        if isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            return
        if isinstance(node, ast.Assign):
            if len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
                self._assign_node(node.targets[0].id, node.value, scope)
                return
            value = self._value(node.value, scope, "value")
            for target in node.targets:
                self._set(target, value, scope)
        elif isinstance(node, ast.AnnAssign) and node.value is not None and isinstance(node.target, ast.Name):
            self._assign_node(node.target.id, node.value, scope)
        elif isinstance(node, ast.AugAssign):
            load = copy.deepcopy(node.target)
            load.ctx = ast.Load()
            self._set(node.target, self._value(ast.BinOp(load, node.op, node.value), scope, "value"), scope)
        elif isinstance(node, ast.For):
            self._loop(node, scope)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            self._call_section(node.value, scope)
        else:
            word = {"While": "a while loop", "With": "with", "Raise": "raise", "Assert": "assert", "Break": "break",
                    "Continue": "continue", "FunctionDef": "a function inside a function", "Try": "try"}  # fmt: skip
            raise self._refusal(
                f"it has {word.get(type(node).__name__, ast.unparse(node).splitlines()[0])}",
                "write it with if, and with for k in range(…) where something repeats",
            )

    def _set(self, target: ast.expr, value: Any, scope: Scope) -> None:
        if isinstance(target, ast.Name):
            self._assign(target.id, value, scope)
        elif isinstance(target, (ast.Tuple, ast.List)):
            parts = value.fields.values() if isinstance(value, Record) else value
            if not isinstance(value, (tuple, Record)) or len(parts) != len(target.elts):
                raise self._refusal(f"{ast.unparse(target)} is given something else", "give a value for each name")
            # all are found before the first is stored, as in a, b = b, a
            parts = [self._settled(one) if scope_changes(target, scope) else one for one in parts]
            for one, part in zip(target.elts, parts, strict=True):
                self._set(one, part, scope)
        elif isinstance(target, ast.Subscript):
            rows = self._value(target.value, scope, "rows")
            if not isinstance(rows, Rows):
                raise self._refusal(f"it changes {ast.unparse(target)}", "keep it in fields of the memory")
            index = self._whole(self._value(target.slice, scope, "index"))
            self._emit(ast.Assign([ast.Subscript(rows.text, index.text)], self._real(self._number(value)).text))
        else:
            raise self._refusal(f"it changes {ast.unparse(target)}", "return a new memory")

    def _settled(self, value: Any) -> Any:
        """A value that later statements do not change."""
        value = self._forced(value)
        if not isinstance(value, Number) or value.value is not None or self._is_steady(value):
            return value
        name = self._local("before", ast.dump(value.text))
        self._store(name, value)
        return self._variable(name)

    def _assign_node(self, name: str, node: ast.expr, scope: Scope) -> None:
        """An assignment; of a conditional expression each branch assigns."""
        if isinstance(node, ast.IfExp):
            test = self._flag(self._value(node.test, scope, "test"))
            if test.value is not None:
                self._assign_node(name, node.body if test.value else node.orelse, scope)
                return
            out = self._out_name(name, scope)
            if not scope.is_final(name):
                self.unsteady.add(out)
            value = self._choice(node, test, scope, out)
            self._assign(name, value, scope)
            return
        self._assign(name, self._value(node, scope, name), scope)

    def _out_name(self, name: str, scope: Scope) -> str:
        if name not in scope.called:
            scope.called[name] = self._local(name, "local")
        return scope.called[name]

    def _assign(self, name: str, value: Any, scope: Scope) -> None:
        if isinstance(value, Later):
            value = self._forced(value)
        if isinstance(value, Record) and not scope.is_final(name):
            fields = {}
            for n, one in value.fields.items():
                out = self._out_name(f"{name}_{n}", scope)
                self._store(out, self._number(self._forced(one)))
                fields[n] = self._variable(out)
            scope.names[name] = Record(value.cls, fields)
            return
        constant = self.is_start and isinstance(value, Number) and value.value is not None
        if not isinstance(value, Number) or constant or (scope.is_final(name) and self._is_steady(value)):
            scope.names[name] = value
            return
        out = self._out_name(name, scope)
        if not scope.is_final(name):
            self.unsteady.add(out)
        elif value.kind == "flag":
            self.definitions[out] = value.text
        self._store(out, value)
        scope.names[name] = self._variable(out)

    def _loop(self, node: ast.For, scope: Scope) -> None:
        call = node.iter
        if (
            not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range")
            or node.orelse
        ):
            raise self._refusal(f"it has for … in {ast.unparse(call)}", "write for k in range(…)")
        if has_return(node) or not isinstance(node.target, ast.Name):
            raise self._refusal("it returns from a loop", "keep what is found, and return behind the loop")
        given = [self._whole(self._value(one, scope, "end")) for one in call.args]
        if len(given) == 3 and given[2].value != -1:
            raise self._refusal(f"it has {ast.unparse(call)}", "count by one, up or down")
        i = self._local(node.target.id.strip("_") or "k", "loop")
        scope.names[node.target.id] = Number(ast.Name(i), "whole")
        self.kinds[i] = "whole"
        low, high = (given[0], given[1]) if len(given) > 1 else (constant(0), given[0])
        extra: list[ast.expr] = []
        if len(given) < 3:
            # a loop of the languages has constant ends
            largest = self._largest(high)
            if largest is None:
                raise self._refusal(
                    f"{ast.unparse(call)} has no largest end", "give the loop a constant number of passes"
                )
            if high.value is None:
                extra, high = [ast.Compare(ast.Name(i), [ast.Lt()], [high.text])], constant(largest)
            self.bounds[i] = largest - 1
        with self._aside() as inner:
            self._run(node.body, scope, None)
        if inner:
            inner = [ast.If(extra[0], inner, [])] if extra else inner
            ends = [low.text, high.text] if len(given) > 1 else [high.text]
            ends += [ast.UnaryOp(ast.USub(), ast.Constant(1))] if len(given) == 3 else []
            made = ast.For(ast.Name(i), ast.Call(ast.Name("range"), ends, []), inner, [])
            self._emit(made)

    def _largest(self, end: Number) -> int | None:
        """The largest value of a whole number."""
        if end.value is not None:
            return int(end.value)
        text = end.text
        if isinstance(text, ast.Name):
            return self.bounds.get(text.id)
        if isinstance(text, ast.BinOp) and isinstance(text.op, ast.Add) and isinstance(text.right, ast.Constant):
            left, more = self._largest(Number(text.left, "whole")), text.right.value
            return None if left is None or not isinstance(more, int) else left + more
        return None

    def _comment(self, before: int, node: ast.stmt, scope: Scope) -> None:
        """Let the comments of a statement stand above what it has become."""
        filename = scope.function.__code__.co_filename
        if len(self.out) > before and (filename, node.lineno) not in self.said:
            self.said.add((filename, node.lineno))
            first: Any = self.out[before]
            first.above = [*getattr(first, "above", []), *comments_of(filename, node.lineno)]

    def _call(self, node: ast.Call, scope: Scope, hint: str) -> Any:  # noqa: PLR0911 — one for each kind
        function = self._value(node.func, scope, hint)
        if isinstance(function, type) and hasattr(function, "_fields"):
            return self._made(function, node, scope)
        if function is is_sample:  # an exported controller is called at its samples alone
            return constant(True)
        given = [self._value(one, scope, hint) for one in node.args]
        if function is len and isinstance(given[0], Table):
            return constant(len(given[0].values))
        name = self._known_function(function)
        if name == "int":
            number = self._real(self._number(given[0]))
            return Number(call_of("int", number.text), "whole", None if number.value is None else int(number.value))
        if name in ("float", "bool"):
            return self._real(self._number(given[0])) if name == "float" else self._flag(given[0])
        if name:
            return self._mathematics(name, [self._number(one) for one in given])
        python = getattr(function, "py_func", function)
        if not isinstance(python, FunctionType):
            raise self._refusal(
                f"it calls {ast.unparse(node.func)}",
                f"use {', '.join(sorted({*MATHEMATICS} - {'isnan'}))} and functions written in Python",
            )
        keywords = {str(one.arg): self._value(one.value, scope, hint) for one in node.keywords}
        before, self.path = self.path, (*self.path, id(node))
        found = self._called_function(python, given, keywords, hint)
        self.path = before
        return found

    def _called_function(self, python: FunctionType, given: list[Any], keywords: Mapping[str, Any], hint: str) -> Any:
        """The call of a function: its formula if that is short, else a function of the code, else all it does."""
        if keywords:
            names = python.__code__.co_varnames[: python.__code__.co_argcount]
            given = [*given, *(keywords[n] for n in names[len(given) :] if n in keywords)]
        given = [self._forced(one) for one in given]
        before = (set(self.said), dict(self.definitions))
        with self._aside() as block:
            found = self._inlined(python, given, hint)
        is_short = isinstance(found, Number) and not block and len(ast.unparse(found.text)) <= _SHORT
        is_scalar = isinstance(found, Number) and found.value is None and not found.needs
        if not is_short and is_scalar and all(isinstance(one, Number) and not one.needs - self.facts for one in given):
            self.said, self.definitions = before
            given = [self._plain_choice(one) for one in given]
            name = self._function(python, tuple(one.kind for one in given))
            if name:
                return Number(call_of(name[0], *(one.text for one in given)), name[1])
            return self._inlined(python, given, hint)
        self.out += block
        return found

    def _inlined(self, python: FunctionType, given: list[Any], hint: str = "found") -> Any:
        scope = self._scope(python, given)
        scope.hint = hint
        return self._run(scope.definition.body, scope, None)

    def _function(self, python: FunctionType, kinds: tuple[str, ...]) -> tuple[str, str] | None:
        """Name and kind of a function of the code, made where it is first called."""
        key = (python, kinds)
        if key not in self.functions:
            before = (self.path, self.facts, self.definitions, self.out, self.as_function)
            self.path, self.facts, self.definitions, self.out, self.as_function = (key,), set(), {}, [], True
            name = self._local(python.__name__, "function")
            names = python.__code__.co_varnames[: python.__code__.co_argcount]
            arguments = [self._local(one, "argument") for one in names]
            given = [Number(ast.Name(one), kind) for one, kind in zip(arguments, kinds, strict=False)]
            returned: set[str] = set()

            def finish(value: Any) -> None:
                number = self._number(value)
                number = self._real(number) if number.kind == "whole" else number
                returned.add(
                    number.kind if not number.needs and number.value is None or number.value == number.value else ""
                )
                self._emit(ast.Return(number.text))

            try:
                scope = self._scope(python, given)
                self._run(scope.definition.body, scope, finish)
            except SeesConstantsError:
                returned.add("")
            body = self.out
            self.path, self.facts, self.definitions, self.out, self.as_function = before
            kind = returned.pop() if len(returned) == 1 else ""
            words = {"real": "float", "flag": "bool", "whole": "int"}
            head = [f"{one}: {words[k]}" for one, k in zip(arguments, kinds, strict=False)]
            text = function_text(name, head, words.get(kind, ""), docstring_of(python), merged(body)) if kind else ""
            self.functions[key] = (name, kind, text)
        name, kind, _ = self.functions[key]
        return (name, kind) if kind else None

    def _call_section(self, node: ast.Call, scope: Scope) -> None:
        """A function that changes the array and returns nothing."""
        function = self._value(node.func, scope, "value")
        python = getattr(function, "py_func", function)
        if not isinstance(python, FunctionType):
            raise self._refusal(f"it calls {ast.unparse(node)}", "use what it returns, or leave it out")
        given = [self._value(one, scope, "value") for one in node.args]
        numbers = [self._plain_choice(one) for one in given if isinstance(one, Number)]
        if any(one.needs - self.facts for one in numbers) or not isinstance(given[0], Rows):
            self._inlined(python, given)
            return
        kinds = tuple(one.kind for one in numbers)
        key = (python, kinds)
        if key not in self.sections:
            before = (self.path, self.facts, self.definitions, self.out)
            self.path, self.facts, self.definitions, self.out = (key,), set(), {}, []
            name = self._local(python.__name__, "section")
            names = python.__code__.co_varnames[1 : python.__code__.co_argcount]
            arguments = [self._local(one, "argument") for one in names]
            inner = self._scope(
                python, [given[0], *(Number(ast.Name(a), k) for a, k in zip(arguments, kinds, strict=True))]
            )
            self._run(inner.definition.body, inner, lambda value: None)
            body = self.out
            self.path, self.facts, self.definitions, self.out = before
            words = {"real": "float", "flag": "bool", "whole": "int"}
            head = ["s: State", *(f"{a}: {words[k]}" for a, k in zip(arguments, kinds, strict=True))]
            self.sections[key] = (name, "", function_text(name, head, "None", docstring_of(python), merged(body)))
        self._emit(ast.Expr(call_of(self.sections[key][0], ast.Name("s"), *(one.text for one in numbers))))
