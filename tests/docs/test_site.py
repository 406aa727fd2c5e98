"""The site: every page gets into it, links lead somewhere, and its checker finds what does not; without Sphinx."""

import posixpath
import re
from pathlib import Path
from types import ModuleType

import pytest
from builder.links import check
from builder.pages import public_names, redirects, source_of
from builder.stage import stage

import fastcoil as fc

ROOT = Path(__file__).parents[2]
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
    targets = {posixpath.normpath(posixpath.join(posixpath.dirname(page), link)) for page, link in links}
    assert {page for page in targets if page not in pages and not page.startswith(FROM_SPHINX)} == set()


def test_a_former_address_leads_to_the_page_that_has_its_content_now(pages):
    for name, text in redirects().items():
        to = re.search(r"url=(\S+)\.html", text)[1]
        assert f"{to}.md" in pages
        assert name.replace(".html", ".md") not in pages, "a page of the site would be overwritten"


def test_an_equation_stands_beside_its_source(pages):
    module = (ROOT / "fastcoil" / "model" / "physics.py").read_text()
    page = pages["model.md"]
    assert source_of(module, "backlash") in page
    source = (ROOT / "docs" / "model.md").read_text()
    function_names = ", ".join(re.findall(r"^<!-- code \S+: (.+) -->$", source, re.MULTILINE)).split(", ")
    assert [name for name in function_names if f"\ndef {name}(" not in page] == []
    assert len(function_names) > 30
    assert page.count("```{math}") == source.count("```math") > 10


def test_the_reference_has_every_public_name_once():
    text = (ROOT / "docs" / "reference.md").read_text()
    packages = {name for name in fc.__all__ if isinstance(getattr(fc, name), ModuleType)}
    inside = {f"fastcoil.{package}.{name}" for package in packages for name in getattr(fc, package).__all__}
    expected_names = {f"fastcoil.{name}" for name in fc.__all__ if name not in packages} | inside
    names_in_reference = public_names(text) + re.findall(r"`fc(.__version__)`", text)
    assert len(set(names_in_reference)) == len(names_in_reference)
    # classes of results are named with their module, three dots and more
    assert {name.replace(".__", "fastcoil.__") for name in names_in_reference if name.count(".") < 3} == expected_names


def test_dead_links_and_what_comes_from_outside_are_found(tmp_path, capsys):
    assert check(tmp_path) == 1, "a site has pages"
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "other.html").write_text('<h2 id="there">B</h2><a href="#there">b</a>')
    (tmp_path / "_static").mkdir()
    (tmp_path / "_static" / "template.html").write_text('<a href="{{ nowhere }}">a</a>')
    good = '<a href="other.html#there">b</a><a href="https://example.org">c</a><img src="a.png">'
    (tmp_path / "page.html").write_text(good)
    capsys.readouterr()
    assert check(tmp_path) == 0
    addresses = ("gone.html", "other.html#gone", "#gone")
    bad = "".join(f'<a href="{address}">a</a>' for address in addresses)
    (tmp_path / "page.html").write_text(f'{good}{bad}<script src="https://cdn.example.org/x.js"></script>')
    assert check(tmp_path) == 1
    assert capsys.readouterr().out.splitlines() == [
        "page.html loads https://cdn.example.org/x.js",
        "page.html links to #gone: page.html has no such heading",
        "page.html links to gone.html, which does not exist",
        "page.html links to other.html#gone: other.html has no such heading",
    ]
