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


def parsed(text):
    """The tree of a text without mistakes."""
    parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    root = parser.parse(text.encode("ascii")).root_node
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
        for text in texts:
            for node in parsed(text).named_children:
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
        self.unit, self.v = unit, SimpleNamespace()
        for name, start in unit.start.items():
            setattr(self.v, name, start())

    def __call__(self, **inputs):
        for name, value in inputs.items():
            assert name.lower() in self.unit.inputs
            setattr(self.v, name.lower(), value)
        self.unit.run(self.v)

    def __getattr__(self, name):
        return getattr(self.v, name.lower())


class Unit:
    """One declaration: its variables, and its statements in Python."""

    def __init__(self, project, node):
        self.project, self.node = project, node
        names = [child for child in node.named_children if child.type == "identifier"]
        self.name = names[0].text.decode().lower()
        self.types, self.start, self.inputs, self.constants = {}, {}, [], set()
        if node.type == "function_declaration":
            self.types[self.name] = node.named_children[1].text.decode()
        for block in node.named_children:
            if block.type.startswith("var_"):
                for one in block.named_children:
                    if one.type == "variable_declaration":
                        self.declare(one, block)

    def declare(self, node, block):
        """Take the variables of a declaration."""
        parts = node.named_children
        kind = next(part for part in parts if part.type != "identifier" or part == parts[-1])
        values = [part.text.decode() for part in parts if part.type.endswith("_literal")]
        for part in parts:
            if part.type != "identifier" or part == kind:
                continue
            name = part.text.decode().lower()
            assert name not in self.types, f"{name} is declared twice"
            if kind.type == "array_type":
                sizes = [int(sub.named_children[1].text) + 1 for sub in kind.named_children[:-1]]
                self.types[name] = (kind.named_children[-1].text.decode(), len(sizes))
                numbers = [float(value) for value in values]
                assert not numbers or len(numbers) == sizes[0]
                self.start[name] = lambda sizes=sizes, numbers=numbers: list(numbers) or zeros(sizes)
            elif kind.type == "identifier":
                self.types[name] = kind.text.decode().lower()
                self.start[name] = lambda of=self.types[name]: self.project.block(of)
            else:
                word = self.types[name] = kind.text.decode()
                value = literal(values[0], word) if values else START[word]
                self.start[name] = lambda value=value: value
            if block.type == "var_input":
                self.inputs.append(name)
            if b"CONSTANT" in block.text.split(b"\n")[0]:
                self.constants.add(name)

    def translate(self):
        """Make Python of the statements."""
        lines = self.body(self.node.named_children, 1)
        code = "\n".join(["def run(v):", *(lines or ["    pass"])])
        names = {name: getattr(math, name) for name in STANDARD.values() if hasattr(math, name)} | {"call": self.call}
        exec(compile(code, self.name, "exec"), names)
        self.run = names["run"]

    def call(self, name, *arguments):
        """A function's value."""
        unit = self.project.units[name]
        block = Block(unit)
        for one, value in zip(unit.inputs, arguments, strict=True):
            setattr(block.v, one, value)
        unit.run(block.v)
        return getattr(block.v, unit.name)

    def body(self, nodes, depth):
        lines = [line for node in nodes for line in self.statement(node, depth)]
        return lines

    def statement(self, node, depth):
        indent = "    " * depth
        if node.type == "assignment_statement":
            target, value = node.named_children
            left, kind = self.expression(target)
            right, of = self.expression(value)
            assert kind == of, f"{of} is assigned to {kind}: {node.text.decode()}"
            assert left.removeprefix("v.") not in self.constants
            return [f"{indent}{left} = {right}"]
        if node.type == "return_statement":
            return [f"{indent}return"]
        if node.type == "for_statement":
            i, low, high, *rest = node.named_children
            by = [rest.pop(0).text.decode()] if node.children[6].type == "BY" else []
            last = f"{self.expression(high)[0]} {'- 1' if by else '+ 1'}"
            numbers = ", ".join([self.expression(low)[0], last, *by])
            return [f"{indent}for {self.expression(i)[0]} in range({numbers}):", *self.body(rest, depth + 1)]
        if node.type == "if_statement":
            return self.condition("if", node, depth)
        if node.type == "invocation_statement":
            name, arguments = node.named_children[0].named_children
            of = self.project.units[self.types[name.text.decode().lower()]]
            given = []
            for argument in arguments.named_children:
                one, value = argument.named_children
                text, kind = self.expression(value)
                assert kind == of.types[one.text.decode().lower()]
                given.append(f"{one.text.decode().lower()}={text}")
            return [f"{indent}v.{name.text.decode().lower()}({', '.join(given)})"]
        assert node.type in ("comment", "identifier", "elementary_type", "empty_statement") or node.type.startswith(
            "var_"
        ), node.type
        return []

    def condition(self, word, node, depth):
        """An IF or ELSIF with what follows."""
        test, *inner = node.named_children
        text, kind = self.expression(test)
        assert kind == "BOOL"
        own = [one for one in inner if one.type not in ("elsif_clause", "else_clause")]
        indent = "    " * depth
        lines = [f"{indent}{word} {text}:", *(self.body(own, depth + 1) or [f"{indent}    pass"])]
        for one in inner:
            if one.type == "elsif_clause":
                lines += self.condition("elif", one, depth)
            elif one.type == "else_clause":
                lines += [f"{indent}else:", *self.body(one.named_children, depth + 1)]
        return lines

    def expression(self, node):  # noqa: PLR0911 — one for each kind
        """(Python, type) of an expression."""
        text = node.text.decode()
        if node.type == "parenthesized_expression":
            inner, kind = self.expression(node.named_children[0])
            return f"({inner})", kind
        if node.type == "identifier":
            return f"v.{text.lower()}", self.types[text.lower()]
        if node.type == "member_access_expression":
            of, name = (child.text.decode().lower() for child in node.named_children)
            return f"v.{of}.{name}", self.project.units[self.types[of]].types[name]
        if node.type == "index_expression":
            name, *indices = node.named_children
            found = [self.expression(one) for one in indices]
            kind, dims = self.types[name.text.decode().lower()]
            assert dims == len(found)
            assert {of for _, of in found} == {"INT"}
            return f"v.{name.text.decode().lower()}" + "".join(f"[{one}]" for one, _ in found), kind
        if node.type == "call_expression":
            name, arguments = node.named_children
            found = [self.expression(one) for one in arguments.named_children]
            given, kinds = ", ".join(one for one, _ in found), [kind for _, kind in found]
            word = name.text.decode()
            if word in CONVERSIONS:
                takes, does, gives = CONVERSIONS[word]
                assert kinds == [takes], text
                return f"{does}({given})", gives
            if word in STANDARD:
                assert set(kinds) == {"LREAL"} or (set(kinds) == {"INT"} and word in ("ABS", "MIN", "MAX")), text
                return f"{STANDARD[word]}({given})", kinds[0]
            unit = self.project.units[word.lower()]
            assert kinds == [unit.types[one] for one in unit.inputs], text
            return f"call({word.lower()!r}, {given})", unit.types[unit.name]
        if node.type == "unary_expression":
            inner, kind = self.expression(node.named_children[0])
            sign = node.children[0].type
            assert (sign == "NOT") == (kind == "BOOL")
            return f"({SIGNS.get(sign, sign)}{inner})", kind
        if node.type == "binary_expression":
            (left, kind), (right, of) = map(self.expression, node.named_children)
            sign = node.children[1].type
            assert kind == of, f"{kind} and {of} in {text}"
            assert (sign in ("AND", "OR")) == (kind == "BOOL")
            answers = sign in ("=", "<>", "<", "<=", ">", ">=", "AND", "OR")
            return f"({left} {SIGNS.get(sign, sign)} {right})", "BOOL" if answers else kind
        kind = {"real_literal": "LREAL", "integer_literal": "INT", "boolean_literal": "BOOL"}[node.type]
        return repr(literal(text, kind)), kind


def literal(text, kind):
    """A number or truth as written."""
    if kind == "BOOL":
        return {"TRUE": True, "FALSE": False}[text]
    assert (kind == "LREAL") == ("." in text), text
    return float(text) if kind == "LREAL" else int(text)


def zeros(sizes):
    """Lists in lists, full of zeros."""
    return [zeros(sizes[1:]) for _ in range(sizes[0])] if len(sizes) > 1 else [0.0] * sizes[0]
