"""The report of `fastcoil paper`: every claim and figure on one page."""

import json
import shutil

import pytest
from helpers.commands import fastcoil
from helpers.pages import Page

from fastcoil.base.errors import IntegrityError
from fastcoil.deliver.report.paper import paper_page

pytestmark = pytest.mark.kernel


@pytest.fixture
def paper(folder, tmp_path):
    """What the page needs of a folder of the paper's figures."""
    for path in (*folder.glob("*.png"), folder / "scorecard.json"):
        shutil.copy(path, tmp_path)
    return tmp_path


def test_every_claim_figure_and_warning_is_on_the_page(paper, card):
    done = fastcoil("report", paper)
    assert done.exit_code == 0, done.output
    page = Page(paper / "report.html")
    page.require_alone()
    assert len(page.pictures) == 7
    assert page.text.index("Quick mode: too few tunings and days to be quoted.") < page.text.index("Answer")
    for claim in card["claims"]:
        assert f"{claim['claim']} ({claim['section']})" in page.text
        for kind, found in claim["kinds"].items():
            assert f"{kind}: {found['verdict_text']}" in page.text
    shares = [found["share"] for claim in card["claims"] for found in claim["kinds"].values()]
    n_hold, n_not = sum(one >= 0.95 for one in shares), sum(one <= 0.05 for one in shares)
    assert f"Of {len(shares)} verdicts, one for each claim and kind of day, {n_hold} say that it holds" in page.text
    assert f"{n_not} that it does not (5 % or less)" in page.text
    assert all(sha256 in page.text for sha256 in card["grid"]["content_sha256"].values())


def test_a_missing_figure_is_told(paper):
    (paper / "fig09.png").unlink()
    assert "fig09.png is missing" in paper_page(paper / "scorecard.json").html()


@pytest.mark.parametrize("damage", ["", "[]", '{"claims": [{}]}', '{"grid": {}, "claims": 3}'])
def test_a_damaged_scorecard_is_refused_in_a_sentence(paper, damage):
    (paper / "scorecard.json").write_text(damage)
    done = fastcoil("report", paper)
    assert done.exit_code == IntegrityError.exit_code
    assert "scorecard.json is damaged" in done.stderr
    assert not (paper / "report.html").exists()


def test_what_is_no_figure_is_not_shown(paper, card):
    (paper / "fig07.png").write_text("<svg onload=alert(1)>")
    with pytest.raises(IntegrityError, match=r"fig07.png is no PNG"):
        paper_page(paper / "scorecard.json")
    assert json.loads((paper / "scorecard.json").read_text()) == card
