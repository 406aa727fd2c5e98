"""The translation of the laws: expressions keep their grouping, loops their bounds."""

import ctypes
import math
import shutil
import subprocess

import pytest
from helpers.exported import COMPILER_FLAGS
from helpers.structured_text import Project

from fastcoil.deliver.export.languages import CPrinter, StructuredTextPrinter
from fastcoil.deliver.export.printer import Laws

EXPRESSIONS = [
    "a - (b - c)", "a - b - c", "a / (b * c)", "a / b / c", "a * (b + c) - c", "-(a + b) * c", "-a * b", "(a - b) * -c",
    "a - (b + c) * (a - c)", "max(a, b - c) / min(c, -a)", "abs(-a - b)", "math.sqrt(abs(a)) * math.exp(-b)",
    "math.log(c * c) - (a - (b - (c - a)))",
]  # fmt: skip
CONDITIONS = [
    "not (a > b and b > c)", "not a > b or c >= a", "(a > b or b > c) and c > a", "a > b or b > c and c > a",
    "not flag and (a <= b or not (b == c))",
]  # fmt: skip
LAWS = '''"""Laws for a test."""

NUMBER = 2.5  # a constant
COUNT = 3


class State:
    """What is found."""

{fields}


def start(s: State, start_command: float) -> None:
    """Begin."""
    s.r_0 = 0.0


def step(
    s: State,
    a: float,  # a
    b: float,  # b
    c: float,  # c
    flag: bool,  # a flag
) -> float:
    """Find."""
{body}
    return s.r_0
'''


def make_laws(*body, n=1):
    fields = "\n".join(f"    r_{k}: float  # result" for k in range(n))
    return Laws(LAWS.format(fields=fields, body="\n".join(f"    {line}" for line in body)))


def expected_values(values):
    names = dict(zip("abc", values, strict=True)) | {"math": math, "flag": True}
    return [float(eval(text, names)) for text in [*EXPRESSIONS, *CONDITIONS]]


def all_expressions():
    body = [f"s.r_{k} = {text}" for k, text in enumerate(EXPRESSIONS)]
    for k, text in enumerate(CONDITIONS, len(EXPRESSIONS)):
        body += [f"s.r_{k} = 0.0", f"if {text}:", f"    s.r_{k} = 1.0"]
    return make_laws(*body, n=len(EXPRESSIONS) + len(CONDITIONS))


VALUES = [(0.3, 1.7, -0.9), (-2.0, 0.1, 0.1), (5.0, -3.0, 0.7), (1.0, 1.0, 1.0)]


@pytest.mark.parametrize("values", VALUES)
def test_structured_text_groups_expressions_as_they_were(values):
    block = Project(StructuredTextPrinter(all_expressions(), "test").code_text()).block("FB_test")
    block(**dict(zip("abc", values, strict=True)), flag=True)
    assert [getattr(block, f"r_{k}") for k in range(len(expected_values(values)))] == expected_values(values)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_c_groups_expressions_as_they_were(tmp_path):
    (tmp_path / "test.c").write_text(CPrinter(all_expressions(), "test").code_text())
    flags = [*COMPILER_FLAGS, "-Wno-unused-parameter", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, "test.c", "-lm", "-o", "test.so"], cwd=tmp_path, check=True)
    step = ctypes.CDLL(str(tmp_path / "test.so")).test_step
    step.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 3, ctypes.c_bool]
    for values in VALUES:
        state = (ctypes.c_double * len(expected_values(values)))()
        step(state, *values, True)
        assert list(state) == pytest.approx(expected_values(values), rel=1e-15)


def test_loops_are_kept_and_what_is_said_of_constants_and_functions():
    body = [
        "common = 0.0", "for i in range(1, COUNT):", "    common += a",
        "for i in range(COUNT - 1, 0, -1):", "    common -= b", "s.r_0 = common * NUMBER",
    ]  # fmt: skip
    parsed_laws = make_laws(*body)
    text = StructuredTextPrinter(parsed_laws, "test").code_text()
    block = Project(text).block("FB_test")
    block(a=3.0, b=0.5, c=0.0, flag=False)
    assert block.r_0 == (2 * 3.0 - 2 * 0.5) * 2.5
    assert "FOR i := COUNT - 1 TO 1 BY -1 DO" in text
    for code in (text, CPrinter(parsed_laws, "test").code_text()):
        assert all(comment in code for comment in ("a constant", "What is found.", "Find."))
