"""The rendered laws, taken apart: constants, state and functions, with the comments that belong to each."""

import ast
from dataclasses import dataclass

from fastcoil.deliver.export.python import comments_in

_KINDS = {"float": "real", "bool": "flag", "int": "whole", "None": "", "list[float]": "real"}
"""Types of the laws: every number is a double but for the counters of loops."""


@dataclass(frozen=True)
class Named:
    """A constant with its value, a field of the state or an argument; size: of an array."""

    name: str
    kind: str
    line: int
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
        tree = ast.parse(text)
        self.source, self.lines, self._comments = text, text.splitlines(), comments_in(text)
        self.text, self.state_text = ast.get_docstring(tree) or "", ""
        self.constants: list[Named] = []
        self.fields: list[Named] = []
        self.functions: dict[str, Function] = {}
        for node in tree.body:
            if isinstance(node, ast.Assign):
                value = ast.literal_eval(node.value)
                kind = "whole" if isinstance(value, int) else "real"
                self.constants.append(Named(ast.unparse(node.targets[0]), kind, node.lineno, value))
            elif isinstance(node, ast.FunctionDef):
                self.functions[node.name] = _function(node)
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
                self.fields.append(Named(name, kind, node.lineno, size=sizes.get(name, 0)))
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                self.state_text = str(node.value.value)
        self.kinds = {one.name: one.kind for one in self.constants} | {f"s.{one.name}": one.kind for one in self.fields}
        self.kinds |= {one.name: one.returns for one in self.functions.values()}

    def comment(self, line: int) -> str:
        """What is said behind the code of a line."""
        return self._comments.get(line, "") if self.lines[line - 1].strip()[:1] != "#" else ""

    def above(self, line: int) -> list[str]:
        """The comments right above a line, each a line of its own."""
        found: list[str] = []
        while line > 1 and self.lines[line - 2].strip().startswith("#"):
            line -= 1
            found.insert(0, self._comments[line])
        return found


def _function(node: ast.FunctionDef) -> Function:
    kinds = {one.arg: ast.unparse(one.annotation or ast.Name("float")) for one in node.args.args}
    return Function(
        node.name,
        [Named(one.arg, _KINDS[kinds[one.arg]], one.lineno) for one in node.args.args if kinds[one.arg] != "State"],
        _KINDS[ast.unparse(node.returns or ast.Name("None"))],
        ast.get_docstring(node) or "",
        node.body[1:],  # behind its text
        "State" in kinds.values(),
    )
