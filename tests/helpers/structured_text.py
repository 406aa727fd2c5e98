"""Runs Structured Text: a small interpreter for the tests, no compiler of a PLC.

The text is parsed by the grammar of tree-sitter; each statement of the tree then becomes one of Python.  Names are told
apart as the standard does, by their letters alone, small or capital; numbers of two types do not mix.
"""

import math
from types import SimpleNamespace

import tree_sitter
import tree_sitter_iec61131_3_st as grammar

STANDARD = {
    "ABS": "abs", "MAX": "max", "MIN": "min", "EXP": "exp", "LN": "log", "SQRT": "sqrt", "SIN": "sin", "COS": "cos",
    "TAN": "tan", "ASIN": "asin", "ACOS": "acos", "ATAN": "atan", "EXPT": "pow",
}  # fmt: skip
CONVERSIONS = {"INT_TO_LREAL": ("INT", "float", "LREAL"), "DINT_TO_LREAL": ("INT", "float", "LREAL"),
               "TRUNC": ("LREAL", "int", "INT")}  # fmt: skip
"""What they take, do and give; INT and DINT count as one."""
SIGNS = {"=": "==", "<>": "!=", "AND": "and", "OR": "or", "NOT": "not "}
START = {"LREAL": 0.0, "INT": 0, "BOOL": False}


def parsed(code):
    """The tree of a text without mistakes."""
    parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    root = parser.parse(code.encode("ascii")).root_node
    assert not root.has_error, first_error(root)
    return root


def first_error(node):
    """Where the grammar does not fit."""
    if node.type == "ERROR" or node.is_missing:
        return f"line {node.start_point[0] + 1}: {node.text.decode()[:80]!r}"
    return next(filter(None, map(first_error, node.children)), None)


class Project:
    """The functions, function blocks and programs of some texts."""

    def __init__(self, *texts):
        self.units = {}
        for code in texts:
            for node in parsed(code).named_children:
                if node.type.endswith("_declaration"):
                    unit = Unit(self, node)
                    assert unit.name not in self.units, f"{unit.name} is declared twice"
                    self.units[unit.name] = unit
        for unit in self.units.values():
            unit.translate()

    def block(self, name):
        """A new function block or program."""
        return Block(self.units[name.lower()])


class Block:
    """A function block: what it holds, and a call."""

    def __init__(self, unit):
        self.unit, self.v = unit, SimpleNamespace(**{name: start() for name, start in unit.start.items()})

    def __call__(self, **inputs):
        assert {name.lower() for name in inputs} <= set(self.unit.inputs)
        vars(self.v).update({name.lower(): value for name, value in inputs.items()})
        self.unit.run(self.v)

    def __getattr__(self, name):
        return getattr(self.v, name.lower())


class Unit:
    """One declaration: its variables, and its statements in Python."""

    def __init__(self, project, node):
        self.project, self.node = project, node
        self.name = next(text(child) for child in node.named_children if child.type == "identifier").lower()
        self.types, self.start, self.inputs, self.constants = {}, {}, [], set()
        if node.type == "function_declaration":
            self.types[self.name] = text(node.named_children[1])
        for block in node.named_children:
            for one in block.named_children if block.type.startswith("var_") else ():
                if one.type == "variable_declaration":
                    self.declare(one, block)

    def declare(self, node, block):
        """Take the variables of a declaration."""
        parts = node.named_children
        kind = next(part for part in parts if part.type != "identifier" or part == parts[-1])
        values = [text(part) for part in parts if part.type.endswith("_literal")]
        for name in (text(part).lower() for part in parts if part.type == "identifier" and part != kind):
            assert name not in self.types, f"{name} is declared twice"
            of = self.types[name] = text(kind).lower() if kind.type == "identifier" else text(kind)
            if kind.type == "array_type":
                (limits, inner) = kind.named_children
                size, self.types[name] = int(text(limits.named_children[1])) + 1, f"{text(inner)}[]"
                numbers = [float(value) for value in values] or [0.0] * size
                assert len(numbers) == size
                self.start[name] = numbers.copy
            elif kind.type == "identifier":
                self.start[name] = lambda of=of: self.project.block(of)
            else:
                value = literal(values[0], of) if values else START[of]
                self.start[name] = lambda value=value: value
            if block.type == "var_input":
                self.inputs.append(name)
            if b"CONSTANT" in block.text.split(b"\n")[0]:
                self.constants.add(name)

    def translate(self):
        """Make Python of the statements."""
        code = "\n".join(["def run(v):", *self.body(self.node.named_children, 1)])
        names = {name: getattr(math, name) for name in STANDARD.values() if hasattr(math, name)} | {"call": self.call}
        exec(compile(code, self.name, "exec"), names)
        self.run = names["run"]

    def call(self, name, *arguments):
        """A function's value."""
        block = self.project.block(name)
        block(**dict(zip(block.unit.inputs, arguments, strict=True)))
        return getattr(block, name)

    def body(self, nodes, depth):
        lines = [line for node in nodes for line in self.statement(node, depth)]
        return lines or ["    " * depth + "pass"]

    def statement(self, node, depth):
        indent, children = "    " * depth, node.named_children
        if node.type == "assignment_statement":
            (left, kind), (right, of) = map(self.expression, children)
            assert kind == of, f"{of} is assigned to {kind}: {text(node)}"
            assert left.removeprefix("v.") not in self.constants
            return [f"{indent}{left} = {right}"]
        if node.type == "return_statement":
            return [f"{indent}return"]
        if node.type == "for_statement":
            i, low, high, *rest = children
            by = [text(rest.pop(0))] if node.children[6].type == "BY" else []
            last = f"{self.expression(high)[0]} {'- 1' if by else '+ 1'}"
            numbers = ", ".join([self.expression(low)[0], last, *by])
            return [f"{indent}for {self.expression(i)[0]} in range({numbers}):", *self.body(rest, depth + 1)]
        if node.type == "if_statement":
            return self.condition("if", node, depth)
        if node.type == "invocation_statement":
            name, arguments = children[0].named_children
            of = self.project.units[self.types[text(name).lower()]]
            given = []
            for one, value in (argument.named_children for argument in arguments.named_children):
                found, kind = self.expression(value)
                assert kind == of.types[text(one).lower()]
                given.append(f"{text(one).lower()}={found}")
            return [f"{indent}v.{text(name).lower()}({', '.join(given)})"]
        known = ("comment", "identifier", "elementary_type", "empty_statement")
        assert node.type in known or node.type.startswith("var_"), node.type
        return []

    def condition(self, word, node, depth):
        """An IF or ELSIF with what follows."""
        test, *inner = node.named_children
        found, kind = self.expression(test)
        assert kind == "BOOL"
        own = [one for one in inner if one.type not in ("elsif_clause", "else_clause")]
        indent = "    " * depth
        lines = [f"{indent}{word} {found}:", *self.body(own, depth + 1)]
        for one in inner:
            if one.type == "elsif_clause":
                lines += self.condition("elif", one, depth)
            elif one.type == "else_clause":
                lines += [f"{indent}else:", *self.body(one.named_children, depth + 1)]
        return lines

    def expression(self, node):  # noqa: PLR0911 — one for each kind
        """(Python, type) of an expression."""
        said, children = text(node), node.named_children
        if node.type == "identifier":
            return f"v.{said.lower()}", self.types[said.lower()]
        if node.type.endswith("_literal"):
            kind = {"real_literal": "LREAL", "integer_literal": "INT", "boolean_literal": "BOOL"}[node.type]
            return repr(literal(said, kind)), kind
        if node.type == "member_access_expression":
            of, name = (text(child).lower() for child in children)
            return f"v.{of}.{name}", self.project.units[self.types[of]].types[name]
        if node.type == "call_expression":
            return self.called(text(children[0]), [self.expression(one) for one in children[1].named_children])
        found = [self.expression(one) for one in children]
        (one, kind), sign = found[0], node.children[len(found) - 1].type
        if node.type == "parenthesized_expression":
            return f"({one})", kind
        if node.type == "index_expression":
            assert kind.endswith("[]")
            assert found[1][1] == "INT"
            return f"{one}[{found[1][0]}]", kind[:-2]
        if node.type == "unary_expression":
            assert (sign == "NOT") == (kind == "BOOL")
            return f"({SIGNS.get(sign, sign)}{one})", kind
        assert node.type == "binary_expression", node.type
        other, of = found[1]
        assert kind == of, f"{kind} and {of} in {said}"
        assert (sign in ("AND", "OR")) == (kind == "BOOL")
        answers = sign in ("=", "<>", "<", "<=", ">", ">=", "AND", "OR")
        return f"({one} {SIGNS.get(sign, sign)} {other})", "BOOL" if answers else kind

    def called(self, word, found):
        """(Python, type) of a function's value."""
        given, kinds = ", ".join(one for one, _ in found), [kind for _, kind in found]
        if word in CONVERSIONS:
            takes, does, gives = CONVERSIONS[word]
            assert kinds == [takes], word
            return f"{does}({given})", gives
        if word in STANDARD:
            assert set(kinds) == {"LREAL"} or (set(kinds) == {"INT"} and word in ("ABS", "MIN", "MAX")), word
            return f"{STANDARD[word]}({given})", kinds[0]
        unit = self.project.units[word.lower()]
        assert kinds == [unit.types[one] for one in unit.inputs], word
        return f"call({word.lower()!r}, {given})", unit.types[unit.name]


def text(node):
    """What is written."""
    return node.text.decode()


def literal(said, kind):
    """A number or truth as written."""
    if kind == "BOOL":
        return {"TRUE": True, "FALSE": False}[said]
    assert (kind == "LREAL") == ("." in said), said
    return float(said) if kind == "LREAL" else int(said)
