"""The rendered laws, taken apart: constants, state and functions, with what is said of each."""

import ast
import io
import tokenize
from dataclasses import dataclass

_KINDS = {"float": "real", "bool": "flag", "int": "whole", "None": "", "list[float]": "real"}
"""Types of the laws: every number is a double but for the counters of loops."""


@dataclass(frozen=True)
class Named:
    """A constant with its value, a field of the state or an argument, and what is said of it; size: of an array."""

    name: str
    kind: str
    said: str = ""
    value: float | int | list[float] = 0.0
    size: int = 0


@dataclass(frozen=True)
class Function:
    """A function of numbers, or a section: one that works on the state, given first."""

    name: str
    arguments: list[Named]
    returns: str
    text: str
    body: list[ast.stmt]
    is_section: bool

    @property
    def kinds(self) -> dict[str, str]:
        """Of its arguments."""
        return {one.name: one.kind for one in self.arguments}


class Laws:
    """What the text of the laws holds."""

    def __init__(self, text: str) -> None:
        tree, said = ast.parse(text), _comments(text)
        self.source = text
        self.text, self.state_text = ast.get_docstring(tree) or "", ""
        self.constants: list[Named] = []
        self.fields: list[Named] = []
        self.functions: dict[str, Function] = {}
        for node in tree.body:
            if isinstance(node, ast.Assign):
                value = ast.literal_eval(node.value)
                kind = "whole" if isinstance(value, int) else "real"
                self.constants.append(Named(ast.unparse(node.targets[0]), kind, said.get(node.lineno, ""), value))
            elif isinstance(node, ast.FunctionDef):
                self.functions[node.name] = _function(node, said)
        sizes = {
            ast.unparse(node.targets[0])[2:]: int(ast.unparse(node.value.args[0]))
            for node in self.functions["start"].body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
            if ast.unparse(node.value.func) == "zeros"
        }
        for node in next(node for node in tree.body if isinstance(node, ast.ClassDef)).body:
            if isinstance(node, ast.AnnAssign):
                name = ast.unparse(node.target)
                kind = _KINDS[ast.unparse(node.annotation)]
                self.fields.append(Named(name, kind, said.get(node.lineno, ""), size=sizes.get(name, 0)))
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                self.state_text = str(node.value.value)
        self.kinds = {one.name: one.kind for one in self.constants} | {f"s.{one.name}": one.kind for one in self.fields}
        self.kinds |= {one.name: one.returns for one in self.functions.values()}


def _comments(text: str) -> dict[int, str]:
    """What is said of a line, behind it or right above it, by the number of the line."""
    found: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            line, said = token.start[0], token.string.removeprefix("#").strip()
            if token.line.strip().startswith("#"):
                found[line + 1] = f"{found.pop(line, '')} {said}".strip()
            else:
                found[line] = said
    return found


def _function(node: ast.FunctionDef, said: dict[int, str]) -> Function:
    kinds = {one.arg: ast.unparse(one.annotation or ast.Name("float")) for one in node.args.args}
    return Function(
        node.name,
        [
            Named(one.arg, _KINDS[kinds[one.arg]], said.get(one.lineno, ""))
            for one in node.args.args
            if kinds[one.arg] != "State"
        ],
        _KINDS[ast.unparse(node.returns or ast.Name("None"))],
        ast.get_docstring(node) or "",
        node.body[1:],  # behind its text
        "State" in kinds.values(),
    )
