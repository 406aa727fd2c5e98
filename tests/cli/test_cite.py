"""``fastcoil cite``: the same as CITATION.cff, and results by their hash."""

from pathlib import Path

import pytest
from helpers.commands import fastcoil
from helpers.studies import PLAIN_STUDY, copy_run, undisturbed_hash

import fastcoil as fc
from fastcoil.deliver.report.page import AUTHORS, LICENCE, PAPER, TITLE, citation

ROOT = Path(__file__).parents[2]


def test_it_says_what_citation_cff_says():
    yaml = pytest.importorskip("yaml")
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    (paper,) = cff["references"]
    assert (cff["title"], cff["license"], cff["authors"]) == (TITLE, LICENCE, [{"name": AUTHORS}])
    assert PAPER == {
        "title": paper["title"],
        "authors": " and ".join(f"{a['family-names']}, {a['given-names']}" for a in paper["authors"]),
        "year": str(paper["year"]),
        "series": paper["conference"]["name"],
        "number": paper["number"],
        "publisher": paper["database"],
        "url": paper["url"],
    }


def test_it_names_software_version_and_paper():
    result = fastcoil("cite")
    assert result.exit_code == 0
    assert result.output.splitlines() == citation()
    assert f"Version {fc.__version__}, MIT licence." in result.output


@pytest.mark.kernel
def test_results_are_cited_with_the_version_and_the_hash_that_made_them(out):
    copy_run(PLAIN_STUDY, out)
    result = fastcoil("cite", out)
    version = fc.open_study(out).attrs["fastcoil_version"]
    assert result.output.splitlines()[-1] == (
        f"Results: small. Made with fastcoil {version}; content_sha256 {undisturbed_hash(PLAIN_STUDY)}."
    )
