"""Run Structured Text: a small interpreter for the tests, no compiler of a PLC.

The text is parsed by the grammar of tree-sitter; each statement of the tree becomes one of Python.  Names ignore case,
as in the standard; numbers of two types do not mix.
"""

import math
from types import SimpleNamespace

import tree_sitter
import tree_sitter_iec61131_3_st as grammar

STANDARD_FUNCTIONS = {
    "ABS": "abs", "MAX": "max", "MIN": "min", "EXP": "exp", "LN": "log", "SQRT": "sqrt", "SIN": "sin", "COS": "cos",
    "TAN": "tan", "ASIN": "asin", "ACOS": "acos", "ATAN": "atan", "EXPT": "pow",
}  # fmt: skip
CONVERSIONS = {"INT_TO_LREAL": ("INT", "float", "LREAL"), "DINT_TO_LREAL": ("INT", "float", "LREAL"),
               "TRUNC": ("LREAL", "int", "INT")}  # fmt: skip
"""Type of the argument, Python function, type of the result; INT and DINT count as one."""
OPERATORS = {"=": "==", "<>": "!=", "AND": "and", "OR": "or", "NOT": "not "}
START_VALUES = {"LREAL": 0.0, "INT": 0, "BOOL": False}


def parse_tree(code):
    """Parse a text; assert that it has no mistakes."""
    parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    root = parser.parse(code.encode("ascii")).root_node
    assert not root.has_error, first_error(root)
    return root


def first_error(node):
    """Return the first place that does not fit the grammar."""
    if node.type == "ERROR" or node.is_missing:
        return f"line {node.start_point[0] + 1}: {node.text.decode()[:80]!r}"
    return next(filter(None, map(first_error, node.children)), None)


class Project:
    """The functions, function blocks and programs of some texts."""

    def __init__(self, *texts):
        self.units = {}
        for code in texts:
            for node in parse_tree(code).named_children:
                if node.type.endswith("_declaration"):
                    unit = Unit(self, node)
                    assert unit.name not in self.units, f"{unit.name} is declared twice"
                    self.units[unit.name] = unit
        for unit in self.units.values():
            unit.translate()

    def block(self, name):
        """Return a new function block or program."""
        return Block(self.units[name.lower()])


class Block:
    """A function block: its variables, and a call."""

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
        self.name = next(node_text(child) for child in node.named_children if child.type == "identifier").lower()
        self.types, self.start, self.inputs, self.constants = {}, {}, [], set()
        if node.type == "function_declaration":
            self.types[self.name] = node_text(node.named_children[1])
        for block in node.named_children:
            for child_node in block.named_children if block.type.startswith("var_") else ():
                if child_node.type == "variable_declaration":
                    self.declare(child_node, block)

    def declare(self, node, block):
        """Add the variables of a declaration."""
        parts = node.named_children
        kind = next(part for part in parts if part.type != "identifier" or part == parts[-1])
        values = [node_text(part) for part in parts if part.type.endswith("_literal")]
        for name in (node_text(part).lower() for part in parts if part.type == "identifier" and part != kind):
            assert name not in self.types, f"{name} is declared twice"
            type_name = self.types[name] = node_text(kind).lower() if kind.type == "identifier" else node_text(kind)
            if kind.type == "array_type":
                (limits, inner) = kind.named_children
                size, self.types[name] = int(node_text(limits.named_children[1])) + 1, f"{node_text(inner)}[]"
                numbers = [float(value) for value in values] or [0.0] * size
                assert len(numbers) == size
                self.start[name] = numbers.copy
            elif kind.type == "identifier":
                self.start[name] = lambda type_name=type_name: self.project.block(type_name)
            else:
                value = parse_literal(values[0], type_name) if values else START_VALUES[type_name]
                self.start[name] = lambda value=value: value
            if block.type == "var_input":
                self.inputs.append(name)
            if b"CONSTANT" in block.text.split(b"\n")[0]:
                self.constants.add(name)

    def translate(self):
        """Translate the statements to Python."""
        code = "\n".join(["def run(v):", *self.body(self.node.named_children, 1)])
        names = {n: getattr(math, n) for n in STANDARD_FUNCTIONS.values() if hasattr(math, n)} | {"call": self.call}
        exec(compile(code, self.name, "exec"), names)
        self.run = names["run"]

    def call(self, name, *arguments):
        """Call a function."""
        block = self.project.block(name)
        block(**dict(zip(block.unit.inputs, arguments, strict=True)))
        return getattr(block, name)

    def body(self, nodes, depth):
        lines = [line for node in nodes for line in self.statement(node, depth)]
        return lines or ["    " * depth + "pass"]

    def statement(self, node, depth):
        indent, children = "    " * depth, node.named_children
        if node.type == "assignment_statement":
            (left, kind), (right, target_unit) = map(self.expression, children)
            assert kind == target_unit, f"{target_unit} is assigned to {kind}: {node_text(node)}"
            assert left.removeprefix("v.") not in self.constants
            return [f"{indent}{left} = {right}"]
        if node.type == "return_statement":
            return [f"{indent}return"]
        if node.type == "for_statement":
            i, low, high, *loop_body = children
            by = [node_text(loop_body.pop(0))] if node.children[6].type == "BY" else []
            last = f"{self.expression(high)[0]} {'- 1' if by else '+ 1'}"
            numbers = ", ".join([self.expression(low)[0], last, *by])
            return [f"{indent}for {self.expression(i)[0]} in range({numbers}):", *self.body(loop_body, depth + 1)]
        if node.type == "if_statement":
            return self.condition("if", node, depth)
        if node.type == "invocation_statement":
            name, arguments = children[0].named_children
            target_unit = self.project.units[self.types[node_text(name).lower()]]
            assignments = []
            for parameter, value in (argument.named_children for argument in arguments.named_children):
                argument, kind = self.expression(value)
                assert kind == target_unit.types[node_text(parameter).lower()]
                assignments.append(f"{node_text(parameter).lower()}={argument}")
            return [f"{indent}v.{node_text(name).lower()}({', '.join(assignments)})"]
        ignored_types = ("comment", "identifier", "elementary_type", "empty_statement")
        assert node.type in ignored_types or node.type.startswith("var_"), node.type
        return []

    def condition(self, word, node, depth):
        """Translate an IF or ELSIF with its branches."""
        test, *inner = node.named_children
        condition, kind = self.expression(test)
        assert kind == "BOOL"
        statements = [clause for clause in inner if clause.type not in ("elsif_clause", "else_clause")]
        indent = "    " * depth
        lines = [f"{indent}{word} {condition}:", *self.body(statements, depth + 1)]
        for clause in inner:
            if clause.type == "elsif_clause":
                lines += self.condition("elif", clause, depth)
            elif clause.type == "else_clause":
                lines += [f"{indent}else:", *self.body(clause.named_children, depth + 1)]
        return lines

    def expression(self, node):  # noqa: PLR0911 — one for each kind
        """Return (Python, type) of an expression."""
        source, children = node_text(node), node.named_children
        if node.type == "identifier":
            return f"v.{source.lower()}", self.types[source.lower()]
        if node.type.endswith("_literal"):
            kind = {"real_literal": "LREAL", "integer_literal": "INT", "boolean_literal": "BOOL"}[node.type]
            return repr(parse_literal(source, kind)), kind
        if node.type == "member_access_expression":
            right_kind, name = (node_text(child).lower() for child in children)
            return f"v.{right_kind}.{name}", self.project.units[self.types[right_kind]].types[name]
        if node.type == "call_expression":
            return self.translate_call(node_text(children[0]), [*map(self.expression, children[1].named_children)])
        operands = [self.expression(left) for left in children]
        (left, kind), sign = operands[0], node.children[len(operands) - 1].type
        if node.type == "parenthesized_expression":
            return f"({left})", kind
        if node.type == "index_expression":
            assert kind.endswith("[]")
            assert operands[1][1] == "INT"
            return f"{left}[{operands[1][0]}]", kind[:-2]
        if node.type == "unary_expression":
            assert (sign == "NOT") == (kind == "BOOL")
            return f"({OPERATORS.get(sign, sign)}{left})", kind
        assert node.type == "binary_expression", node.type
        right, right_kind = operands[1]
        assert kind == right_kind, f"{kind} and {right_kind} in {source}"
        assert (sign in ("AND", "OR")) == (kind == "BOOL")
        is_boolean = sign in ("=", "<>", "<", "<=", ">", ">=", "AND", "OR")
        return f"({left} {OPERATORS.get(sign, sign)} {right})", "BOOL" if is_boolean else kind

    def translate_call(self, function_name, arguments):
        """Return (Python, type) of a call."""
        arguments_text, kinds = ", ".join(name for name, _ in arguments), [kind for _, kind in arguments]
        if function_name in CONVERSIONS:
            argument_type, python_name, result_type = CONVERSIONS[function_name]
            assert kinds == [argument_type], function_name
            return f"{python_name}({arguments_text})", result_type
        if function_name in STANDARD_FUNCTIONS:
            has_integers = set(kinds) == {"INT"} and function_name in ("ABS", "MIN", "MAX")
            assert set(kinds) == {"LREAL"} or has_integers, function_name
            return f"{STANDARD_FUNCTIONS[function_name]}({arguments_text})", kinds[0]
        unit = self.project.units[function_name.lower()]
        assert kinds == [unit.types[name] for name in unit.inputs], function_name
        return f"call({function_name.lower()!r}, {arguments_text})", unit.types[unit.name]


def node_text(node):
    """Return the source of a node."""
    return node.text.decode()


def parse_literal(source, kind):
    """Convert a literal to Python."""
    if kind == "BOOL":
        return {"TRUE": True, "FALSE": False}[source]
    assert (kind == "LREAL") == ("." in source), source
    return float(source) if kind == "LREAL" else int(source)
