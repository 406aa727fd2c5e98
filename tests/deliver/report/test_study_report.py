"""The report of a study: what is on the page, that nothing else is needed, and that nothing of a stranger runs."""

import math

import numpy as np
import pytest
import xarray as xr
from helpers.commands import assert_command_refused, fastcoil
from helpers.pages import Page
from helpers.refusals import assert_refused
from helpers.results import make_result
from helpers.studies import DAYS, PLAIN_STUDY, TRACED_STUDY, copy_run, folder_contents, run, undisturbed_hash

import fastcoil as fc
from fastcoil.base.errors import EXIT_INPUT, EXIT_INTEGRITY
from fastcoil.deliver.report import results as module
from fastcoil.deliver.report.page import Table, format_change, format_change_range, format_parameter, format_significant
from fastcoil.deliver.report.results import comparison_tables
from fastcoil.study.analysis.answer import find_answer

pytestmark = [pytest.mark.kernel, pytest.mark.usefixtures("blank_figures")]


HOSTILE = "</title></style><script>alert(1)</script><img src=x onerror=alert(2)>\u202etxt"


@pytest.fixture
def page(out):
    """The report of a study of three days."""
    copy_run(PLAIN_STUDY, out)
    return Page(fc.report(out))


def test_it_has_question_answer_figures_numbers_settings_hash_file_and_citation_and_needs_nothing_else(page, out):
    page.assert_self_contained()
    ds = fc.open_study(out)
    assert len(page.pictures) == 1
    for words in (
        "Do this: take an inverse of 90 % of the backlash.",
        "Figure 1. Line: median of 3 days",
        "95 % interval: of the median change, over 3 days",
        "standard deviation 0.02 K",
        f"content_sha256 {undisturbed_hash(PLAIN_STUDY)}",
        f"model_sha256 {ds.attrs['model_sha256']}",
        f"fastcoil run study.toml -o results/{out.name}",
        "Cai, Jie and Braun, James E. (2016)",
        " ".join(PLAIN_STUDY.split()),
    ):
        assert words in page.text, words
    assert "Read this first" not in page.text


def test_the_same_results_give_the_same_bytes_and_the_folder_stays_sound(out, tmp_path):
    copy_run(TRACED_STUDY, out)
    first = fc.report(out, tmp_path / "one.html").read_bytes()
    assert fastcoil("report", out).output == f"Report:  {out / 'report.html'}\n"
    assert (out / "report.html").read_bytes() == first
    assert fastcoil("verify", out).exit_code == 0


@pytest.mark.parametrize("state", ["unfinished", "damaged"])
def test_an_unfinished_or_damaged_study_is_not_reported(out, state):
    copy_run(PLAIN_STUDY, out, DAYS - 1 if state == "unfinished" else None)
    if state == "damaged":
        data = bytearray((out / "results.nc").read_bytes())
        data[len(data) // 2] ^= 1
        (out / "results.nc").write_bytes(data)
    before = folder_contents(out)
    assert_command_refused("report", out, exit_code=EXIT_INPUT if state == "unfinished" else EXIT_INTEGRITY)
    assert folder_contents(out) == before


def test_what_a_stranger_wrote_is_shown_and_nothing_of_it_runs(out):
    text = PLAIN_STUDY.replace('"small"', repr(HOSTILE).replace("\\u202e", "\u202e")) + '[cases.odd]\n' + (
        "\"<img src='https://example.org/x.png'>\" = { kp = 0.03 }\nplain = { kp = 0.02 }\n"
    )  # fmt: skip
    run(f'question = """{HOSTILE}"""\n' + text, out)
    page = Page(fc.report(out))
    page.assert_self_contained()
    assert page.text.count("<script>alert(1)</script>") >= 3
    assert "<img src='https://example.org/x.png'>" in page.text
    assert "\u202e" not in page.source
    assert r"\u202etxt" in page.text


def test_what_failed_comes_first_and_is_in_no_number(out, monkeypatch):
    copy_run(PLAIN_STUDY, out)
    ds = fc.open_study(out)
    failed = ds.copy(deep=True)
    metrics = [n for n in ds.data_vars if n != "status"]
    failed["status"][0, 0, :] = 2
    for name in metrics:
        failed[name][0, 0, :] = np.nan
    failed["share_off"][1] = 0.9
    monkeypatch.setattr(module, "open_finished", lambda folder: failed)
    text = Page(fc.report(out)).text
    n_off = failed["share_off"][1].size
    assert text.index(f"{n_off} of 12 are more than 0.5 K off their set-point") < text.index("Answer")
    assert text.index("2 of 12 scenarios failed (2 out_of_range)") < text.index("Answer")
    monkeypatch.setattr(module, "standard_figures", lambda ds: pytest.fail("nothing is there to draw"))
    failed["status"][:] = 4
    for name in metrics:
        failed[name][:] = np.nan
    text = Page(fc.report(out)).text
    assert "12 of 12 scenarios failed (12 crashed)" in text
    assert "Every scenario failed: there is no answer." in text


def cells_by_row(table: Table):
    return {row[0]: dict(zip(table.head[1:], row[1:], strict=True)) for row in table.rows}


def test_changes_are_those_within_pairs():
    rmse = xr.DataArray(np.random.default_rng(1).uniform(0.1, 0.5, (3, 4, 9)), dims=("controller", "backlash", "day"))
    rmse["controller"], rmse["backlash"] = ["pi", "half", "full"], [0.0, 0.02, 0.07, 0.1]
    ds = xr.Dataset({"rmse": rmse, "status": xr.zeros_like(rmse, dtype=np.int8), "motor_travel": 40 * rmse})
    ds["status"][2, 1, 3] = 1
    rmse[1, 0] = rmse[0, 0]  # ties
    tables = comparison_tables(ds)
    cells_of_controller = cells_by_row(next(t for t in tables if t.caption.startswith("Controller: against pi")))
    rows = rmse.sel(fc.answer(ds).place)
    relative = (rmse[2] / rmse[0]).where(ds["status"][2] == 0).values.ravel()
    relative = relative[np.isfinite(relative)] - 1
    assert cells_of_controller["full"]["change"] == f"{100 * np.median(relative):+.0f} %".replace("-", "−")
    assert cells_of_controller["full"]["lower in"] == f"{100 * np.mean(relative < 0):.0f} %"
    low, high = (f"{100 * share:+.0f}".replace("-", "−") for share in np.quantile(relative, [0.05, 0.95]))
    assert cells_of_controller["full"]["5 to 95 % of pairs"] == f"{low} to {high} %"
    assert cells_of_controller["pi"]["change"] == "baseline"
    lower = (rmse[1] < rmse[0]).values.sum() + 0.5 * 9
    assert cells_of_controller["half"]["lower in"] == f"{100 * lower / 36:.0f} %"
    gaps = next(table for table in tables if table.caption == "Backlash: against the sound valve")
    ok = ds["status"].sel(fc.answer(ds).place) == 0
    worst = float((rows[3] / rows[0] - 1).where(ok[3] & ok[0]).median())
    assert cells_by_row(gaps)["10 %"]["change"] == f"{100 * worst:+.0f} %".replace("-", "−")
    assert "over 9 days" in gaps.note


def test_the_table_has_the_recommended_estimate_with_the_number_of_the_answer():
    ratios, factors = np.linspace(0.0, 1.5, 31), np.linspace(1.0, 1.4, 5)
    rmse = np.outer(1.0 - 0.5 * np.minimum(ratios, 0.55), factors)
    travel = np.outer(1.0 + ratios, factors)
    metrics = {"rmse": rmse, "motor_travel": travel, "switch_frequency": travel}
    ds = make_result(("estimate_ratio", "sample"), {"estimate_ratio": ratios}, **metrics)
    do, brings, *_ = find_answer(ds).summary()
    assert do.endswith("an inverse of 50 % of the backlash."), "55 % has an error only 3 % lower"
    (table,) = comparison_tables(ds)
    (row,) = [row for row in table.rows if row[0] == "50 %"]
    assert row[2] == "−25 %"
    assert "25 % lower" in brings


def test_a_single_scenario_has_a_page_with_every_metric(out):
    run("[boundary]\nhours = 0.25\n[run]\nwarm_up = 100\n[loop]\n", out)
    page = Page(fc.report(out))
    page.assert_self_contained()
    ds = fc.open_study(out)
    assert f"Answer Found: the RMS error is {float(ds['rmse']):.3g} K" in page.text
    assert all(ds[name].attrs["long_name"] in page.text for name in ("rmse", "reversals", "condensate"))
    assert page.pictures == []


def test_a_file_that_is_no_report_is_not_replaced_and_another_folder_is_refused(out, tmp_path):
    copy_run(PLAIN_STUDY, out)
    user_file, empty_folder = tmp_path / "mine.html", tmp_path / "other"
    user_file.write_text("<p>mine</p>")
    assert_refused("path", "path", fc.report, out, user_file)
    assert_command_refused("report", out, "-o", tmp_path / "page.pdf")
    empty_folder.mkdir()
    assert_command_refused("report", empty_folder)
    assert not (empty_folder / "report.html").exists()


def test_numbers_shares_changes_and_settings_as_they_are_read():
    text_by_value = {0.1: "0.100", 3: "3.00", 0.99999: "1.00", -0.04567: "−0.0457", 12345: "12,300", 0: "0",
                     9.996: "10.0", 1e-9: "1.00e-09", math.nan: "–", math.inf: "–", 159.4: "159"}  # fmt: skip
    assert {value: format_significant(value) for value in text_by_value} == text_by_value
    assert [format_change(x) for x in (-0.431, 0.004, -0.004, 1.87, math.nan)] == ["−43 %", "0 %", "0 %", "+187 %", "–"]
    assert (format_change_range(-0.7, 0.2), format_change_range(math.nan, 0.2)) == ("−70 to +20 %", "–")
    settings = {"backlash": 0.07, "kp": 0.03, "n_volumes": 8.0, "action": "heating"}
    assert [format_parameter(*each) for each in settings.items()] == ["7 %", "0.03 1/K", "8", "heating"]
