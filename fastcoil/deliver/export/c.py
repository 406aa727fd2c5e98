"""The laws in C99: one file, no dynamic memory, nothing but headers of the standard library."""

from __future__ import annotations

import ast
from collections import Counter
from textwrap import wrap

from fastcoil.deliver.export.expressions import Language, broken, kind_of, loaded_in, stored_in
from fastcoil.deliver.export.source import Constant, Function, Laws, aligned, counted, is_elif
from fastcoil.deliver.export.words import WIDTH, number

_TYPES = {"real": "double", "flag": "bool", "whole": "int", "": "void"}
_ZEROS = {"real": "0.0", "flag": "false", "whole": "0"}
_WORDS = {"or": "||", "and": "&&", "not": "!", "True": "true", "False": "false", "==": "==", "group": ""}
_WORDS |= {sign: sign for sign in ("<", "<=", ">", ">=", "!=")}
_FUNCTIONS = {"abs": "fabs", "max": "fmax", "min": "fmin", "float": "(double)", "int": "(int)"}
_FUNCTIONS |= {
    f"math.{name}": name
    for name in ("exp", "log", "sqrt", "pow", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "floor")
}
_INCLUDED = "#include <math.h>\n#include <stdbool.h>\n#include <string.h>"
_COMPILE = "GCC and Clang need -ffp-contract=off for that, and never -ffast-math."
_BREAKS = r" (?=&& |\|\| |[-+*/] )"


class InC:
    """Writes the laws in C, with ``name`` before the names that other files see."""

    def __init__(self, laws: Laws, name: str) -> None:
        self.laws, self.state = laws, f"{name}_state"
        self.names = {f: f"{name}_{f}" if f in ("start", "step") else f for f in laws.functions}
        self.language = Language(
            _WORDS,
            _FUNCTIONS | self.names,
            lambda field: f"s->{field}",
            # fmin and fmax of whole numbers are doubles
            lambda indices: "".join(f"[(int){one}]" if one.startswith("fm") else f"[{one}]" for one in indices),
            number,
        )

    def text(self) -> str:
        """The whole file."""
        laws = self.laws
        public = [laws.functions[name] for name in ("start", "step")]
        parts = [
            _comment(f"{laws.text}\n{_COMPILE}"),
            _INCLUDED,
            "\n".join(self._constants()).strip(),
            "\n".join(
                [
                    _comment(f"{laws.state_text}\n\nOne full of zeros starts by itself."),
                    f"typedef struct {{\n{self._fields()}\n}} {self.state};",
                ]
            ),
            "\n".join(f"{self._head(one)};" for one in public),
            *(self._function(one) for one in laws.functions.values()),
        ]
        return "\n\n".join(parts) + "\n"

    def _constants(self) -> list[str]:
        """Those with a number as definitions, aligned from gap to gap."""
        lines: list[str] = []
        rows: list[tuple[str, str]] = []
        for one in self.laws.constants:
            if self.laws.has_gap(one.line):
                lines, rows = [*lines, *aligned(rows), ""], []
            rows += [(_comment(line), "") for line in self.laws.above(one.line)]
            said = self.laws.comment(one.line)
            rows.append((self._constant(one), said and _comment(said)))
        return [*lines, *aligned(rows)]

    def _constant(self, one: Constant) -> str:
        if isinstance(one.value, list):
            numbers = wrap(", ".join(map(number, one.value)), WIDTH - 4)
            return "\n    ".join([f"static const double {one.name}[{len(one.value)}] = {{", *numbers]) + "\n};"
        value = number(one.value) if isinstance(one.value, float) else str(one.value)
        return f"#define {one.name} {f'({value})' if one.value < 0 else value}"

    def _fields(self) -> str:
        rows = []
        for one in self.laws.fields:
            sizes, said = "".join(f"[{size}]" for size in one.sizes), self.laws.comment(one.line)
            rows.append((f"    {_TYPES[one.kind]} {one.name}{sizes};", said and _comment(said)))
        return "\n".join(aligned(rows))

    def _head(self, one: Function) -> str:
        arguments = [f"{_TYPES[kind]} {name}" for name, kind in one.arguments.items()]
        arguments = [f"{self.state} *s", *arguments] if one.is_section else arguments
        static = "" if one.name in ("start", "step") else "static "
        head = f"{static}{_TYPES[one.returns]} {self.names[one.name]}({', '.join(arguments)})"
        return "\n".join(broken(head, WIDTH, r" (?=\w+ \w+[,)])"))

    def _function(self, one: Function) -> str:
        known = self.laws.kinds | one.arguments
        written = Counter(
            node.id for top in one.body for node in ast.walk(top) if isinstance(node, ast.Name) and _is_stored(node)
        )
        changed = {
            node.target.id
            for top in one.body
            for node in ast.walk(top)
            if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name)
        }
        once = {name for name, count in written.items() if count == 1} - changed
        lines = self._block(one.body, 1, known, once)
        return "\n".join([_comment(one.text), self._head(one), "{", *lines, "}"])

    def _block(self, body: list[ast.stmt], depth: int, known: dict[str, str], once: set[str]) -> list[str]:
        known, lines, indent = dict(known), [], "    " * depth
        for k, node in enumerate(body):
            if isinstance(node, (ast.If, ast.For)):
                # what a block finds for those behind it is declared before it
                for name in stored_in([node]):
                    if name not in known and name in loaded_in(body[k + 1 :]):
                        known[name] = self._kind(name, node, known)
                        lines.append(f"{indent}{_TYPES[known[name]]} {name} = {_ZEROS[known[name]]};")
            lines += [""] if k and self.laws.has_gap(node.lineno) else []
            lines += [f"{indent}/* {said} */" for said in self.laws.above(node.lineno)]
            said = self.laws.comment(node.lineno)
            first, *rest = self._statement(node, depth, known, once)
            beside = f"{first}  {_comment(said)}" if said else first
            if len(beside) > WIDTH:
                lines, beside = [*lines, *([indent + _comment(said)] if said else [])], first
            lines += [*broken(beside, WIDTH, _BREAKS), *rest]
        return lines

    def _kind(self, name: str, node: ast.stmt, known: dict[str, str]) -> str:
        """The kind of a name that a block gives a value."""
        known = dict(known)
        for one in ast.walk(node):
            if isinstance(one, ast.For) and isinstance(one.target, ast.Name):
                known[one.target.id] = "whole"
        for _ in range(2):  # an earlier value may stand further down in the tree
            for one in ast.walk(node):
                if isinstance(one, ast.Assign) and isinstance(one.targets[0], ast.Name):
                    known[one.targets[0].id] = kind_of(one.value, known)
        return known[name]

    def _statement(  # noqa: PLR0911 — one for each kind
        self, node: ast.stmt, depth: int, known: dict[str, str], once: set[str]
    ) -> list[str]:
        indent, say = "    " * depth, self.language.say
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "zeros":
                field = say(target)
                return [f"{indent}memset({field}, 0, sizeof {field});"]
            left = say(target)
            if isinstance(target, ast.Name) and target.id not in known:
                known[target.id] = kind_of(value, known)
                left = f"{'const ' if target.id in once else ''}{_TYPES[known[target.id]]} {left}"
            return [f"{indent}{left} = {say(value)};"]
        if isinstance(node, ast.AugAssign):
            sign = "+" if isinstance(node.op, ast.Add) else "-"
            return [f"{indent}{say(node.target)} {sign}= {say(node.value)};"]
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            passed = ["s", *map(say, node.value.args[1:])]
            return [f"{indent}{self.names[ast.unparse(node.value.func)]}({', '.join(passed)});"]
        if isinstance(node, ast.Return) and node.value is not None:
            return [f"{indent}return {say(node.value)};"]
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name) and isinstance(node.iter, ast.Call):
            i, (low, high, step) = node.target.id, counted(node.iter)
            to = f"{i} > {say(high)}; {i}--" if step else f"{i} < {say(high)}; {i}++"
            inner = self._block(node.body, depth + 1, known | {i: "whole"}, once)
            return [f"{indent}for (int {i} = {say(low)}; {to}) {{", *inner, f"{indent}}}"]
        if isinstance(node, ast.If):
            lines = [f"{indent}if ({say(node.test)}) {{", *self._block(node.body, depth + 1, known, once)]
            while len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If) and is_elif(node, self.laws):
                node = node.orelse[0]
                lines += [f"{indent}}} else if ({say(node.test)}) {{", *self._block(node.body, depth + 1, known, once)]
            if node.orelse:
                lines += [f"{indent}}} else {{", *self._block(node.orelse, depth + 1, known, once)]
            return [*lines, f"{indent}}}"]
        raise TypeError(f"the laws have no {ast.unparse(node)}")


def _is_stored(node: ast.Name) -> bool:
    return isinstance(node.ctx, ast.Store)


def _comment(text: str) -> str:
    """A comment of one line, or of several."""
    lines = text.splitlines()
    if len(lines) == 1:
        return f"/* {text} */"
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"])
