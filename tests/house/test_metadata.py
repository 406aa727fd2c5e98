"""Metadata of the project: what the wheel holds, and how it is cited."""

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
    yaml = pytest.importorskip("yaml")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "type", "abstract", "keywords"} <= citation.keys()
    project = PYPROJECT["project"]
    assert (citation["version"], citation["license"]) == (fc.__version__, project["license"])
    assert project["dynamic"] == ["version"]
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
