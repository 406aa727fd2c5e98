"""Metadata of the project: what the wheel holds, and how it is cited."""

import re
import tomllib
from pathlib import Path

import pytest

import fastcoil as fc

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_wheel_takes_studies_and_type_marker_along():
    wheel = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["include"] == ["/fastcoil", "/studies/*/*.toml"]
    assert wheel["sources"] == {"studies": "fastcoil/studies"}
    assert Path(fc.__file__).with_name("py.typed").is_file()
    assert "Typing :: Typed" in PYPROJECT["project"]["classifiers"]


def test_the_citation_agrees_with_the_project():
    citation = pytest.importorskip("yaml").safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "type", "abstract", "keywords"} <= citation.keys()
    project = PYPROJECT["project"]
    assert (citation["version"], citation["license"]) == (fc.__version__, project["license"])
    assert "version" in project["dynamic"]
    assert PYPROJECT["tool"]["hatch"]["version"]["path"] == "fastcoil/base/machine.py"
    assert citation["authors"] == project["authors"]
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Cai", "Braun"]
    assert paper["url"].endswith("/iracc/1801")


def test_a_release_date_stands_in_the_citation_once_the_version_is_released():
    changes = (ROOT / "CHANGELOG.md").read_text()
    assert next(line for line in changes.splitlines() if line.startswith("## ")).split()[1] == fc.__version__
    released = f"## {fc.__version__} (unreleased)" not in changes
    assert ("date-released:" in (ROOT / "CITATION.cff").read_text()) == released


def test_the_readme_of_the_package_links_to_nothing_that_is_not_there():
    """The README as a package index gets it."""
    pytest.importorskip("hatch_fancy_pypi_readme")
    metadata = pytest.importorskip("hatchling.metadata.core")
    from hatchling.plugin.manager import PluginManager

    project = metadata.ProjectMetadata(str(ROOT), PluginManager())
    assert project.core.readme_content_type == "text/markdown"
    text = project.core.readme
    links = re.findall(r"\]\(([^)]*)\)", text) + re.findall(r"^\[[^\]]+\]: (\S+)", text, re.MULTILINE)
    assert links
    assert not [link for link in links if not link.startswith("https://")]
    assert "](" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert "is it the valve?" in text
    assert "<img" not in text
    assert project.version == fc.__version__


def test_the_constraints_name_one_version_of_every_dependency_that_it_allows():
    from packaging.requirements import Requirement
    from packaging.version import Version

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    for requirement in map(Requirement, PYPROJECT["project"]["dependencies"]):
        assert requirement.specifier.contains(Version(pinned[requirement.name.lower()])), requirement
