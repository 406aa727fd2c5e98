"""LaTeX: a table that compiles, whose numbers are numpy's medians and percentiles."""

import math
import re

import numpy as np
import pytest
from helpers.results import drawn, result

from fastcoil.base.errors import InputError
from fastcoil.base.text import decimals_of, written
from fastcoil.deliver.tables import escaped, latex_of
from fastcoil.study.analysis.selected import binned


def rows_of(text):
    """The cells of the body, row by row."""
    body = text.split("\\midrule\n")[1].split("\\bottomrule")[0]
    lines = [line for line in body.splitlines() if line != r"\addlinespace"]
    assert all(line.endswith(r" \\") for line in lines)
    return [line.removesuffix(r" \\").split(" & ") for line in lines]


def numbers(cell):
    return [float(n) for n in re.findall(r"-?[\d.]+", cell.replace("$-$", "-"))]


@pytest.fixture
def ds():
    rng = np.random.default_rng(1)
    return result(
        ("backlash", "tuning", "day"), {"backlash": [0.02, 0.07], "tuning": ["as_found", "50 % & up"]},
        rmse=rng.random((2, 2, 9)), hunts=rng.integers(0, 2, (2, 2, 9)), learn_time_reached=np.full((2, 2, 9), np.nan),
        attrs={"title": "A_title % of 5 $"},
    )  # fmt: skip


def test_cells_are_medians_with_percentiles_over_the_days(ds):
    rows = rows_of(latex_of(ds, ["rmse"]))
    for row, values in zip(rows, ds.rmse.values.reshape(4, 9), strict=True):
        assert numbers(row[-1]) == pytest.approx(np.quantile(values, [0.5, 0.1, 0.9]), abs=5e-4)
    few = rows_of(latex_of(ds.isel(day=slice(3)), ["rmse"]))
    values = ds.rmse.values[0, 0, :3]
    assert numbers(few[0][-1]) == pytest.approx([np.median(values), values.min(), values.max()], abs=5e-4)
    (single,) = rows_of(latex_of(ds.isel(day=0, tuning=0, backlash=0), ["rmse"]))
    assert single[0] == f"{values[0]:.3f}"


def test_labels_are_escaped_have_units_and_are_not_repeated(ds):
    text = latex_of(ds, ["rmse"])
    assert [row[:2] for row in rows_of(text)] == [
        ["2", r"as\_found"], ["", r"50 \% \& up"], ["7", r"as\_found"], ["", r"50 \% \& up"],
    ]  # fmt: skip
    assert r"backlash [\%] & tuning & RMS error [K] \\" in text
    assert text.count(r"\addlinespace") == 1


def test_shares_are_means_what_never_came_is_a_word_and_what_failed_takes_no_part(ds):
    rows = rows_of(latex_of(ds, ["hunts", "learn_time_reached"]))
    for row, values in zip(rows, ds.hunts.values.reshape(4, 9), strict=True):
        assert numbers(row[-2]) == pytest.approx([100 * values.mean()], abs=0.06)
        assert row[-1] == "never"
    failed = ds.copy(deep=True)
    failed.rmse[0, 0, 0], failed.status[0, 0, 0] = 1e6, 1
    failed.learn_time_reached[0, 0, 1:] = 3600.0
    assert "never" not in rows_of(latex_of(failed, ["learn_time_reached"]))[0][-1]
    text = latex_of(failed, ["rmse"])
    assert numbers(rows_of(text)[0][-1])[0] == pytest.approx(np.median(ds.rmse.values[0, 0, 1:]), abs=5e-4)
    assert "% Median (10th to 90th percentile) over 9 days; without 1 scenario, which failed." in text


def test_every_line_is_whole_latex(ds):
    """Braces close, every row has as many cells as columns, comments take nothing in, specials are escaped."""
    for text in (latex_of(ds), latex_of(ds, ["rmse", "hunts"]), latex_of(binned(drawn(80), ["kp"]), ["rmse"])):
        body = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
        (columns,) = re.findall(r"\\begin{tabular}{([lr]+)}", body)
        for row in rows_of(text):
            assert len(row) == len(columns)
        plain = re.sub(r"\\[{}$&#_%\\]", "", body)
        assert plain.count("{") == plain.count("}")
        assert plain.count("$") % 2 == 0
        assert not re.search(r"[#_%]", plain)
        assert body.isascii()


def test_the_groups_of_a_drawn_parameter_are_rows():
    given = drawn(80)
    text = latex_of(binned(given, ["kp"]), ["rmse"])
    rows, order = rows_of(text), np.argsort(given.kp.values)
    assert len(rows) == 8
    for row, members in zip(rows, np.array_split(order, 8), strict=True):
        assert numbers(row[0])[0] == pytest.approx(np.median(given.kp.values[members]), rel=5e-3)
        assert numbers(row[1])[0] == pytest.approx(np.median(given.rmse.values[:, members]), abs=6e-4)
    assert "over 2 days and 10 samples in each of 8 groups of proportional gain Kp" in text


@pytest.mark.parametrize(
    ("n", "metrics", "sentence"),
    [
        (61, ["rmse"], "--latex: 61 rows are more than a page takes, 60: fix labels, such as --at backlash=0.0"),
        (2, [*"abcdefg"], "--metric: 7 metrics are wider than a page"),
        (2, ["learning_status"], "--metric learning_status is a word, which has no median"),
        (2, ["iae"], "--metric 'iae' is not in this result"),
    ],
)
def test_what_no_page_takes_is_refused_with_the_cure(n, metrics, sentence):
    shape = (n, 3)
    ds = result(("backlash", "day"), {"backlash": np.linspace(0.0, 0.1, n)}, rmse=np.ones(shape))
    ds = ds.assign({name: ds.rmse for name in "abcdefg"})
    ds["learning_status"] = ds.rmse.assign_attrs(flag_meanings="off on")
    with pytest.raises(InputError) as caught:
        latex_of(ds, metrics)
    assert any(problem.startswith(sentence) for problem in caught.value.problems)


def test_no_letter_is_left_that_latex_would_read():
    assert escaped("a_b & 5 % − ∞ {x} \\ ~^#$") == (
        r"a\_b \& 5 \% $-$ $\infty$ \{x\} \textbackslash{} \textasciitilde{}\textasciicircum{}\#\$"
    )


@pytest.mark.parametrize(
    ("uncertainty", "decimals"),
    # of the Particle Data Group's own examples: 0.827 ± 0.119 → 0.83 ± 0.12, 0.827 ± 0.367 → 0.8 ± 0.4
    [(0.119, 2), (0.367, 1), (0.0042, 3), (3.6, 0), (250.0, 0), (0.35, 2), (0.36, 1), (0.0, None), (math.inf, None)],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves(uncertainty, decimals):
    assert decimals_of(uncertainty) == decimals


@pytest.mark.parametrize(
    ("value", "decimals", "sign", "text"),
    [(-22.4, 0, True, "−22"), (3.14, 1, True, "+3.1"), (-0.001, 1, True, "0.0"), (1234.5, None, False, "1,230"),
     (999.7, None, False, "1,000"), (0.000123, None, False, "0.000123"), (1.5e-9, None, True, "+1.5e-09"),
     (math.nan, 1, False, "–"), (-math.inf, None, True, "−∞")],
)  # fmt: skip
def test_a_number_has_a_true_minus_and_words_for_what_is_none(value, decimals, sign, text):
    assert written(value, decimals, sign=sign) == text
