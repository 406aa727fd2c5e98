"""The site: every page gets into it, links lead somewhere, and its checker finds what does not; without Sphinx."""

import ast
import posixpath
import re
from pathlib import Path
from types import ModuleType

import pytest
from builder.links import check, problems
from builder.pages import Staging, public, redirects, source_of
from builder.stage import stage

import fastcoil as fc

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "docs" / "gallery").glob("*.py"))
FROM_SPHINX = ("examples/", "api/")
"""Where Sphinx makes pages of its own."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    out = tmp_path_factory.mktemp("pages")
    stage(ROOT, out)
    return {str(path.relative_to(out)): path.read_text() for path in out.rglob("*.md")}


def test_every_page_of_the_repository_is_on_the_site(pages):
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= set(pages)
    assert {"overview.md", "answers.md", "benchmarks.md", "changelog.md"} <= set(pages)


def test_links_lead_to_pages_of_the_site(pages):
    links = {
        (page, link.partition("#")[0])
        for page, text in pages.items()
        if not page.startswith("files/")
        for link in re.findall(r"\]\(([^)\s]+\.(?:md|rst)(?:#[^)\s]*)?)\)", re.sub(r"(?ms)^```.*?^```$", "", text))
    }
    assert len(links) > 200
    led = {posixpath.normpath(posixpath.join(posixpath.dirname(page), link)) for page, link in links}
    assert {page for page in led if page not in pages and not page.startswith(FROM_SPHINX)} == set()


def test_a_former_address_leads_to_the_page_that_has_its_content_now(pages):
    for name, text in redirects().items():
        to = re.search(r"url=(\S+)\.html", text)[1]
        assert f"{to}.md" in pages
        assert name.replace(".html", ".md") not in pages, "a page of the site would be overwritten"


def test_the_sections_of_the_index_are_the_order_of_the_site(pages):
    tree = re.findall(r"^[^\n<]+ <(\S+)>$", pages["index.md"], re.MULTILINE)
    assert tree == ["start-here", "examples/index", "use-it", "look-inside", "what-we-found", "reference"]
    assert "\nFirst steps <first-steps>\n" in pages["start-here.md"]
    assert "\nStudies <studies>\n" in pages["use-it.md"]


def test_a_notebook_is_shown_as_text_and_code(pages):
    shown = next(text for page, text in pages.items() if page.endswith(".ipynb.md"))
    assert "```python\nimport" in shown
    assert "cell_type" not in shown


def test_no_page_links_twice_to_a_term(pages):
    lists = {"glossary.md", "index.md", "start-here.md"}
    for page, text in pages.items():
        links = re.findall(r"\(glossary\.md#([^)]+)\)", text)
        assert page in lists or len(links) == len(set(links)), page
    assert "(glossary.md#lane)" in pages["promises.md"]


def test_an_equation_stands_beside_its_source(pages):
    module = (ROOT / "fastcoil" / "model" / "physics.py").read_text()
    page = pages["model.md"]
    assert source_of(module, "backlash") in page
    source = (ROOT / "docs" / "model.md").read_text()
    shown = [
        name for names in re.findall(r"^<!-- code \S+: (.+) -->$", source, re.MULTILINE) for name in names.split(", ")
    ]
    assert [name for name in shown if f"\ndef {name}(" not in page] == []
    assert len(shown) > 30
    assert page.count("```{math}") == source.count("```math") > 10


def test_a_link_to_nothing_is_refused(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[gone](gone.md)\n")
    with pytest.raises(ValueError, match=r"docs/index.md links to gone.md, which does not exist"):
        Staging(tmp_path).text("docs/index.md")


def test_the_reference_has_every_public_name_once():
    text = (ROOT / "docs" / "reference.md").read_text()
    packages = {name for name in fc.__all__ if isinstance(getattr(fc, name), ModuleType)}
    inside = {f"fastcoil.{package}.{name}" for package in packages for name in getattr(fc, package).__all__}
    wanted = {f"fastcoil.{name}" for name in fc.__all__ if name not in packages} | inside
    named = public(text) + re.findall(r"`fc(.__version__)`", text)
    assert len(set(named)) == len(named)
    # classes of results are named with their module, three dots and more
    assert {name.replace(".__", "fastcoil.__") for name in named if name.count(".") < 3} == wanted


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_an_example_asks_a_question_and_ends_with_numbers_of_its_run(path):
    assert int(path.name[:2]) == SCRIPTS.index(path) + 1
    tree = ast.parse(path.read_text())
    title = ast.get_docstring(tree).splitlines()[0]
    assert title.endswith("?")
    answer = path.read_text().rpartition("\n# %%\n# The answer")[2]
    assert answer
    printed = [node for node in ast.walk(ast.parse(answer.partition("\n")[2])) if isinstance(node, ast.JoinedStr)]
    assert any(isinstance(part, ast.FormattedValue) for text in printed for part in text.values)


GOOD = '<h1 id="top">A</h1><a href="other.html#there">b</a><a href="https://example.org">c</a><img src="a.png">'


@pytest.fixture
def site(tmp_path):
    (tmp_path / "index.html").write_text(GOOD)
    (tmp_path / "other.html").write_text('<h2 id="there">B</h2><a href="index.html#top">a</a><a href="#there">b</a>')
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "_static").mkdir()
    (tmp_path / "_static" / "template.html").write_text('<a href="{{ nowhere }}">a</a>')
    return tmp_path


def test_a_sound_site_has_no_problems_and_has_pages(site):
    assert problems(site) == []
    assert check(site) == 0
    assert check(site / "_static" / "none") == 1


@pytest.mark.parametrize(
    ("html", "line"),
    [
        ('<a href="gone.html">a</a>', "page.html links to gone.html, which does not exist"),
        ('<a href="other.html#gone">a</a>', "page.html links to other.html#gone: other.html has no such heading"),
        ('<a href="#gone">a</a>', "page.html links to #gone: page.html has no such heading"),
        ('<script src="https://cdn.example.org/x.js"></script>', "page.html loads https://cdn.example.org/x.js"),
        ('<link rel="stylesheet" href="//example.org/x.css">', "page.html loads //example.org/x.css"),
        ('<img src="gone.png">', "page.html links to gone.png, which does not exist"),
    ],
)
def test_a_dead_link_or_something_from_outside_is_found(site, html, line, capsys):
    (site / "page.html").write_text(html)
    assert check(site) == 1
    assert capsys.readouterr().out.strip() == line


def test_a_site_without_pages_is_no_site(tmp_path):
    assert check(tmp_path) == 1
