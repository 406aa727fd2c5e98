"""Every file that a docstring, a comment or a page names exists."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("fastcoil", "tests", "studies", "benchmarks", "docs", "packaging")
CITED = re.compile(r"(?<![\w.*-])((?:\w[\w-]*/)*[a-z][\w-]*\.(?:py|md|pyi|c)(?:\.jinja)?)\b")
OF_USERS = {"mine.py", "module.py", "points.py", "csv.py", "controller.c", "inverse.c"}
"""Files of users and libraries in examples."""


@cache
def known_files():
    files = [*ROOT.glob("*.*"), *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.*"))]
    return {f"/{path.relative_to(ROOT).as_posix()}" for path in files}


def texts_of_python(source):
    """Yield comments and docstrings, also those of constants."""
    yield from (t.string for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type == tokenize.COMMENT)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value


def texts_of(path):
    """Texts of a file: comments and docstrings, or a page without its fenced blocks."""
    source = path.read_text(encoding="utf-8")
    return texts_of_python(source) if path.suffix == ".py" else [re.sub(r"(?ms)^```.*?^```$", "", source)]


def missing_files(texts):
    cited = {name for text in texts for name in CITED.findall(text)} - OF_USERS
    return sorted(name for name in cited if not any(known.endswith(f"/{name}") for known in known_files()))


@pytest.mark.parametrize("folder", [*FOLDERS, ""])
def test_every_file_that_is_named_exists(folder):
    parts = (ROOT / folder).rglob("*.*") if folder else ROOT.glob("*.md")
    paths = [path for path in parts if path.suffix in (".py", ".md") and path.name != "CHANGELOG.md"]
    wrong = {str(path.relative_to(ROOT)): missing_files(texts_of(path)) for path in paths}
    assert {path: names for path, names in wrong.items() if names} == {}


def test_a_missing_file_is_found():
    texts = texts_of_python('"""See model/physics.py and gone.py."""\nX = 1  # docs/never.md, not "other.md"\n')
    assert missing_files(texts) == ["docs/never.md", "gone.py", "other.md"]
